"""Whether a patient moved after the landmarks were touched, or while the skin was.

For each moment at which he may have moved, landmarks and touches are fitted again with
one more unknown: a rotation and shift of the patient at that moment. How much better
they fit so, against how much they could by chance, is how probable the motion is; and
a region that should hold him also where he moved unnoticed is as wide as that takes.
"""

from typing import Any

import numpy as np
from scipy.linalg import block_diag

from foundation.arrays import Array
from needleforce.anatomy.errors import RegistrationError
from needleforce.anatomy.registration import displacement_jacobian
from needleforce.anatomy.touch_problem import (
    TUKEY,
    Fit,
    Pose,
    Problem,
    tukey_weights,
)


def allow_motion(problem: Problem, fit: Fit, covariance: Array) -> tuple[Pose, Array]:
    """Return pose and covariance of a fit where the patient may have moved unnoticed.

    He moved along or about one axis of his body, or less far along all, about all, or
    both.

    Args:
        problem: Landmarks and touches.
        fit: Their solution without a motion.
        covariance: Of the seven unknowns there, (7, 7).

    Raises:
        RegistrationError: He has probably moved.
    """
    max_probability = 0.9  # right registrations pass in 99 of 100 (seeds below 1000)
    moved = 0.5  # before anything was measured nobody knows whether he did
    between = 0.65  # of those who moved: before the touches (seeds below 1000)
    count = len(problem.touches_m)
    firsts = np.unique(np.linspace(0.0, count, 9)[:-1].astype(int))
    axes = _axes_of_motion(problem, fit.pose)
    near = 0.5 * axes
    # One axis, all, turns alone and shifts alone are equally probable.
    kinds = [*((0.25 / 6.0, axis[None]) for axis in axes)]
    kinds += [(0.25, near), (0.25, near[:3]), (0.25, near[3:])]
    priors = np.full(len(firsts), (1.0 - between) * moved / (len(firsts) - 1))
    priors[0] = between * moved
    known = np.asarray(np.linalg.inv(axes.T @ axes), dtype=np.float64)
    moments = _fit_motions(problem, fit, firsts, known)
    motions: list[Any] = []
    for prior, information, pull, follow in zip(priors, *moments, strict=True):
        for share, ways in kinds:
            # Along the ways each is of one standard deviation.
            inner = np.eye(len(ways)) + ways @ information @ ways.T
            spread = ways.T @ np.linalg.solve(inner, ways)
            gain = 0.5 * float(pull @ spread @ pull - np.linalg.slogdet(inner)[1])
            step = follow @ spread @ pull
            square = follow @ spread @ follow.T + np.outer(step, step)
            motions.append((prior * share * np.exp(min(gain, 500.0)), step, square))
    odds, steps, squares = map(np.array, zip(*motions, strict=True))
    probabilities = odds / (1.0 - moved + odds.sum())
    step = probabilities @ steps
    added = np.tensordot(probabilities, squares, axes=1) - np.outer(step, step)
    if probabilities.sum() > max_probability:
        raise RegistrationError(
            "landmarks and touches contradict each other: the patient has probably "
            f"moved (p = {probabilities.sum():.2f}); hold him still, and touch "
            "landmarks and skin again"
        )
    return problem.move(fit.pose, step), covariance + added


def _axes_of_motion(problem: Problem, pose: Pose) -> Array:
    """Return motions of a patient as rotations about the touches' mean and shifts.

    In rows three turns about the axes of the CT through his middle, and three shifts
    along them, each of one standard deviation, (6, 6).
    """
    turn_std_rad = np.radians(4.0)
    shift_std_m = 8e-3
    centre_m = problem.surface.vertices_m.mean(axis=0)
    middle_m = pose.rotation @ centre_m + pose.translation_m
    turns = turn_std_rad * pose.rotation.T
    # A turn about the middle moves the touches' mean.
    at_pivot = turns @ displacement_jacobian(problem.pivot_m - middle_m)[:, :3].T
    shifts = shift_std_m * pose.rotation.T
    return np.block([[turns, at_pivot], [np.zeros((3, 3)), shifts]])


