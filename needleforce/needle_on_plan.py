"""The needle against the planned path: beside it, turned, to its target, how sure.

The planned path is a line in the robot's base, known as well as the registration. The
needle is a line, too: its tip and its direction as the robot states them. Where both
lines should be one, the distances between them are errors of the registration; beyond
what chance makes of these, the needle is off the plan, and nothing may be named by it.
A needle on the line may still have gone too far: past the target.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array

if TYPE_CHECKING:
    from needleforce.anatomy import NeedleClearance

MARGIN_m = 1e-3
"""Distance beside the path that is never off the plan."""

TOLERANCE_m = 5e-3
"""How far the needle may be beside its path where no plan says it: the usual margin."""

MARGIN_rad = math.radians(1.0)
"""Angle that is never off the plan."""

STDS = 3.7
"""Beyond so many standard deviations the needle is off the plan. A distance in a plane
exceeds them by chance once in a thousand insertions."""

CERTAIN_STDS = 2.0
"""So many standard deviations beyond what is measured the needle may be: within them
it must stay within its tolerance, or nobody can tell that it is on the plan."""


TIP_STD_m = 0.1e-3
"""Standard deviation of the needle's tip in the robot's base: repeatability of arms."""


OFF_PLAN = "off plan"
PAST_TARGET = "past target"
TOO_NEAR = "too near"
CANNOT_TELL = "cannot tell"
ON_PLAN = "on plan"


class _Registration(Protocol):
    """What `needleforce.anatomy.Registration` says of a place."""

    covariance: Array
    pivot_m: Array

    def to_robot(self, points_m: ArrayLike) -> Array:
        """Carry points of the model into the robot's base."""
        ...


class PlanDeviation(NamedTuple):
    """The needle against the planned path; standard deviations include registration.

    Attributes:
        entry_m: Distance of the needle's line from the planned entry.
        entry_std_m: Its standard deviation, the larger one of two directions.
        tip_m: Distance of the tip from the planned line.
        tip_std_m: Its standard deviation.
        angle_rad: Between the planned and the needle's direction.
        angle_std_rad: Its standard deviation.
        depth_m: Of the tip below the planned entry, along the planned line.
        to_target_m: From the tip to the target along the planned line; negative past
            the target, nan where no target is known.
        to_target_std_m: Its standard deviation; organs that move are not in it.
        is_off_plan: Whether one of the first three exceeds its margin and 3.7 standard
            deviations.
        is_past_target: Whether the tip is past the target by more than its margin and
            two standard deviations.
        is_doubtful: Whether it cannot be told that the needle is on the plan: with two
            standard deviations it may be further aside, or past the target, than its
            tolerance, or so turned that it will be.
    """

    entry_m: float
    entry_std_m: float
    tip_m: float
    tip_std_m: float
    angle_rad: float
    angle_std_rad: float
    depth_m: float
    to_target_m: float
    to_target_std_m: float
    is_off_plan: bool
    is_past_target: bool
    is_doubtful: bool

    @property
    def verdict(self) -> str:
        """What holds first: off plan, past target, cannot tell; else on plan."""
        if self.is_off_plan:
            return OFF_PLAN
        if self.is_past_target:
            return PAST_TARGET
        return CANNOT_TELL if self.is_doubtful else ON_PLAN


