"""The true masses of the simulated arm: what the estimator believes, bent by an arm level."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from groundtruth.arm_level import ArmLevel
from groundtruth.link_tables import blend_link_parameters, cad_link_parameters
from urdf import NeedleTool, Payload, Robot, load_lwr


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantBodies:
    """Kinematics and true inertias of arm, F/T sensor and needle."""

    robot: Robot
    """The estimator's robot: kinematics and frames are shared, its inertias are not used here."""

    links: tuple[pin.Inertia, ...]
    """Bare links 1..7, each in its joint frame."""

    sensor: pin.Inertia
    """The tool up to the sensor's measuring plane, in the flange frame."""

    needle: pin.Inertia
    """Everything beyond the measuring plane, in the ``ft_sensor`` frame."""

    def model(self) -> pin.Model:
        """Build a Pinocchio model of the true arm (for feed-forward and for checks).

        Returns:
            The robot's model with every joint's inertia replaced by the true one.
        """
        model = self.robot.model.copy()
        for joint, link in enumerate(self.links, start=1):
            model.inertias[joint] = link
        last = len(self.links)
        model.inertias[last] = (
            self.links[-1]
            + _placement(self.robot, self.robot.flange_frame).act(self.sensor)
            + _placement(self.robot, "ft_sensor").act(self.needle)
        )
        return model


def lwr_bodies(tool: NeedleTool, level: ArmLevel, rng: np.random.Generator) -> PlantBodies:
    """Draw the true LWR 4+ with its needle for one seed.

    Args:
        tool: The tool as the estimator knows it.
        level: How far the truth is from that.
        rng: Source of the payload error.

    Returns:
        The bodies; with a level without model error, exactly the estimator's.
    """
    robot = load_lwr(payload=tool)
    bare = robot.bare_model
    nominal = np.array([bare.inertias[joint].toDynamicParameters() for joint in range(1, 8)])
    links = blend_link_parameters(nominal, cad_link_parameters(), level.cad_share)
    mass_factor = 1.0 + level.payload_error * rng.choice((-1.0, 1.0))
    com_shift_m = level.payload_com_spread_m * rng.standard_normal(3)
    return PlantBodies(
        robot=robot,
        links=tuple(pin.Inertia.FromDynamicParameters(row) for row in links),
        sensor=_bent(tool.sensor, mass_factor, com_shift_m),
        needle=_bent(tool.beyond_sensor, mass_factor, com_shift_m),
    )


def _bent(part: Payload, mass_factor: float, com_shift_m: np.ndarray) -> pin.Inertia:
    return pin.Inertia(
        part.mass_kg * mass_factor,
        part.com_m + com_shift_m,
        part.inertia_kg_m2 * mass_factor,
    )


def _placement(robot: Robot, frame: str) -> pin.SE3:
    return robot.model.frames[robot.frame_id(frame)].placement
