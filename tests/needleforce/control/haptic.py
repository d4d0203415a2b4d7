"""What a session estimates of a needle that a hand drives; what the handle sends."""

from types import SimpleNamespace

import numpy as np

from needleforce.control import HandleWatch, Teleoperation
from residual import Status

DT = 1e-3


def estimate(
    axial_N=0.0,
    tip_N=None,
    depth_m=0.0,
    speed_m_s=0.0,
    status=Status.OK,
    rupture=None,
    stiffness=0.0,
):
    tip_N = axial_N if tip_N is None else tip_N
    identification = SimpleNamespace(
        tip_force_N=tip_N,
        enhanced_force_N=0.5 * (tip_N + axial_N),
        rupture=rupture,
        provisional=None,
        stiffness_N_per_m=stiffness,
    )
    return SimpleNamespace(
        wrench=SimpleNamespace(axial_unsmoothed=axial_N),
        identification=identification,
        depth_m=depth_m,
        speed_m_s=speed_m_s,
        status=status,
    )


def handle(z_m=0.0, speed_m_s=0.0, clutch=True, **changes):
    """Return a sample of a handle that moves along z; ``changes`` of its fields."""
    sample = {
        "position_m": np.array((0.0, 0.0, z_m)),
        "velocity_m_s": np.array((0.0, 0.0, speed_m_s)),
        "clutch": clutch,
    }
    return SimpleNamespace(**sample | changes)


def teleoperate(**settings):
    """Return a teleoperation with a watch of its handle."""
    tele = Teleoperation(**settings)
    tele.watch = HandleWatch()
    return tele


def answer(tele, sample, session_estimate, dt_s=DT):
    """Return the teleoperation's command for a sample of the handle."""
    return tele.update(tele.watch.update(sample, dt_s), session_estimate, dt_s)


class Needle:
    """A needle that follows its commands late.

    Attributes:
        depth_m: Its depth.
        speed_m_s: Its speed.
    """

    def __init__(self):
        self.depth_m = 0.0
        self.speed_m_s = 0.0

    def follow(self, command):
        """Move for a tick; the arm's servo is 5 ms late."""
        self.speed_m_s += (command.speed_m_s - self.speed_m_s) / 6.0
        self.depth_m += self.speed_m_s * DT


def no_force(depth_m, speed_m_s):
    return 0.0


def push(force_N):
    """Return a force that is always the same."""
    return lambda depth_m, speed_m_s: force_N


def track(tele, samples, force_at=no_force, needle=None, device=None, **how):
    """Let a needle follow samples of the handle; ``device`` shows its force.

    Returns for every tick its depth [m], the commanded speed [m/s], the force on the
    hand and the one that is to be shown [N], and why the needle stands.
    """
    needle = needle or Needle()
    rows = []
    for sample in samples:
        motion = {"depth_m": needle.depth_m, "speed_m_s": needle.speed_m_s}
        known = estimate(force_at(**motion), **motion | how)
        move = answer(tele, sample, known)
        if device is not None:
            device.render(move.force_N)
        needle.follow(move)
        felt_N = move.force_N[2]
        rows.append((needle.depth_m, move.speed_m_s, felt_N, tele.shown_N, move.reason))
    return tuple(map(np.array, zip(*rows, strict=True)))
