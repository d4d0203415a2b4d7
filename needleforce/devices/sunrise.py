"""KUKA LBR iiwa and med through FRI for Sunrise, versions 1 and 2.

A Java program on the controller opens the interface (docs/how-to/arm-iiwa.md). The
controller then sends a message every cycle and wants an answer to it. A cycle is
answered before its reading is handed on, with the motion asked for before.
"""

from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices import fri
from needleforce.devices.controller_link import ControllerLink
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.link import ArmReading
from needleforce.devices.sunrise_messages import (
    COMMAND_KIND,
    JOINTS,
    MAX_PERIOD_MS,
    MONITORING_KIND,
    CommandMode,
    Header,
    Monitoring,
    PositionCommand,
    Quality,
    Session,
    read_kind,
    read_monitoring,
    write_command,
)

PORT = 30200
"""Of this machine, unless the program on the controller says otherwise."""

COUNTS = 1 << 32
"""Counters of messages go round after so many."""


class IiwaArm(ControllerLink):
    """The arm at the end of the interface.

    While the controller's program monitors, answers only keep the connection. Where it
    lets positions be commanded, with a good connection and no safety stop, velocities
    given to `send` are integrated and added to the position of that program. Where it
    does not any more, the arm is braked and keeps its place, and commands are taken
    again from rest only. The interface transmits no velocity: readings have
    ``dq_rad_s=None``.

    Args:
        host: Address of this machine to which the controller sends.
        port: The port set in the controller's program; 0 for any free one, see
            `address`.
        peer: Address or name of the controller; others are dropped. None: the first
            that sends a valid message is kept, see `DatagramLink.peer`.
        wait_s: A silence longer than this counts as an outage.
        give_up_s: After so long without a valid message the readings end.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        session: State of the interface, of the latest reading.
        quality: Of the connection, of the latest reading.
        version: Of the interface, 1 or 2; 0 before the first message.
        stamp_s: Of the latest reading, on the controller's clock.
        preset: Name of its limits, see `needleforce.control.Limits.of_arm`.

    Raises:
        LinkError: The address cannot be bound, or the peer's name is unknown.
        DeviceSettingError: A port or a time that cannot work.
    """

    preset = "iiwa14"

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = PORT,
        *,
        peer: str | None = None,
        wait_s: float = 0.2,
        give_up_s: float = 10.0,
        robot: Any = None,
    ) -> None:
        super().__init__(
            host,
            port,
            COUNTS,
            JOINTS,
            peer=peer,
            wait_s=wait_s,
            give_up_s=give_up_s,
            robot=robot,
        )
        self.session = Session.IDLE
        self.quality = Quality.POOR
        self.version = 0
        self.stamp_s = 0.0
        self._message: Monitoring | None = None  # the latest
        self._last_without_period: Monitoring | None = None
        self._period_s: float | None = None  # of such messages
        self._is_commanding = False  # whether positions are commanded
        self._offset_rad = np.zeros(JOINTS)  # that is added to the program's position
        self._answer_count = 0
        self._unanswered = 0  # messages since the latest answer

    def _find_refusal(self) -> str:
        if self._is_commanding and _takes_commands(self._message):
            return ""
        return (
            "the controller's program lets no positions be commanded now, or the "
            "connection is bad"
        )

    def _lose_controller(self) -> None:
        """Note that the controller is silent."""
        self.session = Session.IDLE
        self._last_without_period = None
        self._period_s = None
        self._end_commanding()

    def _end_commanding(self) -> None:
        """Note that the controller takes no positions any more."""
        if self._is_commanding:
            self._guard.anchor()
            self._guard.interrupt()
        self._is_commanding = False

    def _process(self, data: bytes) -> ArmReading | None:
        """Answer a message newer than the latest, and return its reading."""
        message = read_monitoring(data)
        if message is None:
            self.report.malformed += 1
            self.hint = self.hint or describe_stranger(data)
            return None

        message = self._add_period(message)
        if message.period_s == 0.0:
            self.hint = self.hint or "messages have told neither period nor time so far"
            return None

        cycles = self._count_cycles(message.header.number, message.period_s)
        if cycles is None:
            return None

        self._take_state(message)
        self._answer_message(message)
        return ArmReading(
            dt_s=cycles * message.period_s,
            q_rad=message.position_rad,
            dq_rad_s=None,
            tau_Nm=message.torque_Nm,
            external_Nm=message.external_Nm,
            missed=cycles - 1,
            accepts_commands=self._accepts_commands,
            is_real=True,
        )

    def _add_period(self, message: Monitoring) -> Monitoring:
        """Return a message with its period, which some controllers do not send.

        It is then found from the stamps, in whole milliseconds as it is set there; zero
        before the second message.
        """
        if message.period_s > 0.0:
            return message
        last = self._last_without_period
        self._last_without_period = message
        if last is not None and self._period_s is None:
            cycles = (message.header.number - last.header.number) % COUNTS
            period_ms = round(1e3 * (message.stamp_s - last.stamp_s) / max(cycles, 1))
            if 0 < period_ms <= MAX_PERIOD_MS:
                self._period_s = 1e-3 * period_ms
        return message._replace(period_s=self._period_s or 0.0)

    def _take_state(self, message: Monitoring) -> None:
        """Take over the state of the interface; begin or end commanding positions.

        While the session lasts the place of the arm is kept, whether or not commands
        are taken. A session that has waited begins where its program is; one that is
        found running, where the arm is.
        """
        has_waited = self.session is Session.COMMANDING_WAIT
        self._message = message
        self.session = message.session
        self.quality = message.quality
        self.version = 2 if message.commanded_rad is None else 1
        self.stamp_s = message.stamp_s
        if message.session is not Session.COMMANDING_ACTIVE:
            self._end_commanding()
            return
        if not self._is_commanding and message.interpolated_rad is not None:
            self._is_commanding = True
            away_rad = message.position_rad - message.interpolated_rad
            self._offset_rad = np.zeros(JOINTS) if has_waited else away_rad
        if self._is_commanding and not _takes_commands(message):
            self._guard.interrupt()

    def _answer_message(self, message: Monitoring) -> None:
        """Send the command of this cycle, when the controller wants one."""
        position_rad = self._next_position_rad(message)
        self._unanswered += 1
        is_wanted = self._unanswered >= message.answer_cycles
        if message.session is Session.IDLE or not is_wanted:
            return

        self._unanswered = 0
        header = Header(COMMAND_KIND, self._answer_count, message.header.number)
        self._answer_count = (self._answer_count + 1) % COUNTS
        self._send(write_command(PositionCommand(header, position_rad)))

    def _next_position_rad(self, message: Monitoring) -> Array | None:
        """Return the position to be commanded, shape (7,); None while nothing is.

        Version 1 wants its own position back while it monitors, version 2 none.
        """
        if self._is_commanding and message.interpolated_rad is not None:
            self._guard.cycle_s = message.period_s
            place_rad = message.interpolated_rad + self._offset_rad
            step_rad = message.period_s * self._guard.advance(place_rad)
            self._offset_rad = self._offset_rad + step_rad

        if message.session < Session.COMMANDING_WAIT:
            return message.commanded_rad
        if message.interpolated_rad is None:
            return None
        if message.session is Session.COMMANDING_WAIT:
            return message.interpolated_rad

        return message.interpolated_rad + self._offset_rad


def _takes_commands(message: Monitoring | None) -> bool:
    """Return whether the controller lets positions be commanded now."""
    return (
        message is not None
        and message.session is Session.COMMANDING_ACTIVE
        and message.quality >= Quality.GOOD
        and message.command_mode is CommandMode.POSITION
        and message.safety_stop == 0
        and message.interpolated_rad is not None
    )


def describe_stranger(data: bytes) -> str:
    """Return what a datagram seems to be that is no message; empty for nothing."""
    if fri.read_measurement(data) is not None:
        return "the sender speaks FRI 1.0, of an LWR 4+: name it fri"

    kind = read_kind(data)
    if kind is None or kind == MONITORING_KIND:
        return ""

    return (
        f"the sender speaks kind 0x{kind:x} of FRI for Sunrise, expected "
        f"0x{MONITORING_KIND:x}, versions 1 and 2 of an LBR"
    )
