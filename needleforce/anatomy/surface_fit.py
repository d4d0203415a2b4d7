"""Registration by touching a surface: robust point-to-plane fit, its covariance, its refusals.

Gauss-Newton on distances to the nearest triangles with Tukey's weights: touches that slipped count
nothing. A segmented surface is off by a few tenths of a millimetre, and neighbouring touches by the
same: taken for independent, a hundred touches would promise ten times too much.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm
from scipy.spatial import KDTree

from needleforce.anatomy.errors import RegistrationError
from needleforce.anatomy.landmarks import Array, Registration, point_jacobian

TOUCH_STD_m = 0.5e-3
SURFACE_STD_m = 0.35e-3
"""Least error of a segmented surface: measured on organs segmented at 3 mm."""
SURFACE_REACH_m = 8e-3
"""Over which it is the same."""
SURFACE_BIAS_m = 0.2e-3
"""By which all of it may be too large or too small."""
LEAST_TOUCHES = 15
MOST_OUTLIERS = 0.35
TUKEY = 4.685
ROUNDS, LAST_STEP = 60, 1e-7
NEIGHBOURS = 8
"""Nearest middles of triangles among which the nearest triangle is looked for."""
PUSH_m = 6e-3
"""How far a solution is pushed along its weakest directions, measured at the touches."""
BACK = 0.5
"""Part of the push that may be left at the touches after fitting again."""
FAR_m = 4e-3
"""Another solution is another if it lies so far away at the touches."""
TRIES_rad, TRIES_m = 0.2, 12e-3
"""Other starts: turned and shifted by so much."""


class _Fit(NamedTuple):
    rotation: Array  # from robot to model
    translation: Array
    weights: Array
    distances: Array
    rows: Array  # derivatives of the distances, shape (n, 6)

    @property
    def cost(self) -> float:
        """Median absolute distance: outliers do not matter."""
        return float(np.median(np.abs(self.distances)))


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
        self._tree = KDTree(self._corners.mean(axis=1))

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Nearest places on the surface and the normals there, shape (n, 3) each."""
        _, found = self._tree.query(points, k=min(NEIGHBOURS, len(self._corners)))
        found = found.reshape(len(points), -1)
        corners = self._corners[found]
        places = _nearest_in_triangles(points[:, None, :], corners)
        best = np.argmin(((places - points[:, None, :]) ** 2).sum(axis=-1), axis=1)
        rows = np.arange(len(points))
        return places[rows, best], self._normals[found[rows, best]]


def _nearest_in_triangles(points: Array, corners: Array) -> Array:
    """Nearest points of triangles (..., 3, 3) to points (..., 3): inside, or on an edge."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = ((x * y).sum(-1) for x, y in ((ab, ab), (ab, ac), (ac, ac)))
    d20, d21 = (ap * ab).sum(-1), (ap * ac).sum(-1)
    scale = np.maximum(d00 * d11 - d01 * d01, 1e-30)
    v, w = (d11 * d20 - d01 * d21) / scale, (d00 * d21 - d01 * d20) / scale
    inside = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0)
    best = a + v[..., None] * ab + w[..., None] * ac
    least = np.where(inside, ((best - points) ** 2).sum(-1), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        along = ((points - start) * edge).sum(-1) / np.maximum((edge * edge).sum(-1), 1e-30)
        place = start + np.clip(along, 0.0, 1.0)[..., None] * edge
        distance = ((place - points) ** 2).sum(-1)
        is_nearer = ~inside & (distance < least)
        best = np.where(is_nearer[..., None], place, best)
        least = np.where(is_nearer, distance, least)
    return best


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
        RegistrationError: Too few touches, or too many that do not lie on the surface; a surface
            along which the solution slides or spins; another solution that fits as well or better.
    """
    touches = np.asarray(touches_m, dtype=float)
    if touches.ndim != 2 or touches.shape[1:] != (3,) or not np.isfinite(touches).all():
        raise RegistrationError(f"touches of shape {touches.shape}: expected finite (n, 3)")
    if len(touches) < LEAST_TOUCHES:
        raise RegistrationError(
            f"too few touches: {len(touches)}; expected {LEAST_TOUCHES} or more, spread widely"
        )
    inverse = start.rotation.T, -start.rotation.T @ start.translation_m
    found = _fit(surface, touches, inverse, touch_std_m)
    outliers = float(np.mean(found.weights == 0.0))
    if outliers > MOST_OUTLIERS:
        raise RegistrationError(
            f"{100.0 * outliers:.0f} % of the touches do not lie on the surface: another organ, or "
            "a start too far away; register by landmarks again"
        )
    if check:
        _require_no_symmetry(surface, touches, found, touch_std_m)
        _require_no_better(surface, touches, found, touch_std_m)
    return _registration(touches, found, touch_std_m)


