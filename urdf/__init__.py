"""The robot: an arm as a Pinocchio model, with a tool and a payload.

The arm is the LWR 4+, any URDF, or any Pinocchio model of one-number joints.

Conventions: SI units; joint vectors in the order of ``Robot.joint_names``; a payload is
given in the axes of the robot's flange frame, whose z points outward; gravity in base
axes.

Reading order: `robot` (what the estimators get), `loading` with `description` and
`joint_choice` (from a file to a robot), `payload` (with the ten numbers of a body),
`payload_identification`.
"""

from urdf.errors import (
    InertiaError,
    InputError,
    MissingPackageError,
    UnknownNameError,
    UnsupportedJointError,
    UrdfError,
    UrdfFileError,
)
from urdf.joint_choice import joints_towards, movable_joints
from urdf.loading import (
    LWR_GEAR_RATIO,
    example_robot_path,
    load_example,
    load_lwr,
    load_urdf,
)
from urdf.payload import NeedleTool, Payload
from urdf.payload_identification import PayloadEstimate, identify_payload_static
from urdf.robot import Robot, build_robot

__all__ = [
    "LWR_GEAR_RATIO",
    "InertiaError",
    "InputError",
    "MissingPackageError",
    "NeedleTool",
    "Payload",
    "PayloadEstimate",
    "Robot",
    "UnknownNameError",
    "UnsupportedJointError",
    "UrdfError",
    "UrdfFileError",
    "build_robot",
    "example_robot_path",
    "identify_payload_static",
    "joints_towards",
    "load_example",
    "load_lwr",
    "load_urdf",
    "movable_joints",
]
