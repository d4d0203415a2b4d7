"""Where the model lies in the robot's base, and how far off that is at any point.

The model (CT, LPS) is carried into the robot's base: y = R x + t. The covariance of
the six parameters of a registration gives the target registration error at any point,
equal to Fitzpatrick's formula (1998) for isotropic errors. Landmarks register here,
landmarks and touches in `surface_fit`.

Residuals at the landmarks do not say how large the error at the target is (Fitzpatrick
2009); they serve to estimate the touches' deviation, and to refuse.

RAS is LPS after half a turn about the axis from feet to head, so landmarks of the wrong
frame register as well, but with the patient turned over. The skin shows it, or, on a
body that is alike in front and back, names with a side and touches about the entry.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc, chdtri, fdtri

from foundation.arrays import Array
from needleforce.anatomy.errors import RegistrationError, require_deviation
from needleforce.anatomy.surface import Surface
from needleforce.anatomy.volume import RAS_TO_LPS, words_of

MIN_WIDTH_m = 5e-3
"""Root mean square distance of points from a line below which they count as
collinear."""

MAX_LENGTH_RATIO = 5.0
"""Ratio of lengths in model and robot beyond which their units differ."""


MAX_DEGREES = 1e9
"""With so many degrees of freedom the F law is that of chi squared."""


@dataclass(frozen=True, eq=False)
class RigidTransform:
    """Where the model lies in the robot's base: y = R x + t.

    Attributes:
        rotation: R, from the model to the robot's base, (3, 3).
        translation_m: t, (3,).
    """

    rotation: Array
    translation_m: Array

    def to_robot(self, points_m: ArrayLike) -> Array:
        """Carry points of the model, shape (..., 3), into the robot's base."""
        return np.asarray(points_m, dtype=float) @ self.rotation.T + self.translation_m

    def to_model(self, points_m: ArrayLike) -> Array:
        """Carry points in the robot's base, shape (..., 3), into the model."""
        return (np.asarray(points_m, dtype=float) - self.translation_m) @ self.rotation


@dataclass(frozen=True, eq=False)
class Registration(RigidTransform):
    """Where the model lies in the robot's base, with its uncertainty.

    The covariance is that of a small rotation [rad] about the pivot, and a shift [m],
    in the robot's base; nan where nothing can be said.

    Attributes:
        covariance: Of rotation and shift, (6, 6).
        pivot_m: In the robot's base, (3,).
        degrees: Of freedom behind the covariance; infinite where the deviation was
            known.
        residual_rms_m: At the landmarks or touches; says nothing of the target.
        indentation_m: By so much touches pressed the surface in, on average.
        indentation_std_m: Its standard deviation.
    """

    covariance: Array
    pivot_m: Array
    degrees: float
    residual_rms_m: float
    indentation_m: float = 0.0
    indentation_std_m: float = 0.0

    def covariance_at(self, point_m: ArrayLike) -> Array:
        """Return covariances of the error at points (..., 3) of the model, (..., 3, 3).

        Their axes are those of the robot's base.
        """
        jacobian = displacement_jacobian(self.to_robot(point_m) - self.pivot_m)
        return jacobian @ self.covariance @ np.swapaxes(jacobian, -1, -2)

    def tre_m(self, point_m: ArrayLike) -> float:
        """Return the root mean square error to be expected at a point of the model."""
        return float(np.sqrt(np.trace(self.covariance_at(point_m))))

    def std_along_m(self, axis: ArrayLike, point_m: ArrayLike) -> float:
        """Return the standard deviation of a point of the model along an axis.

        Args:
            axis: In the robot's base, of any length, shape (3,).
            point_m: Of the model, shape (3,).
        """
        unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        return float(np.sqrt(unit @ self.covariance_at(point_m) @ unit))

    def largest_std_m(self, points_m: ArrayLike) -> float:
        """Return the largest standard deviation in any direction at points.

        Between two points on a straight path it is no larger than at both.

        Args:
            points_m: Of the model, shape (n, 3).
        """
        variances_m2 = np.linalg.eigvalsh(self.covariance_at(points_m))
        return float(np.sqrt(variances_m2.max()))

    def region_contains(
        self, point_m: ArrayLike, truth_m: ArrayLike, level: float = 0.95
    ) -> bool:
        """Return whether a place lies in the region of a level about a point.

        Args:
            point_m: Of the model, shape (3,).
            truth_m: The place, in the robot's base, shape (3,).
            level: Probability that the point lies in the region.
        """
        min_variance_m2 = 1e-18  # a nanometre, squared, of a fit without any error
        error_m = np.asarray(truth_m, dtype=float) - self.to_robot(point_m)
        covariance = self.covariance_at(point_m) + min_variance_m2 * np.eye(3)
        hotelling_t2 = error_m @ np.linalg.solve(covariance, error_m)
        quantile = 3.0 * fdtri(3, min(self.degrees, MAX_DEGREES), level)
        return bool(hotelling_t2 <= quantile)


