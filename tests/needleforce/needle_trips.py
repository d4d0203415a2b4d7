"""Trips of a needle in air and tissue: joint signals of an arm without errors."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from groundtruth import Layer, Stroke, Tissue
from groundtruth.arm_motion import (
    LWR_POSTURE_rad,
    insertion_path,
    needle_down,
    reach_pose,
)
from residual import ToolKinematics
from tests.residual.residual_signals import pose_of
from urdf import Robot, load_lwr

DT_S = 2e-3
RAMP_S = 0.2
NOISE_NM = 0.01


def cruise(duration_s: float, ramp_fraction: float) -> np.ndarray:
    """Return the travelled fraction at each sample of a smooth motion."""
    stroke = Stroke("cruise", 0.0, duration_s, 0.0, 1.0, ramp_fraction)
    count = round(duration_s / DT_S)
    return stroke.evaluate(np.arange(1, count + 1) * duration_s / count)[0]


class Row(NamedTuple):
    """A sample of the arm, and what is true then.

    `depth_m` is below the surface.
    """

    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    depth_m: float
    tip_N: float
    friction_N: float


class Trip:
    """A needle that is moved along its axis, turned and moved aside.

    Depth is counted from the surface of flat tissue across the vertical needle.
    """

    def __init__(self, layers: tuple[Layer, ...], rng: np.random.Generator) -> None:
        self.robot: Robot = load_lwr()
        self.rows: list[Row] = []
        self._rng = rng
        self._q = needle_down(self.robot, np.array(LWR_POSTURE_rad))
        self._dq = np.zeros_like(self._q)
        tool = ToolKinematics(self.robot)
        tool.update(self._q)
        self._surface_m = tool.pose[:3, 3].copy()
        self._axis = tool.axis_in_base.copy()
        self._tool = tool
        self.fresh_tissue(layers)

    @property
    def posture(self) -> np.ndarray:
        """Joint positions now."""
        return self._q

    def fresh_tissue(self, layers: tuple[Layer, ...]) -> None:
        """Put uncut tissue under the needle; without layers none."""
        self._tissue = Tissue(layers)

    def rest(self, seconds: float) -> None:
        """Stay where the needle is."""
        self._follow(np.repeat(self._q[None], round(seconds / DT_S), axis=0))

    def advance(self, travel_m: float, speed_m_s: float) -> None:
        """Move along the needle, backwards for a negative travel."""
        low_m, high_m = sorted((0.0, travel_m))
        path = insertion_path(self.robot, self._q, (low_m, high_m))
        duration_s = abs(travel_m) / speed_m_s + RAMP_S
        travelled = cruise(duration_s, RAMP_S / duration_s)
        self._follow(path.posture_rad(travel_m * travelled))

    def turn_wrist(self, radians: float, seconds: float) -> None:
        """Turn the last joint but one, and with it the needle."""
        turned = self._q.copy()
        turned[5] += radians
        self._go_to(turned, seconds)

    def move_aside(self, aside_m: tuple[float, float], seconds: float) -> None:
        """Move across the needle, without a turn."""
        step = pin.SE3(np.eye(3), np.array([*aside_m, 0.0]))
        target = pose_of(self.robot, self._q) * step
        self._go_to(reach_pose(self.robot, self._q, target), seconds)

    def _go_to(self, posture: np.ndarray, seconds: float) -> None:
        """Move the joints straight to a posture."""
        travelled = cruise(seconds, 0.5)[:, None]
        self._follow(self._q + travelled * (posture - self._q))

    def _follow(self, postures: np.ndarray) -> None:
        """Append the samples of postures that follow each other."""
        model = self.robot.model
        data = self.robot.create_data()
        tool = self._tool
        for q in postures:
            dq = (q - self._q) / DT_S
            ddq = (dq - self._dq) / DT_S
            tool.update(q)
            depth_m = float(self._axis @ (tool.pose[:3, 3] - self._surface_m))
            speed_m_s = float(tool.axial_jacobian @ dq)
            force = self._tissue.step(depth_m, speed_m_s, DT_S)
            tau = pin.rnea(model, data, q, dq, ddq)
            tau = tau + force.axial_N * tool.axial_jacobian
            tau = tau + NOISE_NM * self._rng.normal(size=len(q))
            self.rows.append(Row(q, dq, tau, depth_m, force.tip_N, force.friction_N))
            self._q = q
            self._dq = dq
