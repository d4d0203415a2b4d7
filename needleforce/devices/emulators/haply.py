"""An emulator of the service of `devices.haply`: one device, in an operator's hand."""

import json
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from foundation.arrays import Array
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.haply import AXES

if TYPE_CHECKING:
    from websockets.sync.server import ServerConnection

    from groundtruth.rig_operator import HapticMaster


def emulate_haply(
    pipe: Connection, wish_m: Array, period_s: float = 1e-3
) -> dict[str, Any]:
    """Emulate the service with one device; a function for `Emulator`.

    Args:
        pipe: To the process that runs the emulator.
        wish_m: Where the person wants the handle: a row per period, shape (m, 3); the
            last row holds from then on.
        period_s: Of the device's states.

    Returns:
        How many cycles passed, and the energy that went through the handle.
    """
    from websockets.sync.server import serve

    from groundtruth.rig_operator import HapticMaster, Operator

    def wish_at(t_s: float) -> Array:
        return wish_m[min(round(t_s / period_s), len(wish_m) - 1)]

    device = _Device(HapticMaster(Operator(wish_m=wish_at)), period_s)
    with serve(device.serve, LOOPBACK, 0) as server:
        port = server.socket.getsockname()[1]
        pipe.send({"address": f"ws://{LOOPBACK}:{port}"})
        threading.Thread(target=server.serve_forever, daemon=True).start()
        pipe.poll(None)

    return {"cycles": device.cycles, "port_energy_J": device.master.port_energy_J}


class _Device:
    """The device of the service.

    Attributes:
        master: What moves it.
        cycles: How many have passed.
    """

    def __init__(self, master: "HapticMaster", period_s: float) -> None:
        self.master = master
        self._period_s = period_s
        self.cycles = 0

    def serve(self, link: "ServerConnection") -> None:
        """Send states and take forces until the connection ends."""
        from websockets.exceptions import ConnectionClosed

        due_s = time.monotonic()
        with suppress(ConnectionClosed):
            while True:
                self._send_state(link)
                due_s += self._period_s
                # The device goes on with its last force when no new one comes in time.
                with suppress(TimeoutError):
                    while (wait_s := due_s - time.monotonic()) > 0.0:
                        self._take_force(link.recv(timeout=wait_s))

    def _send_state(self, link: "ServerConnection") -> None:
        """Send the state of this cycle, if there is one."""
        sample = self.master.read()
        self.cycles += 1
        if sample is None:
            return

        position = dict(zip(AXES, sample.position_m.tolist(), strict=True))
        velocity = dict(zip(AXES, sample.velocity_m_s.tolist(), strict=True))
        state = {"cursor_position": position, "cursor_velocity": velocity}
        device = {"device_id": "emulated", "state": state}
        link.send(json.dumps({"inverse3": [device]}))

    def _take_force(self, text: str | bytes) -> None:
        """Render the force of a command."""
        commands = json.loads(text)["inverse3"][0]["commands"]
        values = commands["set_cursor_force"]["values"]
        self.master.render([values[axis] for axis in AXES])
