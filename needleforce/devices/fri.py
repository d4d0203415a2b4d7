"""KUKA LWR 4+ through the Fast Research Interface 1.0 of its controller (KRC2 lr).

The controller sends a measurement of 916 bytes every cycle and wants a command of 376
bytes back within it. A cycle is answered before its sample is handed on, with the
motion asked for before.
"""

from collections.abc import Iterator
from enum import IntEnum
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from needleforce.devices.proxy import (
    LOOPBACK,
    ArmSample,
    DatagramLink,
    DeviceSettingError,
)

PORT = 49938
JOINTS = 7
COUNTS = 1 << 16
_HEADER = {
    "count": ("<u2", 0),
    "reflected": ("<u2", 2),
    "size": ("<u2", 4),
    "kind": ("<u2", 6),
}


def _packet(size: int, fields: dict[str, tuple[object, int]]) -> np.dtype:
    """A packet of so many bytes with these fields: their types and first bytes."""
    both = _HEADER | fields
    formats, offsets = zip(*both.values(), strict=True)
    table = {
        "names": list(both),
        "formats": formats,
        "offsets": offsets,
        "itemsize": size,
    }
    return np.dtype(table)  # pyright: ignore[reportCallIssue, reportArgumentType]


# Little endian; from published descriptions of the interface (Schreiber, Stemmer,
# Bischoff, ICRA 2010 workshop, and public drivers). Only what is used here.
_MEASURED = {
    "stamp_s": ("<f4", 140),
    "state": ("<u2", 144),
    "quality": ("<u2", 146),
    "period_s": ("<f4", 148),
    "error": ("<u2", 184),
    "position_rad": (("<f4", JOINTS), 216),
    "commanded_rad": (("<f4", JOINTS), 292),
    "added_rad": (("<f4", JOINTS), 320),  # what this interface has added to the command
    "torque_Nm": (("<f4", JOINTS), 444),  # behind the gears
    "external_Nm": (("<f4", JOINTS), 472),
}
MEASUREMENT = _packet(916, _MEASURED)
MEASUREMENT_KIND = 0x2006
COMMAND = _packet(376, {"flags": ("<u4", 140), "position_rad": (("<f4", JOINTS), 144)})
COMMAND_KIND = 0x1005
POSITION_FLAG = 0x1
SILENT_CYCLES = 5  # After so many cycles without `send` the arm is held
LONGEST_COUNTED_s = 1.0
"""Of a longer gap the counter may have gone round or begun anew: our own clock says
how long."""
MOST_WAIT_s = 3600.0  # A socket waits for no infinite time
LATEST_s = 0.1  # By which one datagram may come later than others


class State(IntEnum):
    """Of the interface."""

    OFF = 0
    MONITOR = 1
    COMMAND = 2


class Quality(IntEnum):
    """Of the connection, as the controller rates it."""

    UNACCEPTABLE = 0
    BAD = 1
    GOOD = 2
    PERFECT = 3


def read_measurement(data: bytes) -> np.void | None:
    """Decode a datagram; None if it is no measurement of this version, or has
    impossible values.
    """
    if len(data) != MEASUREMENT.itemsize:
        return None
    found = np.frombuffer(data, MEASUREMENT)[0]
    names = (
        "stamp_s",
        "position_rad",
        "commanded_rad",
        "added_rad",
        "torque_Nm",
        "external_Nm",
    )
    is_valid = (
        (found["size"], found["kind"]) == (MEASUREMENT.itemsize, MEASUREMENT_KIND)
        and found["state"] <= max(State)
        and found["quality"] <= max(Quality)
        and 0.5e-3 < found["period_s"] <= 0.1
        and all(np.isfinite(found[name]).all() for name in names)
    )
    return found if is_valid else None