@dataclass(frozen=True, eq=False)
class PlannedPath:
    """A planned straight path in the robot's base, with its uncertainty.

    Attributes:
        entry_m: Where it enters the patient, (3,).
        target_m: Where it ends, (3,).
        covariance: Of a small rotation [rad] about the pivot and a shift [m], (6, 6).
        pivot_m: In the robot's base, (3,).
        margin_m: Distance that is never off the plan, nor past the target.
        margin_rad: Angle that is never off the plan.
        tolerance_m: How far the needle may be beside the path, or past the target: the
            margin of the plan.
    """

    entry_m: Array
    target_m: Array
    covariance: Array
    pivot_m: Array
    margin_m: float = MARGIN_m
    margin_rad: float = MARGIN_rad
    tolerance_m: float = TOLERANCE_m

    @cached_property
    def _uncertainty(self) -> "_PathCovariance":
        return _PathCovariance(self)

    @classmethod
    def of_registration(
        cls, registration: _Registration, entry_m: ArrayLike, target_m: ArrayLike
    ) -> "PlannedPath":
        """Return the path between two points of the model, registered to the robot."""
        return cls(
            registration.to_robot(entry_m),
            registration.to_robot(target_m),
            np.array(registration.covariance, dtype=float),
            np.array(registration.pivot_m, dtype=float),
        )

    @classmethod
    def of_std(
        cls, entry_m: ArrayLike, target_m: ArrayLike, std_m: float
    ) -> "PlannedPath":
        """Return a path in the robot's base with one deviation for all directions.

        Args:
            entry_m: Entry in the robot's base, (3,).
            target_m: Target in the robot's base, (3,).
            std_m: Standard deviation of the registration along each axis.
        """
        # Landmarks and touches lie some 100 mm around a path: where a registration
        # states one standard deviation for all directions, its rotation has that over
        # this distance.
        registered_radius_m = 0.1
        rotation_rad = std_m / registered_radius_m
        variances = [rotation_rad**2] * 3 + [std_m**2] * 3
        entry = np.array(entry_m, dtype=float)
        return cls(entry, np.array(target_m, dtype=float), np.diag(variances), entry)

    @property
    def axis(self) -> Array:
        """Planned direction, of length one, (3,)."""
        way_m = self.target_m - self.entry_m
        return way_m / np.linalg.norm(way_m)

    @property
    def fingerprint(self) -> str:
        """Text that is equal for equal paths."""
        numbers = [
            self.entry_m.tolist(),
            self.target_m.tolist(),
            self.covariance.tolist(),
            self.pivot_m.tolist(),
            self.margin_m,
            self.margin_rad,
            self.tolerance_m,
        ]
        return repr(numbers)

    def deviation(self, tip_m: Array, axis: Array) -> PlanDeviation:
        """Return where a needle is against the path.

        Args:
            tip_m: Tip of the needle in the robot's base, (3,).
            axis: Its direction, of length one, (3,).
        """
        # Beyond so many standard deviations the tip is past the target: a needle that
        # stops once too early does less harm than one that goes on.
        past_stds = 2.0
        uncertainty = self._uncertainty
        planned = uncertainty.axis
        from_entry = (tip_m - self.entry_m).tolist()
        needle = axis.tolist()
        depth_m = _dot(from_entry, planned)
        entry_m = _distance(from_entry, needle)
        tip_distance_m = _distance(from_entry, planned)
        angle_rad = math.atan2(_distance(planned, needle), _dot(planned, needle))
        entry_std_m = uncertainty.std_m(0.0)
        tip_std_m = uncertainty.std_m(depth_m)
        angle_std_rad = uncertainty.angle_std_rad
        to_target_m = uncertainty.length_m - depth_m
        past_m = max(self.margin_m, past_stds * uncertainty.along_std_m)
        is_off_plan = (
            entry_m > max(self.margin_m, STDS * entry_std_m)
            or tip_distance_m > max(self.margin_m, STDS * tip_std_m)
            or angle_rad > max(self.margin_rad, STDS * angle_std_rad)
        )
        tolerance_rad = math.atan2(self.tolerance_m, uncertainty.length_m)
        is_doubtful = (
            entry_m + CERTAIN_STDS * entry_std_m > self.tolerance_m
            or tip_distance_m + CERTAIN_STDS * tip_std_m > self.tolerance_m
            or angle_rad + CERTAIN_STDS * angle_std_rad > tolerance_rad
            or CERTAIN_STDS * uncertainty.along_std_m - to_target_m > self.tolerance_m
        )
        return PlanDeviation(
            entry_m,
            entry_std_m,
            tip_distance_m,
            tip_std_m,
            angle_rad,
            angle_std_rad,
            depth_m,
            to_target_m,
            uncertainty.along_std_m,
            is_off_plan,
            is_past_target=to_target_m < -past_m,
            is_doubtful=is_doubtful,
        )