def _fit(surface: TouchSurface, touches: Array, start: tuple[Array, Array], std_m: float) -> _Fit:
    rotation, translation = start
    weights = distances = rows = np.empty(0)
    for count in range(ROUNDS):
        points = touches @ rotation.T + translation
        places, normals = surface.nearest(points)
        distances = ((points - places) * normals).sum(axis=1)
        # While far away everything counts; then what lies further than the rest does not.
        true_distance = np.linalg.norm(points - places, axis=1)
        scale = max(1.4826 * float(np.median(true_distance)), 1.5 * std_m)
        ratio = np.minimum(true_distance / (TUKEY * scale), 1.0)
        weights = (1.0 - ratio**2) ** 2
        pivot = points.mean(axis=0)
        levers = point_jacobian(points - pivot)
        rows = np.einsum("ni,nij->nj", normals, levers)
        normal = rows.T @ (weights[:, None] * rows)
        # What the touches do not hold is held a little, so that a sphere has a solution too.
        normal += 1e-6 * np.diag([np.trace(normal[:3, :3])] * 3 + [np.trace(normal[3:, 3:])] * 3)
        step = -np.linalg.solve(normal, rows.T @ (weights * distances))
        turn = expm(_skew(step[:3]))
        rotation, translation = turn @ rotation, turn @ (translation - pivot) + pivot + step[3:]
        if count > 5 and np.linalg.norm(step * [0.1, 0.1, 0.1, 1, 1, 1]) < LAST_STEP:
            break
    return _Fit(rotation, translation, weights, distances, rows)


def _skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _apart(touches: Array, one: tuple[Array, Array], two: tuple[Array, Array]) -> float:
    """Root mean square distance of the touches under two solutions."""
    difference = touches @ (one[0] - two[0]).T + one[1] - two[1]
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


def _pushed(touches: Array, found: _Fit, direction: Array, size_m: float) -> tuple[Array, Array]:
    """A solution moved along a direction of its six, by so much at the touches."""
    points = touches @ found.rotation.T + found.translation
    pivot = points.mean(axis=0)
    moved = point_jacobian(points - pivot) @ direction
    step = direction * size_m / float(np.sqrt((moved**2).sum(axis=1).mean()))
    turn = expm(_skew(step[:3]))
    return turn @ found.rotation, turn @ (found.translation - pivot) + pivot + step[3:]


def _weakest(touches: Array, found: _Fit) -> NDArray[np.float64]:
    """The three directions along which the distances change least, by motion of the touches."""
    points = touches @ found.rotation.T + found.translation
    levers = point_jacobian(points - points.mean(axis=0)).reshape(-1, 6)
    held = found.rows.T @ (found.weights[:, None] * found.rows)
    lower = np.linalg.cholesky(levers.T @ levers / len(points))
    half = np.linalg.solve(lower, np.linalg.solve(lower, held).T)
    _, vectors = np.linalg.eigh(0.5 * (half + half.T))
    return np.asarray(np.linalg.solve(lower.T, vectors[:, :3]).T, dtype=float)


def _require_no_symmetry(surface: TouchSurface, touches: Array, found: _Fit, std_m: float) -> None:
    best = (found.rotation, found.translation)
    for direction in _weakest(touches, found):
        pushed = _pushed(touches, found, direction, PUSH_m)
        again = _fit(surface, touches, pushed, std_m)
        left_m = _apart(touches, (again.rotation, again.translation), best)
        is_as_good = again.cost < 1.3 * max(found.cost, 0.5 * std_m)
        if left_m > BACK * PUSH_m and is_as_good:
            raise RegistrationError(
                f"the surface slides or spins on itself: pushed {1e3 * PUSH_m:g} mm along its "
                f"weakest direction, the solution stays {1e3 * left_m:.1f} mm away and fits as "
                "well; touch a part with edges or another shape"
            )


def _require_no_better(surface: TouchSurface, touches: Array, found: _Fit, std_m: float) -> None:
    best = (found.rotation, found.translation)
    radius = float(np.sqrt(((touches - touches.mean(axis=0)) ** 2).sum(axis=1).mean()))
    for axis in range(3):
        for sign in (1.0, -1.0):
            direction = np.zeros(6)
            direction[axis], direction[3 + axis] = sign * TRIES_rad, sign * TRIES_m
            size_m = float(np.hypot(TRIES_rad * radius * np.sqrt(2.0 / 3.0), TRIES_m))
            again = _fit(surface, touches, _pushed(touches, found, direction, size_m), std_m)
            left_m = _apart(touches, (again.rotation, again.translation), best)
            if left_m > FAR_m and again.cost < 0.9 * found.cost:
                raise RegistrationError(
                    f"another solution, {1e3 * left_m:.0f} mm away, fits better: the start lies "
                    "outside the basin; register by landmarks again"
                )


def _registration(touches: Array, found: _Fit, touch_std_m: float) -> Registration:
    """The fit from model to robot, with a covariance of touches and correlated surface errors."""
    kept = found.weights > 0.0
    weights, rows, distances = found.weights[kept], found.rows[kept], found.distances[kept]
    points = touches[kept] @ found.rotation.T + found.translation
    held = rows.T @ (weights[:, None] * rows)
    gain = np.linalg.solve(held, rows.T * weights)
    apart = np.linalg.norm(points[:, None, :] - points[None, :, :], axis=-1)
    degrees = max(float(kept.sum()) - 6.0, 1.0)
    observed = float((weights * distances**2).sum() / weights.sum()) * len(weights) / degrees
    surface_var = max(observed - touch_std_m**2, SURFACE_STD_m**2)
    errors = surface_var * np.exp(-0.5 * (apart / SURFACE_REACH_m) ** 2) + SURFACE_BIAS_m**2
    errors[np.diag_indices_from(errors)] += touch_std_m**2
    covariance = gain @ errors @ gain.T
    rotation = found.rotation.T
    turn = np.kron(np.eye(2), rotation)  # rotation and shift, from the model's axes to the robot's
    covariance = turn @ covariance @ turn.T
    return Registration(
        rotation=rotation,
        translation_m=-rotation @ found.translation,
        covariance=covariance,
        pivot_m=touches.mean(axis=0),
        degrees=degrees,
        residual_rms_m=float(np.sqrt((distances**2).mean())),
    )
