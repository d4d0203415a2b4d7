"""A haptic device a lab can buy: Haply's Inverse3, through its local service.

The service speaks JSON over a websocket on this machine, in its format 3.1 as public
examples show it. It sends the state of its devices, and the next one after a force has
come. The clutch is button A of the grip where there is one; without a grip the hand
always moves the needle.
"""

import json
import socket
import struct
import time
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.devices.errors import DeviceSettingError, LinkError, import_client
from needleforce.devices.link import SILENCE_S, Link, MasterReading

ADDRESS = "ws://127.0.0.1:10001"
"""Where the service listens."""

AXES = "xyz"
GRIPS = ("wireless_verse_grip", "verse_grip")


class HaplyMaster(Link):
    """An impedance device of three degrees of freedom.

    Args:
        address: Of its service.
        max_force_N: Larger forces are shortened.

    Raises:
        MissingClientError: websockets is not installed.
        LinkError: The service does not answer.
        DeviceSettingError: A force that is not positive.
    """

    def __init__(self, address: str = ADDRESS, *, max_force_N: float = 5.0) -> None:
        if not 0.0 < max_force_N < np.inf:
            raise DeviceSettingError(
                f"max_force_N={max_force_N!r}: expected a positive number"
            )

        super().__init__()
        errors = import_client("websockets.exceptions", "websockets")
        client = import_client("websockets.sync.client", "websockets")
        self._socket_error: type[Exception] = errors.WebSocketException
        try:
            # So long the service may take to answer.
            connect_wait_s = 5.0
            # So long it may take to take its leave.
            close_wait_s = 0.5
            # A longer message is none of the service.
            max_message_bytes = 1 << 20
            self._socket = client.connect(
                address,
                max_size=max_message_bytes,
                open_timeout=connect_wait_s,
                close_timeout=close_wait_s,
            )
        except (OSError, self._socket_error) as error:
            raise LinkError(f"no haptic service at {address}: {error}") from error

        # A service that takes nothing must not hold the loop: sending gives up, and
        # ends the connection.
        wait_us = 100_000
        self._socket.socket.setsockopt(
            socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", 0, wait_us)
        )
        self._force_N = np.zeros(3)
        self._max_force_N = max_force_N
        self._device_id = ""
        self._begin_s = time.monotonic()
        self._asked_s = self._begin_s  # when a force was sent

    def read(self) -> MasterReading | None:
        """Return the newest state.

        Returns:
            The state; None if nothing has come, see `silent_s` for how long.
        """
        now_s = time.monotonic()
        reading = self._receive_newest(now_s - self._begin_s)
        if reading is not None:
            self.report.count_used(1, now_s - self._heard_s)
            self._hear()
        elif not self._count_silence() or now_s - self._asked_s < SILENCE_S:
            return None

        # A state comes back for each force, also after a silence.
        self._asked_s = now_s
        with suppress(self._socket_error):
            self._send_force()

        return reading

    def render(self, force_N: ArrayLike) -> None:
        """Set the force on the hand, sent with the next state.

        Args:
            force_N: Force, shape (3,); one that is not finite counts as zero.
        """
        force = np.array(force_N, dtype=float)
        if force.shape != (3,) or not np.isfinite(force).all():
            force = np.zeros(3)

        size_N = float(np.linalg.norm(force))
        if size_N > 0.0:
            force = force * min(1.0, self._max_force_N / size_N)

        self._force_N = force

    def close(self) -> None:
        """Show no force, and end the connection, within a second."""
        super().close()
        self._force_N = np.zeros(3)
        with suppress(self._socket_error):
            self._send_force()
            self._socket.close()

    def _receive_newest(self, t_s: float) -> MasterReading | None:
        """Return the newest valid state of all that wait; None if there is none."""
        # So long a reading takes what waits at most, whatever the service sends.
        max_read_s = 2e-3
        newest = None
        end_s = time.monotonic() + max_read_s
        with suppress(TimeoutError, self._socket_error):
            while time.monotonic() < end_s:
                text = self._socket.recv(timeout=0)
                newest = self._decode(text, t_s) or newest

        return newest

    def _send_force(self) -> None:
        """Send the force, once the device is known."""
        if self._device_id:
            values = dict(zip(AXES, self._force_N.tolist(), strict=True))
            commands = {"set_cursor_force": {"values": values}}
            device = {"device_id": self._device_id, "commands": commands}
            self._socket.send(json.dumps({"inverse3": [device]}))

    def _decode(self, text: str | bytes, t_s: float) -> MasterReading | None:
        """Return a state of the service as a reading; None if it is malformed."""
        malformed = (
            ValueError,
            TypeError,
            LookupError,
            AttributeError,
            OverflowError,  # an integer of hundreds of digits
            RecursionError,  # brackets nested by the thousand
        )
        try:
            state = json.loads(text)
            device = state["inverse3"][0]
            position_m = _vector(device["state"]["cursor_position"])
            velocity_m_s = _vector(device["state"]["cursor_velocity"])
            if not (np.isfinite(position_m).all() and np.isfinite(velocity_m_s).all()):
                raise ValueError

            self._device_id = str(device["device_id"])
            return MasterReading(t_s, position_m, velocity_m_s, _is_clutched(state))
        except malformed:
            self.report.malformed += 1
            return None


def _vector(values: dict[str, Any]) -> Array:
    """Return values by axis as a vector, shape (3,)."""
    return np.array([float(values[axis]) for axis in AXES])


def _is_clutched(state: dict[str, Any]) -> bool:
    """Return whether button A of the first grip that has one is pressed.

    True without a grip.
    """
    grips = (grip for kind in GRIPS for grip in state.get(kind) or ())
    all_buttons = (grip.get("state", {}).get("buttons", {}) for grip in grips)
    return next((bool(buttons["a"]) for buttons in all_buttons if "a" in buttons), True)
