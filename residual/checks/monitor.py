"""Checks, every few samples: joint limits, singular poses, model mismatch.

The checks of measured velocities, of pushes on the arm and of torque sensors that jump
stand beside this module, in `velocity`, `pushed_arm` and `torque_jump`.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from residual.checks.pushed_arm import TorqueChange, change_step, first_change
from residual.checks.torque_doubt import TorqueDoubt
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

MAX_MISMATCH = 4.0
"""Largest model mismatch that may be chance, in standard deviations of all joints
together."""


class MonitorState(NamedTuple):
    """State of a `ConsistencyMonitor`; its arrays are never written again.

    Attributes:
        doubt: What is doubted of the torques.
        is_covariance_due: Whether the covariance in use is clearly less than that.
        mismatch_squared: Smoothed mean square of the model mismatch, in units of the
            covariance before it was widened.
        warnings: Of the last check, as a number.
        at_limit: Indices of joints at a position limit in that check.
        match: Of measured velocities with positions; None before a check, and where
            velocities are estimated.
        change: Of the torque; None before the tare.
        course: Torque of the last second, and its jumps; None before the tare.
    """

    doubt: TorqueDoubt
    is_covariance_due: bool = False
    mismatch_squared: float = 0.0
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
        assessment: All of this for an estimate of which nothing else is wrong.
    """

    def __init__(self, robot: Robot, wrench: WrenchEstimator) -> None:
        # Half a degree from its limit a joint counts as being there.
        margin_rad = 0.01
        lower = robot.position_lower_rad + margin_rad
        upper = robot.position_upper_rad - margin_rad
        # A joint without a range has no limit: descriptions write 0 and 0 for
        # "unknown".
        is_free = upper <= lower
        self._lower_rad = np.where(is_free, -np.inf, lower).tolist()
        self._upper_rad = np.where(is_free, np.inf, upper).tolist()
        self._wrench = wrench
        self._joints = robot.nv
        self.reset()

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
            residual: External joint torque after removal of the tare's offset, but not
                of the level learnt since [Nm], shape (n,).
            dt_s: Time since the last check.
            tare_error_Nm2: Variance of the residual in free air that lasts, as the tare
                has shown it, shape (n,); None before the tare.
        """
        state = self.state
        at_limit = self._joints_at_limit(q)
        warnings = SensorWarning.NONE
        if at_limit:
            warnings |= SensorWarning.JOINT_LIMIT
        # A newton then makes a twentieth of a newton metre in all joints together, as
        # much as the noise of one torque sample.
        min_singular_value_m = 0.05
        observability = self._wrench.observability
        if observability.smallest_singular_value_m < min_singular_value_m:
            warnings |= SensorWarning.NEAR_SINGULAR
        doubt = state.doubt
        change = None
        course = None
        square = 0.0  # before the tare the covariance is the prior's
        if tare_error_Nm2 is not None:
            own_residual = residual - doubt.level_Nm
            square = doubt.widening * self._wrench.mismatch_squared(own_residual)
            change = self._next_change(residual, dt_s)
            course = state.course or TorqueCourse.after_tare(tare_error_Nm2)
            course, finding = course.advanced(self._tip_rows, residual, max(dt_s, 0.0))
            doubt = doubt.after_finding(finding, change.pushed_s)
            if doubt.jumps > state.doubt.jumps:
                # The jump is known by now: it is no push.
                change = change._replace(reference=change.present, pushed_s=0.0)
            if change.pushed_s > 0.0:
                warnings |= SensorWarning.ARM_PUSHED
            if doubt.has_jumped:
                warnings |= SensorWarning.TORQUE_JUMP
        memory_s = 0.2  # A knock of a few milliseconds is no mismatch.
        faded = -math.expm1(-dt_s / memory_s)
        mismatch_squared = state.mismatch_squared
        mismatch_squared += faded * (square - mismatch_squared)
        if mismatch_squared > MAX_MISMATCH**2:
            warnings |= SensorWarning.MODEL_MISMATCH
        self.state = MonitorState(
            doubt=doubt._replace(since_s=doubt.since_s + max(dt_s, 0.0)),
            is_covariance_due=state.is_covariance_due
            or doubt is not state.doubt
            or doubt.is_too_narrow(mismatch_squared),
            mismatch_squared=mismatch_squared,
            warnings=int(warnings),
            at_limit=at_limit,
            match=None if dq is None else self._next_match(q, dq, dt_s),
            change=change,
            course=course,
        )
        self._report()

    def _joints_at_limit(self, q: Array) -> tuple[int, ...]:
        return tuple(
            i
            for i, position_rad in enumerate(q.tolist())
            if not self._lower_rad[i] < position_rad < self._upper_rad[i]
        )

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

    @property
    def _tip_rows(self) -> Array:
        """Torque per unit of a force at the tip in any direction, shape (k, n).

        With a torque where the mode has one.
        """
        directions = max(self._wrench.size, 3)
        return np.ascontiguousarray(self._wrench.kinematics.jacobian[:directions])

    def _next_match(self, q: Array, dq: Array, dt_s: float) -> VelocityMatch:
        """Return the next match of velocities with positions; arguments of `check`."""
        match = self.state.match
        if match is None or dt_s <= 0.0:
            return first_match(q, dq)
        return velocity_match_step(match, q, dq, dt_s)

    @property
    def jump_std_N(self) -> float:
        """Standard deviation of the axial force by jumps of torque sensors."""
        gain = self._wrench.gain
        axial_per_Nm = gain.direction.dot(gain.matrix[:3])
        return math.sqrt(axial_per_Nm.dot(self.state.doubt.jump_Nm2).dot(axial_per_Nm))

    def widen(self, covariance_Nm2: Array) -> Array:
        """Return a covariance widened by the joint torque that no wrench explains.

        It is the tare's, shape (n, n).
        """
        doubt = self.state.doubt.widened(self.state.mismatch_squared)
        self.state = self.state._replace(doubt=doubt, is_covariance_due=False)
        return doubt.widening * covariance_Nm2

    def forget_tare(self) -> None:
        """Doubt nothing any more, and compare velocities with positions anew."""
        warnings = int(self.warnings & ~SensorWarning.VELOCITY)
        doubt = TorqueDoubt.after_tare(self._joints)
        self.restore(
            self.state._replace(
                doubt=doubt._replace(widening=self.state.doubt.widening),
                is_covariance_due=True,
                warnings=warnings,
                match=None,
                change=None,
                course=None,
            )
        )

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
        if self.state.doubt.widening * square > MAX_MISMATCH**2:
            warnings |= SensorWarning.MODEL_MISMATCH
        change = self.state.change
        axial_row = self._wrench.kinematics.axial_jacobian[None]
        if change is not None and change.has_begun(axial_row):
            warnings |= SensorWarning.ARM_PUSHED
        message = "; ".join(filter(None, (estimate.message, *_reasons(warnings))))
        return estimate._replace(warnings=estimate.warnings | warnings, message=message)

    @property
    def limit(self) -> str:
        """Which joints are at a position limit, in words; empty if none is."""
        at_limit = self.state.at_limit
        return f"at a position limit: {named_joints(at_limit)}" if at_limit else ""

    def reset(self) -> None:
        """Forget everything."""
        self.restore(MonitorState(TorqueDoubt.after_tare(self._joints)))

    def restore(self, state: MonitorState) -> None:
        """Go on from a `state` taken earlier."""
        self.state = state
        self._report()

    def _report(self) -> None:
        """Set the attributes that report the result of a check."""
        match = self.state.match
        self.velocity_fault = "" if match is None else velocity_fault(match)
        self.mismatch = math.sqrt(self.state.mismatch_squared)
        self.warnings = SensorWarning(self.state.warnings)
        self.message = ""
        if self.velocity_fault:
            self.warnings |= SensorWarning.VELOCITY
        if self.warnings:
            texts = (self.velocity_fault, self.limit, *_reasons(self.warnings))
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
        "a torque has jumped, by its sensor or a steady push on the arm; its new level "
        "counts as the zero, axial_std holds the doubt: withdraw and tare again"
    ),
}


def _reasons(warnings: SensorWarning) -> list[str]:
    return [reason for warning, reason in _REASONS.items() if warning in warnings]
