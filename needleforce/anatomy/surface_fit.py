"""Registration by touching a surface: robust point-to-plane fit, its covariance, its refusals.

Gauss-Newton on distances to the nearest triangles with Tukey's weights: touches that slipped count
nothing. A segmented surface is off by a few tenths of a millimetre, and neighbouring touches by the
same: taken for independent, a hundred touches would promise ten times too much.
"""

from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from needleforce.anatomy.errors import Array, RegistrationError, require_deviation
from needleforce.anatomy.landmarks import LEAST_WIDTH_m, Registration, point_jacobian

Pose = tuple[Array, Array]  # Rotation and shift

TOUCH_STD_m = 0.5e-3
SURFACE_STD_m = 0.25e-3  # Least error of a segmented surface: measured on organs segmented at 3 mm
SURFACE_REACH_m = 7e-3  # Over which it is the same
COARSE_STD_m = 0.45e-3  # More than such a surface is off as a whole
SURFACE_BIAS_m = 0.05e-3  # By which all of it may be too large or too small
LEAST_TOUCHES = 15
LARGEST = 5.0  # Metres of touches or surface, and their ratio, beyond which units differ
MOST_OUTLIERS = 0.35
TUKEY = 4.685
ROUNDS, LAST_STEP = 60, 1e-7
WIDE_ROUNDS = 12  # So long the touches' own distances say which of them slipped, then their noise
FULL_STEPS = 8.0  # Later ones are shorter: from facet to facet they would go back and forth
NEIGHBOURS = 8  # Nearest middles of triangles among which the nearest triangle is looked for
PUSH_m = 6e-3  # How far a solution is pushed along its weakest directions, measured at the touches
BACK = 0.5  # Part of the push that may be left at the touches after fitting again
FAR_m = 4e-3  # Another solution is another if it lies so far away at the touches
TRIES_rad, TRIES_m = 0.2, 12e-3
"""Other starts: turned and shifted by so much."""


