"""Registration by touching a surface: robust point-to-plane fit, its covariance, its refusals.

Gauss-Newton on distances to the nearest triangles with Tukey's weights: touches that slipped count
nothing. A segmented surface is off by a few tenths of a millimetre, and neighbouring touches by the
same: taken for independent, a hundred touches would promise ten times too much.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from needleforce.anatomy.errors import Array, RegistrationError, require_deviation
from needleforce.anatomy.landmarks import (
    LEAST_WIDTH_m,
    Registration,
    point_jacobian,
    rigid_fit,
    rms,
    widths_m,
)
from needleforce.anatomy.surface import Surface

TOUCH_STD_m = 0.5e-3
SURFACE_STD_m = 0.25e-3  # Least error of a segmented surface: measured on organs segmented at 3 mm
SURFACE_REACH_m = 7e-3  # Over which it is the same
COARSE_STD_m = 0.45e-3  # More than such a surface is off as a whole
SURFACE_BIAS_m = 0.05e-3  # By which all of it may be too large or too small
LEAST_TOUCHES = 15
LARGEST = 5.0  # Metres of touches or surface, and their ratio, beyond which units differ
MOST_OUTLIERS = 0.35
TUKEY = 4.685
ROUNDS, LAST_STEP_m = 60, 1e-7
WIDE_ROUNDS = 12  # So long the touches' own distances say which of them slipped, then their noise
FULL_STEPS = 8.0  # Later ones are shorter: from facet to facet they would go back and forth
PUSH_m = 6e-3  # How far a solution is pushed along its weakest directions, measured at the touches
BACK = 0.5  # Part of the push that may be left at the touches after fitting again
FAR_m = 4e-3  # Another solution is another if it lies so far away at the touches
TRIES = np.diag([0.2] * 3 + [12e-3] * 3)
"""Other starts: turned [rad] and shifted [m] by so much, either way."""


class _Fit(NamedTuple):
    """A solution."""

    points: Array  # touches, carried into the model (n, 3)
    levers: Array  # their motion by a small rotation about their middle, and a shift (n, 3, 6)
    rows: Array  # derivatives of the distances (n, 6)
    distances: Array  # from the surface, positive outside
    weights: Array  # 0 for touches that slipped
    normal: Array  # matrix of the normal equations (6, 6)
    middle_m: float  # median distance from the nearest place: outliers do not matter


def fit_surface(
    surface: Surface,
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
    noise_m = float(np.hypot(touch_std_m, COARSE_STD_m))
    found = _fitted(surface, start.to_model(touches), noise_m)
    outliers = float(np.mean(found.weights == 0.0))
    if outliers > MOST_OUTLIERS:
        raise RegistrationError(
            f"{100.0 * outliers:.0f} % of the touches do not lie on the surface: another organ, or "
            "a start too far away; register by landmarks again"
        )
    if found.middle_m > noise_m:
        raise RegistrationError(
            f"half of the touches lie {1e3 * found.middle_m:.1f} mm or more from the surface, "
            f"expected {1e3 * noise_m:.1f} at most: the patient has moved, it is another organ, or "
            "touch_std_m is too small"
        )
    if check:
        _require_no_other(surface, found, noise_m)
    return _registration(touches, found, touch_std_m)


def _checked(surface: Surface, touches_m: ArrayLike, std_m: float) -> Array:
    """Touches that could register."""
    require_deviation("touch_std_m", std_m, RegistrationError)
    touches = np.asarray(touches_m, dtype=float)
    if touches.ndim != 2 or touches.shape[1:] != (3,) or not np.isfinite(touches).all():
        raise RegistrationError(f"touches of shape {touches.shape}: expected finite (n, 3)")
    if len(touches) < LEAST_TOUCHES:
        raise RegistrationError(
            f"too few touches: {len(touches)}; expected {LEAST_TOUCHES} or more, spread widely"
        )
    size_m, extent_m = float(np.linalg.norm(np.ptp(touches, axis=0))), float(surface.mesh.scale)
    if max(size_m, extent_m, size_m / extent_m) > LARGEST:
        raise RegistrationError(
            f"the touches spread over {size_m:.3g} m, the surface over {extent_m:.3g} m: "
            "millimetres for metres? Give both in metres"
        )
    if widths_m(touches)[1] < LEAST_WIDTH_m:
        raise RegistrationError(
            f"the touches spread over {1e3 * size_m:.3g} mm, near a point or a line: touch more of "
            "the surface"
        )
    return touches


def _fitted(surface: Surface, points: Array, noise_m: float) -> _Fit:
    """Gauss-Newton with Tukey's weights from where touches lie in the model, (n, 3)."""
    for count in range(ROUNDS):
        places, normals = surface.nearest(points)
        apart = points - places
        distances, far = (apart * normals).sum(axis=1), np.linalg.norm(apart, axis=1)
        # While far away everything counts; then what lies further than the rest does not; last
        # what lies further than noise: many that slipped together would widen their own scale.
        middle_m, scale = float(np.median(far)), 1.15 * noise_m
        if count < WIDE_ROUNDS:
            scale = max(1.4826 * middle_m, scale)
        weights = (1.0 - np.minimum(far / (TUKEY * scale), 1.0) ** 2) ** 2
        levers = point_jacobian(points - points.mean(axis=0))
        rows = np.einsum("ni,nij->nj", normals, levers)
        normal = rows.T @ (weights[:, None] * rows)
        found = _Fit(points, levers, rows, distances, weights, normal, middle_m)
        # What the touches do not hold is held a little, so that a sphere has a solution too.
        spins, slides = np.split(np.diag(normal), 2)
        held = normal + 1e-6 * np.diag(np.repeat([spins.sum(), slides.sum()], 3))
        step = -np.linalg.lstsq(held, rows.T @ (weights * distances))[0]  # 0 where all slipped
        step *= min(1.0, FULL_STEPS / (count + 1.0))
        points = _moved(points, step)
        if count > WIDE_ROUNDS and rms(points - found.points) < LAST_STEP_m:
            break
    return found


