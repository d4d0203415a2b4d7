"""Whether torques that jump do so as a force on the tool makes them."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from urdf import Robot

MOST_STEP_N = 100.0
"""A force that may come or go within one sample: a rupture is newtons, a stiff contact tens."""
MOST_UNEXPLAINED = 0.35
"""Share of the jump that the force may leave over; a spike of one joint leaves most of itself."""


class ContactStep:
    """Tells a contact, felt by all joints according to their levers, from a spike of a sensor.

    Args:
        robot: The arm; forces act on its tool frame.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._data = robot.model, robot.create_data()
        self._frame_id = robot.tool_frame_id

    def explains(
        self, q: NDArray[np.float64], jump: NDArray[np.float64], scale: NDArray[np.float64]
    ) -> bool:
        """Whether a believable force explains a jump of the torques.

        Args:
            q: Configuration [rad], shape (n,).
            jump: Of the torques [Nm], shape (n,).
            scale: Jump that each joint is believed without a reason [Nm], shape (n,).
        """
        axes = pin.ReferenceFrame.LOCAL
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._frame_id, axes)[:3]
        levers, wanted = jacobian.T / scale[:, None], jump / scale
        force = np.linalg.lstsq(levers, wanted, rcond=None)[0]
        left = wanted - levers.dot(force)
        is_explained = left.dot(left) <= MOST_UNEXPLAINED**2 * wanted.dot(wanted)
        return bool(is_explained and force.dot(force) <= MOST_STEP_N**2)
