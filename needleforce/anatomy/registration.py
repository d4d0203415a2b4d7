"""Rigid registration, by landmarks and by touching a surface, and how far off it is at
any point.

The model (CT, LPS) is carried into the robot's base: y = R x + t. Landmarks: least
squares (Arun, Huang, Blostein 1987); the covariance of the six parameters gives the
target registration error at any point, equal to Fitzpatrick's formula (1998) for
isotropic errors. Residuals at the landmarks do not say how large the error at the
target is (Fitzpatrick 2009); they serve to estimate the touches' deviation, and to
refuse.

Touches: Gauss-Newton on distances to the nearest triangles with Tukey's weights, so
that touches that slipped count nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from scipy.stats import f as f_law

from needleforce.anatomy.errors import Array, RegistrationError, require_deviation
from needleforce.anatomy.surface import Surface

LEAST_WIDTH_m = 5e-3
"""Root mean square distance of landmarks from a line below which they count as
collinear."""
FALSE_REFUSAL = 1e-6  # Probability that good landmarks do not fit
TOUCH_STD_m = 0.5e-3
SURFACE_STD_m = 0.24e-3
SURFACE_EDGES = 5.0
SURFACE_REACH_m = 3.7e-3
"""Least error of a flat segmented surface, its growth towards edges, 1 + 5 (1 -
flatness), and the reach of its correlation exp(-(distance / reach)^2 / 2): measured on
liver, kidneys, gallbladder, bladder, femur and two muscles against what segmenting them
at 3 mm leaves."""
HOLD_REACH_m = (
    2.0 * SURFACE_REACH_m
)  # Normals averaged so far around hold hardly any of that error
COARSE_STD_m = 0.6e-3  # More than such a surface is off as a whole
LEAST_TOUCHES = 15
LARGEST = (
    5.0  # Metres of touches or surface, and ratio of lengths, beyond which units differ
)
MOST_OUTLIERS = 0.35
TUKEY = 4.685
ROUNDS = 60
LAST_STEP_m = 1e-7
WIDE_ROUNDS = (
    12  # So long the touches' own distances say which of them slipped, then their noise
)
FULL_STEPS = (
    8.0  # Later ones are shorter: from facet to facet they would go back and forth
)
PUSH_m = 6e-3  # How far a solution is pushed along its weakest directions, measured at the touches
BACK = 0.5  # Part of the push that may be left at the touches after fitting again
FAR_m = 4e-3  # Another solution is another if it lies so far away at the touches
TRIES = np.diag(
    [0.2] * 3 + [12e-3] * 3
)  # Other starts: turned [rad], shifted [m], either way


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the model lies in the robot's base, with its uncertainty.

    The covariance is that of a small rotation [rad] about the pivot, and a shift [m],
    in the robot's base; nan where nothing can be said.

    Attributes:
        rotation: R, (3, 3).
        translation_m: t, (3,).
        covariance: (6, 6).
        pivot_m: In the robot's base, (3,).
        degrees: Of freedom behind the covariance; infinite where the deviation was
            known.
        residual_rms_m: At the landmarks or touches; says nothing of the target.
    """

    rotation: Array
    translation_m: Array
    covariance: Array
    pivot_m: Array
    degrees: float
    residual_rms_m: float

    def to_robot(self, points_m: ArrayLike) -> Array:
        """Points of the model, shape (..., 3), in the robot's base."""
        return np.asarray(points_m, dtype=float) @ self.rotation.T + self.translation_m

    def to_model(self, points_m: ArrayLike) -> Array:
        """Points in the robot's base, shape (..., 3), in the model."""
        return (np.asarray(points_m, dtype=float) - self.translation_m) @ self.rotation

    def covariance_at(self, point_m: ArrayLike) -> Array:
        """Covariance of the error at a point of the model, in the robot's base,
        shape (3, 3).
        """
        lever = _jacobian(self.to_robot(point_m) - self.pivot_m)
        return lever @ self.covariance @ lever.T

    def tre_m(self, point_m: ArrayLike) -> float:
        """Root mean square error to be expected at a point of the model."""
        return float(np.sqrt(np.trace(self.covariance_at(point_m))))

    def std_along_m(self, axis: ArrayLike, point_m: ArrayLike) -> float:
        """Standard deviation at a point of the model along an axis in the robot's
        base.
        """
        unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        return float(np.sqrt(unit @ self.covariance_at(point_m) @ unit))

    def region_contains(
        self, point_m: ArrayLike, truth_m: ArrayLike, level: float = 0.95
    ) -> bool:
        """Whether a place in the robot's base lies in the region of that level about
        a point.
        """
        error = np.asarray(truth_m, dtype=float) - self.to_robot(point_m)
        least = 1e-18 * np.eye(3)  # a nanometre, of a fit without any error
        distance = error @ np.linalg.solve(self.covariance_at(point_m) + least, error)
        # Hotelling's T squared; with so many degrees chi squared.
        return bool(distance <= 3.0 * f_law.ppf(level, 3, min(self.degrees, 1e9)))


