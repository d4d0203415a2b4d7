"""An arm behind a vendor's client library, which a thread reads and connects again."""

from abc import abstractmethod
from contextlib import suppress
from queue import Empty, Full, Queue
from threading import Thread
from time import monotonic, sleep
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.devices.errors import LinkError
from needleforce.devices.guard import GuardedArm
from needleforce.devices.link import ArmReading


class ArmSignals(NamedTuple):
    """What an arm's client has read at a time.

    Attributes:
        time_s: On the arm's clock.
        q_rad: Joint positions, shape (n,).
        dq_rad_s: Joint velocities, shape (n,).
        effort: Torques or motor currents, shape (n,).
        external_Nm: The arm's own estimate of the external torques, shape (n,), or
            None.
    """

    time_s: float
    q_rad: Array
    dq_rad_s: Array
    effort: Array
    external_Nm: Array | None = None


class ClientArm(GuardedArm):
    """An arm whose signals a thread reads; they are checked, counted and handed on.

    An arm that is only listened to is connected to again when it is lost. One that is
    commanded has then stopped itself: it has to be opened anew.

    Args:
        host: Address of the arm.
        joints: How many it has.
        period_s: Of its cycle.
        takes_commands: Whether the arm shall move.
        give_up_s: After so long a silence the arm is lost.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        takes_commands: Whether the arm shall move.
    """

    def __init__(
        self,
        host: str,
        joints: int,
        period_s: float,
        *,
        takes_commands: bool,
        give_up_s: float,
        robot: Any,
    ) -> None:
        self._set_patience(give_up_s)
        super().__init__()
        self.joints = joints
        self.robot = robot
        self.takes_commands = takes_commands
        self._host = host
        self._period_s = period_s
        self._guard = self._make_guard(period_s)
        self._latest_s: float | None = None  # stamp of the latest reading
        self._taken_s = 0.0  # when that was taken, on this machine's clock
        self._place_rad = np.zeros(joints)  # of the latest signals
        # So many readings wait for a program that is busy; later ones are lost to it.
        max_waiting_readings = 100
        self._waiting: Queue[ArmSignals | Exception] = Queue(max_waiting_readings)
        self._thread = Thread(target=self._run, daemon=True)

    @abstractmethod
    def _connect(self) -> None:
        """Connect to the arm, or raise one of `_errors`."""

    @abstractmethod
    def _errors(self) -> tuple[type[Exception], ...]:
        """Return what the client raises."""

    @abstractmethod
    def _read_client(self) -> ArmSignals | None:
        """Return what the client reads newly; None if it holds nothing newer."""

    @abstractmethod
    def _move(self, velocity_rad_s: Array | None) -> None:
        """Send the velocity of this cycle, or raise one of `_errors`.

        Args:
            velocity_rad_s: Shape (n,); None for an arm at rest that shall stay there.
        """

    @abstractmethod
    def _release(self) -> None:
        """End the client's connection, and with it the motion of the arm."""

    def _open(self) -> None:
        """Connect to the arm for the first time; `LinkError` if it does not answer."""
        try:
            self._connect()
        except self._errors() as error:
            self._release()
            raise LinkError(f"no arm {self._place()}: {error}") from error
        self._thread.start()

    def _place(self) -> str:
        return f"{type(self).__name__} at {self._host}"

    def _lose(self) -> None:
        self._guard.anchor()  # it stops itself

    def _run(self) -> None:
        """Read the client, and connect again where it is lost, until the end."""
        # Fraction of a cycle between two looks for a newer reading.
        poll_ratio = 0.2
        while self._is_open:
            try:
                signals = self._read_client()
                if signals is None:
                    sleep(poll_ratio * self._period_s)
                    continue
                with suppress(Full):
                    self._waiting.put_nowait(signals)
            except self._errors() as error:
                if self.takes_commands:
                    self._waiting.put(error)
                    return
                self._connect_again()

    def _connect_again(self) -> None:
        """Connect to an arm that was lost, until it answers or the readings end."""
        retry_s = 0.5
        while self._is_open:
            sleep(retry_s)
            with suppress(*self._errors()):
                self._connect()
                return

    def _read(self, wait_s: float) -> ArmReading | None:
        try:
            signals = self._waiting.get(timeout=wait_s)
        except Empty:
            return None
        if isinstance(signals, Exception):
            raise self._stopped_error(signals) from signals
        self._place_rad = signals.q_rad
        # What has waited tells of the past: one command a cycle.
        if self.takes_commands and self._waiting.empty():
            try:
                is_idle = self._guard.is_idle
                self._move(None if is_idle else self._guard.advance(signals.q_rad))
            except self._errors() as error:
                raise self._stopped_error(error) from error
        return self._checked(signals)

    def _checked(self, signals: ArmSignals) -> ArmReading | None:
        """Return signals as a reading, if they are valid and new."""
        arrays = [signals.q_rad, signals.dq_rad_s, signals.effort]
        if signals.external_Nm is not None:
            arrays.append(signals.external_Nm)
        if not all(
            array.shape == (self.joints,) and np.isfinite(array).all()
            for array in arrays
        ):
            self.report.malformed += 1
            return None

        now_s = monotonic()
        dt_s = self._period_s
        if self._latest_s is not None:
            # Stamps count microseconds or more; their differences have rounding errors.
            stamp_digits = 9
            dt_s = round(signals.time_s - self._latest_s, stamp_digits)
            if self._is_silent:  # its clock may have begun anew
                dt_s = max(now_s - self._taken_s, self._period_s)
        if dt_s <= 0.0:
            self.report.stale += 1
            return None

        missed = max(round(dt_s / self._period_s) - 1, 0)
        self._latest_s = signals.time_s
        self._taken_s = now_s
        self.report.count_used(missed + 1, dt_s)
        return ArmReading(
            dt_s=dt_s,
            q_rad=signals.q_rad,
            dq_rad_s=signals.dq_rad_s,
            tau_Nm=signals.effort,
            external_Nm=signals.external_Nm,
            missed=missed,
            accepts_commands=self._accepts_commands,
            is_real=True,
        )

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
        with suppress(*self._errors()):
            while not self._guard.is_at_rest:
                self._move(self._guard.advance(self._place_rad))
                sleep(self._period_s)
        self._guard.anchor()
        if self._thread.is_alive():
            # A client waits for an arm that is silent for a second.
            max_wait_s = 1.5
            self._thread.join(max_wait_s)
        self._release()
