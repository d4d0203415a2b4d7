"""Rigid registration by landmarks and touches of a surface, in one estimate.

Unknown are a small rotation and shift of the model, and how far touches press the
surface in. Each touch says how far it lies from the surface; the landmarks, and what
is known of how soft the surface is, are prior knowledge of the same unknowns, in one
set of normal equations. Tukey's weights leave out touches that slipped.

A solution is refused where the surface slides on itself, where another pose fits better
and where the patient moved, or stated with its errors. For each moment at which he may
have moved, landmarks and touches are fitted again with one more unknown: a rotation and
shift of the patient at that moment. How much better they fit so, against how much they
could by chance, is how probable the motion is; and a region that should hold him also
where he moved unnoticed is as wide as that takes.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, eigh
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from needleforce.anatomy.errors import RegistrationError, require_deviation
from needleforce.anatomy.registration import (
    MAX_LENGTH_RATIO,
    MIN_WIDTH_m,
    Registration,
    displacement_jacobian,
    rms_extents_m,
    rms_length,
)
from needleforce.anatomy.surface import Surface

# The error of a segmented surface was measured on liver, kidneys, gallbladder, bladder,
# femur and two muscles against what segmenting them at 3 mm leaves.

SURFACE_STD_m = 0.24e-3
"""Least error of such a surface where it is flat."""

SURFACE_EDGES = 5.0
"""Growth of that error towards edges: times 1 + 5 (1 - flatness)."""

SURFACE_REACH_m = 3.7e-3
"""Reach of its correlation exp(-(distance / reach)^2 / 2)."""

SPREAD_OF_SOFTNESS = 0.25
"""Standard deviation of how far single touches press a soft surface in, as a part of
how far they do on average: skin over a rib gives way less than beside it."""

TUKEY = 4.685
"""Reach of Tukey's weights in standard deviations: 95 % efficient for normal errors."""

NEARLY_STILL_m = 2e-5
"""Motion of the touches in a step after which their noise says which slipped."""


class Pose(NamedTuple):
    """Where the model lies, and how far the surface is pressed in; one or many.

    Attributes:
        rotation: From the model to the robot's base, (..., 3, 3).
        translation_m: Of the model's origin, (..., 3).
        indentation_m: Of the surface by the touches, (...).
    """

    rotation: Array
    translation_m: Array
    indentation_m: Array


class Measured(NamedTuple):
    """Touches beside the surface; each array may have further dimensions in front.

    Attributes:
        points_m: Touches, carried into the model (n, 3).
        distances_m: From the surface that is pressed in, positive outside, (n,).
        lengths_m: From the nearest place on it, (n,).
        rows: Derivatives of the distances by rotation, shift, indentation (n, 7).
        flatness: Of the surface there, 1 for a plane (n,).
    """

    points_m: Array
    distances_m: Array
    lengths_m: Array
    rows: Array
    flatness: Array


class Fit(NamedTuple):
    """A solution of the touches.

    Attributes:
        pose: The solution.
        touches: Beside the surface there.
        weights: 0 for touches that slipped, else up to 1.
        variance_m2: Of the distances.
        median_m: Median distance from the nearest place: outliers do not matter.
    """

    pose: Pose
    touches: Measured
    weights: Array
    variance_m2: float
    median_m: float

    @property
    def information(self) -> Array:
        """What the touches say of the unknowns, (7, 7)."""
        rows = self.touches.rows
        return rows.T @ (self.weights[:, None] * rows) / self.variance_m2


