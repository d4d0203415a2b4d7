"""To 3D Slicer through OpenIGTLink: the needle's pose, the forces, detected ruptures.

Slicer's OpenIGTLinkIF module connects as a client. Poses are in the model's
coordinates, turned from LPS metres to Slicer's RAS millimetres.
"""

from contextlib import AbstractContextManager
from functools import partial
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from foundation.extras import install_command
from needleforce.depth_zero import find_depth_zero
from needleforce.needle_on_plan import state_values
from needleforce.scene.moment import FREE_PORT, SceneError

PORT = 18944
"""Where Slicer connects, unless another port is given."""

MAX_RATE_HZ = 50.0
"""So many updates are sent a second, at most."""


class SlicerOutput(AbstractContextManager[Any]):
    """A server that sends at most `MAX_RATE_HZ` updates a second.

    Args:
        port: Where Slicer connects.
        any_address: Listen on every address of this machine, not on loopback only.

    Raises:
        SceneError: The port cannot be used.
    """

    def __init__(self, port: int = PORT, *, any_address: bool = False) -> None:
        try:
            import pyigtl
        except ImportError as error:
            raise SceneError(
                "pyigtl is not installed", f"Install it: {install_command('slicer')}"
            ) from error

        self._igtl: Any = pyigtl
        try:
            self._server = pyigtl.OpenIGTLinkServer(
                port=port, local_server=not any_address
            )
        except (OSError, OverflowError) as error:
            raise SceneError(
                f"port {port}: {error}; expected a free one, 0 to 65535", FREE_PORT
            ) from error

        self._send = partial(self._server.send_message, wait=False)
        self._next_s = -np.inf

    @property
    def is_connected(self) -> bool:
        """Whether Slicer listens."""
        return bool(self._server.is_connected())

    def put(self, estimate: Any, pose_m: ArrayLike) -> bool:
        """Send a tick, unless the latest one was just before; ruptures are always sent.

        Args:
            estimate: A `SessionEstimate`.
            pose_m: The needle's pose in the model, shape (4, 4).

        Returns:
            Whether anything was sent.
        """
        found = estimate.identification
        zero = find_depth_zero(estimate)
        rupture = found.rupture
        if rupture is not None:
            self._send_text(
                "Rupture",
                {
                    "layer": rupture.layer,
                    "depth_mm": zero.shown_mm(rupture.depth_m),
                    "depth_zero": zero.name,
                    "probability": rupture.probability,
                    "time_s": rupture.time_s,
                },
            )
        # A time before that of the last tick is that of a session which has begun anew.
        if self._next_s - 1.0 / MAX_RATE_HZ <= estimate.time_s < self._next_s:
            return rupture is not None

        self._next_s = estimate.time_s + 1.0 / MAX_RATE_HZ
        # LPS, to the left and the back, becomes RAS, to the right and the front.
        matrix = np.diag([-1.0, -1.0, 1.0, 1.0]) @ np.asarray(pose_m, dtype=float)
        matrix[:3, 3] *= 1e3  # mm
        self._send(self._igtl.TransformMessage(matrix, device_name="NeedleToReference"))
        self._send_text(
            "Force",
            {
                "force_N": estimate.wrench.axial,
                "force_std_N": estimate.wrench.axial_std,
                "tip_force_N": found.tip_force_N,
                "depth_mm": zero.shown_mm(estimate.depth_m),
                "depth_zero": zero.name,
            },
        )
        if estimate.deviation is not None:
            on_plan = state_values(estimate.deviation, estimate.clearances)
            self._send_text("Plan", on_plan)
        return True

    def _send_text(self, name: str, values: dict[str, Any]) -> None:
        """Send values as JSON; a NaN becomes null."""
        text = msgspec.json.encode(values, enc_hook=np.generic.item).decode()
        self._send(self._igtl.StringMessage(text, device_name=name))

    def __exit__(self, *error: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """End the connection."""
        self._server.stop()
