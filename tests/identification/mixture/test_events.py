"""Events: what they change of the unknowns, and what they leave as it is."""

import numpy as np
import pytest

from foundation.records import read_column
from identification.mixture.evidence import weigh_evidence
from identification.mixture.force_model import (
    FRICTION_BEFORE,
    FRICTION_LAST,
    HELD,
    LAYER,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    MEMBRANE,
    MODEL_ERROR,
    TRAVERSED_COULOMB,
)
from identification.mixture.layer_report import friction_of_last_layer
from identification.mixture.mixture import CAPACITY, MixtureMemory
from tests.identification.mixture.mixtures import (
    BLOCK,
    branch,
    component,
    forces,
    select,
)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("medium", "holds_force"), [(LAYER, False), (LAYER, True), (MEMBRANE, True)]
)
def test_the_force_goes_on_across_an_event(seed, medium, holds_force):
    parent = component(seed, medium, holds_force=holds_force)
    parent_ruptures = read_column(parent.assumptions, "ruptures")[0]
    mixture = branch(parent, 0.3, int(parent_ruptures))
    children = select(mixture, slice(1, None))

    assert children.size > 2
    assert forces(children) == pytest.approx(np.repeat(forces(parent), children.size))

    new_ruptures = read_column(children.assumptions, "ruptures") - parent_ruptures

    assert set(new_ruptures) <= {0.0, 1.0}
    assert mixture.size <= CAPACITY


def test_friction_of_a_layer_traversed_stays_on_the_shaft():
    parent = component(5, LAYER)
    parent.means[0, HELD] = 0.0  # no cutting force, part of which may be friction
    mixture = branch(parent, 0.3, 1)
    ruptures = read_column(mixture.assumptions, "ruptures")
    is_end = (ruptures == 2.0) & (
        read_column(mixture.assumptions, "holds_force") == 0.0
    )
    rupture_forces = read_column(mixture.history, "rupture_force_N")[is_end]

    assert set(rupture_forces) == {BLOCK.force_before_N}

    length = BLOCK.depth_mm - 4.0
    viscous = BLOCK.speed_mm_s * parent.means[0, LAYER_VISCOUS]
    friction = length * (parent.means[0, LAYER_COULOMB] + viscous)
    expected = np.full(is_end.sum(), friction)

    assert mixture.means[is_end, FRICTION_LAST] == pytest.approx(expected)

    likely = mixture._replace(log_weights=np.where(is_end, 0.0, -50.0))
    reported = friction_of_last_layer(weigh_evidence(likely, None, 0), 2, 0.0)

    assert reported is not None
    assert reported.force_N == pytest.approx(friction)


@pytest.mark.parametrize(
    ("reported", "last", "before"), [(1, 0.16, 0.3), (0, 0.46, 0.5)]
)
def test_friction_of_an_unreported_rupture_counts_with_the_next(reported, last, before):
    # The component knows of one rupture, and has 8 mm of shaft in the layer.
    parent = component(5, LAYER)
    frictions = [LAYER_COULOMB, LAYER_VISCOUS, FRICTION_LAST, FRICTION_BEFORE]
    parent.means[0, frictions] = 0.02, 0.0, 0.3, 0.5
    parent.means[0, HELD] = 0.0
    mixture = branch(parent, 0.1, reported)
    release_start = read_column(mixture.assumptions, "release_start_mm")
    is_end = release_start == BLOCK.depth_mm

    assert is_end.any()

    ruptures = read_column(mixture.assumptions, "ruptures")[is_end]

    assert (ruptures == reported + 1.0).all()
    assert np.allclose(mixture.means[is_end, FRICTION_LAST], last)
    assert np.allclose(mixture.means[is_end, FRICTION_BEFORE], before)


def test_a_part_of_the_cutting_force_stays_on_the_shaft_as_friction():
    parent = component(5, LAYER)
    parent.means[0, HELD] = 0.0
    without = branch(parent, 0.3, 1)
    parent.means[0, HELD] = 0.1
    mixture = branch(parent, 0.3, 1)
    ruptures = read_column(mixture.assumptions, "ruptures")
    held = read_column(mixture.assumptions, "holds_force")
    is_end = (ruptures == 2.0) & (held == 0.0)
    travel_mm = BLOCK.depth_mm - parent.assumptions[0]["tip_start_mm"]
    on_shaft_N = 0.04 * (1.0 - np.exp(-travel_mm / 10.0))

    assert is_end.any()

    gained_N = mixture.means[is_end] - without.means[is_end]

    assert gained_N[:, TRAVERSED_COULOMB] == pytest.approx(on_shaft_N, rel=1e-6)
    assert gained_N[:, FRICTION_LAST] == pytest.approx(on_shaft_N, rel=1e-6)

    doubt_N2 = (
        mixture.covariances[is_end, TRAVERSED_COULOMB, TRAVERSED_COULOMB]
        - without.covariances[is_end, TRAVERSED_COULOMB, TRAVERSED_COULOMB]
    )

    assert (doubt_N2 > (0.8 * on_shaft_N) ** 2).all()


def test_a_rupture_may_change_the_slow_error_of_torque_sensors():
    # By 0.05 N where it is 0.2 N: their hysteresis turns round as the force falls.
    grown_N2 = _model_error_at_end(0.2) - _model_error_at_end(0.0)

    assert grown_N2 == pytest.approx(0.05**2)


def _model_error_at_end(force_std_N):
    """Variance of the model's error just after a layer ends, equal in all children."""
    memory = MixtureMemory(component(5, LAYER))
    block = BLOCK._replace(force_std_N=force_std_N)
    memory.branch(block, block.depth_mm - 0.3, 0.0, 1)
    ruptures = read_column(memory.mixture.assumptions, "ruptures")
    variances_N2 = memory.mixture.covariances[ruptures == 2.0, MODEL_ERROR, MODEL_ERROR]

    assert variances_N2.min() == pytest.approx(variances_N2.max())

    return float(variances_N2[0])
