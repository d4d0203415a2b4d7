"""What every device offers, real or emulated: readings, and a report of its link.

An arm is iterated over: one reading per cycle, in SI units; what the interface lacks is
None. Arms and haptic devices satisfy the protocols of `needleforce.control.ports`, as
the simulated ones do.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from time import monotonic, sleep
from typing import Any, NamedTuple, Self

from numpy.typing import ArrayLike

from foundation.arrays import Array

SILENCE_S = 0.1
"""A longer time without a valid reading is a silence."""

GIVE_UP_S = 10.0
"""After so long a silence an arm is lost, unless said otherwise."""


class ArmReading(NamedTuple):
    """What an arm reports in one cycle.

    Attributes:
        dt_s: Time since the previous reading; after a silence, how long that was.
        q_rad: Joint positions, shape (n,).
        dq_rad_s: Joint velocities, shape (n,); None where the interface has none.
        tau_Nm: Torques measured behind the gears, with gravity, shape (n,); None where
            it has none.
        external_Nm: The arm's own estimate of the external torques, shape (n,), or
            None.
        missed: Cycles since the previous reading that brought nothing valid.
        accepts_commands: Whether the arm would move now.
        current_A: Motor currents of an arm without torque sensors, shape (n,), or None.
        is_real: Whether commands would move an arm, not a simulation: a controller then
            needs limits of the jerk. An emulator counts as the arm that it stands for.
    """

    dt_s: float
    q_rad: Array
    dq_rad_s: Array | None
    tau_Nm: Array | None
    external_Nm: Array | None
    missed: int
    accepts_commands: bool
    current_A: Array | None = None
    is_real: bool = False


class MasterReading(NamedTuple):
    """What a haptic device reports.

    Attributes:
        t_s: On its own clock.
        position_m: Of the handle, shape (3,), in the device's axes.
        velocity_m_s: Of the handle, shape (3,), in the device's axes.
        clutch: True while the hand moves the needle.
    """

    t_s: float
    position_m: Array
    velocity_m_s: Array
    clutch: bool


@dataclass(slots=True)
class LinkReport:
    """Counts of what a link has received since it was opened.

    Attributes:
        used: Valid, passed on.
        missed: Cycles of which nothing valid came.
        malformed: Wrong size, type or checks, or numbers that are not finite.
        stale: The same as the one before, or older.
        foreign: From another address than the device's.
        outages: Silences longer than `SILENCE_S`.
        longest_gap_s: Between two valid ones, or since the last one.
    """

    used: int = 0
    missed: int = 0
    malformed: int = 0
    stale: int = 0
    foreign: int = 0
    outages: int = 0
    longest_gap_s: float = 0.0

    def count_used(self, cycles: int, gap_s: float) -> None:
        """Count a reading that was passed on.

        Args:
            cycles: Since the one before; 1 if none was missed.
            gap_s: Time since the one before.
        """
        self.used += 1
        self.missed += cycles - 1
        self.longest_gap_s = max(self.longest_gap_s, gap_s)

    def __str__(self) -> str:
        """Return one line for people: what is not zero."""
        counts = (f"{value:g} {name}" for name, value in asdict(self).items() if value)
        text = ", ".join(counts).replace("longest_gap_s", "s the longest gap")
        return text or "nothing received"


class Link:
    """A connection to a device; at the end of a ``with`` statement it closes itself.

    Attributes:
        report: What has come, and what has not.
        on_silence: Called every `SILENCE_S` of a silence with its length [s], by the
            loop that waits for the device.
    """

    def __init__(self) -> None:
        self.report = LinkReport()
        self.on_silence: Callable[[float], None] = lambda silent_s: None
        self._is_open = True
        self._heard_s = monotonic()  # when something valid came, or was waited for
        self._is_silent = False
        self._reported_s = 0.0  # length of the silence when it was reported last

    @property
    def silent_s(self) -> float:
        """How long nothing valid has come [s]; 0 for less than `SILENCE_S`."""
        silent_s = monotonic() - self._heard_s
        return silent_s if silent_s >= SILENCE_S else 0.0

    def _hear(self) -> None:
        """Note that something valid has come."""
        self._heard_s = monotonic()
        self._is_silent = False
        self._reported_s = 0.0

    def _count_silence(self) -> float:
        """Count and report a silence; return its length [s], 0 while there is none."""
        silent_s = self.silent_s
        if silent_s > 0.0:
            self.report.outages += not self._is_silent
            self._is_silent = True
            if self.report.used:
                self.report.longest_gap_s = max(self.report.longest_gap_s, silent_s)
            if silent_s >= self._reported_s + 0.9 * SILENCE_S:
                self._reported_s = silent_s
                self.on_silence(silent_s)
        return silent_s

    def end(self) -> None:
        """Let the readings end, at the latest when the present wait does.

        A signal handler may call it.
        """
        self._is_open = False

    def close(self) -> None:
        """End the connection, and with it the readings."""
        self.end()

    def __enter__(self) -> Self:
        """Return the link itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the link."""
        self.close()


class ReplayArm(Link):
    """Recorded joint signals of m cycles as an arm that takes no commands.

    Its report counts the readings given out.

    Args:
        dt_s: Time steps, shape (m,).
        q_rad: Joint positions, shape (m, n).
        dq_rad_s: Joint velocities, shape (m, n), or None.
        tau_Nm: Joint torques, shape (m, n).
        robot: The model of the arm, kept for those who need both.

    Attributes:
        joints: How many there are, n.
        robot: See the arguments.
    """

    def __init__(
        self,
        dt_s: Array,
        q_rad: Array,
        dq_rad_s: Array | None,
        tau_Nm: Array,
        robot: Any = None,
    ) -> None:
        super().__init__()
        self.robot = robot
        self.joints = q_rad.shape[1]
        velocities = [None] * len(dt_s) if dq_rad_s is None else dq_rad_s
        self._rows = zip(dt_s.tolist(), q_rad, velocities, tau_Nm, strict=True)

    def __iter__(self) -> Iterator[ArmReading]:
        """Yield the readings as fast as they are taken; see `pace`."""
        for dt_s, q_rad, dq_rad_s, tau_Nm in self._rows:
            if not self._is_open:
                return

            self.report.used += 1
            yield ArmReading(
                dt_s=dt_s,
                q_rad=q_rad,
                dq_rad_s=dq_rad_s,
                tau_Nm=tau_Nm,
                external_Nm=None,
                missed=0,
                accepts_commands=False,
            )

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """Return False: no command is taken."""
        return False


def pace(arm: Iterable[ArmReading]) -> Iterator[ArmReading]:
    """Yield the readings of a recorded arm in real time, as they were recorded."""
    due_s = monotonic()
    for reading in arm:
        due_s += reading.dt_s
        sleep(max(due_s - monotonic(), 0.0))
        yield reading
