"""The needle turns about its entry point."""

import math

import numpy as np

from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import Trocar
from needleforce import control
from needleforce.cli.demos.result_page import DemoResult, panels_over_time
from needleforce.cli.terminal import Progress
from needleforce.control import Controller, Limits, Posture
from needleforce.plots import (
    Chart,
    palette,
)

CIRCLE_M = 40e-3 / 2


CIRCLE_S = 8.0


ENTRY_M = 80e-3


def turn_about_entry(progress: Progress) -> DemoResult:
    """The tip draws a circle while the needle turns about its entry point."""
    trocar = Trocar(behind_tip_m=ENTRY_M)
    arm = SimulatedArm(contacts=[trocar], duration_s=CIRCLE_S + 0.5)
    controller = Controller(arm.robot, Limits(arm.robot))
    controller.tool.update(arm.home_rad)
    start_m = controller.tool.tip_m.copy()
    axis = controller.tool.axis.copy()
    tip = control.TipVelocity((0.0, 0.0, 0.0), start_m, gain_per_s=20.0)
    stack = [control.RemoteCentre(start_m - ENTRY_M * axis), tip, Posture(arm.home_rad)]
    rows = []
    for sample in arm:
        part = min(arm.time_s / CIRCLE_S, 1.0)
        angle = (
            2.0 * math.pi * (part - math.sin(2.0 * math.pi * part) / (2.0 * math.pi))
        )
        offset = CIRCLE_M * (1.0 - math.cos(angle)), CIRCLE_M * math.sin(angle), 0.0
        rate = 2.0 * math.pi / CIRCLE_S * (1.0 - math.cos(2.0 * math.pi * part))
        along = np.array((math.sin(angle), math.cos(angle), 0.0))
        tip.goal_m = start_m + offset
        tip.rate = CIRCLE_M * rate * along
        arm.send(controller.update(sample, stack).dq_rad_s)
        entry_m = arm.distance_to_axis_m(trocar.point_m)
        rows.append((arm.time_s, entry_m, math.dist(arm.truth.tip_m, tip.goal_m)))
        progress(arm.time_s / (CIRCLE_S + 0.5))
    t_s, entry, error = np.array(rows)[::10].T
    errors = (
        ("entry [µm]", palette.OURS, 1e6 * entry),
        ("tip [mm]", palette.TIP, 1e3 * error),
    )
    chart = Chart(
        title="Remote centre of motion\nerror at the entry and of the tip, circle of 40 mm in 8 s",
        x_label=palette.TIME,
        panels=panels_over_time(t_s, *errors),
    )
    table = (
        ("entry, largest error", f"{1e3 * entry.max():.4f} mm"),
        ("tip, largest error", f"{1e3 * error.max():.2f} mm"),
        (
            "kinematics",
            "shared by arm and controller; a real arm's are off by some 0.1 mm",
        ),
    )
    return DemoResult(
        "Remote centre of motion", table, (("rcm", chart, "Errors over the circle."),)
    )
