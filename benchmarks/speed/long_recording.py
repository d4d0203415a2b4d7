"""Recordings of any length: one cycle of motion, again and again, with fresh noise."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.signals.tool_jacobians import tool_jacobians
from groundtruth import insert_needle
from urdf import NeedleTool, Robot, load_lwr

Columns = dict[str, NDArray[np.float64]]

RATE_HZ = 1000.0
FREE_S = 10.0
"""So long at its start a recording of joint signals is without contact."""

_CYCLE_S = 20.0
_REACH_RAD = 0.05
_PUSH_N = 1.5
_TORQUE_NOISE_NM = 0.01
_FORCE_NOISE_N = 0.003
_WAY_S = 20.0


def joint_recording(seconds: float, rng: np.random.Generator) -> Iterator[Columns]:
    """Joint signals of an LWR that moves, and is pushed once in every cycle.

    Args:
        seconds: Length [s].
        rng: Of the noise.

    Yields:
        Columns of consecutive rows.
    """
    cycle = _joint_cycle(load_lwr(payload=NeedleTool()))
    for columns in _repeated(cycle, seconds):
        torque = columns["tau_Nm"]
        columns["tau_Nm"] = torque + _TORQUE_NOISE_NM * rng.normal(size=torque.shape)
        yield columns


def needle_recording(seconds: float, rng: np.random.Generator) -> Iterator[Columns]:
    """Depth, speed and force of a needle that goes into gel and out, again and again.

    Every cycle is in fresh tissue, whose surface lies as deep as the needle has come before: in
    the channel of an insertion there is nothing left to rupture.

    Args:
        seconds: Length [s].
        rng: Of the noise.

    Yields:
        Columns of consecutive rows.
    """
    run = insert_needle("gel-50-constant", seed=0, rate_hz=RATE_HZ)
    taring = int(np.searchsorted(run.t_s, run.tare_end_s))
    deepest_m = float(run.depth_m.max())
    way_m = deepest_m + float(run.depth_m[taring] - run.depth_m[-1])
    phase = np.arange(1.0, _WAY_S * RATE_HZ) / (_WAY_S * RATE_HZ) * np.pi
    way = run.depth_m[-1] + 0.5 * way_m * (1.0 - np.cos(phase))
    way_speed = 0.5 * way_m * np.pi / _WAY_S * np.sin(phase)
    cycle = {
        "depth_m": np.concatenate((run.depth_m, way)),
        "speed_m_s": np.concatenate((run.speed_m_s, way_speed)),
        "force_N": np.concatenate((run.force_N, np.zeros(len(way)))),
    }
    for number, columns in enumerate(_repeated(cycle, seconds, taring)):
        columns["depth_m"] += number * deepest_m
        force = columns["force_N"]
        columns["force_N"] = force + _FORCE_NOISE_N * rng.normal(size=force.shape)
        yield columns


def _repeated(cycle: Columns, seconds: float, again_from: int = 0) -> Iterator[Columns]:
    """The cycle, and then over and over its rows from `again_from` on."""
    left, done, start = round(seconds * RATE_HZ), 0, 0
    while left > 0:
        columns = {name: values[start : start + left].copy() for name, values in cycle.items()}
        rows = len(next(iter(columns.values())))
        yield {"t_s": np.arange(done, done + rows) / RATE_HZ, **columns}
        left, done, start = left - rows, done + rows, again_from


def _joint_cycle(robot: Robot) -> Columns:
    """Smooth motion that ends as it began, and a push along the needle in its second half."""
    t = np.arange(_CYCLE_S * RATE_HZ) / RATE_HZ
    joints = np.arange(robot.nv)
    pulsation = 2.0 * np.pi / _CYCLE_S * (1.0 + joints % 3)
    phase = np.outer(t, pulsation)
    middle = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0])
    q = np.asarray(middle + _REACH_RAD * np.sin(phase), dtype=np.float64)
    dq = np.asarray(_REACH_RAD * pulsation * np.cos(phase), dtype=np.float64)
    ddq = -_REACH_RAD * pulsation**2 * np.sin(phase)
    push = np.where(t > FREE_S, _PUSH_N * np.sin(np.pi * (t - FREE_S) / FREE_S) ** 2, 0.0)
    data = robot.create_data()
    free = [pin.rnea(robot.model, data, *row) for row in zip(q, dq, ddq, strict=True)]
    # The tissue pushes the tool back along its z axis: torque of the environment.
    external = -push[:, None] * tool_jacobians(robot, q)[:, 2]
    return {"q_rad": q, "dq_rad_s": dq, "tau_Nm": np.array(free) - external}
