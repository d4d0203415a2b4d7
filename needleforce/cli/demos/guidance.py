"""A hand pushes the hub aside with a growing force and lets go; the arm yields."""

import math

import numpy as np

from foundation.arrays import Array
from groundtruth.rig_arm import ArmSample, SimulatedArm
from groundtruth.rig_contacts import HandOnArm
from needleforce import control
from needleforce.cli.demos.result_page import (
    DemoResult,
    NamedChart,
    panel_over_time,
)
from needleforce.cli.shared_options import Direction
from needleforce.cli.terminal import Progress
from needleforce.control import AxialSpeed, Controller, Fixture, Limits, Task
from needleforce.plots import Chart, palette
from residual import SensorConfig, Status, VirtualForceSensor

TARE_S = 4.0
"""Time of the free stroke before the tare [s]."""

STROKE_SPEED_M_S = 0.02
"""Largest speed of that stroke, there and back [m/s]."""

PUSH_S = 5.0
"""When the push begins [s]."""

PUSH_END_S = 7.0
"""When the hand lets go [s]."""

PUSH_N = 2.0
"""Force of the push when the hand lets go [N]."""

GUIDED_S = 10.0
"""When the demonstration ends [s]."""

GAIN_PER_S = 20.0
"""Gain that holds the needle's line before the tare [1/s]."""

YIELDED_MM = 0.5
"""Motion from which on the arm has yielded [mm]."""

REST_S = 1.0
"""Time after the push from which on the arm should rest [s]."""

TICKS_BEFORE_PUSH = 500
"""Ticks of 1 ms before the push that are drawn."""

S_TO_TICKS = 1e3
M_TO_MM = 1e3


def push_force_N(t_s: float) -> Direction:
    """Return the force of the hand after a time [s], which grows evenly [N]."""
    if not PUSH_S <= t_s < PUSH_END_S:
        return (0.0, 0.0, 0.0)
    return (PUSH_N * (t_s - PUSH_S) / (PUSH_END_S - PUSH_S), 0.0, 0.0)


class _GuidedArm:
    """Tare over a free stroke, then guidance by the residual."""

    def __init__(self, arm: SimulatedArm) -> None:
        self._arm = arm
        self._sensor = VirtualForceSensor(
            arm.robot, SensorConfig(smooth_momentum=False)
        )
        self._controller = Controller(arm.robot, Limits(arm.robot))
        self._controller.tool.update(arm.home_rad)
        self._guidance = control.Guidance(arm.robot)
        self._shaft = Fixture.here(self._controller.tool, GAIN_PER_S)

    def update(self, sample: ArmSample) -> None:
        """Move the arm by one tick."""
        tasks = self._tasks(sample)
        self._arm.send(self._controller.update(sample, tasks).dq_rad_s)

    def _tasks(self, sample: ArmSample) -> list[Task]:
        sensor = self._sensor
        wrench = sensor.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        if sensor.tared:
            is_valid = wrench.status is Status.OK
            std_Nm = sensor.residual_std_Nm
            return [
                self._guidance.update(
                    wrench.residual, std_Nm, sample.dt_s, is_valid=is_valid
                )
            ]
        time_s = self._arm.time_s
        speed_m_s = STROKE_SPEED_M_S * math.sin(math.pi * time_s / 2.0)
        if time_s > TARE_S:
            sensor.tare()
        return [self._shaft, AxialSpeed(speed_m_s)]


def guide_by_hand(progress: Progress) -> DemoResult:
    """Push the arm at the hub; return push and motion of the tip."""
    hand = HandOnArm(at="hub", force_N=push_force_N)
    arm = SimulatedArm(contacts=[hand], duration_s=GUIDED_S)
    guided = _GuidedArm(arm)
    t_s: list[float] = []
    push_N: list[float] = []
    tip_m: list[Array] = []
    for sample in arm:
        guided.update(sample)
        t_s.append(arm.time_s)
        push_N.append(push_force_N(arm.time_s)[0])
        tip_m.append(np.array(arm.truth.tip_m))
        progress(arm.time_s / GUIDED_S)
    drawn = slice(round(S_TO_TICKS * PUSH_S) - TICKS_BEFORE_PUSH, None)
    tips_m = np.array(tip_m)[drawn]
    moved_mm = M_TO_MM * np.linalg.norm(tips_m - tips_m[0], axis=1)
    return _result_of(np.array(t_s)[drawn], np.array(push_N)[drawn], moved_mm)


def _result_of(t_s: Array, push_N: Array, moved_mm: Array) -> DemoResult:
    """Return table and chart of push and motion over time, each of shape (n,)."""
    yielded = int(np.argmax(moved_mm > YIELDED_MM))
    creep_mm = np.ptp(moved_mm[t_s > PUSH_END_S + REST_S])
    chart = Chart(
        title="Manual guidance\na push at the hub grows by 1 N/s, then lets go",
        x_label=palette.TIME,
        panels=(
            panel_over_time(t_s, "push [N]", palette.READING, push_N),
            panel_over_time(t_s, "tip moved [mm]", palette.OURS, moved_mm),
        ),
    )
    rows = (
        (
            "force at which the arm has yielded by 0.5 mm",
            f"{push_N[yielded]:.2f} N",
        ),
        ("creep, from 1 s after it was let go", f"{creep_mm:.4f} mm in 2 s"),
    )
    charts = (NamedChart("guidance", chart, "Push and motion of the tip."),)
    return DemoResult("Manual guidance", rows, charts)
