"""To 3D Slicer through OpenIGTLink: the needle's pose, the forces, detected ruptures.

Slicer's OpenIGTLinkIF module connects as a client. Poses are in the model's
coordinates, turned from LPS metres to Slicer's RAS millimetres.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from foundation.extras import install_command
from needleforce.depth_zero import DepthZero, find_depth_zero
from needleforce.needle_on_plan import find_verdict
from needleforce.scene.state_ring import FREE_PORT, Closing, SceneError

PORT = 18944
"""Where Slicer connects, unless another port is given."""

MAX_RATE_HZ = 50.0
"""So many updates are sent a second, at most."""

M_TO_MM = 1e3


def _to_json(values: dict[str, float | str]) -> str:
    """Return numbers as JSON; a NaN becomes null."""
    return msgspec.json.encode(values, enc_hook=float).decode()


class SlicerOutput(Closing):
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
        rupture = estimate.identification.rupture
        if rupture is not None:
            self._send_rupture(rupture, find_depth_zero(estimate))
        # A time before that of the last tick is that of a session which has begun anew.
        if self._next_s - 1.0 / MAX_RATE_HZ <= estimate.time_s < self._next_s:
            return rupture is not None

        self._next_s = estimate.time_s + 1.0 / MAX_RATE_HZ
        self._send_pose(pose_m)
        self._send_forces(estimate)
        if getattr(estimate, "deviation", None) is not None:
            clearances = getattr(estimate, "clearances", ())
            self._send_deviation(estimate.deviation, clearances)
        return True

    def _send_rupture(self, rupture: Any, zero: DepthZero) -> None:
        """Send a detected rupture."""
        values = {
            "layer": rupture.layer,
            "depth_mm": zero.shown_mm(rupture.depth_m),
            "depth_zero": zero.name,
            "probability": rupture.probability,
            "time_s": rupture.time_s,
        }
        self._send(self._igtl.StringMessage(_to_json(values), device_name="Rupture"))

    def _send_pose(self, pose_m: ArrayLike) -> None:
        """Send the needle's pose in the model, shape (4, 4)."""
        # LPS, to the left and the back, becomes RAS, to the right and the front.
        matrix = np.diag([-1.0, -1.0, 1.0, 1.0]) @ np.array(pose_m, dtype=float)
        matrix[:3, 3] *= M_TO_MM
        self._send(self._igtl.TransformMessage(matrix, device_name="NeedleToReference"))

    def _send_forces(self, estimate: Any) -> None:
        """Send the axial force, the tip force and the depth."""
        zero = find_depth_zero(estimate)
        values = {
            "force_N": estimate.wrench.axial,
            "force_std_N": estimate.wrench.axial_std,
            "tip_force_N": estimate.identification.tip_force_N,
            "depth_mm": zero.shown_mm(estimate.depth_m),
            "depth_zero": zero.name,
        }
        self._send(self._igtl.StringMessage(_to_json(values), device_name="Force"))

    def _send_deviation(self, deviation: Any, clearances: Sequence[Any]) -> None:
        """Send the needle against the plan, and the nearest structure at risk."""
        values = {
            "verdict": find_verdict(deviation, clearances),
            "is_off_plan": deviation.is_off_plan,
            "is_past_target": deviation.is_past_target,
            "entry_mm": M_TO_MM * deviation.entry_m,
            "entry_std_mm": M_TO_MM * deviation.entry_std_m,
            "tip_mm": M_TO_MM * deviation.tip_m,
            "tip_std_mm": M_TO_MM * deviation.tip_std_m,
            "angle_deg": math.degrees(deviation.angle_rad),
            "angle_std_deg": math.degrees(deviation.angle_std_rad),
            "depth_below_entry_mm": M_TO_MM * deviation.depth_m,
        }
        if not math.isnan(deviation.to_target_m):
            values["to_target_mm"] = M_TO_MM * deviation.to_target_m
            values["to_target_std_mm"] = M_TO_MM * deviation.to_target_std_m
        for nearest in clearances[:1]:
            values["nearest"] = nearest.name
            values["nearest_mm"] = M_TO_MM * nearest.distance_m
            values["nearest_std_mm"] = M_TO_MM * nearest.std_m
            values["nearest_is_ahead"] = nearest.is_ahead
            values["is_too_near"] = nearest.is_too_near
        self._send(self._igtl.StringMessage(_to_json(values), device_name="Plan"))

    def close(self) -> None:
        """End the connection."""
        self._server.stop()
