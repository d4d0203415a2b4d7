"""The links of an arm, and its description, for bags that show it."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from needleforce.cli.robot import urdf_with_shapes
from needleforce.cli.shared_options import RobotOptions
from needleforce.recordings.table import LinkTransforms
from urdf import Robot


@dataclass(frozen=True, slots=True)
class ArmFrames:
    """Where the links and the tool frame of an arm are; called with joint positions.

    Attributes:
        robot: The arm.
    """

    robot: Robot

    def __call__(self, q_rad: np.ndarray) -> LinkTransforms:
        """Return the poses in the axes of the root link.

        Args:
            q_rad: Joint positions [rad or m], shape (n,).
        """
        model = self.robot.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, q_rad)
        poses = {
            frame.name: data.oMf[index]
            for index, frame in enumerate(model.frames)
            if frame.type == pin.BODY or index == self.robot.tool_frame_id
        }
        # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
        root = self.robot.frame_names[1]
        poses = {name: poses[name] for name in poses if name not in (root, "universe")}
        return LinkTransforms(
            parent=root,
            children=tuple(poses),
            translation_m=np.array([pose.translation for pose in poses.values()]),
            rotation_xyzw=np.array(
                [pin.Quaternion(pose.rotation).coeffs() for pose in poses.values()]
            ),
        )


def read_description(options: RobotOptions) -> str:
    """Return the text of the URDF that options name; empty if it cannot be read.

    Args:
        options: Options that describe the robot.
    """
    try:
        return urdf_with_shapes(options).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
