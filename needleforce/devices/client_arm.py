"""An arm behind a vendor's client library, which a thread reads and connects again."""

from abc import abstractmethod
from contextlib import suppress
from queue import Empty, Full, Queue
from threading import Thread
from time import monotonic, sleep
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.errors import LinkError
from needleforce.devices.guard import GuardedArm
from needleforce.devices.link import ArmReading

StampedReading = tuple[float, ArmReading]
"""A reading whose time step is still the arm's cycle, and its stamp [s] on the arm's
clock."""


class ClientArm(GuardedArm):
    """An arm whose client a thread reads; readings are checked, counted, handed on.

    An arm that is only listened to is connected to again when it is lost. One that is
    commanded has then stopped itself: it has to be opened anew.

    Args:
        host: Address of the arm.
        joints: How many it has.
        period_s: Of its cycle.
        errors: What its client raises.
        takes_commands: Whether the arm shall move.
        give_up_s: After so long a silence the arm is lost.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        takes_commands: Whether the arm shall move.

    Raises:
        LinkError: The arm does not answer.
    """

    def __init__(
        self,
        host: str,
        joints: int,
        period_s: float,
        errors: tuple[type[Exception], ...],
        *,
        takes_commands: bool,
        give_up_s: float,
        robot: Any,
    ) -> None:
        super().__init__(joints, robot, give_up_s, cycle_s=period_s)
        self.takes_commands = takes_commands
        self._host = host
        self._period_s = period_s
        self._client_errors = errors
        self._latest_stamp_s = -np.inf
        self._latest_s = monotonic()  # when that was taken
        self._place_rad = np.zeros(joints)
        # So many readings wait for a program that is busy; later ones are lost to it.
        max_waiting_readings = 100
        self._waiting: Queue[StampedReading | Exception] = Queue(max_waiting_readings)
        try:
            self._connect()
        except errors as error:
            self._release()
            raise LinkError(f"no arm {self._place()}: {error}") from error
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    @abstractmethod
    def _connect(self) -> None:
        """Connect to the arm, or raise one of the client's errors."""

    @abstractmethod
    def _read_client(self) -> StampedReading | None:
        """Return what the client reads newly; None if it holds nothing newer."""

    @abstractmethod
    def _move(self, velocity_rad_s: Array | None) -> None:
        """Send the velocity of this cycle, or raise one of the client's errors.

        Args:
            velocity_rad_s: Shape (n,); None for an arm at rest that shall stay there.
        """

    @abstractmethod
    def _release(self) -> None:
        """End the client's connection, and with it the motion of the arm."""

    def _place(self) -> str:
        return f"{type(self).__name__} at {self._host}"

    def _lose(self) -> None:
        self._guard.anchor()  # it stops itself

    def _run(self) -> None:
        """Read the client, and connect again where it is lost, until the end."""
        # Fraction of a cycle between two looks for a newer reading.
        poll_ratio = 0.2
        # Between two attempts to connect.
        retry_s = 0.5
        is_connected = True
        while self._is_open:
            try:
                if not is_connected:
                    sleep(retry_s)
                    self._connect()
                    is_connected = True
                reading = self._read_client()
            except self._client_errors as error:
                if self.takes_commands:
                    self._waiting.put(error)
                    return
                is_connected = False
                continue
            if reading is None:
                sleep(poll_ratio * self._period_s)
                continue
            with suppress(Full):
                self._waiting.put_nowait(reading)

    def _read(self, wait_s: float) -> ArmReading | None:
        try:
            item = self._waiting.get(timeout=wait_s)
        except Empty:
            return None
        if isinstance(item, Exception):
            raise self._stopped_error(item) from item
        stamp_s, reading = item
        self._place_rad = reading.q_rad
        # What has waited tells of the past: one command a cycle.
        if self.takes_commands and self._waiting.empty():
            guard = self._guard
            try:
                self._move(None if guard.is_idle else guard.advance(reading.q_rad))
            except self._client_errors as error:
                raise self._stopped_error(error) from error
        return self._check(stamp_s, reading)

    def _check(self, stamp_s: float, reading: ArmReading) -> ArmReading | None:
        """Return a reading with its time step, if it is valid and new."""
        signals = [signal for signal in reading if isinstance(signal, np.ndarray)]
        if not all(
            signal.shape == (self.joints,) and np.isfinite(signal).all()
            for signal in signals
        ):
            self.report.malformed += 1
            return None

        now_s = monotonic()
        # Stamps count microseconds or more; their differences have rounding errors.
        stamp_digits = 9
        dt_s = round(stamp_s - self._latest_stamp_s, stamp_digits)
        if self._is_silent:  # its clock may have begun anew
            dt_s = max(now_s - self._latest_s, self._period_s)
        if np.isinf(self._latest_stamp_s):
            dt_s = self._period_s
        if dt_s <= 0.0:
            self.report.stale += 1
            return None

        missed = max(round(dt_s / self._period_s) - 1, 0)
        self._latest_stamp_s = stamp_s
        self._latest_s = now_s
        self.report.count_used(missed + 1, dt_s)
        is_ready = self._accepts_commands
        return reading._replace(dt_s=dt_s, missed=missed, accepts_commands=is_ready)

    def _find_refusal(self) -> str:
        if self.takes_commands:
            return ""
        return "the arm was opened without takes_commands=True"

    def _stopped_error(self, error: BaseException) -> LinkError:
        """Return the error of an arm that has stopped by itself, and stands."""
        self.end()
        self._guard.anchor()
        return LinkError(
            f"the arm {self._place()} has stopped: {error}",
            "Release it at its own panel, see to the cause that the message "
            "names, and open the connection again.",
        )

    def close(self) -> None:
        """Brake the arm to rest if it was commanded, end readings and connection."""
        super().close()
        self._guard.brake()
        with suppress(*self._client_errors):
            while not self._guard.is_at_rest:
                self._move(self._guard.advance(self._place_rad))
                sleep(self._period_s)
        self._guard.anchor()
        # A client waits for an arm that is silent for a second.
        max_wait_s = 1.5
        self._thread.join(max_wait_s)
        self._release()
