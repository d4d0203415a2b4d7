"""The needle stops by itself after a rupture."""

import math

import numpy as np

from groundtruth.rig_arm import SimulatedArm
from groundtruth.tissue import Rupture
from needleforce import InsertionSession, control
from needleforce.cli.demos.result_page import DemoResult, panels_over_time
from needleforce.cli.terminal import Progress
from needleforce.control import AxialSpeed, Controller, Fixture, Limits, Posture
from needleforce.plots import (
    Chart,
    Shading,
    palette,
)


def stop_after_rupture(progress: Progress) -> DemoResult:
    """The needle goes in by itself until it has left the first layer."""
    arm = SimulatedArm("stack-glove-constant", standoff_m=5e-3, duration_s=40.0)
    manager = control.Manager(
        InsertionSession(arm.robot), control.SafetyLimits(axial_N=20.0)
    )
    profile = control.InsertionProfile(
        control.InsertionPlan(speed_m_s=5e-3, depth_m=0.12, layer=1)
    )
    controller = Controller(arm.robot, Limits(arm.robot))
    controller.tool.update(arm.home_rad)
    line = Fixture.here(controller.tool, 20.0)
    posture = Posture(arm.home_rad)
    rows = []
    inserted_s = stopped_s = math.inf
    for sample in arm:
        manager.heartbeat()
        now = manager.update(sample)
        step = profile.update(now)
        if step.event:
            manager.request(step.event)
        arm.send(
            controller.update(
                sample, [line, AxialSpeed(step.speed_m_s), posture]
            ).dq_rad_s
        )
        rows.append((arm.time_s, 1e3 * arm.truth.depth_m, now.estimate.wrench.axial))
        if now.state == "insertion":
            inserted_s = min(inserted_s, arm.time_s)
        elif inserted_s < arm.time_s:
            stopped_s = min(stopped_s, arm.time_s)
        progress(arm.time_s / 40.0)
        if arm.time_s > stopped_s + 0.5:
            break
    drawn = np.array(rows)[::10].T
    ruptures = [item for item in arm.tissue_truth().ruptures if item.layer]
    past_mm = (
        float(drawn[1].max() - 1e3 * ruptures[0].onset_m) if ruptures else math.nan
    )
    begin_s = inserted_s if math.isfinite(inserted_s) else 0.0
    chart = _stop_chart(drawn, ruptures, begin_s)
    table = (
        ("ruptures passed", f"{len(ruptures)} (asked: 1)"),
        ("overshoot past the rupture", f"{past_mm:.2f} mm"),
    )
    return DemoResult(
        "Autonomous insertion", table, (("stop", chart, "Depth and measured force."),)
    )


def _stop_chart(rows: np.ndarray, ruptures: list[Rupture], begin_s: float) -> Chart:
    t_s, depth, force = rows
    marks = tuple((item.onset_s, min(item.end_s, float(t_s[-1]))) for item in ruptures)
    drawn = ("depth [mm]", palette.OURS, depth), ("force [N]", palette.READING, force)
    return Chart(
        title="Autonomous insertion\nstops after the first rupture, 5 mm/s",
        x_label=palette.TIME,
        panels=panels_over_time(t_s, *drawn),
        shadings=(Shading("the layer ruptures", palette.TRUE_RUPTURE, marks, 1.5),),
        x_limits=(begin_s, float(t_s[-1])),
    )
