"""Slow checks of every few samples: joint limits, singular poses, model mismatch.

The checks of measured velocities and of pushes on the arm stand beside this module, in
`velocity` and `pushed_arm`.
"""

import math
from typing import NamedTuple

import numpy as np

from residual.checks.pushed_arm import (
    BESIDE,
    LEARNED_S,
    TorqueChange,
    change_step,
    unusual_change,
)
from residual.checks.velocity import (
    VelocityMatch,
    first_match,
    velocity_fault,
    velocity_match_step,
)
from residual.errors import Array, named_joints
from residual.estimate import SensorWarning, WrenchEstimate
from residual.wrench_estimator import WrenchEstimator
from urdf import Robot

LIMIT_MARGIN_RAD = 0.01  # half a degree from its limit a joint counts as being there
MOST_RAD = (
    4.0 * math.pi
)  # two turns: beyond a limit and this a position is hardly in radians
LEAST_SINGULAR_VALUE = 0.05
"""[m] At this value a newton makes a twentieth of a newton metre in all joints
together, as much as the noise of one torque sample; below it the pose is near singular."""
MISMATCH_MEMORY_S = 0.2  # a knock of a few milliseconds is no model mismatch
MOST_MISMATCH = 4.0  # so many standard deviations in all joints together are no chance


class MonitorState(NamedTuple):
    """All that a `ConsistencyMonitor` remembers.

    Attributes:
        widening: Factor by which the covariance in use was widened.
        warnings: Of the last check, as a number.
        at_limit: Indices of joints at a position limit in that check.
        match: Of measured velocities with positions; None before a check, and where
            velocities are estimated.
        change: None before the tare.
    """

    mismatch_squared: float = (
        0.0  # Smoothed, in units of the covariance before it was widened
    )
    widening: float = 1.0
    warnings: int = 0
    at_limit: tuple[int, ...] = ()
    match: VelocityMatch | None = None
    change: TorqueChange | None = None