def _jacobian(lever_m: Array) -> Array:
    """Displacement of points (..., 3) about a pivot by a small rotation and shift,
    (..., 3, 6).
    """
    turned = np.cross(lever_m[..., None, :], np.eye(3))
    return np.concatenate((turned, np.broadcast_to(np.eye(3), turned.shape)), axis=-1)


def _rms(vectors: Array) -> float:
    """Root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


def _widths_m(points_m: Array) -> Array:
    """Root mean square extents of points (n, 3) about their mean, the largest first,
    (3,).
    """
    return (
        np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)
        / len(points_m) ** 0.5
    )


def _rigid_fit(model: Array, robot: Array) -> tuple[Array, Array, float]:
    """Rotation and shift with the least squares, and their sum."""
    one = model.mean(axis=0)
    two = robot.mean(axis=0)
    found = Rotation.align_vectors(robot - two, model - one)
    turn = found[0]
    return turn.as_matrix(), two - turn.apply(one), float(found[1]) ** 2


def fit_landmarks(
    model_m: ArrayLike,
    robot_m: ArrayLike,
    *,
    std_m: float = 1e-3,
    is_std_known: bool = False,
) -> Registration:
    """Register by landmarks.

    Args:
        model_m: Landmarks in the CT [m], LPS, shape (n, 3).
        robot_m: The same, in the same order, touched with the robot's pointer [m], base
            axes.
        std_m: Standard deviation of a touch along each axis, localisation in the CT
            included: what does not fit with several times as much is refused.
        is_std_known: Use it for the covariance too; else that is estimated from the
            residuals, and with three landmarks, which leave next to none, nothing is
            claimed.

    Raises:
        RegistrationError: Too few, collinear, mirrored or swapped landmarks,
            millimetres for metres, a deviation that is none, one landmark elsewhere.
            Three landmarks cannot show a mirror image.
    """
    require_deviation("std_m", std_m, RegistrationError)
    model, robot = _checked_landmarks(model_m, robot_m)
    rotation, translation, squares = _rigid_fit(model, robot)
    degrees = 3 * len(model) - 6
    residual_m = float(np.sqrt(squares / len(model)))
    if not _fits(model, robot, std_m):
        explained = _explanations(model, robot)
        causes = [why for why, one, two in explained if _fits(one, two, std_m)]
        unknown = (
            f"the landmarks do not fit: {1e3 * residual_m:.1f} mm rms are left with "
            f"{1e3 * std_m:g} mm per axis expected; are they the same points, in the same order?"
        )
        raise RegistrationError([*causes, unknown][0])
    moved = model @ rotation.T + translation
    pivot = moved.mean(axis=0)
    lever = _jacobian(moved - pivot).reshape(-1, 6)
    variance = (
        std_m**2 if is_std_known else squares / degrees if len(model) > 3 else np.nan
    )
    return Registration(
        rotation=rotation,
        translation_m=translation,
        covariance=np.asarray(variance * np.linalg.inv(lever.T @ lever), dtype=float),
        pivot_m=pivot,
        degrees=np.inf if is_std_known else float(degrees),
        residual_rms_m=residual_m,
    )


def _checked_landmarks(model_m: ArrayLike, robot_m: ArrayLike) -> tuple[Array, Array]:
    model, robot = (np.asarray(points, dtype=float) for points in (model_m, robot_m))
    if model.ndim != 2 or model.shape[1:] != (3,) or model.shape != robot.shape:
        shapes = f"{model.shape} and {robot.shape}"
        raise RegistrationError(f"landmarks of shapes {shapes}: expected (n, 3) twice")
    if len(model) < 3:
        raise RegistrationError(f"too few landmarks: {len(model)}; touch three or more")
    if not np.isfinite([model, robot]).all():
        raise RegistrationError("a landmark is not finite; touch it again")
    widths = np.array([_widths_m(model), _widths_m(robot)])
    scale = widths[1, 0] / max(widths[0, 0], 1e-12)
    if not 1.0 / LARGEST < scale < LARGEST:
        raise RegistrationError(
            f"the touched landmarks are {scale:.3g} times as far apart as those of the model: "
            "millimetres for metres? Give both in metres"
        )
    if widths[:, 1].min() < LEAST_WIDTH_m:
        raise RegistrationError(
            "the landmarks are collinear: the model could turn about their line; touch one that "
            "lies aside"
        )
    return model, robot


def _fits(model: Array, robot: Array, std_m: float) -> bool:
    limit = std_m**2 * chi2.isf(FALSE_REFUSAL, 3 * len(model) - 6)
    return bool(_rigid_fit(model, robot)[2] <= limit)


def _explanations(model: Array, robot: Array) -> Iterator[tuple[str, Array, Array]]:
    """What may be wrong, and the landmarks without it: order, mirror, scale, one, in
    this order.
    """
    count = len(model)
    for i, j in combinations(range(count), 2):
        order = np.arange(count)
        order[[i, j]] = j, i
        why = f"landmarks {i + 1} and {j + 1} are swapped; touch them in the model's order"
        yield why, model, robot[order]
    yield (
        "the touched landmarks are the mirror image of the model's: left for right?",
        -model,
        robot,
    )
    scale = _rms(robot - robot.mean(axis=0)) / _rms(model - model.mean(axis=0))
    why = (
        f"the touched landmarks fit with a scale of {scale:.3f}: is the spacing right?"
    )
    yield why, scale * model, robot
    for k in range(count if count > 4 else 0):
        why = f"landmark {k + 1} lies elsewhere than in the model; touch it again"
        yield why, np.delete(model, k, axis=0), np.delete(robot, k, axis=0)


class _Fit(NamedTuple):
    """A solution of the touches.

    Attributes:
        points: touches, carried into the model (n, 3).
        levers: Their motion by a small rotation about their middle, and a shift (n, 3,
            6).
        rows: Derivatives of the distances (n, 6).
        flatness: Of the surface there, 1 for a plane (n,).
        distances: From the surface, positive outside.
        weights: 0 for touches that slipped.
        normal: Matrix of the normal equations (6, 6).
        middle_m: Median distance from the nearest place: outliers do not matter.
    """

    points: Array
    levers: Array
    rows: Array
    flatness: Array
    distances: Array
    weights: Array
    normal: Array
    middle_m: float


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
    found = _fitted(surface, points, noise_m)
    if found.middle_m > noise_m:
        others = (
            _fitted(surface, _moved(points, step), noise_m)
            for step in (*TRIES, *-TRIES)
        )
        found = min(others, key=lambda fit: fit.middle_m)
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
    return _registration(surface, touches, found, touch_std_m)


def _checked_touches(surface: Surface, touches_m: ArrayLike, std_m: float) -> Array:
    """Touches that could register."""
    require_deviation("touch_std_m", std_m, RegistrationError)
    touches = np.asarray(touches_m, dtype=float)
    if touches.ndim != 2 or touches.shape[1:] != (3,) or not np.isfinite(touches).all():
        raise RegistrationError(
            f"touches of shape {touches.shape}: expected finite (n, 3)"
        )
    if len(touches) < LEAST_TOUCHES:
        raise RegistrationError(
            f"too few touches: {len(touches)}; touch {LEAST_TOUCHES} or more"
        )
    size_m = float(np.linalg.norm(np.ptp(touches, axis=0)))
    extent_m = float(surface.mesh.scale)
    if max(size_m, extent_m, size_m / extent_m) > LARGEST:
        raise RegistrationError(
            f"the touches spread over {size_m:.3g} m, the surface over {extent_m:.3g} m: "
            "millimetres for metres? Give both in metres"
        )
    if _widths_m(touches)[1] < LEAST_WIDTH_m:
        raise RegistrationError(
            f"the touches spread over {1e3 * size_m:.3g} mm, near a point or a line: touch more of "
            "the surface"
        )
    return touches


def _fitted(surface: Surface, points: Array, noise_m: float) -> _Fit:
    """Gauss-Newton with Tukey's weights from where touches lie in the model, (n, 3)."""
    count = 0
    while True:
        places, normals = surface.nearest(points)
        apart = points - places
        distances = (apart * normals).sum(axis=1)
        far = np.linalg.norm(apart, axis=1)
        # While far away everything counts; then what lies further than the rest does
        # not; last what lies further than noise: many that slipped together would widen
        # their own scale.
        middle_m = float(np.median(far))
        scale = noise_m
        if count < WIDE_ROUNDS:
            scale = max(1.4826 * middle_m, scale)
        else:
            normals = surface.mean_normals(places, normals, HOLD_REACH_m)
        flatness = np.linalg.norm(normals, axis=1)
        weights = (1.0 - np.minimum(far / (TUKEY * scale), 1.0) ** 2) ** 2
        levers = _jacobian(points - points.mean(axis=0))
        rows = np.einsum("ni,nij->nj", normals / flatness[:, None], levers)
        normal = rows.T @ (weights[:, None] * rows)
        found = _Fit(
            points, levers, rows, flatness, distances, weights, normal, middle_m
        )
        # What the touches do not hold is held a little, so that a sphere has a solution
        # too.
        spins, slides = np.split(np.diag(normal), 2)
        held = normal + 1e-6 * np.diag(np.repeat([spins.sum(), slides.sum()], 3))
        step = -np.linalg.lstsq(held, rows.T @ (weights * distances))[
            0
        ]  # 0 where all slipped
        count += 1
        points = _moved(points, step * min(1.0, FULL_STEPS / count))
        is_still = count > WIDE_ROUNDS + 1 and _rms(points - found.points) < LAST_STEP_m
        if is_still or count == ROUNDS:
            return found


