"""What every device offers, real or emulated, and how a link reports what it has
missed.

An arm is iterated over: one sample per cycle, in SI units; what the interface lacks is
None. Arms and haptic devices satisfy the protocols of `needleforce.control.ports`, as
the simulated ones do.
"""

import socket
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import import_module
from time import monotonic, sleep
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class DeviceError(Exception):
    """Base of all errors of this package; each of the others is also a standard
    exception.
    """


class DeviceSettingError(DeviceError, ValueError):
    """An address, a rate or a scale that cannot work."""


class LinkError(DeviceError, ConnectionError):
    """A device that cannot be reached, does not answer or has stayed away for too
    long.
    """


class MissingClientError(DeviceError, ImportError):
    """The vendor's client library is not installed; the message names it."""


def client(module: str, package: str) -> Any:
    """A module of a vendor's library; `MissingClientError` where it is not
    installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingClientError(
            f"{package} is not installed; pip install {package}"
        ) from error


LOOPBACK = "127.0.0.1"  # Where links bind and connect unless an address is named
MOST_DATAGRAM = 65536
ROOM = (
    1 << 17
)  # Bytes for datagrams that wait to be read: no more than usual, old ones are stale


class ArmSample(NamedTuple):
    """What an arm reports in one cycle.

    Attributes:
        dt_s: Time since the previous sample, by the arm's own count of cycles.
        q_rad: Joint positions, shape (n,).
        dq_rad_s: Joint velocities, shape (n,); None where the interface has none.
        tau_Nm: Torques measured behind the gears, with gravity, shape (n,); None where
            it has none.
        external_Nm: The arm's own estimate of the external torques, shape (n,), or
            None.
        missed: Cycles since the previous sample that brought nothing valid.
        accepts_commands: Whether the arm would move now.
        current_A: Motor currents of an arm without torque sensors, shape (n,), or None.
    """

    dt_s: float
    q_rad: Array
    dq_rad_s: Array | None
    tau_Nm: Array | None
    external_Nm: Array | None
    missed: int
    accepts_commands: bool
    current_A: Array | None = None


@dataclass(slots=True)
class LinkReport:
    """Counts of what a link has received since it was opened.

    Attributes:
        used: valid, passed on.
        missed: Cycles of which nothing valid came.
        malformed: Wrong size, type or checks, or numbers that are not finite.
        stale: The same as the one before, or older.
        foreign: From another address than the device's.
        outages: Silences longer than the time that the link waits.
        longest_gap_s: Between two valid ones.
    """

    used: int = 0
    missed: int = 0
    malformed: int = 0
    stale: int = 0
    foreign: int = 0
    outages: int = 0
    longest_gap_s: float = 0.0

    def use(self, cycles: int, gap_s: float) -> None:
        """Count a sample that came so many cycles, and so long, after the one
        before.
        """
        self.used += 1
        self.missed += cycles - 1
        self.longest_gap_s = max(self.longest_gap_s, gap_s)

    def __str__(self) -> str:
        """One line for people: what is not zero."""
        counts = (f"{value:g} {name}" for name, value in asdict(self).items() if value)
        return (
            ", ".join(counts).replace("longest_gap_s", "s the longest gap")
            or "nothing received"
        )


class MasterSample(NamedTuple):
    """What a haptic device reports.

    Attributes:
        t_s: On its own clock.
        position_m: Of the handle, shape (3,), in the device's axes.
        velocity_m_s: Shape (3,).
        clutch: True while the hand moves the needle.
    """

    t_s: float
    position_m: Array
    velocity_m_s: Array
    clutch: bool


def paced(arm: Iterable[ArmSample]) -> Iterator[ArmSample]:
    """The samples of a recorded arm in real time: each waits until its time has
    come.
    """
    due_s = monotonic()
    for sample in arm:
        due_s += sample.dt_s
        sleep(max(due_s - monotonic(), 0.0))
        yield sample


class Link:
    """A connection to a device; at the end of a ``with`` statement it closes itself.

    Attributes:
        report: What has come, and what has not.
    """

    def __init__(self) -> None:
        self.report = LinkReport()
        self._is_open = True

    def end(self) -> None:
        """Let the samples end, at the latest with the present wait; a signal handler
        may.
        """
        self._is_open = False

    def close(self) -> None:
        """End the connection, and with it the samples."""
        self.end()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class ReadOnlyArm(Link):
    """An arm that is only listened to."""

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """No command is taken: False."""
        return False


class ReplayArm(ReadOnlyArm):
    """Recorded joint signals as an `Arm` that takes no commands; reports how many it
    gave out.
    """

    def __init__(
        self, dt_s: Array, q_rad: Array, dq_rad_s: Array | None, tau_Nm: Array
    ) -> None:
        """Take m samples: time steps, shape (m,), the others (m, n); velocities may
        be None.
        """
        super().__init__()
        self.joints = q_rad.shape[1]
        dq = [None] * len(dt_s) if dq_rad_s is None else dq_rad_s
        self._rows = zip(dt_s.tolist(), q_rad, dq, tau_Nm, strict=True)

    def __iter__(self) -> Iterator[ArmSample]:
        """The samples, as fast as they are taken; see `paced`."""
        for dt_s, q, dq, tau in self._rows:
            if not self._is_open:
                return
            self.report.used += 1
            yield ArmSample(dt_s, q, dq, tau, None, 0, accepts_commands=False)


def resolved(host: str) -> str:
    """The numeric address of a host, which its datagrams bear; `LinkError` for an
    unknown name.
    """
    try:
        return socket.gethostbyname(host)
    except (OSError, ValueError) as error:
        what = f"{host!r} is no address and no name that is known here: {error}"
        raise LinkError(f"{what}; give the numeric address of the device") from error


class DatagramLink(Link):
    """A link over UDP with one peer; datagrams from elsewhere are counted and dropped.

    Attributes:
        address: Where it listens.
        sender: From where the last datagram came.
        peer: Where it sends to, and the only one it listens to; None: not known yet.

    Raises:
        LinkError: The address cannot be bound, or the peer's name is unknown.
        DeviceSettingError: A port outside 0 to 65535.
    """

    def __init__(
        self, host: str, port: int, *, peer: str | None = None, room: int = ROOM
    ) -> None:
        if not 0 <= port <= 65535:
            raise DeviceSettingError(
                f"port {port}: expected 0 to 65535 (0: any free one)"
            )
        super().__init__()
        self._peer_host = peer and resolved(peer)
        self.sender: tuple[str, int] | None = None
        self.peer: tuple[str, int] | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, room)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            what = f"cannot listen on {host}:{port}: {error.strerror or error}"
            why = "is another program using the port, and is the address one of this machine?"
            raise LinkError(f"{what}; {why}") from error
        self.address: tuple[str, int] = self._socket.getsockname()
        self._empty_s = (
            monotonic()
        )  # When last nothing waited to be read: what came, came later

    def _receive(self, timeout_s: float) -> bytes | None:
        """The next datagram that may be the peer's; None when none came in time (0:
        now).
        """
        deadline_s = monotonic() + timeout_s
        is_empty = False
        while True:
            asked_s = monotonic()
            self._socket.settimeout(max(deadline_s - asked_s, 0.0) if is_empty else 0.0)
            try:
                data, sender = self._socket.recvfrom(MOST_DATAGRAM)
            except (TimeoutError, BlockingIOError):
                self._empty_s = asked_s
                is_empty = True
                if asked_s >= deadline_s:
                    return None
                continue
            except ConnectionError:  # what was sent before found nobody listening
                continue
            if sender[0] == (self._peer_host or sender[0]) and self.peer in (
                None,
                sender,
            ):
                self.sender = sender
                return data
            self.report.foreign += 1

    def _send(self, data: bytes, to: tuple[str, int] | None = None) -> None:
        """Send to the peer, or to an address; what the network refuses is lost, as
        on a wire.
        """
        if target := to or self.peer:
            with suppress(OSError):
                self._socket.sendto(data, target)

    def close(self) -> None:
        """End the samples, and free the port."""
        super().close()
        self._socket.close()
