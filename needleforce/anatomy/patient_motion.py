"""Whether a patient moved after the landmarks were touched, or while the skin was.

A patient who moved by m between two touches puts all later ones beside the earlier ones
and the landmarks by J m. For every touch before which he may have moved, and every axis
of the patient along or about which, m is one more unknown of the same normal equations;
how much better they then fit, against how well any m would have fitted, says how
probable that is (a Bayes factor, in closed form).
"""

from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.registration import displacement_jacobian

MOVED = 0.1
"""Probability that a patient moved, before anything was measured: half of it between
landmarks and touches."""

SHIFT_STD_m = 10e-3
"""Standard deviation of a shift, if he moved."""

TURN_STD_rad = np.radians(5.0)
"""Of a turn about the middle of the body."""

EDGE_TOUCHES = 4
"""Fewer touches before or behind a motion are taken for some that slipped."""


class TouchEquations(NamedTuple):
    """Normal equations of touches at their solution.

    Attributes:
        rows: Derivatives of the distances by the n unknowns, of which the first six are
            a rotation about a pivot and a shift, (touches, n).
        distances_m: From the surface, in the order of touching, (touches,).
        weights: 0 for touches that slipped, else up to 1, (touches,).
        variance_m2: Of the distances.
        degrees: Of freedom of that variance.
        information: Of the unknowns by touches, landmarks and all else, (n, n).
    """

    rows: Array
    distances_m: Array
    weights: Array
    variance_m2: float
    degrees: float
    information: Array


class PatientMotion(NamedTuple):
    """How probable it is that the patient moved, and what that means.

    Attributes:
        probability: That he did.
        step: What the unknowns are off on average, as he lies now, (n,).
        covariance: What this adds to theirs, (n, n).
        first: Number of the first touch behind the most probable motion, 0 for one
            between landmarks and touches.
        size_m: Of that motion, at the touches.
    """

    probability: float
    step: Array
    covariance: Array
    first: int
    size_m: float


def axes_of_motion(rotation: Array, middle_m: Array, pivot_m: Array) -> Array:
    """Return motions of a patient as rotations about a pivot and shifts, (6, 6).

    In rows three turns about the axes of the CT through his middle, and three shifts
    along them, each of one standard deviation.

    Args:
        rotation: From the CT to the robot's base, (3, 3).
        middle_m: Of the patient, in the base, (3,).
        pivot_m: Of the rotations, in the base, (3,).
    """
    axes = np.zeros((6, 6))
    axes[:3, :3] = TURN_STD_rad * rotation.T
    # A turn about the middle moves the pivot.
    at_pivot = displacement_jacobian(pivot_m - middle_m)
    axes[:3, 3:] = axes[:3] @ at_pivot.T
    axes[3:, 3:] = SHIFT_STD_m * rotation.T
    return axes


def find_motion(touches: TouchEquations, axes: Array, moved: Array) -> PatientMotion:
    """Return how probable it is that the patient moved.

    Args:
        touches: Equations of one solution for all.
        axes: Of motion, see `axes_of_motion`, (m, 6).
        moved: Displacement of the touches by rotation and shift, (touches, 3, 6).
    """
    count, unknowns = touches.rows.shape
    firsts = np.array([0, *range(EDGE_TOUCHES, count - EDGE_TOUCHES + 1)])
    prior = np.full((len(firsts), len(axes)), 0.5 * MOVED / len(axes))
    prior[1:] /= max(len(firsts) - 1, 1)
    weighted = touches.weights[:, None] / touches.variance_m2 * touches.rows
    # Per axis, what every touch behind the motion adds; summed from the last one.
    effects = touches.rows[:, :6] @ axes.T  # (touches, m)
    scale = touches.weights[:, None] / touches.variance_m2
    of_self = _sum_behind(scale * effects**2, firsts)
    of_residual = -_sum_behind(scale * effects * touches.distances_m[:, None], firsts)
    with_others = _sum_behind(effects[:, :, None] * weighted[:, None, :], firsts)
    covariance = np.linalg.inv(touches.information)
    responses = with_others @ covariance  # (firsts, m, n)
    fisher = of_self - np.vecdot(responses, with_others)
    precision = 1.0 + np.maximum(fisher, 0.0)
    amounts = of_residual / precision
    gains = of_residual * amounts
    # Between touches and landmarks deviations are stated; among touches they are those
    # of the touches themselves, which a motion makes larger: Student's law.
    degrees = touches.degrees
    logs = 0.5 * gains
    part = np.minimum(gains[1:] / degrees, 0.999)
    logs[1:] = -0.5 * degrees * np.log1p(-part)
    odds = prior * np.exp(np.minimum(logs - 0.5 * np.log(precision), 500.0))
    odds /= 1.0 - MOVED + odds.sum()
    ways = -responses
    ways[:, :, :6] += axes
    step = np.einsum("fm,fmn->n", odds * amounts, ways)
    squares = odds * (amounts**2 + 1.0 / precision)
    spread = np.einsum("fm,fmn,fmk->nk", squares, ways, ways)
    best = np.unravel_index(int(odds.argmax()), odds.shape)
    motion_m = amounts[best] * (moved @ axes[best[1]])
    return PatientMotion(
        probability=float(odds.sum()),
        step=step,
        covariance=spread - np.outer(step, step),
        first=int(firsts[best[0]]),
        size_m=float(np.sqrt((motion_m**2).sum(axis=1).mean())),
    )


def _sum_behind(values: Array, firsts: Array) -> Array:
    """Return sums of values from each of some numbers to the last."""
    return np.cumsum(values[::-1], axis=0)[::-1][firsts]
