"""What is wrong with the inertia of a robot's links, as far as it can matter.

A link that is fixed to the ground never moves and is not looked at. Links that are
fixed to each other move as one body, and only what they have together enters a torque.
Inertia that no body can have changes no torque at rest; while joints accelerate it
does, by the `urdf.payload.impossible_moment` times the acceleration. A small one is one
warning for the whole robot; a large one is refused, and so is a link that moves without
inertia, whose weight would be missing.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from urdf.errors import GIVE_INERTIA, InertiaError
from urdf.payload import impossible_moment, principal_moments
from urdf.robot import Robot


def check_inertia(
    robot: Robot, bodies: Mapping[str, Array], source: str, *, accept: bool
) -> str:
    """Refuse inertia that matters and is missing or cannot be.

    Args:
        robot: The robot.
        bodies: The ten parameters of its links that move, by name.
        source: Name of the description, for messages.
        accept: Whether to warn instead of refusing.

    Returns:
        One warning for the whole robot; empty if nothing is odd.

    Raises:
        InertiaError: All links that are refused; with ``accept`` only if no moving link
            has inertia.
    """
    refused: list[str] = []
    tolerated: list[str] = []
    missing: list[str] = []
    for joint in range(1, robot.model.njoints):
        links = _links_moved_by(robot, joint)
        described = [name for name in links if name in bodies]
        if not described and robot.model.inertias[joint].mass == 0.0:
            missing.append(f"{links[0]} (joint {robot.model.names[joint]})")
        for name, is_refused in _find_odd(robot, joint, bodies, described).items():
            (refused if is_refused else tolerated).append(name)
    impossible = ", ".join(f"{name} ({_describe(bodies[name])})" for name in refused)
    if (refused or missing) and not (accept and len(missing) < robot.nv):
        raise InertiaError(
            f"{source}: no rigid body has the inertia of {impossible or 'none'}; "
            f"moving links without inertia: {', '.join(missing) or 'none'}",
            GIVE_INERTIA if missing else "",
        )
    warnings: list[str] = []
    if refused:
        warnings.append(f"accepted that no rigid body has the inertia of {impossible}")
    if missing:
        warnings.append(
            f"accepted without inertia: {', '.join(missing)}; their weight is in the "
            "force, but for what the tare removes"
        )
    if tolerated:
        moment_kg_m2 = max(impossible_moment(bodies[name]) for name in tolerated)
        warnings.append(
            f"no rigid body has the inertia of {', '.join(tolerated)}: no effect at "
            f"rest, up to {moment_kg_m2:.2g} Nm at 1 rad/s^2 of a joint"
        )
    return f"{source}: {'; '.join(warnings)}" if warnings else ""


def _links_moved_by(robot: Robot, joint: int) -> list[str]:
    """Return the links that move as one with a joint, its own first."""
    return [
        frame.name
        for frame in robot.model.frames
        if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
    ]


def _find_odd(
    robot: Robot, joint: int, bodies: Mapping[str, Array], names: Sequence[str]
) -> dict[str, bool]:
    """Return which links of a joint no body can be, and whether that is too much.

    Moments of what slides do not matter, and neither does how links that are fixed to
    each other share what they have together.
    """
    model = robot.model
    together = robot.bare_model.inertias[joint].toDynamicParameters()
    turned_kg_m2 = _largest_turned(robot)
    carriers = list(model.supports[joint])[1:]  # without the ground
    is_turned = any(_is_turning(model.joints[carrier]) for carrier in carriers)
    is_body = not _is_large(together, turned_kg_m2)
    odd: dict[str, bool] = {}
    for name in names:
        moment_kg_m2 = impossible_moment(bodies[name])
        is_none = bool(np.isinf(moment_kg_m2))
        if is_none or (moment_kg_m2 > 0.0 and is_turned):
            odd[name] = is_none or (
                not is_body and _is_large(bodies[name], turned_kg_m2)
            )
    return odd


def _is_large(parameters: Array, turned_kg_m2: float) -> bool:
    """Return whether no body has ten parameters, by more than is tolerated.

    The largest moment that a joint turns is given: neither that nor the body's own is
    known better than to 5 %.
    """
    moment_kg_m2 = impossible_moment(parameters)
    if moment_kg_m2 in (0.0, np.inf):
        return moment_kg_m2 > 0.0
    largest_kg_m2 = max(float(principal_moments(parameters)[2]), turned_kg_m2)
    # A milligram at a metre is the rounding of a written table.
    return moment_kg_m2 > max(1e-6, 0.05 * largest_kg_m2)


def _describe(parameters: Array) -> str:
    """Return mass and principal moments of a body in words."""
    if not np.isfinite(parameters).all() or parameters[0] <= 0.0:
        return f"mass {parameters[0]:g} kg"
    shown = ", ".join(f"{moment:.4g}" for moment in principal_moments(parameters))
    return f"mass {parameters[0]:g} kg, principal moments {shown} kg m^2"


def _is_turning(joint: pin.JointModel) -> bool:
    return joint.shortname().startswith("JointModelR")


def _largest_turned(robot: Robot) -> float:
    """Return the largest moment of inertia that a joint turns, at neutral [kg m^2]."""
    model = robot.model
    mass_matrix = pin.crba(model, robot.create_data(), pin.neutral(model))
    turned = [
        mass_matrix[joint.idx_v, joint.idx_v]
        for joint in list(model.joints)[1:]
        if _is_turning(joint)
    ]
    return max(turned, default=0.0)