class TouchSurface:
    """A surface to find touches on.

    Args:
        vertices_m: Of the model, LPS, shape (v, 3).
        triangles: Indices of vertices, shape (t, 3).
    """

    def __init__(self, vertices_m: ArrayLike, triangles: ArrayLike) -> None:
        corners = np.asarray(vertices_m, dtype=float)[np.asarray(triangles)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sizes = np.linalg.norm(normals, axis=1)
        kept = sizes > 0.0
        self._corners, self._normals = corners[kept], normals[kept] / sizes[kept, None]
        self.extent_m = float(np.linalg.norm(np.ptp(self._corners, axis=(0, 1))))
        self._tree = KDTree(self._corners.mean(axis=1))

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Nearest places on the surface and the normals there, shape (n, 3) each."""
        from trimesh.triangles import closest_point

        count, near = len(points), min(NEIGHBOURS, len(self._corners))
        found = self._tree.query(points, k=near)[1].reshape(count, near)
        # In millimetres: its tolerances are absolute, and in metres as large as a small triangle.
        corners = 1e3 * self._corners[found].reshape(-1, 3, 3)
        places = 1e-3 * closest_point(corners, 1e3 * np.repeat(points, near, axis=0))
        places = places.reshape(count, near, 3)
        best = np.argmin(((places - points[:, None]) ** 2).sum(axis=-1), axis=1)
        rows = np.arange(count)
        return places[rows, best], self._normals[found[rows, best]]


class _Fit:
    """A solution from the robot to the model: Gauss-Newton from a start, with Tukey's weights."""

    def __init__(self, surface: TouchSurface, touches: Array, std_m: float, start: Pose) -> None:
        self._given = surface, touches, std_m
        self.pose = start
        narrow = 1.15 * float(np.hypot(std_m, COARSE_STD_m))
        for count in range(ROUNDS):
            self.points = touches @ self.pose[0].T + self.pose[1]
            places, normals = surface.nearest(self.points)
            apart = self.points - places
            self.distances = (apart * normals).sum(axis=1)
            # While far away everything counts; then what lies further than the rest does not; last
            # what lies further than noise: many that slipped together would widen their own scale.
            far = np.linalg.norm(apart, axis=1)
            self.middle_m = float(np.median(far))
            scale = max(1.4826 * self.middle_m, narrow) if count < WIDE_ROUNDS else narrow
            self.weights = (1.0 - np.minimum(far / (TUKEY * scale), 1.0) ** 2) ** 2
            # Derivatives of the distances, shape (n, 6).
            self.rows = np.einsum("ni,nij->nj", normals, self._levers())
            normal = self.rows.T @ (self.weights[:, None] * self.rows)
            # What the touches do not hold is held a little, so that a sphere has a solution too.
            spins, slides = np.trace(normal[:3, :3]), np.trace(normal[3:, 3:])
            normal += 1e-6 * np.diag([spins] * 3 + [slides] * 3)
            step = -np.linalg.solve(normal, self.rows.T @ (self.weights * self.distances))
            step *= min(1.0, FULL_STEPS / (count + 1.0))
            self.pose = self._moved(step)
            if count > WIDE_ROUNDS and np.linalg.norm(step * [0.1, 0.1, 0.1, 1, 1, 1]) < LAST_STEP:
                break
        # Median absolute distance: outliers do not matter.
        self.cost = float(np.median(np.abs(self.distances)))

    def _levers(self) -> Array:
        return point_jacobian(self.points - self.points.mean(axis=0))

    def _moved(self, step: Array) -> Pose:
        """The pose after a small rotation about the touches' middle, and a shift."""
        turn, pivot = Rotation.from_rotvec(step[:3]).as_matrix(), self.points.mean(axis=0)
        return turn @ self.pose[0], turn @ (self.pose[1] - pivot) + pivot + step[3:]

    def pushed(self, direction: Array, size_m: float) -> tuple[float, float]:
        """Move it along a direction of its six, by so much at the touches, and fit again.

        Returns how far away it then is, root mean square at the touches, and its cost.
        """
        moved = self._levers() @ direction
        step = direction * size_m / float(np.sqrt((moved**2).sum(axis=1).mean()))
        again = _Fit(*self._given, self._moved(step))
        difference = self._given[1] @ (again.pose[0] - self.pose[0]).T
        difference += again.pose[1] - self.pose[1]
        return float(np.sqrt((difference**2).sum(axis=1).mean())), again.cost

    def weakest(self) -> Array:
        """The three directions along which the distances change least, by motion of the touches."""
        levers = self._levers().reshape(-1, 6)
        held = self.rows.T @ (self.weights[:, None] * self.rows)
        return eigh(held, levers.T @ levers / len(self.points))[1][:, :3].T


def fit_surface(
    surface: TouchSurface,
    touches_m: ArrayLike,
    start: Registration,
    *,
    touch_std_m: float = TOUCH_STD_m,
    check: bool = True,
) -> Registration:
    """Register by touching a surface, beginning at a registration by landmarks.

    Args:
        surface: Of the model.
        touches_m: Places of the pointer's tip on it [m], robot's base, shape (n, 3).
        start: Within some 20 mm and 20 degrees.
        touch_std_m: Standard deviation of a touch along each axis.
        check: Look for other solutions (four times the work).

    Raises:
        RegistrationError: Too few or narrow touches, millimetres for metres, a deviation that is
            none; too many touches off the surface, or the middle one further than noise; a surface
            along which the solution slides or spins; another solution that fits as well or better.
    """
    touches = _checked(surface, touches_m, touch_std_m)
    inverse = start.rotation.T, -start.rotation.T @ start.translation_m
    found = _Fit(surface, touches, touch_std_m, inverse)
    outliers = float(np.mean(found.weights == 0.0))
    if outliers > MOST_OUTLIERS:
        raise RegistrationError(
            f"{100.0 * outliers:.0f} % of the touches do not lie on the surface: another organ, or "
            "a start too far away; register by landmarks again"
        )
    noise_m = float(np.hypot(touch_std_m, COARSE_STD_m))
    if found.middle_m > noise_m:
        raise RegistrationError(
            f"half of the touches lie {1e3 * found.middle_m:.1f} mm or more from the surface, "
            f"expected {1e3 * noise_m:.1f} at most: the patient has moved, it is another organ, or "
            "touch_std_m is too small"
        )
    if check:
        _require_no_other(touches, found, touch_std_m)
    return _registration(touches, found, touch_std_m)


def _checked(surface: TouchSurface, touches_m: ArrayLike, std_m: float) -> Array:
    """Touches that could register."""
    require_deviation("touch_std_m", std_m, RegistrationError)
    touches = np.asarray(touches_m, dtype=float)
    if touches.ndim != 2 or touches.shape[1:] != (3,) or not np.isfinite(touches).all():
        raise RegistrationError(f"touches of shape {touches.shape}: expected finite (n, 3)")
    if len(touches) < LEAST_TOUCHES:
        raise RegistrationError(
            f"too few touches: {len(touches)}; expected {LEAST_TOUCHES} or more, spread widely"
        )
    size_m = float(np.linalg.norm(np.ptp(touches, axis=0)))
    if max(size_m, surface.extent_m, size_m / surface.extent_m) > LARGEST:
        raise RegistrationError(
            f"the touches spread over {size_m:.3g} m, the surface over {surface.extent_m:.3g} m: "
            "millimetres for metres? Give both in metres"
        )
    width = np.linalg.svd(touches - touches.mean(axis=0), compute_uv=False)[1]
    if width < LEAST_WIDTH_m * np.sqrt(len(touches)):
        raise RegistrationError(
            f"the touches spread over {1e3 * size_m:.3g} mm, near a point or a line: touch more of "
            "the surface"
        )
    return touches


def _require_no_other(touches: Array, found: _Fit, std_m: float) -> None:
    """Refuse a surface that the solution slides along, and one that fits better elsewhere."""
    for direction in found.weakest():
        left_m, cost = found.pushed(direction, PUSH_m)
        if left_m > BACK * PUSH_m and cost < 1.3 * max(found.cost, 0.5 * std_m):
            raise RegistrationError(
                f"the surface slides or spins on itself: pushed {1e3 * PUSH_m:g} mm along its "
                f"weakest direction, the solution stays {1e3 * left_m:.1f} mm away and fits as "
                "well; touch a part with edges or another shape"
            )
    radius = float(np.sqrt(((touches - touches.mean(axis=0)) ** 2).sum(axis=1).mean()))
    size_m = float(np.hypot(TRIES_rad * radius * np.sqrt(2.0 / 3.0), TRIES_m))
    screws = np.hstack((TRIES_rad * np.eye(3), TRIES_m * np.eye(3)))
    for screw, sign in product(screws, (1.0, -1.0)):
        left_m, cost = found.pushed(sign * screw, size_m)
        if left_m > FAR_m and cost < 0.9 * found.cost:
            raise RegistrationError(
                f"another solution, {1e3 * left_m:.0f} mm away, fits better: the start lies "
                "outside the basin; register by landmarks again"
            )


def _registration(touches: Array, found: _Fit, touch_std_m: float) -> Registration:
    """The fit from model to robot, with a covariance of touches and correlated surface errors."""
    rows, weights = found.rows, found.weights
    kept = weights > 0.0  # the gain of the others, which slipped, is zero
    gain = np.linalg.solve(rows.T @ (weights[:, None] * rows), rows.T * weights)
    degrees = max(float(kept.sum()) - 6.0, 1.0)
    observed = float(np.average(found.distances**2, weights=weights) * kept.sum()) / degrees
    surface_var = max(observed - touch_std_m**2, SURFACE_STD_m**2)
    same = np.exp(-0.5 * (cdist(found.points, found.points) / SURFACE_REACH_m) ** 2)
    errors = surface_var * same + SURFACE_BIAS_m**2 + touch_std_m**2 * np.eye(len(rows))
    rotation = found.pose[0].T
    turn = np.kron(np.eye(2), rotation)  # rotation and shift, from the model's axes to the robot's
    return Registration(
        rotation=rotation,
        translation_m=-rotation @ found.pose[1],
        covariance=turn @ gain @ errors @ gain.T @ turn.T,
        pivot_m=touches.mean(axis=0),
        degrees=degrees,
        residual_rms_m=float(np.sqrt((found.distances[kept] ** 2).mean())),
    )
