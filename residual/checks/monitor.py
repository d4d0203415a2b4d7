"""Checks, every few samples: joint limits, singular poses, model mismatch.

The checks of measured velocities, of pushes on the arm and of torque sensors that jump
stand beside this module, in `velocity`, `pushed_arm` and `torque_jump`.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from residual.checks.pushed_arm import (
    BESIDE,
    LEARNED_S,
    TorqueChange,
    change_step,
    first_change,
    unusual_change,
)
from residual.checks.torque_jump import TorqueCourse
from residual.checks.velocity import (
    VelocityMatch,
    first_match,
    velocity_fault,
    velocity_match_step,
)
from residual.errors import named_joints
from residual.estimate import Assessment, SensorWarning, Status, WrenchEstimate
from residual.wrench_estimator import WrenchEstimator
from urdf import Robot

LIMIT_MARGIN_RAD = 0.01
"""Half a degree from its limit a joint counts as being there."""

MAX_POSITION_RAD = 4.0 * math.pi
"""Two turns: a position beyond a limit and this is hardly in radians."""

MIN_SINGULAR_VALUE_M = 0.05
"""At this value a newton makes a twentieth of a newton metre in all joints together, as
much as the noise of one torque sample; below it the pose is near singular."""

MISMATCH_MEMORY_S = 0.2
"""Time constant of the model mismatch: a knock of a few milliseconds is none."""

MAX_MISMATCH = 4.0
"""Largest model mismatch that may be chance, in standard deviations of all joints
together."""

VARIANCE_GAIN = 2.0
"""Growth of the covariance with the model mismatch squared: four directions show a
variance only within a factor of two."""

WIDENING_RATIO = 1.1
"""Ratio of the wanted to the present widening from which the covariance is renewed."""


class MonitorState(NamedTuple):
    """State of a `ConsistencyMonitor`; its arrays are never written again.

    Attributes:
        mismatch_squared: Smoothed mean square of the model mismatch, in units of the
            covariance before it was widened.
        widening: Factor by which the covariance in use was widened.
        jump_Nm2: Variance of each torque by jumps of its sensor, in use, shape (n,);
            None for none.
        warnings: Of the last check, as a number.
        at_limit: Indices of joints at a position limit in that check.
        match: Of measured velocities with positions; None before a check, and where
            velocities are estimated.
        change: Of the torque; None before the tare.
        course: Torque of the last second, and its jumps; None before the tare.
    """

    mismatch_squared: float = 0.0
    widening: float = 1.0
    jump_Nm2: Array | None = None
    warnings: int = 0
    at_limit: tuple[int, ...] = ()
    match: VelocityMatch | None = None
    change: TorqueChange | None = None
    course: TorqueCourse | None = None


class ConsistencyMonitor:
    """Checks, every few samples, what changes slowly and costs too much for each.

    Attributes:
        state: Its state.
        mismatch: Smoothed model mismatch, see `WrenchEstimate`.
        velocity_fault: Certain faults of measured velocities, in words; empty if there
            are none.
        warnings: Warnings of the last check.
        message: The same in words.
        is_measuring_jump: Whether a torque has jumped just now, by how much is not
            certain yet.
        jumps: Number of jumps of torque sensors since the tare that were measured.
        assessment: All of this for an estimate of which nothing else is wrong.
    """

    def __init__(self, robot: Robot, wrench: WrenchEstimator) -> None:
        lower = robot.position_lower_rad + LIMIT_MARGIN_RAD
        upper = robot.position_upper_rad - LIMIT_MARGIN_RAD
        # A joint without a range has no limit: descriptions write 0 and 0 for
        # "unknown".
        is_free = upper <= lower
        self._lower_rad = np.where(is_free, -np.inf, lower).tolist()
        self._upper_rad = np.where(is_free, np.inf, upper).tolist()
        self._wrench = wrench
        self.restore(MonitorState())

    def check(
        self,
        q: Array,
        dq: Array | None,
        residual: Array,
        dt_s: float,
        tare_error_Nm2: Array | None,
    ) -> None:
        """Check a sample for which the wrench estimator has a gain.

        Args:
            q: Configuration [rad], shape (n,).
            dq: Velocity as measured [rad/s], shape (n,); None where it is estimated.
            residual: External joint torque after offset removal [Nm], shape (n,).
            dt_s: Time since the last check.
            tare_error_Nm2: Variance of the residual in free air that lasts, as the tare
                has shown it, shape (n,); None before the tare.
        """
        tared = tare_error_Nm2 is not None
        at_limit = self._joints_at_limit(q)
        mismatch_squared = self._next_mismatch(residual, dt_s, tared=tared)
        change = self._next_change(residual, dt_s) if tared else None
        course = None
        if tare_error_Nm2 is not None:
            course = self._next_course(residual, dt_s, tare_error_Nm2)
        if change is not None and course is not None and course.jumps > self.jumps:
            # The jump is known by now: it is no push.
            change = change._replace(reference=change.present, pushed_s=0.0)
        match_before = self.state.match
        match = self._next_match(q, dq, dt_s)
        warnings = SensorWarning.NONE
        if at_limit:
            warnings |= SensorWarning.JOINT_LIMIT
        observability = self._wrench.observability
        if observability.smallest_singular_value_m < MIN_SINGULAR_VALUE_M:
            warnings |= SensorWarning.NEAR_SINGULAR
        if mismatch_squared > MAX_MISMATCH**2:
            warnings |= SensorWarning.MODEL_MISMATCH
        if change is not None and change.pushed_s > 0.0:
            warnings |= SensorWarning.ARM_PUSHED
        if course is not None and course.has_jumped:
            warnings |= SensorWarning.TORQUE_JUMP
        self.state = MonitorState(
            mismatch_squared=mismatch_squared,
            widening=self.state.widening,
            jump_Nm2=self.state.jump_Nm2,
            warnings=int(warnings),
            at_limit=at_limit,
            match=match,
            change=change,
            course=course,
        )
        self._report(self._next_velocity_fault(match, match_before))

    def _joints_at_limit(self, q: Array) -> tuple[int, ...]:
        return tuple(
            i
            for i, position_rad in enumerate(q.tolist())
            if not self._lower_rad[i] < position_rad < self._upper_rad[i]
        )

    def _next_mismatch(self, residual: Array, dt_s: float, *, tared: bool) -> float:
        """Return the next `MonitorState.mismatch_squared`; arguments of `check`."""
        square = 0.0  # before the tare the covariance is the prior's
        if tared:
            square = self.state.widening * self._wrench.mismatch_squared(residual)
        smoothed = self.state.mismatch_squared
        return smoothed - math.expm1(-dt_s / MISMATCH_MEMORY_S) * (square - smoothed)

    def _next_change(self, residual: Array, dt_s: float) -> TorqueChange:
        """Return the next change of torque, after a residual [Nm], shape (n,)."""
        change = self.state.change
        if change is None:
            return first_change(residual)
        if dt_s <= 0.0:
            return change
        return change_step(
            self._wrench.contact_jacobian,
            residual,
            change.present,
            change.reference,
            change.usual,
            change.learned_s,
            change.pushed_s,
            dt_s,
        )

    def _next_course(
        self, residual: Array, dt_s: float, tare_error_Nm2: Array
    ) -> TorqueCourse:
        """Return the next course of the torque; arguments of `check`."""
        course = self.state.course or TorqueCourse.after_tare(tare_error_Nm2)
        # A force at the tip in any direction, or with a torque where the mode has one.
        directions = max(self._wrench.size, 3)
        rows = self._wrench.kinematics.jacobian[:directions]
        return course.advanced(np.ascontiguousarray(rows), residual, max(dt_s, 0.0))

    def _next_match(
        self, q: Array, dq: Array | None, dt_s: float
    ) -> VelocityMatch | None:
        """Return the next match of velocities with positions; arguments of `check`."""
        if dq is None:
            return None
        match = self.state.match
        if match is None or dt_s <= 0.0:
            return first_match(q, dq)
        return velocity_match_step(match, q, dq, dt_s)

    def _next_velocity_fault(
        self, match: VelocityMatch | None, match_before: VelocityMatch | None
    ) -> str:
        """Return the faults of measured velocities after a check, in words."""
        if match is None:
            return ""
        # While nothing moves the sums stay.
        if match_before is not None and match.sums is match_before.sums:
            return self.velocity_fault
        return velocity_fault(match)

    @property
    def _wanted_widening(self) -> float:
        return 1.0 + VARIANCE_GAIN * max(0.0, self.state.mismatch_squared - 1.0)

    @property
    def wants_widening(self) -> bool:
        """Whether the covariance in use is clearly too small for the mismatch.

        Or whether it is not that of the jumps of torque sensors.
        """
        is_too_small = self._wanted_widening > WIDENING_RATIO * self.state.widening
        used_Nm2 = self.state.jump_Nm2
        jump_Nm2 = self._jump_Nm2
        if used_Nm2 is None or jump_Nm2 is None:
            return is_too_small or used_Nm2 is not jump_Nm2
        return is_too_small or not np.array_equal(used_Nm2, jump_Nm2)

    @property
    def _jump_Nm2(self) -> Array | None:
        """Variance of each torque by jumps of its sensor, shape (n,); None for none."""
        course = self.state.course
        return None if course is None else course.jump_Nm2

    @property
    def jump_std_N(self) -> float:
        """Standard deviation of the axial force by jumps of torque sensors."""
        if self._jump_Nm2 is None:
            return 0.0
        gain = self._wrench.gain
        axial_per_Nm = gain.direction.dot(gain.matrix[:3])
        return math.sqrt(float(np.square(axial_per_Nm).dot(self._jump_Nm2)))

    def widen(self, covariance_Nm2: Array) -> Array:
        """Return a covariance widened by the joint torque that no wrench explains.

        It may come of a push on the arm, or of a wrong model. This is the variance
        factor of least squares: errors seen in directions that no wrench explains are
        likely in the other directions, too. See `VARIANCE_GAIN`.
        """
        self.state = self.state._replace(
            widening=self._wanted_widening, jump_Nm2=self._jump_Nm2
        )
        return self.state.widening * covariance_Nm2

    def forget_velocity(self) -> None:
        """Compare velocities with positions anew."""
        warnings = int(self.warnings & ~SensorWarning.VELOCITY)
        self.restore(self.state._replace(match=None, warnings=warnings))

    def recheck(
        self, estimate: WrenchEstimate, estimate_before: WrenchEstimate
    ) -> WrenchEstimate:
        """Return an estimate with a warning if its torques fit no needle force.

        Their change is checked, too. Meant for alarms and for the end of a gap, not for
        every sample: a knock raises the warning, too. The estimate before must show it
        as well, since an arm that brakes hard raises it for one sample.
        """
        square = min(
            self._wrench.mismatch_squared(estimate.residual),
            self._wrench.mismatch_squared(estimate_before.residual),
        )
        warnings = SensorWarning.NONE
        if self.state.widening * square > MAX_MISMATCH**2:
            warnings |= SensorWarning.MODEL_MISMATCH
        if self._has_push_begun():
            warnings |= SensorWarning.ARM_PUSHED
        message = "; ".join(filter(None, (estimate.message, *_reasons(warnings))))
        return estimate._replace(warnings=estimate.warnings | warnings, message=message)

    def _has_push_begun(self) -> bool:
        """Return whether the torques change as no force along the needle does."""
        change = self.state.change
        if change is None or change.learned_s < LEARNED_S:
            return False
        axial = self._wrench.kinematics.axial_jacobian[None]
        difference = change.present - change.reference
        return unusual_change(axial, difference, change.usual, BESIDE) > BESIDE

    @property
    def limit(self) -> str:
        """Which joints are at a position limit, in words; empty if none is."""
        at_limit = self.state.at_limit
        return f"at a position limit: {named_joints(at_limit)}" if at_limit else ""

    @property
    def question(self) -> str:
        """Whether q is in degrees, asked where positions are far beyond; else empty."""
        if not self.state.at_limit:
            return ""
        largest_rad = np.abs(self._wrench.gain.configuration_rad).max()
        return (
            f"{self.limit}: is q in degrees?" if largest_rad > MAX_POSITION_RAD else ""
        )

    def restore(self, state: MonitorState) -> None:
        """Go on from a `state` taken earlier."""
        self.state = state
        self._report("" if state.match is None else velocity_fault(state.match))

    def _report(self, velocity_fault: str) -> None:
        """Set the attributes that report the result of a check."""
        course = self.state.course
        self.is_measuring_jump = course is not None and course.is_settling
        self.jumps = 0 if course is None else course.jumps
        self.velocity_fault = velocity_fault
        self.mismatch = math.sqrt(self.state.mismatch_squared)
        self.warnings = SensorWarning(self.state.warnings)
        self.message = ""
        if velocity_fault:
            self.warnings |= SensorWarning.VELOCITY
        if self.warnings:
            position = self.question or self.limit
            texts = (velocity_fault, position, *_reasons(self.warnings))
            self.message = "; ".join(filter(None, texts))
        self.assessment = Assessment(
            Status.OK, self.message, self.mismatch, self.warnings
        )


_REASONS = {
    SensorWarning.NEAR_SINGULAR: "the joints hardly feel a force in this pose",
    SensorWarning.MODEL_MISMATCH: "the joint torques do not fit the assumed contact",
    SensorWarning.ARM_PUSHED: (
        "the joint torques change as no force at the tip changes them"
    ),
    SensorWarning.TORQUE_JUMP: (
        "a torque has jumped, by its sensor or a steady push on the arm; which one is "
        "not certain, axial_std holds the doubt: withdraw and tare again"
    ),
}


def _reasons(warnings: SensorWarning) -> list[str]:
    return [reason for warning, reason in _REASONS.items() if warning in warnings]
