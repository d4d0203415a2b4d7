"""Rigid registration by landmarks and touches of a surface, in one estimate.

Unknown are a small rotation and shift of the model, and how far touches press the
surface in. Each touch says how far it lies from the surface; the landmarks, and what
is known of how soft the surface is, are prior knowledge of the same unknowns, so one
set of normal equations holds all. Tukey's weights leave out touches that slipped.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from needleforce.anatomy.errors import (
    TOUCH_MORE,
    RegistrationError,
    require_deviation,
)
from needleforce.anatomy.patient_motion import (
    Innovation,
    PatientMotion,
    axes_of_motion,
    find_motion,
)
from needleforce.anatomy.registration import (
    MAX_LENGTH_RATIO,
    MIN_WIDTH_m,
    Registration,
    displacement_jacobian,
    rms_extents_m,
    rms_length,
    small_turn,
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


TOUCH_STD_m = 0.5e-3
"""Standard deviation of a touch along each axis, if no other one is given."""

SPREAD_OF_SOFTNESS = 0.25
"""Standard deviation of how far single touches press a soft surface in, as a part of
how far they do on average: skin over a rib gives way less than beside it."""

MIN_TOUCHES = 15
"""Fewer leave too little to see which of them slipped: seven numbers are fitted."""

NEARLY_STILL_m = 2e-5
"""Motion of the touches in a step after which their noise says which slipped."""


class _Pose(NamedTuple):
    """Where the model lies, and how far the surface is pressed in.

    Attributes:
        rotation: From the model to the robot's base, (3, 3).
        translation_m: Of the model's origin, (3,).
        indentation_m: Of the surface by the touches.
    """

    rotation: Array
    translation_m: Array
    indentation_m: float


class _Fit(NamedTuple):
    """A solution of the touches.

    Attributes:
        pose: The solution.
        points_m: Touches, carried into the model (n, 3).
        rows: Derivatives of the distances by rotation, shift, indentation (n, 7).
        flatness: Of the surface there, 1 for a plane (n,).
        distances_m: Of the touches from the surface that is pressed in, positive
            outside.
        weights: 0 for touches that slipped, else up to 1.
        variance_m2: Of these distances.
        misfit_m2: Half the sum of their squares, of those that slipped the most that
            counts.
        off_prior: From what is known without the touches to the solution, (7,).
        median_m: Median distance from the nearest place: outliers do not matter.
    """

    pose: _Pose
    points_m: Array
    rows: Array
    flatness: Array
    distances_m: Array
    weights: Array
    variance_m2: float
    misfit_m2: float
    off_prior: Array
    median_m: float


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
        start: By landmarks, within some 20 mm and 20 degrees. It counts by its
            covariance: one of metres and radians says nothing.
        touch_std_m: Standard deviation of a touch along each axis.
        softness_m: By up to so much touches press the surface in: 0 for bone, 3 mm for
            skin. How far they do is estimated.
        check: Look for other solutions (four times the work), and for a patient who
            moved.

    Raises:
        RegistrationError: Too few or narrow touches, millimetres for metres, a
            deviation that is none; too many touches off the surface, or the middle one
            further than noise; a surface along which the solution slides or spins;
            another solution that fits as well or better; a patient who moved between
            landmarks and touches, or while he was touched.
    """
    touches = _checked_touches(surface, touches_m, touch_std_m)
    if not 0.0 <= softness_m < 0.02:
        raise RegistrationError(
            f"softness_m={softness_m!r}: expected 0 or some millimetres, in metres, "
            "below 0.02",
            "Give it in metres, above zero and below 0.1.",
        )
    pivot_m = touches.mean(axis=0)
    prior = _prior_of(start, pivot_m, softness_m)
    problem = _Problem(surface, touches, pivot_m, prior, touch_std_m, softness_m)
    fit = problem.fit(problem.prior.pose, still_m=1e-7)
    if fit.median_m > problem.noise_m:
        fits = [problem.fit(pose) for pose in problem.other_starts(problem.prior.pose)]
        fit = min(fits, key=lambda other: other.median_m)
    # With more, what is left may be a part of another surface.
    max_outliers = 0.35
    outliers = float(np.mean(fit.weights == 0.0))
    if outliers > max_outliers:
        raise RegistrationError(
            f"{100.0 * outliers:.0f} % of the touches do not lie on the surface: the "
            "patient has moved, it is another organ, or the start is too far away",
            "Check that it is this organ and that the patient has not moved; "
            "register by landmarks again.",
        )
    if fit.median_m > problem.noise_m:
        raise RegistrationError(
            f"half of the touches lie {1e3 * fit.median_m:.1f} mm or more from the "
            f"surface, expected {1e3 * problem.noise_m:.1f} at most: the patient has "
            "moved, it is another organ, or touch_std_m is too small",
            "Check that it is this organ and that the patient has not moved; "
            "register by landmarks again.",
        )
    if check:
        _require_no_sliding(problem, fit)
        _require_no_better(problem, fit)
    return _registration(problem, fit, start.degrees, check=check)


