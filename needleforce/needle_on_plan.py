"""The needle against the planned path: beside it, turned, to its target, how sure.

The planned path is a line in the robot's base, known as well as the registration. The
needle is a line, too: its tip and its direction as the robot states them. Where both
lines should be one, the distances between them are errors of the registration; beyond
what chance makes of these, the needle is off the plan, and nothing may be named by it.
A needle on the line may still have gone too far: past the target.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array

if TYPE_CHECKING:
    from needleforce.anatomy import NeedleClearance, Registration

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
            the target.
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
    margin_m: float = 1e-3
    margin_rad: float = math.radians(1.0)
    tolerance_m: float = 5e-3

    @classmethod
    def of_registration(
        cls, registration: "Registration", entry_m: ArrayLike, target_m: ArrayLike
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

    @cached_property
    def axis(self) -> Array:
        """Planned direction, of length one, (3,)."""
        return (self.target_m - self.entry_m) / self.length_m

    @cached_property
    def length_m(self) -> float:
        """From entry to target."""
        return float(np.linalg.norm(self.target_m - self.entry_m))

    @property
    def fingerprint(self) -> str:
        """Text that is equal for equal paths."""
        return repr(
            [np.asarray(getattr(self, one.name)).tolist() for one in fields(self)]
        )

    @cached_property
    def _jacobians(self) -> tuple[Array, Array]:
        """Motion of the path with rotation and shift of the registration, (3, 6) each.

        A registration that errs by a rotation w about the pivot p and a shift t moves a
        point x by w x (x - p) + t. Along two directions across the path, and along it,
        that is linear in the depth of x: the first matrix holds at the entry, the
        second is what a metre of depth adds. Along the path it adds nothing.
        """
        least = np.eye(3)[int(np.abs(self.axis).argmin())]
        across = np.cross(self.axis, least)
        across /= np.linalg.norm(across)
        sides = np.array([across, np.cross(self.axis, across), self.axis])
        levers_m = np.cross(self.entry_m - self.pivot_m, sides)
        at_entry = np.zeros((3, 6))
        at_entry[:, :3] = levers_m
        at_entry[:, 3:] = sides
        per_m = np.zeros((3, 6))
        per_m[:, :3] = np.cross(self.axis, sides)
        return at_entry, per_m

    def _std_across(self, jacobian: Array) -> float:
        """Return the larger standard deviation of two motions, (2, 6), across it."""
        variances = np.linalg.eigvalsh(jacobian @ self.covariance @ jacobian.T)
        return math.sqrt(max(float(variances[-1]), 0.0))

    @cached_property
    def _fixed_stds(self) -> list[float]:
        """Standard deviations that no depth changes.

        Of the needle beside the entry [m], of its direction [rad], the larger one of
        two each, and of the tip against the target along the path [m].
        """
        # Standard deviation of the needle's direction in the robot's base.
        axis_std_rad = 1e-3
        at_entry, per_m = self._jacobians
        variance_m2 = float(at_entry[2] @ self.covariance @ at_entry[2])
        return [
            math.hypot(self._std_across(at_entry[:2]), TIP_STD_m),
            math.hypot(self._std_across(per_m[:2]), axis_std_rad),
            math.sqrt(max(variance_m2, 0.0) + TIP_STD_m**2),
        ]

    def deviation(self, tip_m: Array, axis: Array) -> PlanDeviation:
        """Return where a needle is against the path.

        Args:
            tip_m: Tip of the needle in the robot's base, (3,).
            axis: Its direction, of length one, (3,).
        """
        # Beyond so many standard deviations the tip is past the target: a needle that
        # stops once too early does less harm than one that goes on.
        past_stds = 2.0
        entry_std_m, angle_std_rad, along_std_m = self._fixed_stds
        at_entry, per_m = self._jacobians
        from_entry_m = tip_m - self.entry_m
        depth_m = float(from_entry_m @ self.axis)
        to_target_m = self.length_m - depth_m
        entry_m = _distance(from_entry_m, axis)
        beside_m = _distance(from_entry_m, self.axis)
        tip_std_m = self._std_across((at_entry + depth_m * per_m)[:2])
        tip_std_m = math.hypot(tip_std_m, TIP_STD_m)
        angle_rad = math.atan2(_distance(axis, self.axis), float(self.axis @ axis))
        tolerance_rad = math.atan2(self.tolerance_m, self.length_m)
        past_m = max(self.margin_m, past_stds * along_std_m)
        return PlanDeviation(
            entry_m=entry_m,
            entry_std_m=entry_std_m,
            tip_m=beside_m,
            tip_std_m=tip_std_m,
            angle_rad=angle_rad,
            angle_std_rad=angle_std_rad,
            depth_m=depth_m,
            to_target_m=to_target_m,
            to_target_std_m=along_std_m,
            is_off_plan=(
                entry_m > max(self.margin_m, STDS * entry_std_m)
                or beside_m > max(self.margin_m, STDS * tip_std_m)
                or angle_rad > max(self.margin_rad, STDS * angle_std_rad)
            ),
            is_past_target=to_target_m < -past_m,
            is_doubtful=(
                entry_m + CERTAIN_STDS * entry_std_m > self.tolerance_m
                or beside_m + CERTAIN_STDS * tip_std_m > self.tolerance_m
                or angle_rad + CERTAIN_STDS * angle_std_rad > tolerance_rad
                or CERTAIN_STDS * along_std_m - to_target_m > self.tolerance_m
            ),
        )


def _distance(place_m: Array, axis: Array) -> float:
    """Return the distance of a place, (3,), from the line along an axis, (3,)."""
    return float(np.linalg.norm(place_m - (place_m @ axis) * axis))


def describe_deviation(deviation: PlanDeviation) -> str:
    """Return the needle against the plan in words; behind ± is a standard deviation."""
    verdict = deviation.verdict
    said = verdict if verdict == ON_PLAN else verdict.upper()
    return (
        f"{said}: {1e3 * deviation.entry_m:.1f} ± {1e3 * deviation.entry_std_m:.1f} mm "
        f"beside the planned entry, tip {1e3 * deviation.tip_m:.1f} ± "
        f"{1e3 * deviation.tip_std_m:.1f} mm beside the planned path, turned by "
        f"{math.degrees(deviation.angle_rad):.1f} ± "
        f"{math.degrees(deviation.angle_std_rad):.1f}°, tip "
        f"{describe_to_target(deviation)}"
    )


def describe_to_target(deviation: PlanDeviation) -> str:
    """Return how far the tip is in front of the target, or past it, in words."""
    side = "past" if deviation.to_target_m < 0.0 else "in front of"
    return (
        f"{1e3 * abs(deviation.to_target_m):.1f} ± "
        f"{1e3 * deviation.to_target_std_m:.1f} mm {side} the target"
    )


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
    fields = ("needle_m", "ahead_m", "std_m", "needed_m", "is_too_near")
    nearest = {
        one.name: _known({name: getattr(one, name) for name in fields})
        for one in clearances
    }
    verdict = find_verdict(deviation, clearances)
    return _known({"verdict": verdict, **deviation._asdict(), "clearances": nearest})


def _known(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values without numbers that are not finite."""
    return {
        name: value
        for name, value in values.items()
        if not isinstance(value, float) or math.isfinite(value)
    }
