"""An arm whose joints follow what they are sent, late; and a needle that turns about an
entry with it."""

from types import SimpleNamespace

import numpy as np

from needleforce.control import Posture, RemoteCentre, TipVelocity, ToolState

DT_s = 1e-3
NO_FAULTS = {
    "refused": (),
    "held_from": np.inf,
    "ends_at": 40_000,
    "lost": 0.0,
    "noise_rad": 0.0,
    "push_rad": 0.0,
}


class LateArm:
    """Joints that integrate velocities, each after a number of cycles.

    Args:
        robot: The model.
        q_rad: Where it begins.
        late_cycles: From a command to the motion.
        dt_s: Time of a cycle.
        is_real: Whether it says so.
        faults: Cycles ``refused``, ``held_from`` and ``ends_at`` which; the fraction of
            samples ``lost``, ``noise_rad`` of positions, and ``push_rad`` by which
            something moves it after 1000 cycles.
    """

    def __init__(
        self, robot, q_rad, late_cycles=0, dt_s=DT_s, *, is_real=False, **faults
    ):
        self.robot = robot
        self.q_rad = np.array(q_rad, dtype=float)
        self.tool = ToolState(robot)
        self.tool.update(self.q_rad)
        self.sent = [np.zeros(robot.nv)]
        self.tips_m = [self.tool.tip_m]
        self.positions_rad = [self.q_rad]
        self._is_real = is_real
        self._faults = SimpleNamespace(**NO_FAULTS | faults)
        self._line = self.sent * late_cycles
        self._dt_s = dt_s

    def sample(self, dt_s=None):
        return SimpleNamespace(
            q_rad=self.q_rad,
            dq_rad_s=None,
            tau_Nm=None,
            dt_s=dt_s or self._dt_s,
            is_real=self._is_real,
        )

    def move(self, dq_rad_s):
        self._line.append(dq_rad_s)
        self.q_rad = self.q_rad + self._dt_s * self._line.pop(0)
        self.tool.update(self.q_rad)
        self.tips_m.append(self.tool.tip_m)
        self.positions_rad.append(self.q_rad)

    def __iter__(self):
        rng = np.random.default_rng(1000)
        faults = self._faults
        since_s = 0.0
        for count in range(faults.ends_at):
            self._is_taken = count not in faults.refused
            since_s += self._dt_s
            if rng.random() >= faults.lost:
                sample = self.sample(since_s)
                noise_rad = faults.noise_rad * rng.standard_normal(self.robot.nv)
                sample.q_rad = self.q_rad + noise_rad + faults.push_rad * (count > 1000)
                yield sample
                since_s = 0.0
            self.move(self.sent[-1] * (self._is_taken and count < faults.held_from))

    def send(self, dq_rad_s):
        self.sent.append(np.array(dq_rad_s))
        return self._is_taken


def follow(controller, arm, tasks, cycles):
    """Return the commands of some cycles with the same tasks."""
    commands = []
    for _ in range(cycles):
        commands.append(controller.update(arm.sample(), tasks))
        arm.move(commands[-1].dq_rad_s)
    return commands


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
        (command,) = follow(controller, arm, tasks, 1)
        error_m = np.linalg.norm(np.cross(arm.tool.axis, entry_m - arm.tool.tip_m))
        tilt_rad = np.arccos(min(arm.tool.axis @ axes[:, 2], 1.0))
        rows.append((error_m, tilt_rad, command.is_limited, command.dq_rad_s))
    names = ("errors_m", "tilts_rad", "is_limited", "dq_rad_s")
    columns = map(np.array, zip(*rows, strict=True))
    return SimpleNamespace(**dict(zip(names, columns, strict=True)))
