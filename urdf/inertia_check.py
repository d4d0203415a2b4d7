"""What is wrong with the inertia of a robot's links, as far as it can matter.

A link that is fixed to the ground never moves and is not looked at. Links that are
fixed to each other move as one body, and only what they have together enters a torque.
Inertia that no body can have changes no torque at rest; while joints accelerate it
does, by that part of a moment which cannot be, v, times the acceleration:

    v = max(-J_1, J_3 - J_1 - J_2),   J_1 <= J_2 <= J_3 the principal moments.

A small v is one warning for the whole robot; a large one is refused, and so is a link
that moves without inertia, whose weight would be missing.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from urdf.errors import GIVE_INERTIA, InertiaError
from urdf.payload import MAX_PARAMETER, rounding_of
from urdf.robot import Robot

TOLERATED_RATIO = 0.05
"""The same, relative to the largest moment of the body, or to the largest that a joint
of the arm turns: no description is known more exactly."""

LEVER_M = 0.1
"""Lever at which the warning gives the effect on the force."""


class BodyFault(NamedTuple):
    """Why no rigid body has the inertia of a link.

    Attributes:
        text: What is wrong, in words.
        moment_kg_m2: The part of a moment that cannot be; infinite for other faults.
        largest_kg_m2: The largest principal moment.
    """

    text: str
    moment_kg_m2: float
    largest_kg_m2: float

    def is_large(self, limit_kg_m2: float) -> bool:
        """Return whether it is more than rounding, a few percent, and a limit."""
        # A part of a moment that cannot be, below this, is the rounding of a written
        # table.
        rounding_kg_m2 = 1e-6
        own_limit_kg_m2 = TOLERATED_RATIO * self.largest_kg_m2
        return self.moment_kg_m2 > max(rounding_kg_m2, own_limit_kg_m2, limit_kg_m2)


@dataclass(slots=True)
class InertiaFindings:
    """What is wrong with the inertia of a robot's moving links.

    Attributes:
        refused: Links that no rigid body can be, with the reason.
        tolerated: Links that miss being one by little.
        missing: Links that move without inertia, each with its joint.
        moment_kg_m2: The largest part of a tolerated moment that cannot be.
    """

    refused: list[str] = field(default_factory=list)
    tolerated: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    moment_kg_m2: float = 0.0

    def add(self, name: str, fault: BodyFault, *, is_refused: bool) -> None:
        """Add what is wrong with a link."""
        if is_refused:
            self.refused.append(f"link {name!r}: {fault.text}")
        else:
            self.tolerated.append(name)
            self.moment_kg_m2 = max(self.moment_kg_m2, fault.moment_kg_m2)

    def reasons(self) -> str:
        """Return in words what is refused; empty if nothing is."""
        reasons = list(self.refused)
        if self.missing:
            reasons.append(f"moving links without inertia: {', '.join(self.missing)}")
        return "; ".join(reasons)

    def warning(self) -> str:
        """Return what is odd and what it does to the force; empty if nothing is."""
        effects: list[str] = []
        if self.tolerated:
            moment = self.moment_kg_m2
            effects.append(
                f"no rigid body has the inertia of {', '.join(self.tolerated)}, by up "
                f"to {moment:.2g} kg m^2: no effect on the force at rest; while a "
                f"joint accelerates by 1 rad/s^2, up to {moment:.2g} Nm or "
                f"{moment / LEVER_M:.2g} N on a lever of {LEVER_M:g} m"
            )
        if self.refused:
            effects.append(
                f"inertia accepted that no rigid body has ({'; '.join(self.refused)}): "
                "what it adds to gravity and acceleration is in the force"
            )
        if self.missing:
            effects.append(
                f"accepted without inertia: {', '.join(self.missing)}; their weight is "
                "in the force, but for what the tare removes"
            )
        return "; ".join(effects)


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
    findings = find_inertia_faults(robot, bodies)
    reasons = findings.reasons()
    has_inertia = len(findings.missing) < robot.nv
    if reasons and not (accept and has_inertia):
        advice = GIVE_INERTIA if findings.missing else ""
        raise InertiaError(f"{source}: {reasons}", advice)
    warning = findings.warning()
    return f"{source}: {warning}" if warning else ""


def find_inertia_faults(robot: Robot, bodies: Mapping[str, Array]) -> InertiaFindings:
    """Return what is wrong with the inertia of a robot's moving links."""
    findings = InertiaFindings()
    limit_kg_m2 = TOLERATED_RATIO * _largest_turned(robot)
    model = robot.model
    for joint in range(1, model.njoints):
        links = _links_moved_by(model, joint)
        described = [name for name in links if name in bodies]
        if not described and model.inertias[joint].mass == 0.0:
            findings.missing.append(f"{links[0]} (joint {model.names[joint]})")
        whole = _fault_together(robot.bare_model.inertias[joint])
        is_body = whole is not None and not whole.is_large(limit_kg_m2)
        is_turned = _is_turned(model, joint)
        for name in described:
            fault = fault_of(bodies[name])
            if fault is None or not (is_turned or np.isinf(fault.moment_kg_m2)):
                continue
            is_refused = np.isinf(fault.moment_kg_m2) or not is_body
            is_refused = is_refused and fault.is_large(limit_kg_m2)
            findings.add(name, fault, is_refused=bool(is_refused))
    return findings


