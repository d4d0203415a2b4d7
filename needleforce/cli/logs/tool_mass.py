"""The tool mass that a recording states beside the one of the robot's model."""

import pinocchio as pin

from needleforce.recordings.table import ToolMass
from urdf import Robot


def model_tool_mass_kg(robot: Robot) -> float:
    """Return the mass behind the last joint's own link: hand, tool and payload [kg]."""
    model = robot.bare_model
    joint = model.frames[model.getFrameId(robot.flange_frame)].parentJoint
    hand_kg = sum(
        frame.inertia.mass
        for frame in model.frames
        if frame.type == pin.FrameType.FIXED_JOINT and frame.parentJoint == joint
    )
    payload_kg = robot.payload.mass_kg if robot.payload is not None else 0.0
    return float(hand_kg) + payload_kg


def tool_mass_warnings(stated: ToolMass | None, robot: Robot) -> tuple[str, ...]:
    """Return a warning if a recording states another mass on the flange than the model.

    Args:
        stated: What the recording says; None if it does not.
        robot: The robot with its payload.
    """
    max_difference_kg = 0.05  # A smaller difference makes less than half a newton
    if stated is None:
        return ()
    model_kg = model_tool_mass_kg(robot)
    if abs(stated.mass_kg - model_kg) <= max_difference_kg:
        return ()
    return (
        f"the recording says that {stated.mass_kg:.3g} kg hang on the flange "
        f"({stated.source}), the model has {model_kg:.3g} kg there, hand and payload "
        "together: correct --payload FILE, or leave links out with --without LINK, "
        "unless the robot was set wrongly",
    )
