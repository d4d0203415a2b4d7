"""Checks, every few samples: joint limits, singular poses, model mismatch.

The checks of measured velocities and of changes of the torques stand beside this
module, in `velocity` and `torque_watch`.
"""

import math
from dataclasses import dataclass

import numpy as np

from foundation.arrays import Array
from residual.checks.torque_watch import TorqueWatch
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


@dataclass(slots=True, eq=False)
class MonitorState:
    """State of a `ConsistencyMonitor`.

    Attributes:
        widening: Factor of the tare's covariance, by torque that no wrench explains: as
            in least squares, errors seen in directions that no wrench explains are
            likely in the others, too. It lasts as long as that torque.
        is_covariance_due: Whether the covariance in use is clearly less than what is
            doubted.
        mismatch_squared: Smoothed mean square of the model mismatch, in units of the
            covariance before it was widened.
        warnings: Of the last check, as a number, without those of the next two.
        at_limit: Indices of joints at a position limit in that check.
        match: Of measured velocities with positions; None before a check, and where
            velocities are estimated.
        torques: Changes of the torque; None before the tare.
    """

    widening: float = 1.0
    is_covariance_due: bool = False
    mismatch_squared: float = 0.0
    warnings: int = 0
    at_limit: tuple[int, ...] = ()
    match: VelocityMatch | None = None
    torques: TorqueWatch | None = None


class ConsistencyMonitor:
    """Checks, every few samples, what changes slowly and costs too much for each.

    Attributes:
        state: Its state.
        torques: Changes of the torque; none before the tare.
        level_Nm: Its field.
        jump_Nm2: Its property, like the next one.
        is_measuring_jump: Whether a torque has jumped, by how much is not known yet.
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
        still = np.zeros(robot.nv)
        self._idle = TorqueWatch.after_tare(still, still)
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
            residual: External joint torque after removal of the tare's offset, but not
                of the level learnt since [Nm], shape (n,).
            dt_s: Time since the last check.
            tare_error_Nm2: Variance of the residual in free air that lasts, as the tare
                has shown it, shape (n,); None before the tare.
        """
        state = self.state
        state.at_limit = tuple(
            i
            for i, position_rad in enumerate(q.tolist())
            if not self._lower_rad[i] < position_rad < self._upper_rad[i]
        )
        warnings = SensorWarning.JOINT_LIMIT if state.at_limit else SensorWarning.NONE
        # A newton then makes a twentieth of a newton metre in all joints together, as
        # much as the noise of one torque sample.
        min_singular_value_m = 0.05
        if self._wrench.gain.smallest_singular_value_m < min_singular_value_m:
            warnings |= SensorWarning.NEAR_SINGULAR
        square = 0.0  # before the tare the covariance is the prior's
        if tare_error_Nm2 is not None:
            own_residual = residual - self.level_Nm
            square = state.widening * self._wrench.mismatch_squared(own_residual)
            if state.torques is None:
                state.torques = TorqueWatch.after_tare(residual, tare_error_Nm2)
            state.torques.update(self._tip_rows, residual, dt_s)
        memory_s = 0.2  # A knock of a few milliseconds is no mismatch.
        faded = -math.expm1(-dt_s / memory_s)
        state.mismatch_squared += faded * (square - state.mismatch_squared)
        if state.mismatch_squared > MAX_MISMATCH**2:
            warnings |= SensorWarning.MODEL_MISMATCH
        state.warnings = int(warnings)
        if dq is None:
            state.match = None
        elif state.match is None or dt_s <= 0.0:
            state.match = first_match(q, dq)
        else:
            state.match = velocity_match_step(state.match, q, dq, dt_s)
        is_too_narrow = _widening(state.mismatch_squared) > 1.1 * state.widening
        jump_Nm2 = self.jump_Nm2
        self._report()
        is_other_jump = not np.array_equal(jump_Nm2, self.jump_Nm2)
        state.is_covariance_due |= is_too_narrow or is_other_jump

    @property
    def _tip_rows(self) -> Array:
        """Torque per unit of a force at the tip in any direction, shape (k, n).

        With a torque where the mode has one.
        """
        directions = max(self._wrench.size, 3)
        return np.ascontiguousarray(self._wrench.kinematics.jacobian[:directions])

    @property
    def jump_std_N(self) -> float:
        """Standard deviation of the axial force by jumps of torque sensors."""
        gain = self._wrench.gain
        axial_per_Nm = gain.direction.dot(gain.matrix[:3])
        return math.sqrt(axial_per_Nm.dot(self.jump_Nm2).dot(axial_per_Nm))

    def widen(self, covariance_Nm2: Array) -> Array:
        """Return a covariance widened by the joint torque that no wrench explains.

        It is the tare's, shape (n, n).
        """
        self.state.widening = _widening(self.state.mismatch_squared)
        self.state.is_covariance_due = False
        return self.state.widening * covariance_Nm2

    def forget_tare(self) -> None:
        """Doubt nothing any more, and compare velocities with positions anew."""
        state = self.state
        state.is_covariance_due = True
        state.warnings = int(self.warnings & ~SensorWarning.VELOCITY)
        state.match = None
        state.torques = None
        self._report()

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
        axial_row = self._wrench.kinematics.axial_jacobian[None]
        if self.torques.has_begun(axial_row):
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
        self.restore(MonitorState())

    def restore(self, state: MonitorState) -> None:
        """Go on from a `state` taken earlier; it is not copied."""
        self.state = state
        self._report()

    def _report(self) -> None:
        """Set the attributes that report the result of a check."""
        state = self.state
        self.torques = state.torques or self._idle
        self.level_Nm = self.torques.level_Nm
        self.jump_Nm2 = self.torques.jump_Nm2
        self.is_measuring_jump = self.torques.is_measuring
        self.velocity_fault = "" if state.match is None else velocity_fault(state.match)
        self.mismatch = math.sqrt(state.mismatch_squared)
        self.warnings = SensorWarning(state.warnings)
        if self.torques.is_pushed:
            self.warnings |= SensorWarning.ARM_PUSHED
        if self.torques.has_jumped:
            self.warnings |= SensorWarning.TORQUE_JUMP
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


def _widening(mismatch_squared: float) -> float:
    # By more than the mismatch shows: four directions that no wrench explains show a
    # variance only within a factor of two.
    return 1.0 + 2.0 * max(0.0, mismatch_squared - 1.0)
