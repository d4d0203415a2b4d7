"""A haptic device a lab can buy: Haply's Inverse3, through its local service; and an
emulator.

The service speaks JSON over a websocket on this machine, in its format 3.1 as public
examples show it. It sends the state of its devices, and the next one after a force has
come. The clutch is button A of the grip where there is one; without a grip the hand
always moves the needle.
"""

import json
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from needleforce.devices.proxy import (
    DeviceSettingError,
    Link,
    LinkError,
    MasterSample,
    client,
)

ADDRESS = "ws://127.0.0.1:10001"
AXES = "xyz"
GRIPS = ("wireless_verse_grip", "verse_grip")
LOST_s = 0.1  # After so long a silence the force is asked for again


class HaplyMaster(Link):
    """An impedance device of three degrees of freedom; forces above `most_force_N` are
    shortened.

    Raises:
        MissingClientError: websockets is not installed.
        LinkError: The service does not answer.
        DeviceSettingError: A force that is not positive.
    """

    def __init__(self, address: str = ADDRESS, *, most_force_N: float = 5.0) -> None:
        if not 0.0 < most_force_N < np.inf:
            raise DeviceSettingError(
                f"most_force_N={most_force_N!r}: expected a positive number"
            )
        super().__init__()
        self._gone = client("websockets.exceptions", "websockets").WebSocketException
        connect = client("websockets.sync.client", "websockets").connect
        try:
            self._socket = connect(address, max_size=1 << 20, open_timeout=5.0)
        except (OSError, self._gone) as error:
            what = f"no haptic service at {address}: {error}"
            raise LinkError(
                f"{what}; is it running, is a device plugged in?"
            ) from error
        self._force_N = np.zeros(3)
        self._most_N = most_force_N
        self._device = ""
        self._begin_s = self._last_s = self._asked_s = time.monotonic()

    def read(self) -> MasterSample | None:
        """The newest state, or None: nothing has come, or the device is gone; see
        `report`.
        """
        found = None
        now_s = time.monotonic()
        with suppress(TimeoutError, self._gone):
            while True:
                text = self._socket.recv(timeout=0)
                found = self._decoded(text, now_s - self._begin_s) or found
        if found is not None:
            self.report.use(1, now_s - self._last_s)
            self._last_s = now_s
        elif now_s - self._asked_s > LOST_s:
            self.report.outages += self._asked_s == self._last_s  # one a silence
        else:
            return None
        self._asked_s = now_s
        with suppress(self._gone):
            self._command()
        return found

    def render(self, force_N: ArrayLike) -> None:
        """Force on the hand [N], shape (3,), sent with the next state; zero if it is
        not finite.
        """
        force = np.array(force_N, dtype=float)
        if force.shape != (3,) or not np.isfinite(force).all():
            force = np.zeros(3)
        size = float(np.linalg.norm(force))
        self._force_N = force * min(1.0, self._most_N / size) if size > 0.0 else force

    def close(self) -> None:
        """Show no force, and end the connection."""
        super().close()
        self._force_N = np.zeros(3)
        with suppress(self._gone):
            self._command()
            self._socket.close()

    def _command(self) -> None:
        if self._device:
            values = dict(zip(AXES, self._force_N.tolist(), strict=True))
            commands = {"set_cursor_force": {"values": values}}
            device = {"device_id": self._device, "commands": commands}
            self._socket.send(json.dumps({"inverse3": [device]}))

    def _decoded(self, text: str | bytes, t_s: float) -> MasterSample | None:
        try:
            state = json.loads(text)
            device = state["inverse3"][0]
            position, velocity = (
                np.array([float(device["state"][name][axis]) for axis in AXES])
                for name in ("cursor_position", "cursor_velocity")
            )
            if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
                raise ValueError
            self._device = str(device["device_id"])
            grips = (grip for kind in GRIPS for grip in state.get(kind) or ())
            buttons = (grip.get("state", {}).get("buttons", {}) for grip in grips)
            clutch = next((bool(each["a"]) for each in buttons if "a" in each), True)
            return MasterSample(t_s, position, velocity, clutch)
        except (ValueError, TypeError, LookupError, AttributeError):
            self.report.malformed += 1
            return None


def emulate_haply(
    pipe: Connection, wish_m: np.ndarray, period_s: float = 1e-3
) -> dict[str, Any]:
    """The service with one device in an emulated operator's hand; a function for
    `Emulator`.

    The person wants the handle at ``wish_m``: a row per period, shape (m, 3); the last
    row holds from then on. It returns how many cycles passed, and the energy that went
    through the handle.
    """
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import ServerConnection, serve

    from groundtruth.rig_operator import HapticMaster, Operator

    hand = Operator(
        wish_m=lambda t_s: wish_m[min(round(t_s / period_s), len(wish_m) - 1)]
    )
    master = HapticMaster(hand)
    counts = {"cycles": 0}

    def session(link: ServerConnection) -> None:
        due_s = time.monotonic()
        with suppress(ConnectionClosed):
            while True:
                sample = master.read()
                counts["cycles"] += 1
                if sample is not None:
                    at = sample.position_m.tolist()
                    to = sample.velocity_m_s.tolist()
                    values = {"cursor_position": at, "cursor_velocity": to}
                    state = {
                        k: dict(zip(AXES, v, strict=True)) for k, v in values.items()
                    }
                    device = {"device_id": "emulated", "state": state}
                    link.send(json.dumps({"inverse3": [device]}))
                due_s += period_s
                # The device goes on with its last force when no new one comes in time.
                with suppress(TimeoutError):
                    while (left_s := due_s - time.monotonic()) > 0.0:
                        command = json.loads(link.recv(timeout=left_s))
                        values = command["inverse3"][0]["commands"]["set_cursor_force"][
                            "values"
                        ]
                        master.render([values[axis] for axis in AXES])

    with serve(session, "127.0.0.1", 0) as server:
        pipe.send({"address": f"ws://127.0.0.1:{server.socket.getsockname()[1]}"})
        threading.Thread(target=server.serve_forever, daemon=True).start()
        pipe.poll(None)
    return {**counts, "port_energy_J": master.port_energy_J}