def _moved(points: Array, step: Array) -> Array:
    """Points (n, 3) after a rotation about their middle and a shift, (6,)."""
    middle = points.mean(axis=0)
    return Rotation.from_rotvec(step[:3]).apply(points - middle) + middle + step[3:]


def _require_no_other(surface: Surface, found: _Fit, noise_m: float) -> None:
    """Refuse a surface that the solution slides along, and one that fits better
    elsewhere.
    """
    # Directions along which distances change least, each a root mean square of 1 at the
    # touches.
    motion = np.einsum("nij,nik->jk", found.levers, found.levers) / len(found.points)
    for direction in eigh(found.normal, motion)[1][:, :3].T:
        again = _fitted(surface, _moved(found.points, PUSH_m * direction), noise_m)
        left_m = _rms(again.points - found.points)
        if left_m > BACK * PUSH_m and again.middle_m < 1.3 * max(
            found.middle_m, 0.35 * noise_m
        ):
            raise RegistrationError(
                f"the surface slides or spins on itself: pushed {1e3 * PUSH_m:g} mm along its "
                f"weakest direction, the solution stays {1e3 * left_m:.1f} mm away and fits as "
                "well; touch a part with edges or another shape"
            )
    for step in (*TRIES, *-TRIES):
        again = _fitted(surface, _moved(found.points, step), noise_m)
        left_m = _rms(again.points - found.points)
        if left_m > FAR_m and again.middle_m < 0.9 * found.middle_m:
            raise RegistrationError(
                f"another solution, {1e3 * left_m:.0f} mm away, fits better: the start lies "
                "outside the basin; register by landmarks again"
            )


