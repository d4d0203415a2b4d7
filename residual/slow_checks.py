"""What makes a force doubtful and changes slowly: joint limits, singular poses, a misfit."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    """

    misfit_squared: float = 0.0
    cautions: int = 0


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
        self, q: NDArray[np.float64], residual: NDArray[np.float64], dt_s: float, *, tared: bool
    ) -> None:
        """Look at the sample for which a wrench was just estimated.

        Args:
            q: Its configuration [rad], shape (n,).
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
        self.restore(SlowState(square, int(found)))

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
        return SlowState(self._misfit_squared, int(self.cautions))

    def restore(self, state: SlowState) -> None:
        """Go on from a `state` taken earlier."""
        self._misfit_squared = state.misfit_squared
        self.misfit = math.sqrt(state.misfit_squared)
        """Smoothed misfit, see `WrenchEstimate`."""
        self.cautions = Caution(state.cautions)
        """What was found at the last look."""
        self.message = "; ".join(text for one, text in _REASONS.items() if one in self.cautions)
        """The same in words."""
