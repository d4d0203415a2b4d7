"""A hand pushes the hub aside, more and then less; the arm yields."""

import math
from typing import NamedTuple

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
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    Panel,
    Shading,
    palette,
    whole_range_of,
)
from residual import SensorConfig, Status, VirtualForceSensor

TARE_S = 4.0
"""Time of the free stroke before the tare [s]."""

STROKE_SPEED_M_S = 0.02
"""Largest speed of that stroke, there and back [m/s]."""

PUSH_S = 5.0
"""When the push begins [s]."""

PUSH_RISE_S = 1.3
"""Time in which the push grows, and in which it falls again [s]."""

PUSH_N = 1.3
"""Largest force of the push [N]."""

GUIDED_S = 10.0
"""When the demonstration ends [s]."""

GAIN_PER_S = 20.0
"""Gain that holds the needle's line before the tare [1/s]."""

REST_S = 1.0
"""Time after the push from which on the arm should rest [s]."""

TICKS_BEFORE_PUSH = 500
"""Ticks of 1 ms before the push that are drawn."""

S_TO_TICKS = 1e3
MEAN_TICKS = 20
"""Ticks over which the speed of the tip is averaged."""

DRAWN_TICKS = 5
"""Every so many ticks are drawn."""

M_TO_MM = 1e3

FALLING = LineStyle(color=palette.ORANGE, dash=palette.DASHED, width_pt=1.4)
BREAKAWAY = LineStyle(color=palette.VERMILION, marker="o", width_pt=0.5, size_pt=6.0)


def push_force_N(t_s: float) -> Direction:
    """Return the force of the hand at a time [s]; it grows and falls [N]."""
    from_peak_s = abs(t_s - PUSH_S - PUSH_RISE_S)
    return (PUSH_N * max(1.0 - from_peak_s / PUSH_RISE_S, 0.0), 0.0, 0.0)


class _GuidedArm:
    """Tare over a free stroke, then guidance by the residual."""

    def __init__(self, arm: SimulatedArm) -> None:
        self._arm = arm
        self._sensor = VirtualForceSensor(
            arm.robot, SensorConfig(smooth_momentum=False)
        )
        self._controller = Controller(arm.robot, Limits.of_arm(arm.robot, arm.preset))
        self._controller.tool.update(arm.home_rad)
        self._guidance = control.Guidance(arm.robot)
        self._shaft = Fixture.here(self._controller.tool, GAIN_PER_S)

    def update(self, sample: ArmSample) -> bool:
        """Move the arm by one tick; return whether it was told to move."""
        tasks = self._tasks(sample)
        command = self._controller.update(sample, tasks)
        self._arm.send(command.dq_rad_s)
        return bool(np.any(command.dq_rad_s))

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


class GuidedRun(NamedTuple):
    """Push and motion over time, from a little before the push; arrays: (n,).

    Attributes:
        t_s: Time [s].
        push_N: Force of the hand at the hub [N].
        travel_mm: Travel of the tip along the push [mm].
        is_commanded: Whether the arm was told to move.
    """

    t_s: Array
    push_N: Array
    travel_mm: Array
    is_commanded: Array

    @property
    def speed_mm_s(self) -> Array:
        """Speed of the tip along the push, averaged over `MEAN_TICKS` [mm/s]."""
        window = np.full(MEAN_TICKS, 1.0 / MEAN_TICKS)
        ends = np.pad(self.travel_mm, MEAN_TICKS, mode="edge")
        speed_mm_s = S_TO_TICKS * np.gradient(ends)
        return np.convolve(speed_mm_s, window, "same")[MEAN_TICKS:-MEAN_TICKS]

    @property
    def breakaway(self) -> int:
        """Tick at which the arm is first told to move in the push."""
        return int(np.argmax(np.logical_and(self.is_commanded, self.push_N > 0.0)))

    @property
    def standstill(self) -> int:
        """Last tick at which it is told to move."""
        return len(self.t_s) - 1 - int(np.argmax(self.is_commanded[::-1]))

    @property
    def creep_mm(self) -> float:
        """Travel from `REST_S` after the push on [mm]."""
        is_rest = self.t_s > PUSH_S + 2.0 * PUSH_RISE_S + REST_S
        return float(np.ptp(self.travel_mm[is_rest]))