def _checked_touches(surface: Surface, touches_m: ArrayLike, std_m: float) -> Array:
    """Return touches that could register."""
    require_deviation("touch_std_m", std_m, RegistrationError)
    touches = np.asarray(touches_m, dtype=float)
    if touches.ndim != 2 or touches.shape[1:] != (3,) or not np.isfinite(touches).all():
        raise RegistrationError(
            f"touches of shape {touches.shape}: expected finite (n, 3)",
            TOUCH_MORE,
        )
    if len(touches) < MIN_TOUCHES:
        raise RegistrationError(
            f"too few touches: {len(touches)}, expected {MIN_TOUCHES} or more",
            TOUCH_MORE,
        )
    max_spread_m = 5.0  # beyond it the unit is not the metre
    spread_m = float(np.linalg.norm(np.ptp(touches, axis=0)))
    extent_m = float(surface.mesh.scale)
    is_too_large = max(spread_m, extent_m) > max_spread_m
    if is_too_large or spread_m / extent_m > MAX_LENGTH_RATIO:
        raise RegistrationError(
            f"the touches spread over {spread_m:.3g} m, the surface over "
            f"{extent_m:.3g} m: millimetres for metres?",
            TOUCH_MORE,
        )
    _, width_m, _ = rms_extents_m(touches)
    if width_m < MIN_WIDTH_m:
        raise RegistrationError(
            f"the touches spread over {1e3 * spread_m:.3g} mm, near a point or a line",
            TOUCH_MORE,
        )
    return touches


class _Prior(NamedTuple):
    """What is known without the touches.

    Attributes:
        pose: The most probable one.
        information: Of a rotation about the touches' mean, a shift, and the
            indentation, (7, 7).
    """

    pose: _Pose
    information: Array