def _moved(points: Array, step: Array) -> Array:
    """Points (n, 3) after a rotation about their middle and a shift, (6,)."""
    middle = points.mean(axis=0)
    return Rotation.from_rotvec(step[:3]).apply(points - middle) + middle + step[3:]


def _require_no_other(surface: Surface, found: _Fit, noise_m: float) -> None:
    """Refuse a surface that the solution slides along, and one that fits better elsewhere."""
    # Directions along which distances change least, each a root mean square of 1 at the touches.
    motion = np.einsum("nij,nik->jk", found.levers, found.levers) / len(found.points)
    for direction in eigh(found.normal, motion)[1][:, :3].T:
        again = _fitted(surface, _moved(found.points, PUSH_m * direction), noise_m)
        left_m = rms(again.points - found.points)
        if left_m > BACK * PUSH_m and again.middle_m < 1.3 * max(found.middle_m, 0.4 * noise_m):
            raise RegistrationError(
                f"the surface slides or spins on itself: pushed {1e3 * PUSH_m:g} mm along its "
                f"weakest direction, the solution stays {1e3 * left_m:.1f} mm away and fits as "
                "well; touch a part with edges or another shape"
            )
    for step in (*TRIES, *-TRIES):
        again = _fitted(surface, _moved(found.points, step), noise_m)
        left_m = rms(again.points - found.points)
        if left_m > FAR_m and again.middle_m < 0.9 * found.middle_m:
            raise RegistrationError(
                f"another solution, {1e3 * left_m:.0f} mm away, fits better: the start lies "
                "outside the basin; register by landmarks again"
            )


def _registration(touches: Array, found: _Fit, touch_std_m: float) -> Registration:
    """The fit from model to robot, with a covariance of touches and correlated surface errors."""
    kept = found.weights > 0.0  # the gain of the others, which slipped, is zero
    gain = np.linalg.solve(found.normal, found.rows.T * found.weights)
    degrees = max(float(kept.sum()) - 6.0, 1.0)
    observed = np.average(found.distances**2, weights=found.weights) * kept.sum() / degrees
    surface_var = max(observed - touch_std_m**2, SURFACE_STD_m**2)
    same = np.exp(-0.5 * (cdist(found.points, found.points) / SURFACE_REACH_m) ** 2)
    errors = surface_var * same + SURFACE_BIAS_m**2 + touch_std_m**2 * np.eye(len(touches))
    rotation, translation, _ = rigid_fit(found.points, touches)
    turn = np.kron(np.eye(2), rotation) @ gain  # from the model's axes to the robot's
    return Registration(
        rotation=rotation,
        translation_m=translation,
        covariance=turn @ errors @ turn.T,
        pivot_m=touches.mean(axis=0),
        degrees=degrees,
        residual_rms_m=float(np.sqrt(np.mean(found.distances[kept] ** 2))),
    )