def guide_by_hand(progress: Progress) -> DemoResult:
    """Push the arm at the hub; return push and motion of the tip."""
    hand = HandOnArm(at="hub", force_N=push_force_N)
    arm = SimulatedArm(contacts=[hand], duration_s=GUIDED_S)
    guided = _GuidedArm(arm)
    t_s: list[float] = []
    push_N: list[float] = []
    tip_m: list[float] = []
    is_commanded: list[bool] = []
    for sample in arm:
        is_commanded.append(guided.update(sample))
        t_s.append(arm.time_s)
        push_N.append(push_force_N(arm.time_s)[0])
        tip_m.append(float(arm.truth.tip_m[0]))
        progress(arm.time_s / GUIDED_S)
    drawn = slice(round(S_TO_TICKS * PUSH_S) - TICKS_BEFORE_PUSH, None)
    travel_mm = M_TO_MM * np.array(tip_m)[drawn]
    return _result_of(
        GuidedRun(
            t_s=np.array(t_s)[drawn],
            push_N=np.array(push_N)[drawn],
            travel_mm=travel_mm - travel_mm[0],
            is_commanded=np.array(is_commanded)[drawn],
        )
    )


def _result_of(run: GuidedRun) -> DemoResult:
    """Return the answer, the table and the charts of push and motion."""
    breakaway = f"{run.push_N[run.breakaway]:.2f} N"
    standstill = f"{run.push_N[run.standstill]:.2f} N"
    fastest = f"{run.speed_mm_s.max():.0f} mm/s"
    answer = (
        f"The arm stands until the hand pushes with {breakaway}, follows at up to "
        f"{fastest} under {PUSH_N:g} N, and rests when let go."
    )
    setting = (
        f"A hand pushes the hub aside with a force that grows to {PUSH_N:g} N in "
        f"{PUSH_RISE_S:g} s and "
        "falls as evenly. The arm feels it in its joint torques alone: below the "
        "breakaway force the push cannot be told from errors of the torques."
    )
    rest_s = GUIDED_S - PUSH_S - 2.0 * PUSH_RISE_S - REST_S
    rows = (
        ("breakaway: the arm begins to move", breakaway),
        ("the arm stops, as the push falls", standstill),
        ("largest speed of the tip", fastest),
        ("largest push", f"{run.push_N.max():.2f} N"),
        ("creep, from 1 s after the push", f"{run.creep_mm:.4f} mm in {rest_s:.1f} s"),
    )
    charts = (
        NamedChart(
            "guidance",
            _speed_chart(run),
            "Push over the speed it causes. The arm stands while the push rises to the "
            "breakaway; once a hand is felt, the dead zone narrows, so that the arm "
            "follows lightly and stops only at a smaller force.",
        ),
        NamedChart("time", _time_chart(run), "The same run over time."),
    )
    return DemoResult("Manual guidance", rows, charts, answer, setting)


def _speed_chart(run: GuidedRun) -> Chart:
    """Return the push over the speed of the tip, as it grows and as it falls."""
    speed_mm_s = run.speed_mm_s
    peak = int(np.argmax(run.push_N))
    rising = slice(0, peak + 1, DRAWN_TICKS)
    falling = slice(peak, None, DRAWN_TICKS)
    rise = Curve(
        style=palette.OURS,
        x=speed_mm_s[rising],
        y=run.push_N[rising],
        label="push grows",
    )
    fall = Curve(
        style=FALLING,
        x=speed_mm_s[falling],
        y=run.push_N[falling],
        label="push falls",
    )
    tick = run.breakaway
    mark = Curve(
        style=BREAKAWAY,
        x=speed_mm_s[tick : tick + 1],
        y=run.push_N[tick : tick + 1],
        label="breakaway",
    )
    curves = (fall, rise, mark)
    return Chart(
        title=f"Force over speed\nthe arm breaks away at {run.push_N[tick]:.2f} N",
        x_label="speed of the tip along the push [mm/s]",
        panels=(
            Panel(y_label="push [N]", curves=curves, limits=whole_range_of(curves)),
        ),
    )


def _time_chart(run: GuidedRun) -> Chart:
    """Return push, speed and travel over time."""
    drawn = slice(None, None, DRAWN_TICKS)
    t_s = run.t_s[drawn] - PUSH_S
    moving_s = (float(run.t_s[run.breakaway]), float(run.t_s[run.standstill]))
    span = (moving_s[0] - PUSH_S, moving_s[1] - PUSH_S)
    speed_mm_s = run.speed_mm_s[drawn]
    travel_mm = run.travel_mm[drawn]
    return Chart(
        title="Push, speed and travel\na push at the hub that grows and falls by 1 N/s",
        x_label="time since the push began [s]",
        panels=(
            panel_over_time(t_s, "push [N]", palette.READING, run.push_N[drawn]),
            panel_over_time(t_s, "speed\n[mm/s]", palette.OURS, speed_mm_s),
            panel_over_time(t_s, "travel\n[mm]", palette.OURS, travel_mm),
        ),
        shadings=(Shading("the arm is told to move", palette.TARE, (span,)),),
        height_in=4.2,
    )
