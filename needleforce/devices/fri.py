"""KUKA LWR 4+ through the Fast Research Interface 1.0 of its controller (KRC2 lr).

The controller sends a measurement of 916 bytes every cycle and wants a command of 376
bytes back within it. A cycle is answered before its reading is handed on, with the
motion asked for before.
"""

from enum import IntEnum
from typing import Any

import numpy as np

from needleforce.devices.controller_link import ControllerLink
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.link import GIVE_UP_S, ArmReading

PORT = 49938
"""Of this machine, unless the controller is configured otherwise."""

JOINTS = 7

COUNTS = 1 << 16
"""Counters of packets go round after so many."""


def _packet_type(size: int, fields: dict[str, tuple[Any, int]]) -> np.dtype:
    """Return the type of packets of so many bytes: kind and first byte by field."""
    layout = {
        "count": ("<u2", 0),
        "reflected": ("<u2", 2),
        "size": ("<u2", 4),
        "kind": ("<u2", 6),
        **fields,
    }
    return np.dtype(
        {
            "names": list(layout),
            "formats": [kind for kind, _ in layout.values()],
            "offsets": [first_byte for _, first_byte in layout.values()],
            "itemsize": size,
        }
    )


# Little endian; from published descriptions of the interface (Schreiber, Stemmer,
# Bischoff, ICRA 2010 workshop, and public drivers). Only what is used here.
MEASUREMENT = _packet_type(
    916,
    {
        "stamp_s": ("<f4", 140),
        "state": ("<u2", 144),
        "quality": ("<u2", 146),
        "period_s": ("<f4", 148),
        "error": ("<u2", 184),
        "position_rad": (("<f4", JOINTS), 216),
        "commanded_rad": (("<f4", JOINTS), 292),
        # What this interface has added to the command.
        "added_rad": (("<f4", JOINTS), 320),
        # Behind the gears.
        "torque_Nm": (("<f4", JOINTS), 444),
        "external_Nm": (("<f4", JOINTS), 472),
    },
)
"""What the controller sends."""

MEASUREMENT_KIND = 0x2006

COMMAND = _packet_type(
    376, {"flags": ("<u4", 140), "position_rad": (("<f4", JOINTS), 144)}
)
"""What the controller wants back."""

COMMAND_KIND = 0x1005
POSITION_FLAG = 0x1


class FriState(IntEnum):
    """Modes of the interface."""

    OFF = 0
    MONITOR = 1
    COMMAND = 2


class FriQuality(IntEnum):
    """Qualities of the connection, as the controller rates it."""

    UNACCEPTABLE = 0
    BAD = 1
    GOOD = 2
    PERFECT = 3


def read_measurement(data: bytes) -> np.void | None:
    """Decode a datagram.

    Returns:
        A record of `MEASUREMENT`; None if the datagram is no measurement of this
        version, or has impossible values.
    """
    if len(data) != MEASUREMENT.itemsize:
        return None

    measurement = np.frombuffer(data, MEASUREMENT)[0]
    # Periods between which a measurement is valid.
    min_period_s = 0.5e-3
    max_period_s = 0.1
    signals = ("position_rad", "commanded_rad", "added_rad", "torque_Nm", "external_Nm")
    is_valid = (
        measurement["kind"] == MEASUREMENT_KIND
        and measurement["size"] == MEASUREMENT.itemsize
        and measurement["state"] <= max(FriState)
        and measurement["quality"] <= max(FriQuality)
        and min_period_s < measurement["period_s"] <= max_period_s
        and all(np.isfinite(measurement[signal]).all() for signal in signals)
    )
    return measurement if is_valid else None


class FriArm(ControllerLink):
    """The arm at the end of the interface.

    In monitor mode every answer mirrors the position that the controller commands, as
    it demands. In command mode, which the program on the controller begins (friStart),
    with a good or perfect connection and no error, velocities given to `send` are
    integrated. The interface transmits no velocity: readings have ``dq_rad_s=None``.
    After `close` the controller goes to monitor mode.

    Args:
        host: Address of this machine to which the controller sends.
        port: The port set in its configuration; 0 for any free one, see `address`.
        peer: Address or name of the controller; others are dropped. None: the first
            that sends a valid measurement is kept, see `DatagramLink.peer`; after a
            silence only its port may have changed.
        give_up_s: After so long without a valid measurement the arm is lost.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        state: Of the interface, of the latest reading.
        quality: Of the connection, of the latest reading.
        robot: The model of the arm.
        joints: How many there are.
        preset: Name of its limits, see `needleforce.control.Limits.of_arm`.

    Raises:
        LinkError: The address cannot be bound, or the peer's name is unknown.
        DeviceSettingError: A port or a time that cannot work.
    """

    preset = "lwr"

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = PORT,
        *,
        peer: str | None = None,
        give_up_s: float = GIVE_UP_S,
        robot: Any = None,
    ) -> None:
        super().__init__(
            host, port, COUNTS, JOINTS, peer=peer, give_up_s=give_up_s, robot=robot
        )
        self.state = FriState.OFF
        self.quality = FriQuality.UNACCEPTABLE
        self._has_error = False
        self._answer = np.zeros((), COMMAND)
        self._answer["size"] = COMMAND.itemsize
        self._answer["kind"] = COMMAND_KIND
        self._answer["flags"] = POSITION_FLAG
        self._target_rad = np.zeros(JOINTS)

    def _find_refusal(self) -> str:
        is_commanded = self.state is FriState.COMMAND and not self._has_error
        if is_commanded and self.quality >= FriQuality.GOOD:
            return ""
        return "the controller is not in command mode, or its connection is bad"

    def _lose_controller(self) -> None:
        self.state = FriState.OFF

    def _process(self, data: bytes) -> ArmReading | None:
        measurement = read_measurement(data)
        if measurement is None:
            self.report.malformed += 1
            return None

        # The period as it was meant: 1 ms is not a number of 32 bits.
        period_s = round(float(measurement["period_s"]), 6)
        cycles = self._count_cycles(int(measurement["count"]), period_s)
        if cycles is None:
            return None

        self._answer_measurement(measurement)
        return ArmReading(
            dt_s=cycles * period_s,
            q_rad=measurement["position_rad"].astype(float),
            dq_rad_s=None,
            tau_Nm=measurement["torque_Nm"].astype(float),
            external_Nm=measurement["external_Nm"].astype(float),
            missed=cycles - 1,
            accepts_commands=self._accepts_commands,
            is_real=True,
        )

    def _answer_measurement(self, measurement: np.void) -> None:
        """Send the command of this cycle: the position of the controller, or ours."""
        was_commanded = self.state is FriState.COMMAND
        self.state = FriState(measurement["state"])
        self.quality = FriQuality(measurement["quality"])
        self._has_error = bool(measurement["error"])
        guard = self._guard
        if not (was_commanded and self.state is FriState.COMMAND):
            commanded_rad = measurement["commanded_rad"].astype(float)
            self._target_rad = commanded_rad + measurement["added_rad"]
            guard.anchor()
        else:
            if self._find_refusal():
                guard.interrupt()
            guard.cycle_s = float(measurement["period_s"])
            step_rad = guard.cycle_s * guard.advance(self._target_rad)
            self._target_rad = self._target_rad + step_rad

        answer = self._answer
        answer["count"] = (int(answer["count"]) + 1) % COUNTS
        answer["reflected"] = measurement["count"]
        answer["position_rad"] = self._target_rad
        self._send(answer.tobytes())