def _registration(
    surface: Surface, touches: Array, found: _Fit, touch_std_m: float
) -> Registration:
    """The fit from model to robot, with a covariance of touches and correlated
    surface errors.
    """
    # the others, which slipped, gain nothing
    weights = found.weights
    kept = found.weights > 0.0
    degrees = max(float(kept.sum()) - 6.0, 1.0)
    observed = np.average(found.distances**2, weights=weights) * kept.sum() / degrees
    edges = 1.0 + SURFACE_EDGES * (1.0 - found.flatness)
    flat_var = (observed - touch_std_m**2) / np.average(edges**2, weights=weights)
    same = np.exp(-0.5 * (cdist(found.points, found.points) / SURFACE_REACH_m) ** 2)
    surface_var = max(flat_var, SURFACE_STD_m**2) * np.outer(edges, edges) * same
    errors = surface_var + touch_std_m**2 * np.eye(len(touches))
    rotation, translation, _ = _rigid_fit(found.points, touches)
    turn = np.kron(np.eye(2), rotation)  # from the model's axes to the robot's
    gain = turn @ np.linalg.solve(found.normal, found.rows.T * weights)
    return Registration(
        rotation=rotation,
        translation_m=translation,
        covariance=gain @ errors @ gain.T,
        pivot_m=touches.mean(axis=0),
        degrees=degrees,
        residual_rms_m=float(np.sqrt(np.mean(found.distances[kept] ** 2))),
    )