@dataclass(frozen=True, eq=False)
class PlannedEntry:
    """A planned entry whose direction is not known: only the entry can be checked.

    Attributes:
        entry_m: In the robot's base, (3,).
        std_m: Standard deviation of the registration along each axis.
        margin_m: Distance that is never off the plan.
        tolerance_m: How far the needle may be beside the entry.
    """

    entry_m: Array
    std_m: float
    margin_m: float = MARGIN_m
    tolerance_m: float = TOLERANCE_m

    @property
    def fingerprint(self) -> str:
        """Text that is equal for equal entries."""
        numbers = [self.entry_m.tolist(), self.std_m, self.margin_m, self.tolerance_m]
        return repr(numbers)

    def deviation(self, tip_m: Array, axis: Array) -> PlanDeviation:
        """Return how far a needle's line passes from the entry; its angle is 0.

        Args:
            tip_m: Tip of the needle in the robot's base, (3,).
            axis: Its direction, of length one, (3,).
        """
        from_entry = (tip_m - self.entry_m).tolist()
        needle = axis.tolist()
        entry_m = _distance(from_entry, needle)
        std_m = math.hypot(self.std_m, TIP_STD_m)
        return PlanDeviation(
            entry_m=entry_m,
            entry_std_m=std_m,
            tip_m=entry_m,
            tip_std_m=std_m,
            angle_rad=0.0,
            angle_std_rad=math.pi,
            depth_m=_dot(from_entry, needle),
            to_target_m=math.nan,
            to_target_std_m=math.nan,
            is_off_plan=entry_m > max(self.margin_m, STDS * std_m),
            is_past_target=False,
            is_doubtful=entry_m + CERTAIN_STDS * std_m > self.tolerance_m,
        )


def describe_deviation(deviation: PlanDeviation) -> str:
    """Return the needle against the plan in words; behind ± is a standard deviation."""
    text = (
        f"{1e3 * deviation.entry_m:.1f} ± {1e3 * deviation.entry_std_m:.1f} mm beside "
        f"the planned entry, tip {1e3 * deviation.tip_m:.1f} ± "
        f"{1e3 * deviation.tip_std_m:.1f} mm beside the planned path"
    )
    if deviation.angle_std_rad < math.pi:
        text += (
            f", turned by {math.degrees(deviation.angle_rad):.1f} ± "
            f"{math.degrees(deviation.angle_std_rad):.1f}°"
        )
    if not math.isnan(deviation.to_target_m):
        text += f", tip {describe_to_target(deviation)}"
    verdicts = ["OFF PLAN"] if deviation.is_off_plan else []
    verdicts += ["PAST THE TARGET"] if deviation.is_past_target else []
    if not verdicts:
        verdicts = ["CANNOT TELL"] if deviation.is_doubtful else ["on plan"]
    return f"{' and '.join(verdicts)}: {text}"


def describe_to_target(deviation: PlanDeviation) -> str:
    """Return how far the tip is in front of the target, or past it, in words."""
    side = "past" if deviation.to_target_m < 0.0 else "in front of"
    return (
        f"{1e3 * abs(deviation.to_target_m):.1f} ± "
        f"{1e3 * deviation.to_target_std_m:.1f} mm {side} the target"
    )


class Surroundings(Protocol):
    """Interface of what lies around; `anatomy.NeedleSurroundings` is one."""

    def clearances(self, tip_m: Array, axis: Array) -> Sequence["NeedleClearance"]:
        """Return how near a needle comes to each structure.

        What is too near comes first, then the nearest.
        """
        ...


def describe_too_near(clearance: "NeedleClearance") -> str:
    """Return in words that the needle, or its way ahead, is too near to a structure."""
    return (
        f"TOO NEAR: {clearance}, at least {1e3 * max(clearance.needed_m, 0.0):.1f} mm "
        "must stay free"
    )


def describe_clearances(clearances: Sequence["NeedleClearance"], count: int = 3) -> str:
    """Return the nearest structures in words; empty without any."""
    if not clearances:
        return ""
    near = [describe_too_near(one) for one in clearances if one.is_too_near]
    if near:
        return "; ".join(near)
    return f"clear: {', '.join(map(str, clearances[:count]))}"


def find_verdict(
    deviation: PlanDeviation, clearances: Sequence["NeedleClearance"] = ()
) -> str:
    """Return what holds first: `PlanDeviation.verdict`, or too near to a structure.

    Off the plan and past the target come before it, cannot tell comes after.
    """
    verdict = deviation.verdict
    is_near = any(one.is_too_near for one in clearances)
    return TOO_NEAR if is_near and verdict in (CANNOT_TELL, ON_PLAN) else verdict