def fit_rigidly(model_m: Array, robot_m: Array) -> RigidTransform:
    """Fit a rotation and a shift to points in both frames, shape (n, 3) each.

    Least squares (Arun, Huang, Blostein 1987).
    """
    model_mean_m = model_m.mean(axis=0)
    robot_mean_m = robot_m.mean(axis=0)
    fit = Rotation.align_vectors(robot_m - robot_mean_m, model_m - model_mean_m)[0]
    return RigidTransform(fit.as_matrix(), robot_mean_m - fit.apply(model_mean_m))


def displacement_jacobian(lever_m: Array) -> Array:
    """Return the displacement of points per small rotation and shift, (..., 3, 6).

    Args:
        lever_m: From the pivot to the points, shape (..., 3).
    """
    turned = np.cross(np.eye(3), lever_m[..., None, :])  # about each axis, in rows
    shifted = np.broadcast_to(np.eye(3), turned.shape)
    return np.concatenate([np.swapaxes(turned, -1, -2), shifted], axis=-1)


def rms_length(vectors: Array) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


def rms_extents_m(points_m: Array) -> Array:
    """Return the root mean square extents of points about their mean, shape (3,).

    Along their principal axes, the largest first; points have shape (n, 3).
    """
    centred_m = points_m - points_m.mean(axis=0)
    return np.linalg.svd(centred_m, compute_uv=False) / len(points_m) ** 0.5


MIN_VERIFIED = 5
"""With fewer landmarks the others do not say which of them is off."""

