"""The KUKA LWR 4+ of the paper."""

from importlib.resources import as_file, files

from numpy.typing import ArrayLike

from urdf.assembly import STANDARD_GRAVITY_M_S2
from urdf.loading import load_urdf
from urdf.needle_tool import NeedleTool
from urdf.payload import Payload
from urdf.robot import Robot

LWR_GEAR_RATIO = (160.0, 160.0, 160.0, 160.0, 100.0, 100.0, 100.0)
"""Harmonic drives of the LWR 4+, joints 1 to 7 (sources give 60 or 160 for joint 4); the torque
sensors ripple with the motor angle."""


def load_lwr(
    payload: Payload | NeedleTool | None = None,
    *,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
) -> Robot:
    """Load the KUKA LWR 4+ that ships with the package.

    Joints ``lwr_joint_1`` to ``lwr_joint_7`` in the order of KUKA's interface (A1, A2, E1, A3, A4,
    A5, A6), zero when the arm points straight up. The frame ``flange`` lies in the flange's face, z
    outward.

    Args:
        payload: A body in the flange frame; or a needle tool, which adds the frames ``ft_sensor``
            and ``needle_tip`` (z in the direction of insertion) and makes ``needle_tip`` the tool
            frame. Without one the tool frame is ``flange``.
        gravity_m_s2: Gravity in base axes, shape (3,), m/s^2.

    Raises:
        InputError: Payload or gravity of the wrong kind.
    """
    with as_file(files("urdf.data").joinpath("lwr4plus.urdf")) as path:
        return load_urdf(path, tool_frame="flange", payload=payload, gravity_m_s2=gravity_m_s2)