@dataclass(frozen=True, eq=False)
class _Problem:
    """Touches of a surface, and what is known without them.

    Attributes:
        surface: Of the model.
        touches_m: In the robot's base, (n, 3).
        pivot_m: About which the model turns, (3,).
        prior: What is known without the touches.
        touch_std_m: Standard deviation of a touch along each axis.
        softness_m: By up to so much the surface is pressed in.
    """

    surface: Surface
    touches_m: Array
    pivot_m: Array
    prior: _Prior
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
        spread_m = SPREAD_OF_SOFTNESS * self.softness_m
        return float(np.linalg.norm([self.touch_std_m, coarse_std_m, spread_m]))

    def fit(
        self,
        pose: _Pose,
        known_points_m: Array | None = None,
        still_m: float = NEARLY_STILL_m,
    ) -> _Fit:
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
        rounds = 0
        fit = self._linearise(pose, is_wide=True)
        while True:
            rounds += 1
            pose = self.move(fit.pose, self._step(fit, rounds))
            points_m = fit.points_m
            fit = self._linearise(pose, is_wide=rounds < wide_rounds)
            motion_m = rms_length(fit.points_m - points_m)
            if rounds < wide_rounds and motion_m < NEARLY_STILL_m:
                wide_rounds = rounds
            is_still = rounds > wide_rounds + 1 and motion_m < still_m
            is_known = (
                known_points_m is not None
                and rms_length(fit.points_m - known_points_m) < back_m
            )
            if is_still or is_known or rounds == max_rounds:
                return fit

    def _linearise(self, pose: _Pose, *, is_wide: bool) -> _Fit:
        """Return the touches at a pose, with distances, derivatives and weights.

        Args:
            pose: The pose.
            is_wide: Weigh by the touches' own distances, not by noise alone.
        """
        tukey = 4.685  # in standard deviations: 95 % efficient for normal errors
        normal_mad = 1.4826  # standard deviation over median absolute deviation
        points_m = (self.touches_m - pose.translation_m) @ pose.rotation
        positions_m, normals = self.surface.nearest(points_m)
        off_m = points_m - positions_m
        signed_m = np.vecdot(off_m, normals)
        distances_m = signed_m + pose.indentation_m
        beside_m2 = np.maximum(np.vecdot(off_m, off_m) - signed_m**2, 0.0)
        lengths_m = np.sqrt(distances_m**2 + beside_m2)
        median_m = float(np.median(lengths_m))
        scale_m = max(normal_mad * median_m, self.noise_m) if is_wide else self.noise_m
        if not is_wide:
            # Averaged so far around, normals hold hardly any error of the surface.
            around_m = 2.0 * SURFACE_REACH_m
            normals = self.surface.mean_normals(positions_m, normals, around_m)
        flatness = np.linalg.norm(normals, axis=1)
        reach_m = tukey * scale_m
        near = 1.0 - np.minimum(lengths_m / reach_m, 1.0) ** 2
        weights = near**2
        directions = normals / flatness[:, None] @ pose.rotation.T
        rows = np.ones((len(points_m), 7))
        rows[:, :6] = -np.einsum("ni,nij->nj", directions, self.jacobian)
        return _Fit(
            pose=pose,
            points_m=points_m,
            rows=rows,
            flatness=flatness,
            distances_m=distances_m,
            weights=weights,
            variance_m2=self._variance_m2(pose, distances_m, weights, flatness),
            misfit_m2=float(reach_m**2 / 6.0 * (1.0 - near**3).sum()),
            off_prior=self._off_prior(pose),
            median_m=median_m,
        )

    def spread_m2(self, pose: _Pose) -> float:
        """Return the variance of how far single touches press the surface in."""
        return (SPREAD_OF_SOFTNESS * pose.indentation_m) ** 2

    def _variance_m2(
        self, pose: _Pose, distances_m: Array, weights: Array, flatness: Array
    ) -> float:
        """Return the variance of distances, by themselves and by what is stated."""
        stated = 4.0  # distances for which the stated deviations count
        edges = 1.0 + SURFACE_EDGES * (1.0 - flatness)
        surface_m2 = SURFACE_STD_m**2 * np.average(edges**2)
        stated_m2 = self.touch_std_m**2 + self.spread_m2(pose) + surface_m2
        total = float(weights.sum())
        counted = float(np.count_nonzero(weights))
        degrees = max(counted - 7.0, 0.0)
        observed_m2 = weights @ distances_m**2 / total if total > 0.0 else 0.0
        observed_m2 *= counted / max(degrees, 1.0)
        return float((stated * stated_m2 + degrees * observed_m2) / (stated + degrees))

    def _off_prior(self, pose: _Pose) -> Array:
        """Return how far a pose lies from what is known without the touches, (7,)."""
        known = self.prior.pose
        turn = small_turn(pose.rotation @ known.rotation.T)
        pivot_in_model_m = (self.pivot_m - known.translation_m) @ known.rotation
        shift_m = pose.rotation @ pivot_in_model_m + pose.translation_m - self.pivot_m
        indentation_m = pose.indentation_m - known.indentation_m
        return np.concatenate([turn, shift_m, [indentation_m]])

    def _step(self, fit: _Fit, number: int) -> Array:
        """Return a step of Gauss and Newton, (7,)."""
        information = self.touch_information(fit)
        # What nothing holds is held by a little of what the touches do, so that a
        # sphere has a solution too.
        small_hold = 1e-6
        rotations, shifts = np.split(np.diag(information)[:6], 2)
        hold = np.repeat([rotations.sum(), shifts.sum(), 0.0], [3, 3, 1])
        information = information + self.prior.information + small_hold * np.diag(hold)
        gradient = fit.rows.T @ (fit.weights * fit.distances_m) / fit.variance_m2
        gradient = gradient + self.prior.information @ fit.off_prior
        # Later steps are shorter: from facet to facet they would go back and forth.
        full_steps = 8.0
        scale = np.sqrt(np.diag(information))  # radians beside metres
        scaled = np.linalg.lstsq(information / np.outer(scale, scale), gradient / scale)
        step = -scaled[0] / scale
        return np.asarray(step * min(1.0, full_steps / number), dtype=np.float64)

    def touch_information(self, fit: _Fit) -> Array:
        """Return what the touches say of the unknowns, (7, 7)."""
        return fit.rows.T @ (fit.weights[:, None] * fit.rows) / fit.variance_m2

    def tempered_information(self, fit: _Fit, other: _Pose) -> Array:
        """Return what the touches say, no more than their distances bear out.

        Where a smooth surface slides along itself, normals that differ from facet to
        facet look like information. How much worse the touches really fit at another
        pose shows it.

        Args:
            fit: The solution.
            other: The other pose.
        """
        information = self.touch_information(fit)
        way = self._off_prior(other) - fit.off_prior
        expected = way @ (
            0.5 * information @ way - self.prior.information @ fit.off_prior
        )
        if expected < 1.0:
            return information
        elsewhere = self._linearise(other, is_wide=False)
        found = elsewhere.misfit_m2 - fit.misfit_m2
        least = 0.02  # of a fit that slides away, it keeps the equations solvable
        part = min(max(found / fit.variance_m2 / expected, least), 1.0)
        return part * information

    def move(self, pose: _Pose, step: Array) -> _Pose:
        """Return a pose turned about the touches' mean, shifted and pressed in."""
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        offset_m = pose.translation_m - self.pivot_m
        return _Pose(
            turn @ pose.rotation,
            turn @ offset_m + self.pivot_m + step[3:6],
            pose.indentation_m + float(step[6]),
        )

    def other_starts(self, pose: _Pose) -> Iterator[_Pose]:
        """Yield a pose turned about and shifted along each axis, either way."""
        tries = np.diag([0.2] * 3 + [12e-3] * 3 + [0.0])[:6]  # [rad], [m]
        for step in (*tries, *-tries):
            yield self.move(pose, step)


