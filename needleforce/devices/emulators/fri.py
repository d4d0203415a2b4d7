"""An emulator of the controller of an LWR, which speaks `devices.fri`."""

from collections import deque
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices import fri
from needleforce.devices.emulators.arm_controller import ArmController, ArmSettings
from needleforce.devices.emulators.process import take_real_time
from needleforce.devices.emulators.wire import is_within


@dataclass(frozen=True, kw_only=True)
class FriSettings(ArmSettings):
    """What the emulated controller of an LWR does.

    Commands move only the reported command, unless `delay_cycles` is set.

    Attributes:
        in_real_time: Whether it asks the system for real-time priority.
        delay_cycles: So many cycles after a command the reported position is there;
            None: positions are those of ``q_rad``.
    """

    period_s: float = 1e-3
    in_real_time: bool = False
    delay_cycles: int | None = None


def emulate_fri(pipe: Connection, settings: FriSettings) -> dict[str, Any]:
    """Emulate the controller of an LWR; a function for `Emulator`.

    Returns:
        Counts of the cycles, of answers in the same cycle, of packets sent; and the
        position that was commanded at the end.
    """
    if settings.in_real_time:
        take_real_time()

    controller = _Controller(settings)
    controller.run(pipe)
    return {
        "cycles": controller.cycles,
        "same_cycle": controller.answered_in_cycle,
        "sent": controller.wire.sent,
        "commanded_rad": controller.commanded_rad,
    }


class _Controller(ArmController):
    def __init__(self, settings: FriSettings) -> None:
        super().__init__(settings)
        self._packet = np.zeros((), fri.MEASUREMENT)
        self._packet["size"] = fri.MEASUREMENT.itemsize
        self._packet["kind"] = fri.MEASUREMENT_KIND
        self._packet["period_s"] = settings.period_s
        self._packet["commanded_rad"] = settings.q_rad[0]
        self._moves = settings.delay_cycles is not None
        length = (settings.delay_cycles or 0) + 1
        self._commanded: deque[Array] = deque([settings.q_rad[0]] * length, length)

    @property
    def commanded_rad(self) -> Array:
        """The position that was commanded, shape (7,)."""
        return self._packet["commanded_rad"].copy()

    def _message(self, t_s: float) -> bytes:
        settings = self._settings
        is_bad = is_within(settings.faults.bad_quality, t_s)
        is_commanded = t_s >= settings.command_from_s and not is_bad
        row = self.cycles % len(settings.q_rad)
        packet = self._packet
        packet["count"] = self.cycles % fri.COUNTS
        packet["stamp_s"] = t_s
        packet["state"] = fri.FriState.COMMAND if is_commanded else fri.FriState.MONITOR
        packet["quality"] = fri.FriQuality.BAD if is_bad else fri.FriQuality.PERFECT
        packet["position_rad"] = settings.q_rad[row]
        if self._moves:
            self._commanded.append(self.commanded_rad)
            packet["position_rad"] = self._commanded[0]
        packet["torque_Nm"] = settings.tau_Nm[row]
        return packet.tobytes()

    def _take_answer(self, data: bytes) -> bool:
        if len(data) != fri.COMMAND.itemsize:
            return False
        answer = np.frombuffer(data, fri.COMMAND)[0]
        if answer["reflected"] != self._packet["count"]:
            return False
        if self._packet["state"] == fri.FriState.COMMAND:
            self._packet["commanded_rad"] = answer["position_rad"]
        return True