def state_values(
    deviation: PlanDeviation, clearances: Sequence["NeedleClearance"] = ()
) -> dict[str, Any]:
    """Return the state of the needle on its plan as named values, for files and links.

    What is not known is left out.

    Args:
        deviation: The needle against the planned path.
        clearances: How near it comes to structures at risk.
    """
    values: dict[str, Any] = {"verdict": find_verdict(deviation, clearances)}
    values |= deviation._asdict()
    nearest = {
        one.name: {
            "needle_m": one.needle_m,
            "ahead_m": one.ahead_m,
            "std_m": one.std_m,
            "needed_m": one.needed_m,
            "is_too_near": one.is_too_near,
        }
        for one in clearances
    }
    values["clearances"] = {
        name: _known_values(clearance) for name, clearance in nearest.items()
    }
    return _known_values(values)


def _known_values(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values without numbers that are not finite."""
    return {
        name: value
        for name, value in values.items()
        if not isinstance(value, float) or math.isfinite(value)
    }


class _PathCovariance:
    """Covariance of a path: across its direction as a function of depth, and along it.

    A registration that errs by a rotation w about a pivot p and a shift t moves a point
    x by w x (x - p) + t. Across the path, along u and v, that is linear in the depth of
    x, so its variances are polynomials of degree two. Along the path the rotation moves
    all points of the line alike.

    Args:
        path: The path.

    Attributes:
        axis: Direction of the path, three numbers.
        length_m: From entry to target.
        along_std_m: Standard deviation of the tip against the target along the path.
        angle_std_rad: Standard deviation of its direction, the larger one.
    """

    def __init__(self, path: PlannedPath) -> None:
        # Standard deviation of the needle's direction in the robot's base.
        axis_std_rad = 1e-3
        axis = path.axis
        least = np.eye(3)[int(np.abs(axis).argmin())]
        across = np.cross(axis, least)
        across /= np.linalg.norm(across)
        sides = (across, np.cross(axis, across))
        arm_m = path.entry_m - path.pivot_m
        at_entry = np.array([[*np.cross(arm_m, side), *side] for side in sides])
        per_m = np.array([[*np.cross(axis, side), 0.0, 0.0, 0.0] for side in sides])
        constant = at_entry @ path.covariance @ at_entry.T
        mixed = at_entry @ path.covariance @ per_m.T
        square = per_m @ path.covariance @ per_m.T
        along = np.array([*np.cross(arm_m, axis), *axis])
        self.axis: list[float] = axis.tolist()
        self.length_m = float(np.linalg.norm(path.target_m - path.entry_m))
        self.along_std_m = math.hypot(
            math.sqrt(max(float(along @ path.covariance @ along), 0.0)), TIP_STD_m
        )
        self.angle_std_rad = math.hypot(_largest_std(square), axis_std_rad)
        self._constant: list[list[float]] = constant.tolist()
        self._linear: list[list[float]] = (mixed + mixed.T).tolist()
        self._square: list[list[float]] = square.tolist()

    def std_m(self, depth_m: float) -> float:
        """Return the larger standard deviation across the path at a depth."""
        terms = zip(
            *map(_flatten, (self._constant, self._linear, self._square)), strict=True
        )
        a, b, _, c = (
            zero + depth_m * (one + depth_m * two) for zero, one, two in terms
        )
        half = 0.5 * math.hypot(a - c, 2.0 * b)
        return math.sqrt(max(0.5 * (a + c) + half, 0.0) + TIP_STD_m**2)


def _largest_std(covariance: Array) -> float:
    """Return the larger standard deviation of two quantities."""
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


def _flatten(rows: list[list[float]]) -> list[float]:
    """Return the numbers of rows behind each other."""
    return [number for row in rows for number in row]


def _dot(a: list[float], b: list[float]) -> float:
    """Return the scalar product of two vectors; three numbers are faster as such."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _distance(a: list[float], b: list[float]) -> float:
    """Return the length of the vector product of two vectors.

    Of a unit vector and a point it is the distance of the point from the line along it.
    """
    return math.hypot(
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