def _prior_of(start: Registration, pivot_m: Array, softness_m: float) -> _Prior:
    """Return what landmarks and the softness of the surface say.

    Args:
        start: By landmarks.
        pivot_m: About which the model turns, (3,).
        softness_m: By up to so much the surface is pressed in.
    """
    information = 1e-4 * np.eye(7)  # a hundred metres and radians: nothing
    least_known_m = 0.1  # landmarks that say less only pull at what nothing holds
    if start.tre_m(start.to_model(pivot_m)) < least_known_m:  # and not nan
        # The landmarks' shift is one of their own pivot.
        to_start = np.eye(6)
        to_start[3:] = displacement_jacobian(start.pivot_m - pivot_m)
        landmarks = np.linalg.pinv(start.covariance, hermitian=True)
        information[:6, :6] = to_start.T @ landmarks @ to_start
    # Half of the softness, plus or minus a third: none and all of it are possible.
    indentation_std_m = max(softness_m / 3.0, 1e-6)
    information[6, 6] = 1.0 / indentation_std_m**2
    pose = _Pose(start.rotation, start.translation_m, 0.5 * softness_m)
    return _Prior(pose, information)


def _require_no_sliding(problem: _Problem, fit: _Fit) -> None:
    """Refuse a surface that the solution slides along.

    It is pushed along the directions along which distances change least, each a root
    mean square of 1 at the touches.
    """
    push_m = 6e-3
    max_stay = 0.5  # part of the push that may be left after fitting again
    same_fit = 1.3  # ratio of distances up to which a pushed solution fits as well
    fine_fit = 0.35  # part of the noise below which distances are not compared
    weak_directions = 3  # a sphere spins about three axes, a plane slides and spins
    jacobian = problem.jacobian
    motion = np.einsum("nij,nik->jk", jacobian, jacobian) / len(jacobian)
    information = problem.touch_information(fit) + problem.prior.information
    # What is left where the indentation may be any.
    mixed = information[:6, 6]
    pose_information = information[:6, :6] - np.outer(mixed, mixed) / information[6, 6]
    directions = eigh(pose_information, motion)[1][:, :weak_directions].T
    for direction in directions:
        pushed = problem.move(fit.pose, np.append(push_m * direction, 0.0))
        other = problem.fit(pushed, fit.points_m)
        away_m = rms_length(other.points_m - fit.points_m)
        max_median_m = same_fit * max(fit.median_m, fine_fit * problem.noise_m)
        if away_m > max_stay * push_m and other.median_m < max_median_m:
            raise RegistrationError(
                f"the surface slides or spins on itself: pushed {1e3 * push_m:g} mm "
                f"along its weakest direction, the solution stays {1e3 * away_m:.1f} "
                "mm away and fits as well",
                "Touch a part with edges or another shape, or register by "
                "landmarks again.",
            )


def _require_no_better(problem: _Problem, fit: _Fit) -> None:
    """Refuse a solution if another one elsewhere fits better."""
    far_m = 4e-3  # another solution is another if it lies so far away at the touches
    better_fit = 0.9  # ratio of distances below which another solution fits better
    for pose in problem.other_starts(fit.pose):
        other = problem.fit(pose, fit.points_m)
        away_m = rms_length(other.points_m - fit.points_m)
        if away_m > far_m and other.median_m < better_fit * fit.median_m:
            raise RegistrationError(
                f"another solution, {1e3 * away_m:.0f} mm away, fits better: the start "
                "lies outside the basin",
                "Touch a part with edges or another shape, or register by "
                "landmarks again.",
            )


