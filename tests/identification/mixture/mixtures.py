"""Mixtures of one component, made for tests."""

import numpy as np

from foundation.records import read_column
from identification.mixture.block import Block
from identification.mixture.force_model import (
    LAYER,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    STIFFNESS,
    UNKNOWNS,
    regressor,
)
from identification.mixture.mixture import Mixture, MixtureMemory, first_mixture

BLOCK = Block(
    time_s=3.0,
    duration_s=0.01,
    depth_mm=12.0,
    speed_mm_s=4.0,
    deflection=1.0,
    force_N=0.9,
    usual_speed_mm_s=4.0,
    noise_std_N=0.01,
    force_before_N=1.1,
)


def set_fields(records, **values):
    """Set fields of all records of an array."""
    for name, value in values.items():
        read_column(records, name)[:] = value


def component(seed, medium, *, holds_force=False):
    """A mixture of one component that has been in its layer for a while."""
    rng = np.random.default_rng(seed)
    factor = 0.05 * rng.standard_normal((UNKNOWNS, UNKNOWNS))
    means = 0.1 * np.abs(rng.standard_normal((1, UNKNOWNS)))
    mixture = first_mixture()
    set_fields(
        mixture.assumptions,
        medium=medium,
        layer_start_mm=4.0,
        tip_start_mm=5.0,
        holds_force=holds_force,
    )
    if medium == LAYER:
        set_fields(
            mixture.assumptions,
            release_start_mm=5.0,
            release_length_mm=0.3,
            ruptures=1.0,
        )
    else:
        means[0, [LAYER_COULOMB, LAYER_VISCOUS, STIFFNESS]] = 0.0
    return mixture._replace(means=means, covariances=(factor @ factor.T)[None])


def branch(mixture, travel_mm, reported):
    """The mixture with what may have happened over a travel before `BLOCK`."""
    memory = MixtureMemory(mixture)
    memory.branch(BLOCK, BLOCK.depth_mm - travel_mm, 0.0, reported)
    return memory.mixture


def select(mixture, rows):
    """The components of some rows."""
    return Mixture(*(np.ascontiguousarray(array[rows]) for array in mixture.arrays))


def forces(mixture):
    """Force that each component predicts at `BLOCK`, shape (n,)."""
    rows = np.array(
        [regressor(assumption, BLOCK) for assumption in mixture.assumptions]
    )
    return np.einsum("ni,ni->n", rows, mixture.means)