class FriArm(DatagramLink):
    """The arm at the end of the interface.

    In monitor mode every answer mirrors the position that the controller commands, as
    it demands. In command mode, which the program on the controller begins (friStart),
    with a good or perfect connection and no error, velocities given to `send` are
    integrated. The interface transmits no velocity: samples have ``dq_rad_s=None``.
    After `close` the controller goes to monitor mode.

    Args:
        host: Address of this machine on which the controller sends.
        port: The port set in its configuration; 0 for any free one, see `address`.
        peer: Address or name of the controller; others are dropped. None: who is valid
            first.
        wait_s: A silence longer than this counts as an outage.
        give_up_s: After so long without a valid measurement the samples end.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        state: Of the interface, of the last sample.
        quality: Of the connection, of the last sample.

    Raises:
        LinkError: The address cannot be bound, or the peer's name is unknown.
        DeviceSettingError: A port or a time that cannot work.
    """

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = PORT,
        *,
        peer: str | None = None,
        wait_s: float = 0.1,
        give_up_s: float = 10.0,
        robot: Any = None,
    ) -> None:
        if not 0.0 < wait_s <= min(give_up_s, MOST_WAIT_s):
            what = f"0 < wait_s <= give_up_s, and wait_s of at most {MOST_WAIT_s:g} s"
            raise DeviceSettingError(f"{wait_s=}, {give_up_s=}: expected {what}")
        super().__init__(host, port, peer=peer)
        self.robot = robot
        self.joints = JOINTS
        self.state = State.OFF
        self.quality = Quality.UNACCEPTABLE
        self._wait_s = wait_s
        self._give_up_s = give_up_s
        self._last: np.void | None = None
        self._arrival_s = self._after_s = (
            monotonic()
        )  # Of the last: read then, sent later than
        self._answer = np.zeros((), COMMAND)
        self._answer["size"] = COMMAND.itemsize
        self._answer["kind"] = COMMAND_KIND
        self._answer["flags"] = POSITION_FLAG
        self._target_rad = self._velocity_rad_s = np.zeros(JOINTS)
        self._silent = SILENT_CYCLES

    def __iter__(self) -> Iterator[ArmSample]:
        """Samples as they come, each answered already."""
        heard_s = monotonic()
        is_silent = False
        while self._is_open and monotonic() - heard_s < self._give_up_s:
            data = self._receive(self._wait_s)
            if data is None:
                self.report.outages += not is_silent
                is_silent = True
                self.state = State.OFF
                self.peer = None  # after an outage it may come back on another port
                continue
            for sample in self._answered(data):
                yield sample
                heard_s = monotonic()
                is_silent = False

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """Joint velocity for the coming cycles [rad/s], shape (7,).

        It holds for five cycles; then the arm is held where it is. False where the arm
        takes no commands, and for numbers that are not finite.
        """
        velocity = np.array(dq_rad_s, dtype=float)
        is_usable = velocity.shape == (JOINTS,) and bool(np.isfinite(velocity).all())
        if not (is_usable and self._takes_commands()):
            return False
        self._velocity_rad_s = velocity
        self._silent = 0
        return True

    def _takes_commands(self) -> bool:
        is_well = self._last is not None and self._last["error"] == 0
        return self.state is State.COMMAND and self.quality >= Quality.GOOD and is_well

    def _answered(self, data: bytes) -> Iterator[ArmSample]:
        """A sample whose measurement is newer than the last, once that is answered."""
        found = read_measurement(data)
        now_s = monotonic()
        if found is None:
            self.report.malformed += 1
            return
        # Both this and the last may have waited to be read: no more time is between
        # them.
        cycles = 1
        most_s = now_s - self._after_s + LATEST_s
        # The period as it was meant: 1 ms is not a number of 32 bits.
        period_s = round(float(found["period_s"]), 6)
        if self._last is not None:
            cycles = (int(found["count"]) - int(self._last["count"])) % COUNTS
            is_short = self._empty_s - self._arrival_s < LONGEST_COUNTED_s
            is_counted = is_short and most_s < COUNTS // 2 * period_s
            if is_counted and not 0 < cycles < COUNTS // 2:
                self.report.stale += 1
                return
            if not is_counted or cycles * period_s > most_s:
                cycles = max(round((now_s - self._arrival_s) / period_s), 1)
        self.peer = self.sender
        self._arrival_s = now_s
        self._after_s = self._empty_s
        self._send_answer(found)
        dt_s = cycles * period_s
        is_moved = self._takes_commands()
        self.report.use(cycles, dt_s)
        signals = "position_rad", "torque_Nm", "external_Nm"
        q, tau, external = (found[name].astype(float) for name in signals)
        yield ArmSample(
            dt_s, q, None, tau, external, cycles - 1, accepts_commands=is_moved
        )

    def _send_answer(self, found: np.void) -> None:
        was_commanded = self._takes_commands()
        self._last = found
        self.state = State(found["state"])
        self.quality = Quality(found["quality"])
        if not (was_commanded and self._takes_commands()):
            self._target_rad = found["commanded_rad"].astype(float) + found["added_rad"]
            self._silent = SILENT_CYCLES
        elif self._silent < SILENT_CYCLES:
            self._silent += 1
            self._target_rad = (
                self._target_rad + found["period_s"] * self._velocity_rad_s
            )
        answer = self._answer
        answer["count"] = (int(answer["count"]) + 1) % COUNTS
        answer["reflected"] = found["count"]
        answer["position_rad"] = self._target_rad
        self._send(answer.tobytes())
