"""The tip draws a circle while the needle turns about its entry point."""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import Trocar
from needleforce import control
from needleforce.cli.demos.result_page import (
    DemoResult,
    NamedChart,
    panel_over_time,
)
from needleforce.cli.terminal import Progress
from needleforce.control import Controller, Limits, Posture
from needleforce.plots import Chart, palette

CIRCLE_M = 40e-3 / 2
"""Radius of the circle [m]."""

CIRCLE_S = 8.0
"""Time for the circle [s]."""

DURATION_S = CIRCLE_S + 0.5
ENTRY_M = 80e-3
"""Distance from the tip to the entry point [m]."""

GAIN_PER_S = 20.0
DRAWN_TICKS = 10
"""Every so many ticks are drawn."""

M_TO_MM = 1e3
M_TO_UM = 1e6


class CirclePoint(NamedTuple):
    """Where the tip should be on the circle.

    Attributes:
        offset_m: From the start of the circle, shape (3,) [m].
        velocity_m_s: Velocity there, shape (3,) [m/s].
    """

    offset_m: Array
    velocity_m_s: Array


def circle_point(t_s: float) -> CirclePoint:
    """Return the point of the circle after a time [s]; it starts and ends at rest."""
    turn = 2.0 * math.pi
    fraction = min(t_s / CIRCLE_S, 1.0)
    angle = turn * (fraction - math.sin(turn * fraction) / turn)
    rate_rad_s = turn / CIRCLE_S * (1.0 - math.cos(turn * fraction))
    offset_m = (CIRCLE_M * (1.0 - math.cos(angle)), CIRCLE_M * math.sin(angle), 0.0)
    direction = np.array((math.sin(angle), math.cos(angle), 0.0))
    return CirclePoint(np.array(offset_m), CIRCLE_M * rate_rad_s * direction)


def turn_about_entry(progress: Progress) -> DemoResult:
    """Draw the circle; return the errors of entry and tip."""
    trocar = Trocar(behind_tip_m=ENTRY_M)
    arm = SimulatedArm(contacts=[trocar], duration_s=DURATION_S)
    controller = Controller(arm.robot, Limits(arm.robot))
    controller.tool.update(arm.home_rad)
    start_m = controller.tool.tip_m.copy()
    axis = controller.tool.axis.copy()
    tip = control.TipVelocity((0.0, 0.0, 0.0), start_m, gain_per_s=GAIN_PER_S)
    entry = control.RemoteCentre(start_m - ENTRY_M * axis)
    tasks = [entry, tip, Posture(arm.home_rad)]
    t_s: list[float] = []
    entry_m: list[float] = []
    tip_m: list[float] = []
    for sample in arm:
        point = circle_point(arm.time_s)
        tip.goal_m = start_m + point.offset_m
        tip.rate = point.velocity_m_s
        arm.send(controller.update(sample, tasks).dq_rad_s)
        t_s.append(arm.time_s)
        entry_m.append(arm.distance_to_axis_m(trocar.point_m))
        tip_m.append(math.dist(arm.truth.tip_m, tip.goal_m))
        progress(arm.time_s / DURATION_S)
    return _result_of(
        np.array(t_s)[::DRAWN_TICKS],
        np.array(entry_m)[::DRAWN_TICKS],
        np.array(tip_m)[::DRAWN_TICKS],
    )


def _result_of(t_s: Array, entry_m: Array, tip_m: Array) -> DemoResult:
    """Return table and chart of the errors over time, each of shape (n,)."""
    chart = Chart(
        title="Remote centre of motion\n"
        "error at the entry and of the tip, circle of 40 mm in 8 s",
        x_label=palette.TIME,
        panels=(
            panel_over_time(t_s, "entry [µm]", palette.OURS, M_TO_UM * entry_m),
            panel_over_time(t_s, "tip [mm]", palette.TIP, M_TO_MM * tip_m),
        ),
    )
    rows = (
        ("entry, largest error", f"{M_TO_MM * entry_m.max():.4f} mm"),
        ("tip, largest error", f"{M_TO_MM * tip_m.max():.2f} mm"),
        (
            "kinematics",
            "shared by arm and controller; a real arm's are off by some 0.1 mm",
        ),
    )
    charts = (NamedChart("rcm", chart, "Errors over the circle."),)
    return DemoResult("Remote centre of motion", rows, charts)
