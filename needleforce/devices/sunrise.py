"""KUKA LBR iiwa and med through FRI for Sunrise, versions 1 and 2.

A Java program on the controller opens the interface (docs/how-to/arm-iiwa.md). The
controller then sends a message every cycle and wants an answer to it. A cycle is
answered before its reading is handed on, with the motion asked for before.
"""

from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.controller_link import ControllerLink
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.link import GIVE_UP_S, ArmReading
from needleforce.devices.sunrise_messages import (
    JOINTS,
    MAX_PERIOD_MS,
    POSITION_MODE,
    Quality,
    Session,
    message_type,
    read_monitoring,
    write_command,
)

PORT = 30200
"""Of this machine, unless the program on the controller says otherwise."""

COUNTS = 1 << 32
"""Counters of messages go round after so many."""

MS_TO_S = 1e-3
NS_TO_S = 1e-9


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
        give_up_s: After so long without a valid message the arm is lost.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        session: State of the interface, of the latest reading.
        quality: Of the connection, of the latest reading.
        preset: Name of its limits, see `needleforce.control.Limits.of_arm`.

    Raises:
        MissingClientError: protobuf is not installed.
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
        give_up_s: float = GIVE_UP_S,
        robot: Any = None,
    ) -> None:
        message_type("Monitoring")
        super().__init__(
            host, port, COUNTS, JOINTS, peer=peer, give_up_s=give_up_s, robot=robot
        )
        self.session = Session.IDLE
        self.quality = Quality.POOR
        self._takes_positions = False  # by the latest message
        self._stamped: tuple[int, float] | None = None  # number, time of the latest
        self._period_s: float | None = None  # of messages without one
        self._is_commanding = False  # whether positions are commanded
        self._offset_rad = np.zeros(JOINTS)  # that is added to the program's position
        self._answer_count = 0
        self._unanswered = 0  # messages since the latest answer

    def _find_refusal(self) -> str:
        if self._is_commanding and self._takes_positions:
            return ""
        return (
            "the controller's program lets no positions be commanded now, or the "
            "connection is bad"
        )

    def _lose_controller(self) -> None:
        self.session = Session.IDLE
        self._stamped = None
        self._period_s = None
        self._end_commanding()

    def _end_commanding(self) -> None:
        """Note that the controller takes no positions any more."""
        if self._is_commanding:
            self._guard.anchor()
            self._guard.interrupt()
        self._is_commanding = False

    def _process(self, data: bytes) -> ArmReading | None:
        message = read_monitoring(data)
        if message is None:
            self.report.malformed += 1
            return None

        measured = message.measured
        stamp_s = measured.time.seconds + NS_TO_S * measured.time.nanoseconds
        period_s = MS_TO_S * message.connection.period_ms
        if period_s == 0.0:
            period_s = self._find_period(message.header.number, stamp_s)
        if period_s == 0.0:
            return None

        cycles = self._count_cycles(message.header.number, period_s)
        if cycles is None:
            return None

        place_rad = np.array(measured.position_rad.value)
        self._take_state(message, place_rad)
        self._answer_message(message, period_s)
        return ArmReading(
            dt_s=cycles * period_s,
            q_rad=place_rad,
            dq_rad_s=None,
            tau_Nm=np.array(measured.torque_Nm.value),
            external_Nm=np.array(measured.external_Nm.value),
            missed=cycles - 1,
            accepts_commands=self._accepts_commands,
            is_real=True,
        )

    def _find_period(self, number: int, stamp_s: float) -> float:
        """Return the period of messages that do not say it; 0 before the second one.

        It is found from the stamps, in whole milliseconds as it is set there.
        """
        if self._stamped is not None and self._period_s is None:
            last_number, last_s = self._stamped
            cycles = max((number - last_number) % COUNTS, 1)
            period_ms = round((stamp_s - last_s) / MS_TO_S / cycles)
            if 0 < period_ms <= MAX_PERIOD_MS:
                self._period_s = MS_TO_S * period_ms
        self._stamped = (number, stamp_s)
        return self._period_s or 0.0

    def _take_state(self, message: Any, place_rad: Array) -> None:
        """Take over the state of the interface; begin or end commanding positions.

        While the session lasts the place of the arm is kept, whether or not commands
        are taken. A session that has waited begins where its program is; one that is
        found running, where the arm is.
        """
        has_waited = self.session is Session.COMMANDING_WAIT
        self.session = Session(message.connection.session)
        self.quality = Quality(message.connection.quality)
        has_program = message.program.HasField("position_rad")
        self._takes_positions = (
            self.session is Session.COMMANDING_ACTIVE
            and self.quality >= Quality.GOOD
            and message.program.mode == POSITION_MODE
            and message.robot.safety_stop == 0
            and has_program
        )
        if self.session is not Session.COMMANDING_ACTIVE:
            self._end_commanding()
            return
        if not self._is_commanding and has_program:
            self._is_commanding = True
            away_rad = place_rad - message.program.position_rad.value
            self._offset_rad = np.zeros(JOINTS) if has_waited else away_rad
        if self._is_commanding and not self._takes_positions:
            self._guard.interrupt()

    def _answer_message(self, message: Any, period_s: float) -> None:
        """Send the command of this cycle, when the controller wants one."""
        position_rad = self._next_position_rad(message, period_s)
        self._unanswered += 1
        is_wanted = self._unanswered >= message.connection.answer_cycles
        if self.session is Session.IDLE or not is_wanted:
            return

        self._unanswered = 0
        reflected = message.header.number
        self._send(write_command(self._answer_count, reflected, position_rad))
        self._answer_count = (self._answer_count + 1) % COUNTS

    def _next_position_rad(self, message: Any, period_s: float) -> Array | None:
        """Return the position to be commanded, shape (7,); None while nothing is.

        Version 1 wants its own position back while it monitors, version 2 none.
        """
        if self.session < Session.COMMANDING_WAIT:
            is_told = message.measured.HasField("commanded_rad")
            return np.array(message.measured.commanded_rad.value) if is_told else None
        if not message.program.HasField("position_rad"):
            return None

        program_rad = np.array(message.program.position_rad.value)
        if self._is_commanding:
            self._guard.cycle_s = period_s
            velocity_rad_s = self._guard.advance(program_rad + self._offset_rad)
            self._offset_rad = self._offset_rad + period_s * velocity_rad_s
            return program_rad + self._offset_rad
        return program_rad