def fault_of(parameters: Array) -> BodyFault | None:
    """Return why no rigid body has ten parameters, shape (10,); None if one has.

    Rounding of the written table is no fault.
    """
    # Below this, a milligram at a millimetre, it is the rounding of a computation.
    negligible_kg_m2 = 1e-12
    if not np.all(np.abs(parameters) <= MAX_PARAMETER):
        text = f"a number above {MAX_PARAMETER:g} in SI units"
        return BodyFault(text, np.inf, 0.0)
    mass_kg = float(parameters[0])
    if mass_kg <= 0.0:
        text = f"mass is {mass_kg:g} kg, expected a positive mass"
        return BodyFault(text, np.inf, 0.0)
    inertia = pin.Inertia.FromDynamicParameters(parameters)
    moments = np.linalg.eigvalsh(inertia.inertia)
    largest_kg_m2 = float(moments[2])
    excess_kg_m2 = largest_kg_m2 - float(moments[0] + moments[1])
    shown = ", ".join(f"{moment:.4g}" for moment in moments)
    slack_kg_m2 = max(negligible_kg_m2, rounding_of(parameters, largest_kg_m2))
    if moments[0] < -slack_kg_m2:
        impossible_kg_m2 = max(-float(moments[0]), excess_kg_m2)
        text = f"principal moments {shown} kg m^2 are not positive definite"
        return BodyFault(text, impossible_kg_m2, largest_kg_m2)
    if excess_kg_m2 > slack_kg_m2:
        text = (
            f"principal moments {shown} kg m^2 break the triangle inequality by "
            f"{excess_kg_m2:.2g}"
        )
        return BodyFault(text, excess_kg_m2, largest_kg_m2)
    return None


def _fault_together(inertia: pin.Inertia) -> BodyFault | None:
    """Return what is wrong with all links of a joint together; None without mass."""
    no_fault = BodyFault("", 0.0, 0.0)  # a rigid body can have the inertia
    if inertia.mass == 0.0:
        return None
    return fault_of(inertia.toDynamicParameters()) or no_fault


def _links_moved_by(model: pin.Model, joint: int) -> list[str]:
    """Return the links that move as one with a joint, its own first."""
    return [
        frame.name
        for frame in model.frames
        if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
    ]


def _is_turned(model: pin.Model, joint: int) -> bool:
    """Return whether a joint's links can turn: moments of what slides do not matter."""
    carriers = list(model.supports[joint])[1:]  # without the ground
    return any(_is_turning(model.joints[carrier]) for carrier in carriers)


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
