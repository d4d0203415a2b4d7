"""A hand guides the arm."""

import math

import numpy as np

from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import HandOnArm
from needleforce import control
from needleforce.cli.demos.result_page import DemoResult, panels_over_time
from needleforce.cli.terminal import Progress
from needleforce.control import AxialSpeed, Controller, Fixture, Limits
from needleforce.plots import (
    Chart,
    palette,
)
from residual import SensorConfig, Status, VirtualForceSensor

PUSH_S = 5.0


PUSH_END_S = 7.0


GUIDED_S = 10.0


PUSH_N = 2.0


def guide_by_hand(progress: Progress) -> DemoResult:
    """A hand pushes the hub aside with a growing force and lets go; the arm yields
    and rests.
    """

    def push_N(t_s: float) -> tuple[float, float, float]:
        inside = PUSH_S <= t_s < PUSH_END_S
        return (
            PUSH_N * (t_s - PUSH_S) / (PUSH_END_S - PUSH_S) if inside else 0.0,
            0.0,
            0.0,
        )

    arm = SimulatedArm(
        contacts=[HandOnArm(at="hub", force_N=push_N)], duration_s=GUIDED_S
    )
    sensor = VirtualForceSensor(arm.robot, SensorConfig(smooth_momentum=False))
    controller = Controller(arm.robot, Limits(arm.robot))
    controller.tool.update(arm.home_rad)
    guidance = control.Guidance(arm.robot)
    shaft = Fixture.here(controller.tool, 20.0)
    rows = []
    for sample in arm:
        wrench = sensor.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        if not sensor.tared:
            speed_m_s = 0.02 * math.sin(
                math.pi * arm.time_s / 2.0
            )  # a stroke there and back
            stack = [shaft, AxialSpeed(speed_m_s)]
            if arm.time_s > 4.0:
                sensor.tare()
        else:
            valid = wrench.status is Status.OK
            sigma_Nm = sensor.residual_std_Nm
            stack = [
                guidance.update(wrench.residual, sigma_Nm, sample.dt_s, is_valid=valid)
            ]
        arm.send(controller.update(sample, stack).dq_rad_s)
        rows.append((arm.time_s, push_N(arm.time_s)[0], *arm.truth.tip_m))
        progress(arm.time_s / GUIDED_S)
    t_s, force, *tip_m = np.array(rows)[round(1e3 * PUSH_S) - 500 :].T
    moved = 1e3 * np.linalg.norm(np.array(tip_m).T - np.array(tip_m).T[0], axis=1)
    yielded = int(np.argmax(moved > 0.5))
    rest = t_s > PUSH_END_S + 1.0
    drawn = (
        ("push [N]", palette.READING, force),
        ("tip moved [mm]", palette.OURS, moved),
    )
    title = "Manual guidance\na push at the hub grows by 1 N/s, then lets go"
    chart = Chart(
        title=title, x_label=palette.TIME, panels=panels_over_time(t_s, *drawn)
    )
    table = (
        ("force at which the arm has yielded by 0.5 mm", f"{force[yielded]:.2f} N"),
        ("creep, from 1 s after it was let go", f"{np.ptp(moved[rest]):.4f} mm in 2 s"),
    )
    return DemoResult(
        "Manual guidance", table, (("guidance", chart, "Push and motion of the tip."),)
    )