class ConsistencyMonitor:
    """Checks, every few samples, what changes slowly and costs too much for every
    sample.

    Attributes:
        state: All that it remembers; its arrays are never written again.
        mismatch: Smoothed model mismatch, see `WrenchEstimate`.
        velocity_fault: What is surely wrong with measured velocities, in words; empty
            if nothing is.
        warnings: Warnings of the last check.
        message: The same in words.
    """

    def __init__(self, robot: Robot, wrench: WrenchEstimator) -> None:
        lower = robot.position_lower_rad + LIMIT_MARGIN_RAD
        upper = robot.position_upper_rad - LIMIT_MARGIN_RAD
        # A joint without a range has no limit: descriptions write 0 and 0 for
        # "unknown".
        free = upper <= lower
        self._lower = np.where(free, -np.inf, lower).tolist()
        self._upper = np.where(free, np.inf, upper).tolist()
        self._wrench = wrench
        self.restore(MonitorState())

    def check(
        self, q: Array, dq: Array | None, residual: Array, dt_s: float, *, tared: bool
    ) -> None:
        """Check the sample for which a wrench was just estimated.

        Its configuration [rad], its velocity as measured [rad/s], None where it is
        estimated, and its residual after offset removal [Nm] have shape (n,); ``dt_s``
        is the time since the last check [s], ``tared`` says whether the residual's
        covariance is a fitted one.
        """
        found = SensorWarning.NONE
        lower = self._lower
        upper = self._upper
        at_limit = tuple(
            i for i, at in enumerate(q.tolist()) if not lower[i] < at < upper[i]
        )
        if at_limit:
            found |= SensorWarning.JOINT_LIMIT
        if self._wrench.gain.weakest_m < LEAST_SINGULAR_VALUE:
            found |= SensorWarning.NEAR_SINGULAR
        widening = self.state.widening
        last = self.state.mismatch_squared
        now = widening * self._wrench.mismatch_squared(residual) if tared else 0.0
        square = last - math.expm1(-dt_s / MISMATCH_MEMORY_S) * (now - last)
        if square > MOST_MISMATCH**2:
            found |= SensorWarning.MODEL_MISMATCH
        change = self._changed(residual, dt_s) if tared else None
        if change is not None and change.pushed_s > 0.0:
            found |= SensorWarning.ARM_PUSHED
        match = self.state.match
        if dq is None:
            match = None
        elif match is None or dt_s <= 0.0:
            match = first_match(q, dq)
        else:
            match = velocity_match_step(match, q, dq, dt_s)
        last_match = self.state.match
        fault = self.velocity_fault
        self.state = MonitorState(square, widening, int(found), at_limit, match, change)
        # While nothing moves the sums stay.
        if match is None or last_match is None or match.beyond is not last_match.beyond:
            fault = "" if match is None else velocity_fault(match)
        self._report(fault)

    def _changed(self, residual: Array, dt_s: float) -> TorqueChange:
        """The next `TorqueChange`: how far torques have changed as no wrench changes
        them.
        """
        last = self.state.change
        n = len(residual)
        if last is None or dt_s <= 0.0:
            return last or TorqueChange(
                np.vstack((residual, residual, np.zeros((n, n))))
            )
        return TorqueChange(*change_step(self._wrench.rows, residual, *last, dt_s))

    @property
    def _wanted(self) -> float:
        return 1.0 + 2.0 * max(0.0, self.state.mismatch_squared - 1.0)

    @property
    def wants_widening(self) -> bool:
        """Whether the covariance in use is clearly too small for what is seen now."""
        return self._wanted > 1.1 * self.state.widening

    def widened(self, covariance_Nm2: Array) -> Array:
        """A covariance widened by what no wrench explains: a push on the arm, a wrong
        model.

        This is the variance factor of least squares: errors seen in directions that no
        wrench explains are likely in the other directions, too. Twice that, since four
        directions show a variance only within a factor of two.
        """
        self.state = self.state._replace(widening=self._wanted)
        return self.state.widening * covariance_Nm2

    def forget_velocity(self) -> None:
        """Compare velocities with positions anew."""
        warnings = int(self.warnings & ~SensorWarning.VELOCITY)
        self.restore(self.state._replace(match=None, warnings=warnings))

    def recheck(self, last: WrenchEstimate, before: WrenchEstimate) -> WrenchEstimate:
        """The last estimate, with a warning if its torques, or their change, fit no
        needle force.

        Meant for alarms and for the end of a gap, not for every sample: a knock raises
        it, too. The sample before must show it as well, since an arm that brakes hard
        raises it for one sample.
        """
        square = min(
            self._wrench.mismatch_squared(each.residual) for each in (last, before)
        )
        is_off = self.state.widening * square > MOST_MISMATCH**2
        found = SensorWarning.MODEL_MISMATCH if is_off else SensorWarning.NONE
        if (change := self.state.change) is not None and change.learned_s >= LEARNED_S:
            axial = self._wrench.kinematics.axial_jacobian[None]
            torques = change.torques
            if (
                unusual_change(axial, torques[0] - torques[1], torques[2:], BESIDE)
                > BESIDE
            ):
                found |= SensorWarning.ARM_PUSHED
        reasons = [text for one, text in _REASONS.items() if one in found]
        message = "; ".join(filter(None, (last.message, *reasons)))
        return last._replace(warnings=last.warnings | found, message=message)

    @property
    def limit(self) -> str:
        """Which joints are at a position limit, in words; empty if none is."""
        at_limit = self.state.at_limit
        return f"at a position limit: {named_joints(at_limit)}" if at_limit else ""

    @property
    def question(self) -> str:
        """The same if positions are so far beyond that they are hardly in radians;
        else empty.
        """
        is_far = (
            self.state.at_limit and np.abs(self._wrench.gain.rows[0]).max() > MOST_RAD
        )
        return f"{self.limit}: is q in degrees?" if is_far else ""

    def restore(self, state: MonitorState) -> None:
        """Go on from a `state` taken earlier."""
        self.state = state
        self._report("" if state.match is None else velocity_fault(state.match))

    def _report(self, velocity_fault: str) -> None:
        self.velocity_fault = velocity_fault
        self.message = ""
        self.mismatch = math.sqrt(self.state.mismatch_squared)
        self.warnings = SensorWarning(self.state.warnings)
        if self.velocity_fault:
            self.warnings |= SensorWarning.VELOCITY
        if self.warnings:
            reasons = [text for one, text in _REASONS.items() if one in self.warnings]
            self.message = "; ".join(
                filter(
                    None, (self.velocity_fault, self.question or self.limit, *reasons)
                )
            )


_REASONS = {
    SensorWarning.NEAR_SINGULAR: "the joints hardly feel a force in this pose",
    SensorWarning.MODEL_MISMATCH: "the joint torques do not fit the assumed contact",
    SensorWarning.ARM_PUSHED: "the joint torques change as no force at the tip changes them",
}
