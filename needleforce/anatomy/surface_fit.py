"""Rigid registration by touching a surface.

Gauss-Newton on distances to the nearest triangles with Tukey's weights, so that touches
that slipped count nothing.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from needleforce.anatomy.errors import AnatomyCode, RegistrationError, require_deviation
from needleforce.anatomy.registration import (
    MAX_LENGTH_RATIO,
    MIN_WIDTH_m,
    Registration,
    displacement_jacobian,
    fit_rigidly,
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

NORMALS_REACH_m = 2.0 * SURFACE_REACH_m
"""Normals averaged so far around hold hardly any of that error."""

COARSE_STD_m = 0.6e-3
"""More than such a surface is off as a whole."""

TOUCH_STD_m = 0.5e-3
"""Standard deviation of a touch along each axis, if no other one is given."""

MIN_TOUCHES = 15
"""Fewer leave too little to see which of them slipped: six numbers are fitted."""

MAX_SPREAD_m = 5.0
"""Of touches or surface; beyond it the unit is not the metre."""

MAX_OUTLIERS = 0.35
"""Fraction of touches that may have slipped; with more, what is left may be a part of
another surface."""

TUKEY = 4.685
"""Distance, in standard deviations, beyond which a touch counts nothing; 95 % efficient
for normal errors (Tukey's biweight)."""

NORMAL_MAD = 1.4826
"""Standard deviation of normal errors over their median absolute one."""

MAX_ROUNDS = 60
"""Steps of Gauss-Newton; a usual fit needs some 20."""

STILL_m = 1e-7
"""Motion of the touches in a step that is none."""

NEARLY_STILL_m = 2e-5
"""Motion of the touches in a step after which their noise says which slipped."""

WIDE_ROUNDS = 12
"""At most so long the touches' own distances say which of them slipped."""

FULL_STEPS = 8.0
"""Later steps are shorter: from facet to facet they would go back and forth."""

SMALL_HOLD = 1e-6
"""What the touches do not hold is held by this fraction of what they do, so that a
sphere has a solution too."""

PUSH_m = 6e-3
"""How far a solution is pushed along its weakest directions, measured at the
touches."""

WEAK_DIRECTIONS = 3
"""Number of these: a sphere spins about three axes, a plane slides and spins along
three."""

BACK_m = 0.5e-3
"""A solution this near to another one, at the touches, is on its way to it."""

MAX_STAY = 0.5
"""Fraction of the push that may be left at the touches after fitting again."""

SAME_FIT = 1.3
"""Ratio of distances up to which a pushed solution fits as well."""

FINE_FIT = 0.35
"""Fraction of the noise below which distances are not compared."""

FAR_m = 4e-3
"""Another solution is another if it lies so far away at the touches."""

BETTER_FIT = 0.9
"""Ratio of distances below which another solution fits better."""

TRIED_ROTATION_rad = 0.2
"""How far other starts are turned about each axis, either way."""

TRIED_SHIFT_m = 12e-3
"""How far other starts are shifted along each axis, either way."""

_TRIES = np.diag([TRIED_ROTATION_rad] * 3 + [TRIED_SHIFT_m] * 3)


class _Fit(NamedTuple):
    """A solution of the touches.

    Attributes:
        points: Touches, carried into the model (n, 3).
        jacobian: Their motion by a small rotation about their mean, and a shift (n, 3,
            6).
        rows: Derivatives of the distances (n, 6).
        flatness: Of the surface there, 1 for a plane (n,).
        distances: From the surface, positive outside.
        weights: 0 for touches that slipped.
        normal_matrix: Of the normal equations (6, 6).
        median_m: Median distance from the nearest place: outliers do not matter.
    """

    points: Array
    jacobian: Array
    rows: Array
    flatness: Array
    distances: Array
    weights: Array
    normal_matrix: Array
    median_m: float


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
        RegistrationError: Too few or narrow touches, millimetres for metres, a
            deviation that is none; too many touches off the surface, or the middle one
            further than noise; a surface along which the solution slides or spins;
            another solution that fits as well or better.
    """
    touches = _checked_touches(surface, touches_m, touch_std_m)
    noise_m = float(np.hypot(touch_std_m, COARSE_STD_m))
    points = start.to_model(touches)
    fit = _fit_points(surface, points, noise_m)
    if fit.median_m > noise_m:
        other_fits = (_fit_points(surface, p, noise_m) for p in _other_starts(points))
        fit = min(other_fits, key=lambda other: other.median_m)
    outliers = float(np.mean(fit.weights == 0.0))
    if outliers > MAX_OUTLIERS:
        raise RegistrationError(
            f"{100.0 * outliers:.0f} % of the touches do not lie on the surface: "
            "another organ, or a start too far away",
            AnatomyCode.MISFITTING_SURFACE,
        )
    if fit.median_m > noise_m:
        raise RegistrationError(
            f"half of the touches lie {1e3 * fit.median_m:.1f} mm or more from the "
            f"surface, expected {1e3 * noise_m:.1f} at most: the patient has moved, it "
            "is another organ, or touch_std_m is too small",
            AnatomyCode.MISFITTING_SURFACE,
        )
    if check:
        _require_no_sliding(surface, fit, noise_m)
        _require_no_better(surface, fit, noise_m)
    return _registration(touches, fit, touch_std_m)


def _checked_touches(surface: Surface, touches_m: ArrayLike, std_m: float) -> Array:
    """Return touches that could register."""
    require_deviation("touch_std_m", std_m, RegistrationError)
    touches = np.asarray(touches_m, dtype=float)
    if touches.ndim != 2 or touches.shape[1:] != (3,) or not np.isfinite(touches).all():
        raise RegistrationError(
            f"touches of shape {touches.shape}: expected finite (n, 3)",
            AnatomyCode.TOUCHES,
        )
    if len(touches) < MIN_TOUCHES:
        raise RegistrationError(
            f"too few touches: {len(touches)}, expected {MIN_TOUCHES} or more",
            AnatomyCode.TOUCHES,
        )
    spread_m = float(np.linalg.norm(np.ptp(touches, axis=0)))
    extent_m = float(surface.mesh.scale)
    is_too_large = max(spread_m, extent_m) > MAX_SPREAD_m
    if is_too_large or spread_m / extent_m > MAX_LENGTH_RATIO:
        raise RegistrationError(
            f"the touches spread over {spread_m:.3g} m, the surface over "
            f"{extent_m:.3g} m: millimetres for metres?",
            AnatomyCode.TOUCHES,
        )
    _, width_m, _ = rms_extents_m(touches)
    if width_m < MIN_WIDTH_m:
        raise RegistrationError(
            f"the touches spread over {1e3 * spread_m:.3g} mm, near a point or a line",
            AnatomyCode.TOUCHES,
        )
    return touches


def _fit_points(
    surface: Surface, points: Array, noise_m: float, known: Array | None = None
) -> _Fit:
    """Fit from where the touches lie in the model, shape (n, 3).

    While they are far away all of them count; then those count nothing that lie further
    than the others do; last those that lie further than noise: many that slipped
    together would widen their own scale.

    Args:
        surface: Of the model.
        points: Touches in the model, to begin with.
        noise_m: Standard deviation of touches and surface.
        known: Touches in the model in another solution: a fit that comes near to it
            ends there.
    """
    rounds = 0
    wide_rounds = WIDE_ROUNDS
    while True:
        fit = _linearise(surface, points, noise_m, is_wide=rounds < wide_rounds)
        rounds += 1
        points = _move(points, _gauss_newton_step(fit, rounds))
        motion_m = rms_length(points - fit.points)
        if rounds < wide_rounds and motion_m < NEARLY_STILL_m:
            wide_rounds = rounds
        is_still = rounds > wide_rounds + 1 and motion_m < STILL_m
        is_known = known is not None and rms_length(fit.points - known) < BACK_m
        if is_still or is_known or rounds == MAX_ROUNDS:
            return fit


def _linearise(
    surface: Surface, points: Array, noise_m: float, *, is_wide: bool
) -> _Fit:
    """Return the touches where they are, with distances, derivatives and weights.

    Args:
        surface: Of the model.
        points: Touches in the model, shape (n, 3).
        noise_m: Standard deviation of touches and surface.
        is_wide: Weigh by the touches' own distances, not by noise alone.
    """
    positions, normals = surface.nearest(points)
    off = points - positions
    distances = (off * normals).sum(axis=1)
    lengths = np.linalg.norm(off, axis=1)
    median_m = float(np.median(lengths))
    scale_m = max(NORMAL_MAD * median_m, noise_m) if is_wide else noise_m
    if not is_wide:
        normals = surface.mean_normals(positions, normals, NORMALS_REACH_m)
    flatness = np.linalg.norm(normals, axis=1)
    weights = (1.0 - np.minimum(lengths / (TUKEY * scale_m), 1.0) ** 2) ** 2
    jacobian = displacement_jacobian(points - points.mean(axis=0))
    rows = np.einsum("ni,nij->nj", normals / flatness[:, None], jacobian)
    return _Fit(
        points=points,
        jacobian=jacobian,
        rows=rows,
        flatness=flatness,
        distances=distances,
        weights=weights,
        normal_matrix=rows.T @ (weights[:, None] * rows),
        median_m=median_m,
    )


def _gauss_newton_step(fit: _Fit, step_number: int) -> Array:
    """Return the rotation and shift of a step, shape (6,); zero where all slipped."""
    rotations, shifts = np.split(np.diag(fit.normal_matrix), 2)
    hold = np.diag(np.repeat([rotations.sum(), shifts.sum()], 3))
    held = fit.normal_matrix + SMALL_HOLD * hold
    gradient = fit.rows.T @ (fit.weights * fit.distances)
    step = -np.linalg.lstsq(held, gradient)[0]
    return np.asarray(step * min(1.0, FULL_STEPS / step_number), dtype=np.float64)


def _move(points: Array, step: Array) -> Array:
    """Turn points (n, 3) about their mean, and shift them, by a step (6,)."""
    mean = points.mean(axis=0)
    return Rotation.from_rotvec(step[:3]).apply(points - mean) + mean + step[3:]


def _other_starts(points: Array) -> Iterator[Array]:
    """Yield points turned and shifted either way."""
    for step in (*_TRIES, *-_TRIES):
        yield _move(points, step)


def _require_no_sliding(surface: Surface, fit: _Fit, noise_m: float) -> None:
    """Refuse a surface that the solution slides along.

    It is pushed along the directions along which distances change least, each a root
    mean square of 1 at the touches.
    """
    motion = np.einsum("nij,nik->jk", fit.jacobian, fit.jacobian) / len(fit.points)
    directions = eigh(fit.normal_matrix, motion)[1][:, :WEAK_DIRECTIONS].T
    for direction in directions:
        pushed = _move(fit.points, PUSH_m * direction)
        other = _fit_points(surface, pushed, noise_m, fit.points)
        away_m = rms_length(other.points - fit.points)
        max_median_m = SAME_FIT * max(fit.median_m, FINE_FIT * noise_m)
        if away_m > MAX_STAY * PUSH_m and other.median_m < max_median_m:
            raise RegistrationError(
                f"the surface slides or spins on itself: pushed {1e3 * PUSH_m:g} mm "
                f"along its weakest direction, the solution stays {1e3 * away_m:.1f} "
                "mm away and fits as well",
                AnatomyCode.AMBIGUOUS_SURFACE,
            )


def _require_no_better(surface: Surface, fit: _Fit, noise_m: float) -> None:
    """Refuse a solution if another one elsewhere fits better."""
    for points in _other_starts(fit.points):
        other = _fit_points(surface, points, noise_m, fit.points)
        away_m = rms_length(other.points - fit.points)
        if away_m > FAR_m and other.median_m < BETTER_FIT * fit.median_m:
            raise RegistrationError(
                f"another solution, {1e3 * away_m:.0f} mm away, fits better: the start "
                "lies outside the basin",
                AnatomyCode.AMBIGUOUS_SURFACE,
            )


def _registration(touches: Array, fit: _Fit, touch_std_m: float) -> Registration:
    """Return the registration of a fit, with the covariance of its errors.

    They are those of the touches and correlated ones of the surface. Touches that
    slipped add nothing.
    """
    weights = fit.weights
    counts = fit.weights > 0.0
    degrees = max(float(counts.sum()) - 6.0, 1.0)
    mean_square = np.average(fit.distances**2, weights=weights)
    observed_var = mean_square * counts.sum() / degrees
    edges = 1.0 + SURFACE_EDGES * (1.0 - fit.flatness)
    flat_var = (observed_var - touch_std_m**2) / np.average(edges**2, weights=weights)
    distance_m = cdist(fit.points, fit.points)
    correlation = np.exp(-0.5 * (distance_m / SURFACE_REACH_m) ** 2)
    surface_var = max(flat_var, SURFACE_STD_m**2) * np.outer(edges, edges) * correlation
    errors = surface_var + touch_std_m**2 * np.eye(len(touches))
    motion = fit_rigidly(fit.points, touches)
    to_robot = np.kron(np.eye(2), motion.rotation)
    gain = to_robot @ np.linalg.solve(fit.normal_matrix, fit.rows.T * weights)
    return Registration(
        rotation=motion.rotation,
        translation_m=motion.translation_m,
        covariance=gain @ errors @ gain.T,
        pivot_m=touches.mean(axis=0),
        degrees=degrees,
        residual_rms_m=float(np.sqrt(np.mean(fit.distances[counts] ** 2))),
    )