def _registration(
    problem: _Problem, fit: _Fit, start_degrees: float, *, check: bool
) -> Registration:
    """Return the registration of a fit, with the covariance of its errors.

    They are those of the touches, correlated ones of the surface, those of what is
    known without them, and what a patient who may have moved adds. Touches that slipped
    add nothing.

    Raises:
        RegistrationError: The patient has moved.
    """
    counted = float(np.count_nonzero(fit.weights))
    degrees = max(counted - 7.0, 1.0)
    touch_information = problem.touch_information(fit)
    prior_information = problem.prior.information
    information = touch_information + prior_information
    inverse = np.linalg.pinv(information, hermitian=True)
    edges = 1.0 + SURFACE_EDGES * (1.0 - fit.flatness)
    mean_edges = np.average(edges**2, weights=fit.weights)
    iid_m2 = problem.touch_std_m**2 + problem.spread_m2(fit.pose)
    flat_m2 = max((fit.variance_m2 - iid_m2) / mean_edges, SURFACE_STD_m**2)
    distance_m = cdist(fit.points_m, fit.points_m)
    correlation = np.exp(-0.5 * (distance_m / SURFACE_REACH_m) ** 2)
    errors_m2 = flat_m2 * np.outer(edges, edges) * correlation
    errors_m2 += min(iid_m2, fit.variance_m2) * np.eye(len(distance_m))
    gain = fit.rows.T * (fit.weights / fit.variance_m2)
    covariance = inverse @ (gain @ errors_m2 @ gain.T + prior_information) @ inverse
    pose = fit.pose
    if check:
        motion = _find_motion(problem, pose)
        _require_still(motion, problem)
        pose = problem.move(pose, motion.step)
        still = 1.0 - motion.probability
        covariance = still * covariance + motion.covariance
    shares = [
        (float(np.trace(inverse @ touch_information)), degrees),
        (float(np.trace(inverse @ prior_information)), start_degrees),
    ]
    return Registration(
        rotation=pose.rotation,
        translation_m=pose.translation_m,
        covariance=covariance[:6, :6],
        pivot_m=problem.pivot_m,
        degrees=_join_degrees(shares),
        residual_rms_m=float(np.sqrt(np.mean(fit.distances_m[fit.weights > 0.0] ** 2))),
        indentation_m=pose.indentation_m,
        indentation_std_m=float(np.sqrt(covariance[6, 6])),
    )


def _find_motion(problem: _Problem, pose: _Pose) -> PatientMotion:
    """Return how probable it is that the patient moved before or between the touches.

    Args:
        problem: All touches.
        pose: Where they and the landmarks put the model.
    """
    middle_m = pose.rotation @ problem.surface.vertices_m.mean(axis=0)
    middle_m = middle_m + pose.translation_m
    axes = axes_of_motion(pose.rotation, middle_m, problem.pivot_m)
    count = len(problem.touches_m)
    innovations: list[Innovation] = []
    for first in (0, count // 3, count // 2, 2 * count // 3):
        before = problem.prior
        if first:
            earlier = replace(problem, touches_m=problem.touches_m[:first])
            fit = earlier.fit(pose)
            information = earlier.tempered_information(fit, pose) + before.information
            before = _Prior(fit.pose, information)
        # As far from there as a patient who moved may lie.
        covariance = np.linalg.inv(before.information) + axes.T @ axes
        wide = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        later = replace(
            problem,
            touches_m=problem.touches_m[first:],
            prior=_Prior(before.pose, wide),
        )
        fit = later.fit(pose)
        information = later.tempered_information(fit, pose)
        pull = (information + wide) @ fit.off_prior
        innovations.append(Innovation(first, before.information, information, pull))
    return find_motion(innovations, axes)


def _require_still(motion: PatientMotion, problem: _Problem) -> None:
    """Refuse a patient who has moved."""
    max_probability = 0.9
    if motion.probability <= max_probability:
        return
    size_m = rms_length(problem.jacobian @ motion.motion)
    when = (
        f"before touch {motion.first + 1} or so"
        if motion.first
        else "between landmarks and touches"
    )
    raise RegistrationError(
        f"landmarks and touches contradict each other: the patient has probably moved "
        f"{when}, by some {1e3 * size_m:.0f} mm; hold him still, and touch landmarks "
        "and skin again",
        "Hold the patient still, and touch landmarks and skin again.",
    )


def _join_degrees(shares: list[tuple[float, float]]) -> float:
    """Return degrees of freedom of several sources together (Satterthwaite 1946).

    Args:
        shares: Of each source, what it says and its degrees of freedom.
    """
    whole = sum(share for share, _ in shares)
    return float(1.0 / sum((share / whole) ** 2 / degrees for share, degrees in shares))