@dataclass(frozen=True, eq=False)
class Problem:
    """Touches of a surface, and what is known without them.

    Attributes:
        surface: Of the model.
        touches_m: In the robot's base, (n, 3).
        pivot_m: About which the model turns, (3,).
        known: The most probable pose without the touches.
        information: On a rotation about the pivot, a shift, and the indentation,
            without the touches, (7, 7).
        touch_std_m: Standard deviation of a touch along each axis.
        softness_m: By up to so much the surface is pressed in.
    """

    surface: Surface
    touches_m: Array
    pivot_m: Array
    known: Pose
    information: Array
    touch_std_m: float
    softness_m: float

    @cached_property
    def jacobian(self) -> Array:
        """Motion of the model at the touches by rotation and shift, (n, 3, 6)."""
        return displacement_jacobian(self.touches_m - self.pivot_m)

    @property
    def noise_m(self) -> float:
        """Deviation of good touches from the surface that is still usual."""
        coarse_std_m = 0.6e-3  # more than such a surface is off as a whole
        stds_m = [self.touch_std_m, coarse_std_m, SPREAD_OF_SOFTNESS * self.softness_m]
        return float(np.linalg.norm(stds_m))

    def fit(
        self,
        pose: Pose,
        known_points_m: Array | float = np.inf,
        still_m: float = NEARLY_STILL_m,
    ) -> Fit:
        """Return the solution, beginning at a pose.

        While the touches are far away all of them count; then those count nothing that
        lie further than the others do; last those that lie further than noise: many
        that slipped together would widen their own scale.

        Args:
            pose: To begin with.
            known_points_m: Touches in the model in another solution: a fit that comes
                near to it ends there.
            still_m: Motion of the touches in a step that is none.
        """
        max_rounds = 60  # a usual fit needs some 20
        wide_rounds = 12  # at most so long the touches' own distances say which slipped
        back_m = 0.5e-3  # so near to another solution it is on its way to it
        fit = self._linearise(pose, is_wide=True)
        for number in range(1, max_rounds + 1):
            last_m = fit.touches.points_m
            pose = self.move(fit.pose, self._step(fit, number))
            fit = self._linearise(pose, is_wide=number < wide_rounds)
            motion_m = rms_length(fit.touches.points_m - last_m)
            if number < wide_rounds and motion_m < NEARLY_STILL_m:
                wide_rounds = number
            is_still = number > wide_rounds + 1 and motion_m < still_m
            if is_still or rms_length(fit.touches.points_m - known_points_m) < back_m:
                break
        return fit

    def measure(self, pose: Pose, *, is_fine: bool) -> Measured:
        """Return the touches beside the surface.

        Args:
            pose: One for all touches, or one for each of them, also many times.
            is_fine: Average normals around each place, so far that they hold hardly any
                error of the surface.
        """
        rotation, place_m, indentation_m = pose
        levers_m = (self.touches_m - place_m)[..., None, :]
        points_m = (levers_m @ rotation)[..., 0, :]
        flat_m = points_m.reshape(-1, 3)
        positions_m, normals = self.surface.nearest(flat_m)
        off_m = flat_m - positions_m
        signed_m = np.vecdot(off_m, normals)
        beside_m2 = np.maximum(np.vecdot(off_m, off_m) - signed_m**2, 0.0)
        shape = points_m.shape[:-1]
        distances_m = signed_m.reshape(shape) + indentation_m
        if is_fine:
            around_m = 2.0 * SURFACE_REACH_m
            normals = self.surface.mean_normals(positions_m, normals, around_m)
        flatness = np.linalg.norm(normals, axis=1)
        normals = (normals / flatness[:, None]).reshape(points_m.shape)
        directions = (rotation @ normals[..., None])[..., 0]
        rows = np.ones((*shape, 7))
        rows[..., :6] = -np.einsum("...ni,nij->...nj", directions, self.jacobian)
        return Measured(
            points_m=points_m,
            distances_m=distances_m,
            lengths_m=np.sqrt(distances_m**2 + beside_m2.reshape(shape)),
            rows=rows,
            flatness=flatness.reshape(shape),
        )

    def _linearise(self, pose: Pose, *, is_wide: bool) -> Fit:
        """Return the touches at a pose, with distances, derivatives and weights.

        Args:
            pose: The pose.
            is_wide: Weigh by the touches' own distances, not by noise alone.
        """
        normal_mad = 1.4826  # standard deviation over median absolute deviation
        stated = 4.0  # distances for which the stated deviations count
        touches = self.measure(pose, is_fine=not is_wide)
        median_m = float(np.median(touches.lengths_m))
        scale_m = max(is_wide * normal_mad * median_m, self.noise_m)
        weights = tukey_weights(touches.lengths_m, TUKEY * scale_m)
        edges = np.average(edge_factors(touches) ** 2)
        counted = float(np.count_nonzero(weights))
        degrees = max(counted - 7.0, 0.0)
        observed_m2 = weights @ touches.distances_m**2 / max(weights.sum(), 1e-300)
        observed_m2 *= counted / max(degrees, 1.0)
        stated_m2 = self.stated_m2(pose, edges)
        variance_m2 = (stated * stated_m2 + degrees * observed_m2) / (stated + degrees)
        return Fit(pose, touches, weights, float(variance_m2), median_m)

    def stated_m2(self, pose: Pose, edges: float = 1.0) -> float:
        """Return the variance of the distances that the stated deviations make.

        Args:
            pose: How far the surface is pressed in.
            edges: Mean square of `edge_factors`.
        """
        surface_m2 = SURFACE_STD_m**2 * edges
        return float(self.touch_std_m**2 + self.spread_m2(pose) + surface_m2)

    def spread_m2(self, pose: Pose) -> float:
        """Return the variance of how far single touches press the surface in."""
        return float((SPREAD_OF_SOFTNESS * pose.indentation_m) ** 2)

    def off_known(self, pose: Pose) -> Array:
        """Return how far poses lie from what is known without the touches, (..., 7)."""
        known = self.known
        turn = Rotation.from_matrix(pose.rotation @ known.rotation.T).as_rotvec()
        pivot_in_model_m = (self.pivot_m - known.translation_m) @ known.rotation
        shift_m = pose.rotation @ pivot_in_model_m + pose.translation_m - self.pivot_m
        pressed_m = (pose.indentation_m - known.indentation_m)[..., None]
        return np.concatenate([turn, shift_m, pressed_m], axis=-1)

    def _step(self, fit: Fit, number: int) -> Array:
        """Return a step of Gauss and Newton, (7,)."""
        # What nothing holds is held by a little of what the touches do, so that a
        # sphere has a solution too.
        small_hold = 1e-6
        # Later steps are shorter: from facet to facet they would go back and forth.
        full_steps = 8.0
        rotations, shifts = np.split(np.diag(fit.information)[:6], 2)
        hold = np.repeat([rotations.sum(), shifts.sum(), 0.0], [3, 3, 1])
        information = fit.information + self.information + small_hold * np.diag(hold)
        pull = fit.touches.rows.T @ (fit.weights * fit.touches.distances_m)
        known_pull = self.information @ self.off_known(fit.pose)
        gradient = pull / fit.variance_m2 + known_pull
        scale = np.sqrt(np.diag(information))
        scaled = np.linalg.lstsq(information / np.outer(scale, scale), gradient / scale)
        return np.asarray(-scaled[0] / scale * min(1.0, full_steps / number))

    def move(self, pose: Pose, step: Array) -> Pose:
        """Return poses turned about the touches' mean, shifted and pressed in.

        Args:
            pose: One or many.
            step: A turn, a shift, and what the surface is pressed in further, (..., 7).
        """
        turn = Rotation.from_rotvec(step[..., :3]).as_matrix()
        offset_m = (pose.translation_m - self.pivot_m)[..., None]
        return Pose(
            turn @ pose.rotation,
            (turn @ offset_m)[..., 0] + self.pivot_m + step[..., 3:6],
            pose.indentation_m + step[..., 6],
        )

    def other_starts(self, pose: Pose) -> list[Pose]:
        """Return a pose turned about and shifted along each axis, either way."""
        tries = np.diag([0.2] * 3 + [12e-3] * 3 + [0.0])[:6]  # [rad], [m]
        return [self.move(pose, step) for step in (*tries, *-tries)]


