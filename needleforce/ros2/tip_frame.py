"""Where the needle's tip is in TF: a transform from a link of the description."""

from typing import Any, NamedTuple

import pinocchio as pin

from needleforce.ros2.messages import fill_stamp, fill_vector
from needleforce.ros2.ros_modules import RosModules
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
    is_link = [each.type == pin.FrameType.BODY for each in frames]
    if frame in (each.name for each, link in zip(frames, is_link, strict=True) if link):
        return None
    tip = frames[robot.tool_frame_id]
    index = robot.tool_frame_id
    while not is_link[index]:
        if frames[index].type == pin.FrameType.JOINT:
            # What moves with a joint is the link behind it.
            index = next(
                k
                for k, each in enumerate(frames)
                if is_link[k] and each.parentFrame == index
            )
        else:
            index = frames[index].parentFrame
    parent = frames[index]
    return TipPlacement(parent.name, parent.placement.actInv(tip.placement))


def tip_transforms(ros: RosModules, tip: TipPlacement, frame: str, now_ns: int) -> Any:
    """Return the transform to the tip as a `tf2_msgs/TFMessage`.

    Args:
        ros: The modules of ROS 2.
        tip: Where the tip is.
        frame: Its name in TF.
        now_ns: Of the header [ns].
    """
    message = ros.geometry.TransformStamped()
    fill_stamp(message, now_ns)
    message.header.frame_id = tip.parent
    message.child_frame_id = frame
    fill_vector(message.transform.translation, tip.placement.translation)
    turn = pin.Quaternion(tip.placement.rotation)
    rotation = message.transform.rotation
    rotation.x, rotation.y, rotation.z, rotation.w = turn.x, turn.y, turn.z, turn.w
    return ros.transforms.TFMessage(transforms=[message])
