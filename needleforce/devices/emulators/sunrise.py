"""An emulator of the controller of an LBR iiwa, which speaks `devices.sunrise`.

Its Java program opens the interface, monitors, and then lets positions be commanded.
"""

from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from needleforce.devices.emulators.arm_controller import ArmController, ArmSettings
from needleforce.devices.sunrise_messages import (
    JOINTS,
    MONITORING_KIND,
    CommandMode,
    Header,
    Monitoring,
    Quality,
    Session,
    read_command,
    write_monitoring,
)

WAIT_CYCLES = 20
"""So long the controller waits for answers that keep to its position before it lets
positions be commanded."""

MAX_START_ERROR_rad = 1e-4
"""An answer further away while it waits is refused."""

MAX_STEP_rad = 0.01
"""A command further from the one before is refused, as the controller does."""


@dataclass(frozen=True, kw_only=True)
class SunriseSettings(ArmSettings):
    """What the emulated controller of an iiwa does; commands move the arm.

    Attributes:
        version: Of the interface, 1 or 2.
        period_s: Whole milliseconds.
    """

    version: int = 2
    period_s: float = 5e-3


def emulate_sunrise(pipe: Connection, settings: SunriseSettings) -> dict[str, Any]:
    """Emulate the controller of an LBR iiwa; a function for `Emulator`.

    Returns:
        Counts of the cycles, of answers in the same cycle, of commands refused; and how
        far commands have moved the arm.
    """
    controller = _Controller(settings)
    controller.run(pipe)
    return {
        "cycles": controller.cycles,
        "same_cycle": controller.answered_in_cycle,
        "refused": controller.refused,
        "moved_rad": controller.moved_rad,
    }


class _Controller(ArmController):
    """The controller of an iiwa.

    Attributes:
        refused: How many commands were too far from the one before.
        moved_rad: How far commands have moved the arm, shape (7,).
    """

    def __init__(self, settings: SunriseSettings) -> None:
        super().__init__(settings)
        self.refused = 0
        self.moved_rad = np.zeros(JOINTS)
        self._tells_commanded = settings.version == 1
        self._waited = 0  # cycles with a good answer while it waits
        self._session = Session.MONITORING_READY
        self._reflected = 0

    def _message(self, t_s: float) -> bytes:
        settings = self._settings
        if t_s >= settings.command_from_s and self._session < Session.COMMANDING_WAIT:
            self._session = Session.COMMANDING_WAIT
        row = self.cycles % len(settings.q_rad)
        start_rad = settings.q_rad[0]
        commanded_rad = start_rad + self.moved_rad
        is_commanding = self._session >= Session.COMMANDING_WAIT
        message = Monitoring(
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
            commanded_rad=commanded_rad if self._tells_commanded else None,
            interpolated_rad=start_rad if is_commanding else None,
        )
        return write_monitoring(message)

    def _take_answer(self, data: bytes) -> bool:
        """Move the arm to a commanded position, or begin to take commands."""
        answer = read_command(data)
        if answer is None or answer.header.reflected != self.cycles:
            return False
        self._reflected = answer.header.number
        if self._session < Session.COMMANDING_WAIT:
            return True
        if answer.position_rad is None:
            self.refused += 1
            return True

        offset_rad = answer.position_rad - self._settings.q_rad[0]
        step_rad = np.abs(offset_rad - self.moved_rad).max()
        if self._session is Session.COMMANDING_WAIT:
            self._waited = self._waited + 1 if step_rad < MAX_START_ERROR_rad else 0
            if self._waited >= WAIT_CYCLES:
                self._session = Session.COMMANDING_ACTIVE
        elif step_rad > MAX_STEP_rad:
            self.refused += 1
        else:
            self.moved_rad = offset_rad
        return True
