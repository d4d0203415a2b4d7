"""The needle goes in by itself until it has left the first layer."""

import math
from dataclasses import dataclass, field

import numpy as np

from foundation.arrays import Array
from groundtruth.rig_arm import SimulatedArm
from groundtruth.tissue import Rupture
from needleforce import InsertionSession, control
from needleforce.cli.demos.result_page import (
    DemoResult,
    NamedChart,
    panel_over_time,
)
from needleforce.cli.terminal import Progress
from needleforce.control import AxialSpeed, Controller, Fixture, Limits, Posture
from needleforce.plots import Chart, Shading, palette

STANDOFF_M = 5e-3
"""Distance from the tissue at the start [m]."""

DURATION_S = 40.0
"""When the demonstration ends at the latest [s]."""

MAX_AXIAL_N = 20.0
"""Force at which the manager stops the needle [N]."""

SPEED_M_S = 5e-3
MAX_DEPTH_M = 0.12
LAYER = 1
"""Layer whose rupture ends the insertion."""

GAIN_PER_S = 20.0
"""Gain that holds the needle's line [1/s]."""

AFTER_STOP_S = 0.5
"""Time after the stop that is drawn [s]."""

DRAWN_TICKS = 10
"""Every so many ticks are drawn."""

MIN_MARK_PT = 1.5
"""Least width of the mark of a rupture [pt]."""

M_TO_MM = 1e3


@dataclass
class _StopRun:
    """What happened, one row per tick.

    Attributes:
        t_s: Time [s].
        depth_mm: True depth of the tip [mm].
        axial_N: Axial force as the virtual sensor measures it [N].
        inserting_s: When the insertion began [s].
        stopped_s: When it ended [s].
    """

    t_s: list[float] = field(default_factory=list)
    depth_mm: list[float] = field(default_factory=list)
    axial_N: list[float] = field(default_factory=list)
    inserting_s: float = math.inf
    stopped_s: float = math.inf

    def add(self, arm: SimulatedArm, situation: control.Situation) -> None:
        """Add a row, and note when the insertion began or ended."""
        time_s = arm.time_s
        self.t_s.append(time_s)
        self.depth_mm.append(M_TO_MM * arm.truth.depth_m)
        self.axial_N.append(situation.estimate.wrench.axial)
        if situation.state == "insertion":
            self.inserting_s = min(self.inserting_s, time_s)
        elif self.inserting_s < time_s:
            self.stopped_s = min(self.stopped_s, time_s)


def stop_after_rupture(progress: Progress) -> DemoResult:
    """Insert the needle until the first layer ruptures; return depth and force."""
    arm = SimulatedArm(
        "stack-glove-constant", standoff_m=STANDOFF_M, duration_s=DURATION_S
    )
    manager = control.Manager(
        InsertionSession(arm.robot), control.SafetyLimits(axial_N=MAX_AXIAL_N)
    )
    plan = control.InsertionPlan(speed_m_s=SPEED_M_S, depth_m=MAX_DEPTH_M, layer=LAYER)
    profile = control.InsertionProfile(plan)
    controller = Controller(arm.robot, Limits(arm.robot))
    controller.tool.update(arm.home_rad)
    line = Fixture.here(controller.tool, GAIN_PER_S)
    posture = Posture(arm.home_rad)
    run = _StopRun()
    for sample in arm:
        manager.heartbeat()
        situation = manager.update(sample)
        step = profile.update(situation)
        if step.event:
            manager.request(step.event)
        tasks = [line, AxialSpeed(step.speed_m_s), posture]
        arm.send(controller.update(sample, tasks).dq_rad_s)
        run.add(arm, situation)
        progress(arm.time_s / DURATION_S)
        if arm.time_s > run.stopped_s + AFTER_STOP_S:
            break
    ruptures = [rupture for rupture in arm.tissue_truth().ruptures if rupture.layer]
    return _result_of(run, ruptures)


def _result_of(run: _StopRun, ruptures: list[Rupture]) -> DemoResult:
    """Return the table and the chart of an insertion."""
    depth_mm = np.array(run.depth_mm)[::DRAWN_TICKS]
    overshoot_mm = math.nan
    if ruptures:
        overshoot_mm = float(depth_mm.max() - M_TO_MM * ruptures[0].onset_m)
    rows = (
        ("ruptures passed", f"{len(ruptures)} (asked: 1)"),
        ("overshoot past the rupture", f"{overshoot_mm:.2f} mm"),
    )
    chart = _chart_of(run, depth_mm, ruptures)
    charts = (NamedChart("stop", chart, "Depth and measured force."),)
    return DemoResult("Autonomous insertion", rows, charts)


def _chart_of(run: _StopRun, depth_mm: Array, ruptures: list[Rupture]) -> Chart:
    """Return depth and force over time since the insertion began."""
    t_s = np.array(run.t_s)[::DRAWN_TICKS]
    axial_N = np.array(run.axial_N)[::DRAWN_TICKS]
    end_s = float(t_s[-1])
    start_s = run.inserting_s if math.isfinite(run.inserting_s) else 0.0
    spans = tuple((rupture.onset_s, min(rupture.end_s, end_s)) for rupture in ruptures)
    mark = Shading("the layer ruptures", palette.TRUE_RUPTURE, spans, MIN_MARK_PT)
    return Chart(
        title="Autonomous insertion\nstops after the first rupture, 5 mm/s",
        x_label=palette.TIME,
        panels=(
            panel_over_time(t_s, "depth [mm]", palette.OURS, depth_mm),
            panel_over_time(t_s, "force [N]", palette.READING, axial_N),
        ),
        shadings=(mark,),
        x_limits=(start_s, end_s),
    )
