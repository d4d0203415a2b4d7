"""What shows that the force's zero has changed: free air, and jumps of a torque sensor.

In free air nothing acts on the needle: a force that shows there is an error. A payload
that was gripped anew after the tare, a cable, a sensor that has moved: free air shows
them before the tissue hides them.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

from residual import SensorWarning, VirtualForceSensor, WrenchEstimate

if TYPE_CHECKING:
    from needleforce.rewinding import RewindingIdentifier


class AirWatch(NamedTuple):
    """What shows that the force's zero has changed since the tare; immutable.

    Attributes:
        mean_N: Mean axial force in free air of late.
        odd_s: Time for which it has been no chance.
        quiet_s: Time for which it has been gone.
        doubt_N: Deviation of the axial force that free air has shown; 0 for none.
        jumps: Number of jumps of torque sensors that the identifier knows of.
        jump_std_N: Standard deviation of the axial force due to these; 0 without one.
    """

    mean_N: float = 0.0
    odd_s: float = 0.0
    quiet_s: float = 0.0
    doubt_N: float = 0.0
    jumps: int = 0
    jump_std_N: float = 0.0

    def with_force(self, axial_N: float, std_N: float, dt_s: float) -> "AirWatch":
        """Return the same after a sample in free air.

        Args:
            axial_N: Axial force, positive where it resists.
            std_N: Its deviation.
            dt_s: Time since the sample before.
        """
        # Time constant of the mean: as long a memory as a mean over 0.3 s
        mean_s = 0.15
        # Mean force in free air, in its own deviations, that is no chance: once in
        # 16,000 insertions. Its error is slow, one draw in each.
        odd_sigmas = 4.0
        # Mean force below which it counts as gone
        gone_sigmas = 1.0
        # Time for which it stays there: a force that turns crosses zero
        gone_s = 1.0
        # A contact is told from free air within this time: a force that resists and
        # began later may be the contact's
        max_onset_s = 1.0
        mean_N = self.mean_N - math.expm1(-dt_s / mean_s) * (axial_N - self.mean_N)
        size_N = abs(mean_N)
        is_odd = size_N > odd_sigmas * std_N
        odd_s = self.odd_s + dt_s if is_odd else 0.0
        quiet_s = self.quiet_s + dt_s if size_N < gone_sigmas * std_N else 0.0
        doubt_N = self.doubt_N
        if doubt_N > 0.0:
            doubt_N = 0.0 if quiet_s > gone_s else max(size_N, std_N)
        elif is_odd and (mean_N < 0.0 or odd_s > max_onset_s):
            doubt_N = size_N
        return self._replace(
            mean_N=mean_N, odd_s=odd_s, quiet_s=quiet_s, doubt_N=doubt_N
        )


class ZeroWatch:
    """Lets the identifier doubt the force's zero where something shows a change of it.

    Args:
        sensor: Counts the jumps of its torque sensors.
        identifier: Doubts the zero, and ruptures since then.

    Attributes:
        air: What free air and the torque sensors have shown.
    """

    def __init__(
        self, sensor: VirtualForceSensor, identifier: "RewindingIdentifier"
    ) -> None:
        self._sensor = sensor
        self._identifier = identifier
        self.air = AirWatch()
        self.begin_insertion()

    def begin_tare(self) -> None:
        """Forget what free air has shown: the tare takes it out."""
        self.air = AirWatch(jumps=self.air.jumps, jump_std_N=self.air.jump_std_N)

    def begin_insertion(self) -> None:
        """Take all jumps so far for known: the identifier begins with this zero."""
        sensor = self._sensor
        self.air = self.air._replace(jumps=sensor.jumps, jump_std_N=sensor.jump_std_N)

    def watch(
        self, wrench: WrenchEstimate, elapsed_s: float, *, is_outside: bool
    ) -> None:
        """Let the identifier doubt the zero after a jump, or a force where none can be.

        It does so once after a jump of a torque; when the torque returns again, by as
        much as before.

        Args:
            wrench: Force of a sample.
            elapsed_s: Time since the sample before.
            is_outside: Whether nothing touches the needle.
        """
        # Within it a changed zero is noticed: a rupture since may be that change
        jump_seen_s = 0.6
        before = self.air
        if before.jumps != self._sensor.jumps:
            self.begin_insertion()
            doubted_N = max(before.jump_std_N, self.air.jump_std_N)
            # The identifier's clock has stood still since samples are not used.
            since_s = max(self._sensor.jump_since_s - self._identifier.unused_s, 0.0)
            self._identifier.identifier.doubt_zero(doubted_N, min(since_s, jump_seen_s))
        if not is_outside:
            if before.odd_s + before.quiet_s > 0.0:  # the doubt stays
                self.air = self.air._replace(odd_s=0.0, quiet_s=0.0)
            return
        self.air = self.air.with_force(wrench.axial, wrench.axial_std, elapsed_s)
        is_new = self.air.doubt_N > before.doubt_N == 0.0
        if is_new and self._identifier.contact_m is None:
            self._identifier.identifier.doubt_zero(self.air.doubt_N, jump_seen_s)

    def widen(self, wrench: WrenchEstimate) -> WrenchEstimate:
        """Return an estimate with what free air has shown in its deviation."""
        if self.air.doubt_N == 0.0:
            return wrench
        return wrench._replace(
            axial_std=math.hypot(wrench.axial_std, self.air.doubt_N),
            warnings=wrench.warnings | SensorWarning.UNEXPLAINED,
        )