def _fit_motions(
    problem: Problem, fit: Fit, firsts: Array, motion_information: Array
) -> list[Array]:
    """Fit landmarks and touches with a motion before each of some touches.

    The unknowns are where the model lies before the motion and how far touches press
    the surface in, with what is known of them, and the motion, with what is known of
    motions. All moments are fitted at once, and one fit beside them has no motion.

    Args:
        problem: Landmarks and touches.
        fit: Their solution without a motion.
        firsts: Numbers of the first touches behind a motion, (b,).
        motion_information: What is known of a motion, (6, 6).

    Returns:
        Information on the motion, (b, 6, 6); that times the motion that fits best,
        (b, 6); how the unknowns after a motion follow it, (b, 7, 6).
    """
    rounds = 8
    far_rounds = 5  # the first ones, in which touches count that lie far away
    fine_rounds = 2  # the last ones, with normals averaged around each place
    far_m = 20e-3  # at first so far touches count: the patient may have moved by it
    count = len(problem.touches_m)
    starts = np.append(firsts, count)
    is_moved = np.arange(count) >= starts[:, None]
    numbers = np.arange(len(starts))[:, None]
    poses = Pose(*(np.array([part] * len(starts)) for part in fit.pose))
    motions = np.zeros((len(starts), 6))
    prior = np.asarray(block_diag(problem.information, motion_information), float)
    number = 0
    while True:
        moved = problem.move(poses, np.pad(motions, ((0, 0), (0, 1))))
        # Before or after the motion, by the touch.
        pairs = [np.stack(pair, axis=1) for pair in zip(poses, moved, strict=True)]
        at_touch = Pose(*(pair[numbers, is_moved.astype(int)] for pair in pairs))
        touches = problem.measure(at_touch, is_fine=number > rounds - fine_rounds)
        rows = np.dstack([touches.rows, touches.rows[..., :6] * is_moved[..., None]])
        reach_m = max(TUKEY * problem.noise_m, far_m * 0.6**number)
        weights = tukey_weights(touches.lengths_m, reach_m)
        variance_m2 = _least_variance_m2(problem, touches.distances_m, weights, fit)
        weighted = weights[..., None] * rows / variance_m2
        hessians = np.einsum("bni,bnj->bij", rows, weighted) + prior
        off = np.hstack([problem.off_known(poses), motions])
        # A touch is off as usual or, anywhere, slipped: it counts in full up to where
        # the latter is as probable, at three standard deviations, and no further.
        usual = np.logaddexp(-0.5 * touches.lengths_m**2 / variance_m2, -4.5)
        misfits = 0.5 * np.einsum("bi,ij,bj->b", off, prior, off) - usual.sum(axis=1)
        if number == rounds:
            break
        gradients = np.einsum("bni,bn->bi", weighted, touches.distances_m) + off @ prior
        # Radians beside metres.
        scales = np.sqrt(np.einsum("bii->bi", hessians))
        scaled = hessians / (scales[:, :, None] * scales[:, None, :])
        solved = np.linalg.solve(scaled, (gradients / scales)[..., None])[..., 0]
        steps = -solved / scales
        motions = motions + steps[:, 7:]
        poses = problem.move(poses, steps[:, :7])
        number += 1
        if number == far_rounds:
            # What explains less than no motion does follows touches that slipped: it
            # begins again where there is none.
            is_lost = misfits > misfits[-1]
            for part in (motions, *poses):
                part[is_lost] = part[-1]
    gains = np.maximum(misfits[-1] - misfits, 0.0)[:-1]
    mixed = hessians[:-1, :7, 7:]
    follow = -np.linalg.solve(hessians[:-1, :7, :7], mixed)
    information = hessians[:-1, 7:, 7:] + np.swapaxes(mixed, 1, 2) @ follow
    pull = np.einsum("bij,bj->bi", information, motions[:-1])
    # Normals differ from facet to facet, so that a motion may promise to explain more
    # than its fit does: what speaks for it is what the fit explains.
    promised = 0.5 * np.vecdot(motions[:-1], pull)
    parts = np.minimum(gains / np.maximum(promised, 1e-9), 1.0)
    follow[:, :6] += np.eye(6)
    pull = pull * np.sqrt(parts)[:, None]
    return [information - motion_information, pull, follow]


def _least_variance_m2(
    problem: Problem, distances_m: Array, weights: Array, fit: Fit
) -> float:
    """Return the variance of the distances where a motion makes it the least."""
    stated = 8.0  # distances for which the stated deviations count
    totals = np.maximum(weights.sum(axis=1), 1e-9)
    observed_m2 = (weights * distances_m**2).sum(axis=1) / totals
    degrees = np.maximum((weights > 0.0).sum(axis=1) - 13.0, 0.0)
    stated_m2 = problem.stated_m2(fit.pose)
    variances_m2 = (stated * stated_m2 + degrees * observed_m2) / (stated + degrees)
    return float(variances_m2.min())
