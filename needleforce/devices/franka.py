"""Franka arms through libfranka at 1 kHz: FER (Panda) and FR3.

The two speak different versions of the interface, each with a client library of its
own: panda-python for the FER, the vendor's pylibfranka for the FR3. The clients are
imported when an arm is opened. An arm that is no longer commanded is braked, within
limits that no Franka takes for a fault.
"""

import threading
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from queue import Empty, Full, Queue
from typing import Any

import numpy as np

from needleforce.devices.checked_arm import ArmSignals, CheckedArm
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.errors import LinkError, import_client
from needleforce.devices.franka_versions import (
    FER_LIBRARY,
    FR3_LIBRARY,
    Library,
    describe_mismatch,
)
from needleforce.devices.franka_wire import read_urdf
from needleforce.devices.link import ArmReading

JOINTS = 7
PERIOD_S = 1e-3

MAX_BRAKE_CYCLES = 2000
"""An arm that moves at its highest speed has come to rest before."""


class _FrankaArm(CheckedArm):
    """What both arms have in common.

    Args:
        host: Address of the arm.
        library: Which client is used.
        client_module: Its module, with a `Robot`.
        takes_commands: Whether the arm shall move.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        client: The client's own robot, for what this driver does not offer, such as
            collision thresholds or the load; None after `close`.
        takes_commands: Whether the arm shall move.
    """

    def __init__(
        self,
        host: str,
        library: Library,
        client_module: Any,
        *,
        takes_commands: bool,
        robot: Any,
    ) -> None:
        super().__init__(JOINTS, PERIOD_S, robot)
        self._library = client_module
        self.takes_commands = takes_commands
        self._guard = self._make_guard()
        self.client: Any = self._connect(host, library)

    def _connect(self, host: str, library: Library) -> Any:
        """Return the client's robot.

        Raises:
            LinkError: The arm does not answer, or speaks another version.
        """
        try:
            return self._client_robot(host)
        except self._errors() as error:
            mismatch = describe_mismatch(host, library)
            if mismatch:
                raise LinkError(f"no Franka arm at {host}: {mismatch}") from error

            raise LinkError(
                f"no Franka arm at {host}: {error}; is its FCI activated, and does no "
                "other program control it?"
            ) from error

    def _client_robot(self, host: str) -> Any:
        """Return the client's robot, or raise one of its errors."""
        return self._library.Robot(host, self._library.RealtimeConfig.kIgnore)

    def _errors(self) -> tuple[type[Exception], ...]:
        """Return what the client raises."""
        return (RuntimeError,)

    def __iter__(self) -> Iterator[ArmReading]:
        """Yield readings as they come, until the arm stays away.

        Raises:
            LinkError: An arm that is controlled has stopped, as with a reflex.
        """
        if self.takes_commands and self._is_open:
            yield from self._controlled_readings()
            return

        while self._is_open:
            try:
                state = self.client.read_once()
            except self._errors():
                self.report.outages += 1
                return

            yield from self._state_readings(state, self._time_s(state))

    @abstractmethod
    def _controlled_readings(self) -> Iterator[ArmReading]:
        """Yield readings of an arm that is commanded."""

    @abstractmethod
    def _time_s(self, state: Any) -> float:
        """Return the arm's own time of a state of the client [s]."""

    def _find_refusal(self) -> str:
        if self.takes_commands:
            return ""
        return "the arm was opened without takes_commands=True"

    def _state_readings(self, state: Any, time_s: float) -> Iterator[ArmReading]:
        """Yield a state of the client as a reading, if it is valid and new."""
        signals = ArmSignals(
            time_s=time_s,
            q_rad=np.array(state.q),
            dq_rad_s=np.array(state.dq),
            effort=np.array(state.tau_J),
            external_Nm=np.array(state.tau_ext_hat_filtered),
        )
        return self._checked(signals)

    def _stopped_error(self, error: BaseException) -> LinkError:
        """Return the error of an arm that has stopped by itself, and stands."""
        self.end()
        return LinkError(
            f"the Franka arm has stopped: {error}",
            "Release it at its own panel, see to the cause that the message "
            "names, and open the connection again.",
        )