DOUBTFUL = 0.01
"""A landmark whose residual would be exceeded less often is named."""


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
        is_std_known: It decides the covariance of three landmarks, which leave next to
            no residuals and else claim nothing; of more it counts as half a residual,
            so that one landmark that is off widens the covariance.

    Raises:
        RegistrationError: Too few, collinear, mirrored or swapped landmarks,
            millimetres for metres, a deviation that is none, one landmark elsewhere,
            landmarks that fit as well in another order.
            Three landmarks cannot show a mirror image.
    """
    false_refusal = 1e-6  # probability that good landmarks do not fit
    require_deviation("std_m", std_m, RegistrationError)
    model = np.asarray(model_m, dtype=float)
    robot = np.asarray(robot_m, dtype=float)
    _require_landmarks(model, robot)
    fit = fit_rigidly(model, robot)
    moved_m = fit.to_robot(model)
    squares_m2 = float(((moved_m - robot) ** 2).sum())
    residual_rms_m = float(np.sqrt(squares_m2 / len(model)))
    degrees = 3.0 * len(model) - 6.0
    if squares_m2 > std_m**2 * chdtri(degrees, false_refusal):
        raise RegistrationError(
            f"the landmarks do not fit: {1e3 * residual_rms_m:.1f} mm rms are left, "
            f"with {1e3 * std_m:g} mm per axis expected: two are swapped, one lies "
            "elsewhere, or they are a mirror image or scaled"
        )
    _require_one_order(model, robot, std_m, squares_m2)
    # Residuals that good landmarks exceed more seldom are taken for those of one
    # landmark that is off: its three coordinates decide.
    is_off = chdtrc(degrees, squares_m2 / std_m**2) < 0.05
    # A known deviation counts as half a residual: as all but those of the landmarks,
    # or one of them that is off would leave the error as it is.
    stated = 0.0 if is_off else 0.5 * is_std_known
    variance_m2 = (squares_m2 + stated * std_m**2) / (degrees + stated)
    degrees = 3.0 if is_off else degrees + stated
    if len(model) == 3 and not (is_std_known and is_off):
        variance_m2 = std_m**2 if is_std_known else np.nan
        degrees = np.inf if is_std_known else 3.0
    pivot_m = moved_m.mean(axis=0)
    rows = displacement_jacobian(moved_m - pivot_m).reshape(-1, 6)
    return Registration(
        rotation=fit.rotation,
        translation_m=fit.translation_m,
        covariance=np.asarray(variance_m2 * np.linalg.inv(rows.T @ rows), dtype=float),
        pivot_m=pivot_m,
        degrees=degrees,
        residual_rms_m=residual_rms_m,
    )


def _require_landmarks(model: Array, robot: Array) -> None:
    """Refuse landmarks that could not register."""
    is_list = model.ndim == 2 and model.shape[1:] == (3,) and model.shape == robot.shape
    if not is_list or len(model) < 3 or not np.isfinite([model, robot]).all():
        raise RegistrationError(
            f"landmarks of shapes {model.shape} and {robot.shape}, too few or one not "
            "finite: expected (n, 3) twice, three or more"
        )
    extents_m = np.array([rms_extents_m(model), rms_extents_m(robot)])
    ratio = extents_m[1, 0] / max(extents_m[0, 0], 1e-12)
    is_narrow = extents_m[:, 1].min() < MIN_WIDTH_m
    if is_narrow or not 1.0 / MAX_LENGTH_RATIO < ratio < MAX_LENGTH_RATIO:
        raise RegistrationError(
            f"the touched landmarks are {ratio:.3g} times as far apart as those of the "
            "model (millimetres for metres?), or collinear: the model could turn about "
            "their line"
        )


def _require_one_order(
    model: Array, robot: Array, std_m: float, squares_m2: float
) -> None:
    """Refuse landmarks that fit as well in another order: they lie symmetrically."""
    # Of more landmarks not all orders are tried.
    max_ordered = 7
    # Distances between landmarks that differ by so many standard deviations rule an
    # order out before it is fitted.
    max_gap_std = 8.0
    # Difference of the squares over the variance below which another order fits as
    # well: the stated one is less than 150 times as likely. Of three landmarks two
    # sides are often nearly equal.
    equal_fit = 10.0 if len(model) > 3 else 2.0
    if len(model) > max_ordered:
        return
    # Without the first one, which is the stated order.
    orders = np.array(list(permutations(range(len(model)))))[1:]
    gaps_m = cdist(robot, robot)[orders[:, :, None], orders[:, None, :]]
    differences_m = np.abs(gaps_m - cdist(model, model)).max(axis=(1, 2))
    for order in orders[differences_m <= max_gap_std * std_m]:
        off_m = fit_rigidly(model, robot[order]).to_robot(model) - robot[order]
        if (off_m**2).sum() <= squares_m2 + equal_fit * std_m**2:
            raise RegistrationError(
                f"the landmarks fit as well in another order ({order + 1}): they lie "
                "symmetrically; touch one more, off the symmetry"
            )


@dataclass(frozen=True)
class LandmarkResidual:
    """How far a landmark lies from where the others put it.

    Attributes:
        name: Of the landmark.
        left_m: Distance that the fit of all landmarks leaves.
        left_out_m: Distance in the fit of the others; nan where they cannot register.
        probability: Of so large a distance or a larger one where nothing is wrong; nan
            where it cannot be judged.
    """

    name: str
    left_m: float
    left_out_m: float
    probability: float

    @property
    def is_doubtful(self) -> bool:
        """Whether the landmark is probably off."""
        return bool(self.probability < DOUBTFUL)


def judge_landmarks(
    model_m: ArrayLike,
    robot_m: ArrayLike,
    std_m: float,
    names: Sequence[str] = (),
) -> list[LandmarkResidual]:
    """Return the residual of each landmark, also in the fit of the others.

    That is not pulled towards the landmark itself. With n - 1 others of standard
    deviation s, its covariance is s^2 (I + J (J'J)^-1 J'), J the displacement per
    rotation and shift, so its size follows chi squared with three degrees of freedom.

    Args:
        model_m: Landmarks in the CT, (n, 3).
        robot_m: The same in the robot's base.
        std_m: Standard deviation of a landmark along each axis.
        names: Of the landmarks; by default their numbers from 1.
    """
    model = np.asarray(model_m, dtype=float)
    robot = np.asarray(robot_m, dtype=float)
    left_m = fit_rigidly(model, robot).to_robot(model) - robot
    residuals: list[LandmarkResidual] = []
    for number, name in enumerate(names or map(str, range(1, len(model) + 1))):
        others = np.delete(np.arange(len(model)), number)
        distance_m = probability = np.nan
        if len(model) > 3 and rms_extents_m(model[others])[1] >= MIN_WIDTH_m:
            moved_m = fit_rigidly(model[others], robot[others]).to_robot(model)
            error_m = moved_m[number] - robot[number]
            distance_m = float(np.linalg.norm(error_m))
            jacobian = displacement_jacobian(moved_m - moved_m[others].mean(axis=0))
            rows = jacobian[others].reshape(-1, 6)
            inner = np.linalg.solve(rows.T @ rows, jacobian[number].T)
            factor = np.eye(3) + jacobian[number] @ inner
            squares = error_m @ np.linalg.solve(factor, error_m) / std_m**2
            if len(model) >= MIN_VERIFIED:
                probability = float(chdtrc(3, squares))
        left = float(np.linalg.norm(left_m[number]))
        residuals.append(LandmarkResidual(name, left, distance_m, probability))
    return residuals


SIDES = {
    "left": np.array([1.0, 0.0, 0.0]),
    "right": np.array([-1.0, 0.0, 0.0]),
    **dict.fromkeys(
        ("xiphoid", "sternum", "navel", "umbilicus", "nipple"),
        np.array([0.0, -1.0, 0.0]),
    ),
}
"""Directions in LPS of words in the names of landmarks."""


def require_lps(
    points_m: Array,
    skin: Surface,
    names: Sequence[str] = (),
    *,
    touches_m: ArrayLike = (),
    entry_m: Array | None = None,
) -> list[str]:
    """Refuse landmarks that belong to the CT only with x and y negated.

    Args:
        points_m: Landmarks of the skin as LPS, (n, 3).
        skin: Of the CT.
        names: Of the landmarks; those with a side, such as *left*, are compared with
            the body.
        touches_m: Touches of the skin around the entry, carried into the CT by these
            landmarks, (m, 3).
        entry_m: The planned entry, (3,) in LPS, with which touches are compared.

    Returns:
        What is doubtful or could not be verified, in words.

    Raises:
        RegistrationError: So they lie nearer to the skin, on the sides that their names
            state, or the touches nearer to the planned entry; or they lie far from the
            skin either way.
    """
    # So much nearer to the skin they are in the right frame than in the wrong one.
    other_frame_ratio = 3.0
    # Landmarks this near to the skin are in the right frame, as far as it shows.
    min_off_skin_m = 2e-3
    max_off_skin_m = 0.012  # landmarks of the skin lie nearer to it
    other_ct_m = 0.03  # so far, on average, are those of another CT
    far_from_entry_m = 0.15  # touches about the entry lie nearer to it
    off_m, other_m = (
        np.linalg.norm(one_m - skin.nearest(one_m)[0], axis=1).mean()
        for one_m in (points_m, points_m * RAS_TO_LPS)
    )
    if off_m > max(min_off_skin_m, other_frame_ratio * other_m):
        raise _refusal(f"{1e3 * off_m:.1f} mm from the skin, then {1e3 * other_m:.1f}")
    if off_m > other_ct_m:
        raise RegistrationError(
            f"the landmarks lie {1e3 * off_m:.0f} mm from the skin on average, less "
            f"than {1e3 * other_ct_m:.0f} expected: they belong to another CT"
        )
    has_sides = _require_sides(points_m, skin, names)
    off_entry_m = _require_touches(np.asarray(touches_m), entry_m)
    is_shown_by_skin = other_m > max(min_off_skin_m, other_frame_ratio * off_m)
    is_shown = is_shown_by_skin or has_sides or np.isfinite(off_entry_m)
    doubts = {
        f"half of the touches lie {1e3 * off_entry_m:.0f} mm or more from the planned "
        "entry: whether they belong to this plan": off_entry_m > far_from_entry_m,
        f"the landmarks lie {1e3 * off_m:.0f} mm from the skin of the CT on average: "
        "whether they belong to this CT": off_m > max_off_skin_m,
        "whether the landmarks are in LPS, as with x and y negated they lie on the "
        "skin too, and no name says left, right or navel,": not is_shown,
    }
    return [f"{what} is not verified" for what, is_open in doubts.items() if is_open]


def _refusal(finding: str) -> RegistrationError:
    """Return the refusal for a finding."""
    return RegistrationError(
        f"the landmarks belong to the CT only with x and y negated ({finding}): the "
        "file says LPS and holds RAS, or the reverse; `--negate-xy` negates them"
    )


def _require_sides(points_m: Array, skin: Surface, names: Sequence[str]) -> bool:
    """Refuse landmarks that do not lie on the sides that their names state.

    Returns:
        Whether any name states one.
    """
    min_side_m = 5e-3  # landmarks nearer to the middle of the body say nothing of sides
    middle_m = 0.5 * (skin.vertices_m.min(axis=0) + skin.vertices_m.max(axis=0))
    aside_m = [
        (point_m - middle_m) @ SIDES[word]
        for name, point_m in zip(names, points_m, strict=False)
        for word in words_of(name) & SIDES.keys()
    ]
    wrong = sum(one_m < -min_side_m for one_m in aside_m)
    right = sum(one_m > min_side_m for one_m in aside_m)
    if wrong and wrong >= right:
        raise _refusal(f"{wrong} lie on the other side than their names say")
    return right > 0


def _require_touches(touches_m: Array, entry_m: Array | None) -> float:
    """Refuse touches that lie about the entry only with x and y negated.

    Returns:
        How far they lie from it, in the median; nan where there are none.
    """
    # Touches are in the other frame if there they lie so much nearer to the entry:
    # errors of the first registration and the choice of places make less.
    min_nearer_m = 0.03
    nearer_ratio = 1.5  # far from the entry the distance alone shows little
    if entry_m is None or not len(touches_m):
        return float("nan")
    off_m, other_m = (
        float(np.median(np.linalg.norm(one_m - entry_m, axis=1)))
        for one_m in (touches_m, touches_m * RAS_TO_LPS)
    )
    if off_m > max(nearer_ratio * other_m, other_m + min_nearer_m):
        raise _refusal(
            f"the entry is {1e3 * off_m:.0f} mm from touches, then {1e3 * other_m:.0f}"
        )
    return off_m
