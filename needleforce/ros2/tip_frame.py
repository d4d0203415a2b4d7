"""Where the needle's tip is in TF: a transform from a link of the description."""

from typing import NamedTuple

import pinocchio as pin

from urdf import Robot


class TipPlacement(NamedTuple):
    """Where the tip is on a link.

    Attributes:
        parent: The link, which robot_state_publisher has in TF.
        placement: Of the tip, in the axes of the link.
    """

    parent: str
    placement: pin.SE3


def place_tip(robot: Robot, frame: str) -> TipPlacement | None:
    """Return where the tip is; None if its frame is a link and so in TF already.

    Args:
        robot: The arm, whose tool frame is the tip.
        frame: The tip's name in TF.
    """
    frames = list(robot.model.frames)
    links = [each for each in frames if each.type == pin.FrameType.BODY]
    if frame in (link.name for link in links):
        return None
    tip = frames[robot.tool_frame_id]
    carrier = tip
    while carrier.type not in (pin.FrameType.BODY, pin.FrameType.JOINT):
        carrier = frames[carrier.parentFrame]
    if carrier.type == pin.FrameType.JOINT:
        # What moves with a joint is the link behind it.
        index = frames.index(carrier)
        carrier = next(link for link in links if link.parentFrame == index)
    return TipPlacement(carrier.name, carrier.placement.actInv(tip.placement))