class Fr3Arm(_FrankaArm):
    """A Franka FR3 through pylibfranka.

    `external_Nm` of a reading is the arm's own filtered estimate. With
    ``takes_commands`` the arm is controlled from the first reading to `close`, which
    brakes it to rest: a program has to come back for the next reading in time, since
    after 20 cycles without an answer the arm stops.

    Args:
        host: Address of the arm.
        takes_commands: Whether it shall move; otherwise it is only listened to.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        preset: Name of its limits, see `needleforce.control.Limits.of_arm`.

    Raises:
        MissingClientError: pylibfranka is not installed.
        LinkError: The arm does not answer, or speaks another version.
    """

    preset = "fr3"

    def __init__(
        self, host: str = LOOPBACK, *, takes_commands: bool = False, robot: Any = None
    ) -> None:
        super().__init__(
            host,
            FR3_LIBRARY,
            import_client("pylibfranka", "pylibfranka"),
            takes_commands=takes_commands,
            robot=robot,
        )
        self._control: Any = None  # while the arm is controlled
        self._is_answer_due = False
        self._place_rad = np.zeros(JOINTS)  # of the latest state

    def _errors(self) -> tuple[type[Exception], ...]:
        return (RuntimeError, self._library.FrankaException)

    @staticmethod
    def read_urdf(host: str = LOOPBACK) -> str:
        """Return the description that an arm has of itself, as URDF.

        It serves one connection at a time: ask before this class is opened.

        Args:
            host: Address of the arm.

        Raises:
            LinkError: The arm does not answer, or gives no description.
        """
        return read_urdf(host, FR3_LIBRARY.version)

    def _time_s(self, state: Any) -> float:
        return state.time.to_sec()

    def _controlled_readings(self) -> Iterator[ArmReading]:
        """Yield a reading a cycle, and answer it before the next one."""
        try:
            if self._control is None:
                mode = self._library.ControllerMode.JointImpedance
                self._control = self.client.start_joint_velocity_control(mode)

            while self._is_open:
                self._answer()
                state, _ = self._control.readOnce()
                self._is_answer_due = True
                self._place_rad = np.array(state.q)
                yield from self._state_readings(state, state.time.to_sec())
        except self._errors() as error:
            self._control = None
            self._is_answer_due = False
            self.report.outages += 1
            raise self._stopped_error(error) from error

    def _answer(self, *, is_last: bool = False) -> None:
        """Send the velocity of this cycle, if its state has been read."""
        if self._is_answer_due:
            velocities = self._library.JointVelocities(
                self._guard.advance(self._place_rad).tolist()
            )
            velocities.motion_finished = is_last
            self._is_answer_due = False
            self._control.writeOnce(velocities)

    def close(self) -> None:
        """Brake the arm to rest, and end readings and connection."""
        super().close()
        try:
            if self._control is not None:
                self._brake()
        except self._errors():
            self.report.outages += 1
        finally:
            self._control = None
            self.client = None

    def _brake(self) -> None:
        """Go on with control until the arm rests, then give it back."""
        self._guard.brake()
        for _ in range(MAX_BRAKE_CYCLES):
            self._answer()
            state, _ = self._control.readOnce()
            self._is_answer_due = True
            self._place_rad = np.array(state.q)
            if self._guard.is_at_rest:
                break

        self._answer(is_last=True)


class FrankaArm(_FrankaArm):
    """A Franka FER (Panda) through panda-python.

    `external_Nm` of a reading is the arm's own filtered estimate. With
    ``takes_commands`` a thread of its own answers every cycle of the arm with the
    velocity that was sent last, limited in rate by libfranka: a program that is busy
    makes the arm brake, not stop.

    Args:
        host: Address of the arm.
        takes_commands: Whether it shall move; otherwise it is only listened to.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        preset: Name of its limits, see `needleforce.control.Limits.of_arm`.

    Raises:
        MissingClientError: panda-python is not installed.
        LinkError: The arm does not answer, or speaks another version.
    """

    preset = "fer"

    def __init__(
        self, host: str = LOOPBACK, *, takes_commands: bool = False, robot: Any = None
    ) -> None:
        super().__init__(
            host,
            FER_LIBRARY,
            import_client("panda_py.libfranka", "panda-python"),
            takes_commands=takes_commands,
            robot=robot,
        )
        # So many readings wait for a program that is busy; later ones are lost to it.
        max_waiting_readings = 100
        self._states: Queue[tuple[Any, float] | None] = Queue(max_waiting_readings)
        self._failure: BaseException | None = None
        self._thread: threading.Thread | None = None  # while the arm is controlled

    def _time_s(self, state: Any) -> float:
        return 1e-3 * state.time.to_msec()

    def _controlled_readings(self) -> Iterator[ArmReading]:
        """Yield the readings of the thread that answers the arm."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._control, daemon=True)
            self._thread.start()

        while self._is_open:
            try:
                # Without a state for so long an arm is away.
                silence_s = 1.0
                item = self._states.get(timeout=silence_s)
            except Empty:
                item = None

            if item is None:
                self.report.outages += 1
                if self._failure is not None:
                    raise self._stopped_error(self._failure) from self._failure

                return

            yield from self._state_readings(*item)

    def _control(self) -> None:
        """Answer the arm until it rests after the end, or stops by itself."""
        try:
            self.client.control_joint_velocity(self._answer)
        except RuntimeError as error:
            self._failure = error
        finally:
            with suppress(Full):
                self._states.put_nowait(None)

    def _answer(self, state: Any, _duration: Any) -> Any:
        """Return the velocity of this cycle; called by the client's thread."""
        with suppress(Full):
            self._states.put_nowait((_Copied(state), 1e-3 * state.time.to_msec()))
        if not self._is_open:
            self._guard.brake()
        velocity_rad_s = self._guard.advance(np.array(state.q))
        velocities = self._library.JointVelocities(velocity_rad_s.tolist())
        velocities.motion_finished = not self._is_open and self._guard.is_at_rest
        return velocities

    def close(self) -> None:
        """Brake the arm to rest, and end readings and connection."""
        super().close()
        if self._thread is not None:
            self._thread.join(MAX_BRAKE_CYCLES * PERIOD_S)

        self.client = None


class _Copied:
    """The signals of a state, which the client owns only during its call."""

    def __init__(self, state: Any) -> None:
        self.q = list(state.q)
        self.dq = list(state.dq)
        self.tau_J = list(state.tau_J)
        self.tau_ext_hat_filtered = list(state.tau_ext_hat_filtered)
