"""An emulator of the controller of an LBR iiwa, which speaks the protocol of `sunrise`.

Its Java program opens the interface, monitors, and then lets positions be commanded.
"""

import time
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.datagram_link import LOOPBACK, Endpoint
from needleforce.devices.emulators import FaultyWire, WireFaults, run_cycles
from needleforce.devices.sunrise_messages import (
    JOINTS,
    MONITORING_KIND,
    CommandMode,
    Header,
    Monitoring,
    PositionCommand,
    Quality,
    Session,
    read_command,
    write_monitoring,
)

STOP_CHECK_CYCLES = 20
"""Once in so many cycles the emulator looks whether it shall end."""

WAIT_CYCLES = 20
"""So long the controller waits for answers that keep to its position before it lets
positions be commanded."""

MAX_START_ERROR_rad = 1e-4
"""An answer further away while it waits is refused."""

MAX_STEP_rad = 0.01
"""A command further from the one before is refused, as the controller does."""


@dataclass(frozen=True, kw_only=True)
class SunriseSettings:
    """What the emulated controller does.

    Rows of the signals are sent in turn, one a cycle; commands move the arm.

    Attributes:
        port: To which it sends.
        q_rad: Joint positions, shape (m, 7).
        tau_Nm: Joint torques, shape (m, 7).
        version: Of the interface, 1 or 2.
        period_s: Of a cycle: whole milliseconds.
        cycles: After so many it ends; None: when it is stopped.
        extra_wait_s: So much longer a cycle lasts until it is answered; one of a real
            controller never does.
        command_from_s: When it goes from monitoring to commanding.
        faults: What goes wrong on the wire.
    """

    port: int
    q_rad: Array
    tau_Nm: Array
    version: int = 2
    period_s: float = 5e-3
    cycles: int | None = None
    extra_wait_s: float = 0.0
    command_from_s: float = float("inf")
    faults: WireFaults = field(default_factory=WireFaults)


def emulate_sunrise(pipe: Connection, settings: SunriseSettings) -> dict[str, Any]:
    """Emulate the controller of an LBR iiwa; a function for `Emulator`.

    Returns:
        Counts of the cycles, of answers in the same cycle, of commands refused; and how
        far commands have moved the arm.
    """
    controller = _Controller(settings)
    pipe.send({"port": controller.wire.address.port})
    run_cycles(controller, settings.cycles, pipe, STOP_CHECK_CYCLES)
    return {
        "cycles": controller.cycles,
        "same_cycle": controller.answered_in_cycle,
        "refused": controller.refused,
        "moved_rad": controller.moved_rad,
    }


class _Controller:
    """The controller: sends a message every cycle, and takes the answer.

    Attributes:
        wire: The link to the arm's program.
        cycles: How many have passed.
        answered_in_cycle: How many were answered before they ended.
        refused: How many commands were too far from the one before.
        moved_rad: How far commands have moved the arm, shape (7,).
    """

    def __init__(self, settings: SunriseSettings) -> None:
        self._settings = settings
        self.wire = FaultyWire(settings.faults, Endpoint(LOOPBACK, settings.port))
        self.cycles = 0
        self.answered_in_cycle = 0
        self.refused = 0
        self.moved_rad = np.zeros(JOINTS)
        self._waited = 0  # cycles with a good answer while it waits
        self._session = Session.MONITORING_READY
        self._reflected = 0
        self._due_s = time.monotonic()

    def run_cycle(self) -> None:
        """Send a message, and wait for its answer until the cycle is over."""
        settings = self._settings
        t_s = self.cycles * settings.period_s
        if t_s >= settings.command_from_s and self._session < Session.COMMANDING_WAIT:
            self._session = Session.COMMANDING_WAIT

        message = self._message(t_s)
        self._due_s += settings.period_s
        was_sent = self.wire.put(write_monitoring(message), t_s)
        end_s = self._due_s + (settings.extra_wait_s if was_sent else 0.0)
        answer = self._await_answer(end_s)
        if answer is not None:
            self.answered_in_cycle += 1
            self._due_s = (
                max(self._due_s, time.monotonic()) if was_sent else self._due_s
            )
            self._take_answer(message, answer)

        self.cycles += 1

    def _message(self, t_s: float) -> Monitoring:
        """Return the message of this cycle."""
        settings = self._settings
        row = self.cycles % len(settings.q_rad)
        start_rad = settings.q_rad[0]
        commanded_rad = start_rad + self.moved_rad
        is_commanding = self._session >= Session.COMMANDING_WAIT
        return Monitoring(
            header=Header(MONITORING_KIND, self.cycles, self._reflected),
            session=self._session,
            quality=Quality.EXCELLENT,
            period_s=settings.period_s,
            answer_cycles=1,
            safety_stop=0,
            command_mode=CommandMode.POSITION if is_commanding else CommandMode.NONE,
            stamp_s=t_s,
            position_rad=settings.q_rad[row] + self.moved_rad,
            torque_Nm=settings.tau_Nm[row],
            external_Nm=0.1 * settings.tau_Nm[row],
            commanded_rad=commanded_rad if settings.version == 1 else None,
            interpolated_rad=start_rad if is_commanding else None,
        )

    def _await_answer(self, end_s: float) -> PositionCommand | None:
        """Return the answer to this cycle's message; None if none came in time."""
        for datagram in self.wire.received(end_s):
            command = read_command(datagram.data)
            if command is not None and command.header.reflected == self.cycles:
                return command

        return None

    def _take_answer(self, message: Monitoring, answer: PositionCommand) -> None:
        """Move the arm to a commanded position, or begin to take commands."""
        self._reflected = answer.header.number
        if message.interpolated_rad is None:
            return
        if answer.position_rad is None:
            self.refused += 1
            return

        offset_rad = answer.position_rad - message.interpolated_rad
        step_rad = np.abs(offset_rad - self.moved_rad).max()
        if self._session is Session.COMMANDING_WAIT:
            self._waited = self._waited + 1 if step_rad < MAX_START_ERROR_rad else 0
            if self._waited >= WAIT_CYCLES:
                self._session = Session.COMMANDING_ACTIVE
        elif step_rad > MAX_STEP_rad:
            self.refused += 1
        else:
            self.moved_rad = offset_rad
