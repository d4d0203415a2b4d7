"""What a lag may hide: a force that changes is known less well than one that rests."""

import math


class LagDoubt:
    """Widens a standard deviation by what changes faster than the lag may show.

    One more lag of the same length follows the force: what it still misses is about what the
    estimate has missed. Only what stands out of the noise counts as a change.
    """

    def __init__(self) -> None:
        self.restart()

    def widen(self, axial_N: float, std_N: float, lag_s: float, dt_s: float) -> float:
        """Standard deviation of an axial force with the doubt added [N].

        Args:
            axial_N: The force.
            std_N: Its standard deviation.
            lag_s: By how much it follows the true one; 0 for not at all.
            dt_s: Time since the force before.
        """
        if self._slow_N is None or lag_s <= 0.0:
            self._slow_N = axial_N
            return std_N
        behind = axial_N - self._slow_N
        self._slow_N += behind * -math.expm1(-dt_s / lag_s)
        variance = std_N * std_N
        hidden = behind * behind - 4.0 * variance
        return math.sqrt(variance + hidden) if hidden > 0.0 else std_N

    def restart(self) -> None:
        """Forget the force followed: the next one is a first one."""
        self._slow_N: float | None = None

    @property
    def state(self) -> float | None:
        """The force followed [N]; None before the first."""
        return self._slow_N

    def restore(self, state: float | None) -> None:
        """Go on from a `state` taken earlier."""
        self._slow_N = state
