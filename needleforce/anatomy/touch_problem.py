"""The pose of a model on whose surface touches lie, in one set of normal equations.

Unknown are a small rotation and shift of the model, and how far touches press the
surface in. Each touch says how far it lies from the surface; the landmarks, and what
is known of how soft the surface is, are prior knowledge of the same unknowns. Tukey's
weights leave out touches that slipped.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from needleforce.anatomy.registration import (
    Registration,
    displacement_jacobian,
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
