"""Whether a patient moved after the landmarks were touched, or while the skin was.

What was measured before some moment says where the model lies, and what was measured
behind it says so once more. A patient who lay still is at one place: how far the two
differ, against what their covariances allow, is tested; and a region that should hold
him also where he moved unnoticed is as wide as that takes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.registration import displacement_jacobian

MOVED = 0.1
"""Probability that a patient moved, before anything was measured: half of it between
landmarks and touches."""


class Innovation(NamedTuple):
    """What touches say beyond all that was measured before them.

    The unknowns are a rotation about a pivot, a shift, and how far touches press the
    surface in; as differences from where the earlier measurements put them.

    Attributes:
        first: Number of the first of these touches, 0 for all of them.
        before: Information of the earlier measurements, (7, 7).
        touches: Information of the touches, (7, 7).
        pull: That information times where the touches put the unknowns, (7,).
    """

    first: int
    before: Array
    touches: Array
    pull: Array


class PatientMotion(NamedTuple):
    """How probable it is that the patient moved, and what that means.

    Attributes:
        probability: That he did.
        step: How far the unknowns then lie from where they are without a motion,
            times the probability, (7,).
        covariance: Of the unknowns if he did, times the probability, and what the
            differing places add, (7, 7).
        first: Number of the first touch behind the most probable motion, 0 for one
            between landmarks and touches.
        motion: The most probable one, a rotation and a shift, (6,).
    """

    probability: float
    step: Array
    covariance: Array
    first: int
    motion: Array


def axes_of_motion(rotation: Array, middle_m: Array, pivot_m: Array) -> Array:
    """Return motions of a patient as rotations about a pivot and shifts, (6, 7).

    In rows three turns about the axes of the CT through his middle, and three shifts
    along them, each of one standard deviation. The last column, of how far touches
    press the surface in, is zero.

    Args:
        rotation: From the CT to the robot's base, (3, 3).
        middle_m: Of the patient, in the base, (3,).
        pivot_m: Of the rotations, in the base, (3,).
    """
    turn_std_rad = np.radians(5.0)
    shift_std_m = 10e-3
    axes = np.zeros((6, 7))
    axes[:3, :3] = turn_std_rad * rotation.T
    # A turn about the middle moves the pivot.
    at_pivot = displacement_jacobian(pivot_m - middle_m)
    axes[:3, 3:6] = axes[:3, :6] @ at_pivot.T
    axes[3:, 3:6] = shift_std_m * rotation.T
    return axes


def find_motion(innovations: Sequence[Innovation], axes: Array) -> PatientMotion:
    """Return how probable it is that the patient moved.

    He moved along or about one of some axes, or along and about all of them, far or
    less far.

    Args:
        innovations: Of the touches behind each moment at which he may have moved, the
            first of which is that before all touches.
        axes: Of motion, each of one standard deviation, see `axes_of_motion`.
    """
    kinds = [*(axis[None] for axis in axes), axes, 0.4 * axes]
    priors = np.full(len(innovations), 0.5 * MOVED / max(len(innovations) - 1, 1))
    priors[0] = 0.5 * MOVED
    odds = np.zeros((len(innovations), len(kinds)))
    steps = np.zeros((len(innovations), len(kinds), 7))
    spreads = np.zeros((len(innovations), len(kinds), 7, 7))
    for number, one in enumerate(innovations):
        before = np.asarray(np.linalg.inv(one.before), dtype=np.float64)
        still = _evidence(one, before)
        for kind, ways in enumerate(kinds):
            wider = np.asarray(before + ways.T @ ways, dtype=np.float64)
            moved = _evidence(one, wider)
            gain = min(moved.log - still.log, 500.0)
            odds[number, kind] = priors[number] / len(kinds) * np.exp(gain)
            steps[number, kind] = moved.mean - still.mean
            spreads[number, kind] = moved.covariance
    probabilities = odds / (1.0 - MOVED + odds.sum())
    step = np.einsum("fk,fkn->n", probabilities, steps)
    means = np.einsum("fk,fkn,fkm->nm", probabilities, steps, steps)
    covariance = np.einsum("fk,fknm->nm", probabilities, spreads) + means
    best_number, best_kind = divmod(int(odds.argmax()), len(kinds))
    return PatientMotion(
        probability=float(probabilities.sum()),
        step=step,
        covariance=covariance - np.outer(step, step),
        first=innovations[best_number].first,
        motion=steps[best_number, best_kind][:6],
    )


class _Evidence(NamedTuple):
    """The unknowns by all measurements, if the earlier ones have some covariance.

    Attributes:
        log: Logarithm of the probability of what was touched, up to a constant.
        mean: Of the unknowns, (7,).
        covariance: Of the unknowns, (7, 7).
    """

    log: float
    mean: Array
    covariance: Array


def _evidence(one: Innovation, before: Array) -> _Evidence:
    """Return the unknowns where the earlier measurements have a covariance (7, 7)."""
    factor = np.eye(7) + before @ one.touches
    covariance = np.asarray(np.linalg.solve(factor, before), dtype=np.float64)
    mean = covariance @ one.pull
    log = 0.5 * float(one.pull @ mean) - 0.5 * float(np.linalg.slogdet(factor)[1])
    return _Evidence(log, mean, covariance)
