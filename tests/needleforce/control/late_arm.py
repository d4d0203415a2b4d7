"""An arm whose joints follow what they are sent, late; and a needle that turns about an
entry with it."""

from types import SimpleNamespace

import numpy as np

from needleforce.control import Posture, RemoteCentre, TipVelocity
from needleforce.control.tasks import ToolState

DT_s = 1e-3


class LateArm:
    """Joints that integrate velocities, each after a number of cycles.

    Args:
        robot: The model.
        q_rad: Where it begins.
        late_cycles: From a command to the motion.
        dt_s: Time of a cycle.
    """

    def __init__(self, robot, q_rad, late_cycles=0, dt_s=DT_s):
        self.q_rad = np.array(q_rad, dtype=float)
        self.tool = ToolState(robot)
        self.tool.update(self.q_rad)
        self._line = [np.zeros(robot.nv)] * late_cycles
        self._dt_s = dt_s

    def sample(self, dt_s=None):
        return SimpleNamespace(
            q_rad=self.q_rad, dq_rad_s=None, tau_Nm=None, dt_s=dt_s or self._dt_s
        )

    def move(self, dq_rad_s):
        self._line.append(dq_rad_s)
        self.q_rad = self.q_rad + self._dt_s * self._line.pop(0)
        self.tool.update(self.q_rad)


def smooth(part):
    """Return a course from 0 to 1 that begins and ends at rest."""
    part = min(part, 1.0)
    return part**2 * (3.0 - 2.0 * part)


def turn_about_entry(controller, arm, tilt_at, *, cycles, depth_m, gain_per_s=30.0):
    """Turn the needle about an entry so far behind its tip.

    ``tilt_at`` returns two angles for a cycle: of the needle, and of its direction.
    Returns for every cycle the error of the axis at the entry [m], the tilt [rad], the
    positions and the commands.
    """
    axes = arm.tool.rotation
    entry_m = arm.tool.tip_m - depth_m * arm.tool.axis
    tip = TipVelocity((0.0, 0.0, 0.0), arm.tool.tip_m, gain_per_s=10.0)
    tasks = [RemoteCentre(entry_m, gain_per_s), tip, Posture(arm.q_rad)]
    rows = []
    for k in range(cycles):
        tilt, turn = tilt_at(k)
        aside = np.sin(tilt) * np.array((np.cos(turn), np.sin(turn)))
        tip.goal_m = entry_m + depth_m * axes @ (*aside, np.cos(tilt))
        command = controller.update(arm.sample(), tasks)
        arm.move(command.dq_rad_s)
        error_m = np.linalg.norm(np.cross(arm.tool.axis, entry_m - arm.tool.tip_m))
        tilt_rad = np.arccos(min(arm.tool.axis @ axes[:, 2], 1.0))
        rows.append((error_m, tilt_rad, arm.q_rad, command))
    errors_m, tilts_rad, positions_rad, commands = zip(*rows, strict=True)
    return SimpleNamespace(
        errors_m=np.array(errors_m),
        tilts_rad=np.array(tilts_rad),
        positions_rad=np.array(positions_rad),
        dq_rad_s=np.array([command.dq_rad_s for command in commands]),
        is_limited=np.array([command.is_limited for command in commands]),
    )
