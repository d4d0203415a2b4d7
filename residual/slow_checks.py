"""What makes a force doubtful and changes slowly: limits, singular poses, a misfit, velocities."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.errors import VelocityError
from residual.velocity_fault import velocity_fault
from residual.velocity_match import first_match, velocity_match_step
from residual.wrench import WrenchEstimator
from residual.wrench_estimate import Caution, WrenchEstimate
from urdf import Robot

LIMIT_MARGIN_RAD = 0.01
"""Half a degree from its limit a joint counts as being there."""
LEAST_LEVER_M = 0.05
"""Below it a newton is a twentieth of a newton metre in all joints together: as much as the noise
of one torque sample."""
MISFIT_MEMORY_S = 0.2
"""A knock of a few milliseconds is no misfit."""
MOST_MISFIT = 4.0
"""The covariance holds for the arm that was tared; four times its standard deviation does not
happen by chance in all joints together."""

NO_TARE = (
    " No tare would hold: correct the velocities and move in free air anew, or force=True if you "
    "know better"
)
_REASONS = {
    Caution.JOINT_LIMIT: "a joint is at its position limit",
    Caution.NEAR_SINGULAR: "the joints hardly feel a force in this pose",
    Caution.MISFIT: "the joint torques do not fit the assumed contact",
}


class SlowState(NamedTuple):
    """All that `SlowChecks` remember.

    Attributes:
        misfit_squared: Smoothed.
        cautions: Of the last look, as a number.
        match: Of measured velocities with positions, see `residual.velocity_match`; None before a
            look, and where velocities are estimated.
    """

    misfit_squared: float = 0.0
    cautions: int = 0
    match: NDArray[np.float64] | None = None


class SlowChecks:
    """Looks now and then at what is too slow, and too dear, for every sample.

    Args:
        robot: Gives the position limits.
        wrench: Of the estimates that are judged.
    """

    def __init__(self, robot: Robot, wrench: WrenchEstimator) -> None:
        self._lower = robot.position_lower_rad + LIMIT_MARGIN_RAD
        self._upper = robot.position_upper_rad - LIMIT_MARGIN_RAD
        # A joint without a range has no limit: descriptions write 0 and 0 for "unknown".
        free = self._upper <= self._lower
        self._lower[free], self._upper[free] = -np.inf, np.inf
        self._wrench = wrench
        self.restore(SlowState())

    def look(
        self,
        q: NDArray[np.float64],
        dq: NDArray[np.float64] | None,
        residual: NDArray[np.float64],
        dt_s: float,
        *,
        tared: bool,
    ) -> None:
        """Look at the sample for which a wrench was just estimated.

        Args:
            q: Its configuration [rad], shape (n,).
            dq: Its velocity as measured [rad/s], shape (n,); None where it is estimated from q.
            residual: After offset removal [Nm], shape (n,).
            dt_s: Time since the last look [s].
            tared: Whether the residual's covariance is a fitted one.
        """
        found = Caution.NONE
        if (q <= self._lower).any() or (q >= self._upper).any():
            found |= Caution.JOINT_LIMIT
        if self._wrench.lever_m() < LEAST_LEVER_M:
            found |= Caution.NEAR_SINGULAR
        now = self._wrench.misfit_squared(residual) if tared else 0.0
        share = -math.expm1(-dt_s / MISFIT_MEMORY_S)
        square = self._misfit_squared + share * (now - self._misfit_squared)
        if square > MOST_MISFIT**2:
            found |= Caution.MISFIT
        match = None if dq is None else self._matched(q, dq, dt_s)
        self.restore(SlowState(square, int(found), match))

    def _matched(
        self, q: NDArray[np.float64], dq: NDArray[np.float64], dt_s: float
    ) -> NDArray[np.float64]:
        """How velocities match positions after one more look."""
        if self._match is None or dt_s <= 0.0:
            return first_match(q, dq)
        return velocity_match_step(self._match, q, dq, dt_s)

    def check_velocity(self, *, force: bool) -> None:
        """Refuse a tare with velocities that are not the rate of positions.

        Args:
            force: Take it all the same.

        Raises:
            VelocityError: With what is wrong with them.
        """
        if self.velocity_fault and not force:
            raise VelocityError(self.velocity_fault + NO_TARE)

    def forget_velocity(self) -> None:
        """Compare velocities with positions anew."""
        cautions = self.cautions & ~Caution.VELOCITY
        self.restore(SlowState(self._misfit_squared, int(cautions)))

    def recheck(self, last: WrenchEstimate) -> WrenchEstimate:
        """The last estimate, its `Caution.MISFIT` told at once if its sample alone misfits.

        Too dear for every sample, and a knock does it too: for what must not wait.
        """
        if self._wrench.misfit_squared(last.residual) <= MOST_MISFIT**2:
            return last
        message = "; ".join(filter(None, (last.message, _REASONS[Caution.MISFIT])))
        return last._replace(cautions=last.cautions | Caution.MISFIT, message=message)

    @property
    def state(self) -> SlowState:
        """All that is remembered."""
        return SlowState(self._misfit_squared, int(self.cautions), self._match)

    def restore(self, state: SlowState) -> None:
        """Go on from a `state` taken earlier."""
        self._misfit_squared = state.misfit_squared
        self.misfit = math.sqrt(state.misfit_squared)
        """Smoothed misfit, see `WrenchEstimate`."""
        self._match = state.match
        self.velocity_fault = "" if state.match is None else velocity_fault(state.match)
        """What is wrong with measured velocities, in words; empty if nothing surely is."""
        told = Caution.VELOCITY if self.velocity_fault else Caution.NONE
        self.cautions = Caution(state.cautions) | told
        """What was found at the last look."""
        reasons = [text for one, text in _REASONS.items() if one in self.cautions]
        self.message = "; ".join(filter(None, (self.velocity_fault, *reasons)))
        """The same in words."""