def tukey_weights(lengths_m: Array, reach_m: float) -> Array:
    """Return Tukey's weights: 1 at the surface, 0 from a distance on."""
    return np.maximum(1.0 - (lengths_m / reach_m) ** 2, 0.0) ** 2


def edge_factors(touches: Measured) -> Array:
    """Return by how much the surface's error is larger at touches towards edges."""
    return 1.0 + SURFACE_EDGES * (1.0 - touches.flatness)


def state_problem(
    surface: Surface,
    touches_m: Array,
    start: Registration,
    touch_std_m: float,
    softness_m: float,
) -> Problem:
    """Return the touches, and what landmarks and the softness of the surface say.

    Args:
        surface: Of the model.
        touches_m: In the robot's base, (n, 3).
        start: By landmarks.
        touch_std_m: Standard deviation of a touch along each axis.
        softness_m: By up to so much the surface is pressed in.
    """
    pivot_m = touches_m.mean(axis=0)
    information = 1e-4 * np.eye(7)  # a hundred metres and radians: nothing
    least_known_m = 0.1  # landmarks that say less only pull at what nothing holds
    if start.tre_m(start.to_model(pivot_m)) < least_known_m:  # and not nan
        # The landmarks' shift is one of their own pivot.
        to_start = np.eye(6)
        to_start[3:] = displacement_jacobian(start.pivot_m - pivot_m)
        landmarks = np.linalg.pinv(start.covariance, hermitian=True)
        information[:6, :6] = to_start.T @ landmarks @ to_start
    # Half of the softness, plus or minus a third: none and all of it are possible.
    information[6, 6] = 1.0 / max(softness_m / 3.0, 1e-6) ** 2
    pose = Pose(start.rotation, start.translation_m, np.array(0.5 * softness_m))
    return Problem(
        surface, touches_m, pivot_m, pose, information, touch_std_m, softness_m
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


TOUCH_STD_m = 0.5e-3
"""Standard deviation of a touch along each axis, if no other one is given."""

MIN_TOUCHES = 15
"""Fewer leave too little to see which of them slipped: seven numbers are fitted."""


def fit_surface(
    surface: Surface,
    touches_m: ArrayLike,
    start: Registration,
    *,
    touch_std_m: float = TOUCH_STD_m,
    softness_m: float = 0.0,
    check: bool = True,
) -> Registration:
    """Register by touching a surface, together with a registration by landmarks.

    Args:
        surface: Of the model.
        touches_m: Places of the pointer's tip on it [m], robot's base, in the order of
            touching, shape (n, 3).
        start: By landmarks, within 20 mm, at the touches, and 20 degrees. It counts by
            its covariance: one of metres and radians says nothing.
        touch_std_m: Standard deviation of a touch along each axis.
        softness_m: By up to so much touches press the surface in: 0 for bone, 3 mm for
            skin. How far they do is estimated.
        check: Look for other solutions (four times the work), and for a patient who
            moved.

    Raises:
        RegistrationError: Too few or narrow touches, millimetres for metres, a
            deviation that is none; too many touches off the surface, or the middle one
            further than noise; a surface along which the solution slides or spins;
            another solution that fits as well or better, or one half as far again from
            the start as that may be; a patient who moved between landmarks and
            touches, or while he was touched.
    """
    touches = _checked_touches(surface, touches_m, touch_std_m)
    if not 0.0 <= softness_m < 0.02:
        raise RegistrationError(
            f"softness_m={softness_m!r}: expected 0 or some millimetres, in metres, "
            "below 0.02",
            "Give it in metres, above zero and below 0.1.",
        )
    problem = state_problem(surface, touches, start, touch_std_m, softness_m)
    fit = problem.fit(problem.known, still_m=1e-7)
    if fit.median_m > problem.noise_m:
        fits = map(problem.fit, problem.other_starts(problem.known))
        fit = min(fits, key=lambda other: other.median_m)
    # With more, what is left may be a part of another surface.
    max_outliers = 0.35
    outliers = float(np.mean(fit.weights == 0.0))
    if outliers > max_outliers or fit.median_m > problem.noise_m:
        raise RegistrationError(
            f"{100.0 * outliers:.0f} % of the touches do not lie on the surface, half "
            f"of all {1e3 * fit.median_m:.1f} mm or more away, expected "
            f"{1e3 * problem.noise_m:.1f} at most: the patient has moved, it is "
            "another organ, the start is too far away, or touch_std_m is too small"
        )
    if check:
        _require_one_solution(problem, fit)
    _require_near_start(problem, fit)
    return _registration(problem, fit, start.degrees, check=check)


def _checked_touches(surface: Surface, touches_m: ArrayLike, std_m: float) -> Array:
    """Return touches that could register."""
    require_deviation("touch_std_m", std_m, RegistrationError)
    touches = np.asarray(touches_m, dtype=float)
    is_list = touches.ndim == 2 and touches.shape[1:] == (3,)
    if not is_list or not np.isfinite(touches).all() or len(touches) < MIN_TOUCHES:
        raise RegistrationError(
            f"touches of shape {touches.shape}: expected finite (n, 3), "
            f"{MIN_TOUCHES} or more"
        )
    max_length_m = 5.0  # beyond it the unit is not the metre
    spread_m = float(np.linalg.norm(np.ptp(touches, axis=0)))
    extent_m = float(surface.mesh.scale)
    is_large = spread_m > MAX_LENGTH_RATIO * extent_m
    if (
        is_large
        or max(spread_m, extent_m) > max_length_m
        or rms_extents_m(touches)[1] < MIN_WIDTH_m
    ):
        raise RegistrationError(
            f"the touches spread over {spread_m:.3g} m, the surface over "
            f"{extent_m:.3g} m: millimetres for metres, or near a point or a line"
        )
    return touches


def _require_near_start(problem: Problem, fit: Fit) -> None:
    """Refuse a solution so far from the start that it may be another one's.

    An organ that is nearly symmetric fits as well half a turn off.
    """
    max_turn_deg = 30.0  # the promise, and half as much
    max_shift_m = 30e-3  # likewise
    turn_rad, shift_m = np.split(problem.off_known(fit.pose)[:6], 2)
    turn_deg = float(np.degrees(np.linalg.norm(turn_rad)))
    if turn_deg > max_turn_deg or np.linalg.norm(shift_m) > max_shift_m:
        raise RegistrationError(
            f"the solution is turned by {turn_deg:.0f} degrees and shifted by "
            f"{1e3 * np.linalg.norm(shift_m):.0f} mm from the start: expected "
            f"{max_turn_deg:g} and {1e3 * max_shift_m:g} at most",
            "Register by landmarks again.",
        )


def _require_one_solution(problem: Problem, fit: Fit) -> None:
    """Refuse a solution that slides along the surface, or beside which one fits better.

    It is pushed along the directions along which distances change least, each a root
    mean square of 1 at the touches.
    """
    push_m = 6e-3
    max_stay = 0.5  # part of the push that may be left after fitting again
    same_fit = 1.3  # ratio of distances up to which a pushed solution fits as well
    fine_fit = 0.35  # part of the noise below which distances are not compared
    weak_directions = 3  # a sphere spins about three axes, a plane slides and spins
    far_m = 4e-3  # another solution is another if it lies so far away at the touches
    better_fit = 0.9  # ratio of distances below which another solution fits better
    jacobian = problem.jacobian
    motion = np.einsum("nij,nik->jk", jacobian, jacobian) / len(jacobian)
    information = fit.information + problem.information
    # What is left where the indentation may be any.
    mixed = information[:6, 6]
    pose_information = information[:6, :6] - np.outer(mixed, mixed) / information[6, 6]
    directions = eigh(pose_information, motion)[1][:, :weak_directions].T
    same_m = same_fit * max(fit.median_m, fine_fit * problem.noise_m)
    pushed = [
        (
            problem.move(fit.pose, np.append(push_m * way, 0.0)),
            max_stay * push_m,
            same_m,
        )
        for way in directions
    ]
    others = [
        (pose, far_m, better_fit * fit.median_m)
        for pose in problem.other_starts(fit.pose)
    ]
    for pose, least_m, max_median_m in [*pushed, *others]:
        other = problem.fit(pose, fit.touches.points_m)
        away_m = rms_length(other.touches.points_m - fit.touches.points_m)
        if away_m > least_m and other.median_m < max_median_m:
            raise RegistrationError(
                f"another solution, {1e3 * away_m:.1f} mm away, fits as well: the "
                "surface slides or spins on itself, or the start lies too far away",
                "Touch a part with edges or another shape, or register by "
                "landmarks again.",
            )


def _registration(
    problem: Problem, fit: Fit, start_degrees: float, *, check: bool
) -> Registration:
    """Return the registration of a fit, with the covariance of its errors.

    They are those of the touches, correlated ones of the surface, those of what is
    known without them, and what a patient who may have moved adds. Touches that slipped
    add nothing.

    Raises:
        RegistrationError: The patient has moved.
    """
    touches = fit.touches
    inverse = np.linalg.pinv(fit.information + problem.information, hermitian=True)
    edges = edge_factors(touches)
    mean_edges = np.average(edges**2, weights=fit.weights)
    iid_m2 = problem.touch_std_m**2 + problem.spread_m2(fit.pose)
    flat_m2 = max((fit.variance_m2 - iid_m2) / mean_edges, SURFACE_STD_m**2)
    apart = cdist(touches.points_m, touches.points_m) / SURFACE_REACH_m
    errors_m2 = flat_m2 * np.outer(edges, edges) * np.exp(-0.5 * apart**2)
    errors_m2 += min(iid_m2, fit.variance_m2) * np.eye(len(apart))
    gain = touches.rows.T * (fit.weights / fit.variance_m2)
    errors = gain @ errors_m2 @ gain.T + problem.information
    covariance = inverse @ errors @ inverse
    pose = fit.pose
    if check:
        pose, covariance = allow_motion(problem, fit, covariance)
    # Degrees of freedom of several sources together (Satterthwaite 1946).
    parts = [fit.information, problem.information]
    shares = np.array([np.trace(inverse @ part) for part in parts])
    is_counted = fit.weights > 0.0
    own_degrees = max(np.count_nonzero(is_counted) - 7.0, 1.0)
    squares = (shares / shares.sum()) ** 2 / [own_degrees, start_degrees]
    return Registration(
        rotation=pose.rotation,
        translation_m=pose.translation_m,
        covariance=covariance[:6, :6],
        pivot_m=problem.pivot_m,
        degrees=float(1.0 / squares.sum()),
        residual_rms_m=float(np.sqrt(np.mean(touches.distances_m[is_counted] ** 2))),
        indentation_m=float(pose.indentation_m),
        indentation_std_m=float(np.sqrt(covariance[6, 6])),
    )
