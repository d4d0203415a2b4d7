"""To 3D Slicer through OpenIGTLink: the needle's pose, the forces, detected ruptures.

Slicer's OpenIGTLinkIF module connects as a client. Poses are in the model's
coordinates, turned from LPS metres to Slicer's RAS millimetres.
"""

from functools import partial
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from needleforce.scene.state_ring import Closing, SceneError

PORT = 18944
MOST_HZ = 50.0
LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


def _json(values: dict[str, float]) -> str:
    return msgspec.json.encode(values, enc_hook=float).decode()  # a NaN becomes null


class SlicerOutput(Closing):
    """A server that sends at most `MOST_HZ` updates a second; `SceneError` if the port
    is no use.

    Args:
        port: Where Slicer connects.
        any_address: Listen on every address of this machine, not on loopback only.
    """

    def __init__(self, port: int = PORT, *, any_address: bool = False) -> None:
        import pyigtl

        self._igtl: Any = pyigtl
        try:
            self._server = pyigtl.OpenIGTLinkServer(
                port=port, local_server=not any_address
            )
        except (OSError, OverflowError) as error:
            raise SceneError(
                f"port {port}: {error}; expected a free one, 0 to 65535"
            ) from error
        self._send = partial(self._server.send_message, wait=False)
        self._next_s = -np.inf

    @property
    def is_connected(self) -> bool:
        """Whether Slicer listens."""
        return bool(self._server.is_connected())

    def put(self, now: Any, pose_m: ArrayLike) -> bool:
        """Send a tick: the session's estimate, the needle's pose in the model, shape
        (4, 4).

        Ruptures are sent whenever they come. Returns whether anything was sent.
        """
        rupture = now.identification.rupture
        if rupture is not None:
            known = {"layer": rupture.layer, "depth_mm": 1e3 * rupture.depth_m}
            known |= {"probability": rupture.probability, "time_s": rupture.time_s}
            self._send(self._igtl.StringMessage(_json(known), device_name="Rupture"))
        # A time before that of the last tick is that of a session which has begun anew.
        if self._next_s - 1.0 / MOST_HZ <= now.time_s < self._next_s:
            return rupture is not None
        self._next_s = now.time_s + 1.0 / MOST_HZ
        matrix = LPS_TO_RAS @ np.array(pose_m, dtype=float)
        matrix[:3, 3] *= 1e3
        self._send(self._igtl.TransformMessage(matrix, device_name="NeedleToReference"))
        forces = {"force_N": now.wrench.axial, "force_std_N": now.wrench.axial_std}
        forces |= {
            "tip_force_N": now.identification.tip_force_N,
            "depth_mm": 1e3 * now.depth_m,
        }
        self._send(self._igtl.StringMessage(_json(forces), device_name="Force"))
        return True

    def close(self) -> None:
        """End the connection."""
        self._server.stop()
