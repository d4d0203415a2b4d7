"""`needleforce demo`: the needle moved in closed loop on the simulated arm, as a table
and a page.

Simulation only; nothing here is a medical device or claimed of one.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import HandOnArm, Trocar
from groundtruth.tissue import Rupture
from needleforce import InsertionSession, control, plots
from needleforce.cli import demo_runs
from needleforce.cli.demo_runs import STANDOFF_M, HandPlan, Teleinsertion
from needleforce.cli.live_options import DemoOptions
from needleforce.cli.terminal import CommandError, aligned, progress_bar, write_out
from needleforce.control import AxialSpeed, Controller, Fixture, Limits, Posture
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    PageFigure,
    Panel,
    Shading,
    palette,
)
from residual import SensorConfig, Status, VirtualForceSensor

Progress = Callable[[float], None]
Drawn = Callable[[Path], list[PageFigure]]  # into a folder
NEVER = "Simulation only: not a medical device."


class Shown(NamedTuple):
    """What a demonstration has to show.

    Attributes:
        charts: Name of the file, the chart, its caption.
    """

    title: str
    rows: tuple[tuple[str, str], ...]
    charts: tuple[tuple[str, Chart, str], ...]

    def write(
        self, kind: str, folder: Path | None, first: Drawn = lambda _: []
    ) -> None:
        """Print the table, and write it with the figures as a page, if there is a
        folder for it.
        """
        write_out(f"{self.title}\n{aligned(self.rows)}{NEVER}\n")
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        figures = first(folder)
        for name, chart, caption in self.charts:
            place = folder / f"{name}.svg"
            figures.append(
                plots.save_page_figure(chart, place, alt=caption, caption=caption)
            )
        table = plots.PageTable(
            caption="Result", head=("what", "value"), rows=self.rows
        )
        content = {"figures": tuple(figures), "tables": (table,)}
        section = plots.Section(heading=self.title, anchor=kind, **content)
        page = plots.Page(
            title=f"needleforce demo {kind}", lead=(NEVER,), sections=(section,)
        )
        write_out(f"{plots.write_page(folder / plots.PAGE, page)}\n")


def run(kind: str, options: DemoOptions) -> int:
    """Run a demonstration, print its table, and write what was asked for."""
    if options.report is not None or options.figure is not None:
        plots.require_matplotlib("demo")
    if kind not in DEMOS:
        raise CommandError(f"no demonstration {kind!r}; known: {', '.join(DEMOS)}")
    with progress_bar(f"demonstrating {kind}") as progress:
        shown = DEMOS[kind](progress)
    shown.write(kind, options.report)
    if options.figure is not None:
        plots.save_figure(shown.charts[0][1], options.figure)
    return 0


def _panels(
    t_s: np.ndarray, *rows: tuple[str, LineStyle, np.ndarray]
) -> tuple[Panel, ...]:
    """One panel for each label of the y axis, style and values over time."""
    curves = ((label, Curve(style=style, x=t_s, y=y)) for label, style, y in rows)
    return tuple(Panel(y_label=label, curves=(curve,)) for label, curve in curves)


def _teleop(progress: Progress) -> Shown:
    """A hand drives the needle through three gels and feels the force at its tip."""
    arm = SimulatedArm("stack-glove-constant", "clean", 1, standoff_m=STANDOFF_M)
    hand = HandPlan(needle_speed_m_s=4e-3, needle_travel_m=108e-3, scale=0.4)
    made = demo_runs.teleoperate(arm, hand, seed=1, delay_s=0.01, progress=progress)
    felt = demo_runs.ruptures_felt(made)
    rows = {}
    for k, item in enumerate(felt, 1):
        text = f"{100 * item.shown_drop:.0f} %, {100 * item.raw_drop:.0f} %"
        rows[f"rupture {k}: contrast with, without compensation"] = text
    rows["alarms for ruptures"] = f"{len(made.alarms_s)} for {len(felt)}"
    rows["least energy at the hand's port"] = f"{1e3 * made.least_energy_J:.3f} mJ"
    rows["drift between hand and needle"] = f"{1e3 * abs(made.drift_m):.2f} mm"
    title = "Teleoperation, 10 ms of delay each way"
    return Shown(title, tuple(rows.items()), _teleop_charts(made))


def _teleop_charts(made: Teleinsertion) -> tuple[tuple[str, Chart, str], ...]:
    t_s = made.rows("t_s")
    step = 20
    depth_mm = 1e3 * (made.rows("depth_m") - made.depth_m[0])

    def curve(name: str, label: str, style: LineStyle, scale: float = 1.0) -> Curve:
        smooth = np.convolve(made.rows(name), np.full(step, 1.0 / step), "same")[::step]
        return Curve(style=style, x=t_s[::step], y=scale * smooth, label=label)

    ends = tuple((item.onset_s, item.end_s) for item in made.ruptures if item.layer)
    turns = np.flatnonzero(np.diff(made.rows("is_open"), prepend=False, append=False))
    back = tuple((float(t_s[k]), float(t_s[n - 1])) for k, n in turns.reshape(-1, 2))
    marks = (
        Shading("a layer ruptures", palette.TRUE_RUPTURE, ends, 1.5),
        Shading("clutch open: the hand goes back", palette.TARE, back),
    )
    forces = (
        curve("raw_N", "without compensation: force at the base", palette.READING),
        curve("shown_N", "with compensation: shown to the hand", palette.OURS),
        curve("tip_N", "true force at the tip", palette.TRUE_PART),
    )
    contrast = Chart(
        title="What the surgeon feels\nneedle driven by a hand, three gels, 10 ms delay",
        x_label=palette.TIME,
        panels=(Panel(y_label="force [N]", curves=forces),),
        shadings=marks,
    )
    motion = Curve(
        style=palette.OURS, x=t_s[::step], y=depth_mm[::step], label="needle"
    )
    energy = Chart(
        title="Energy that the hand has put in, and depth\nnever below zero: passive",
        x_label=palette.TIME,
        panels=(
            Panel(
                y_label="energy [mJ]",
                curves=(curve("energy_J", "", palette.OURS, 1e3),),
            ),
            Panel(y_label="travel [mm]", curves=(motion,)),
        ),
        shadings=marks,
    )
    return (
        (
            "contrast",
            contrast,
            "Force before and after each rupture, with friction and without.",
        ),
        ("energy", energy, "Energy through the hand's port and travel of the needle."),
    )


CIRCLE_M = 40e-3 / 2
CIRCLE_S = 8.0
ENTRY_M = 80e-3


def _rcm(progress: Progress) -> Shown:
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
        panels=_panels(t_s, *errors),
    )
    table = (
        ("entry, largest error", f"{1e3 * entry.max():.4f} mm"),
        ("tip, largest error", f"{1e3 * error.max():.2f} mm"),
        (
            "kinematics",
            "shared by arm and controller; a real arm's are off by some 0.1 mm",
        ),
    )
    return Shown(
        "Remote centre of motion", table, (("rcm", chart, "Errors over the circle."),)
    )


def _autonomous(progress: Progress) -> Shown:
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
    return Shown(
        "Autonomous insertion", table, (("stop", chart, "Depth and measured force."),)
    )


def _stop_chart(rows: np.ndarray, ruptures: list[Rupture], begin_s: float) -> Chart:
    t_s, depth, force = rows
    marks = tuple((item.onset_s, min(item.end_s, float(t_s[-1]))) for item in ruptures)
    drawn = ("depth [mm]", palette.OURS, depth), ("force [N]", palette.READING, force)
    return Chart(
        title="Autonomous insertion\nstops after the first rupture, 5 mm/s",
        x_label=palette.TIME,
        panels=_panels(t_s, *drawn),
        shadings=(Shading("the layer ruptures", palette.TRUE_RUPTURE, marks, 1.5),),
        x_limits=(begin_s, float(t_s[-1])),
    )


PUSH_S = 5.0
PUSH_END_S = 7.0
GUIDED_S = 10.0
PUSH_N = 2.0


def _guidance(progress: Progress) -> Shown:
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
    chart = Chart(title=title, x_label=palette.TIME, panels=_panels(t_s, *drawn))
    table = (
        ("force at which the arm has yielded by 0.5 mm", f"{force[yielded]:.2f} N"),
        ("creep, from 1 s after it was let go", f"{np.ptp(moved[rest]):.4f} mm in 2 s"),
    )
    return Shown(
        "Manual guidance", table, (("guidance", chart, "Push and motion of the tip."),)
    )


DEMOS: dict[str, Callable[[Progress], Shown]] = {
    "guidance": _guidance,
    "teleop": _teleop,
    "autonomous": _autonomous,
    "rcm": _rcm,
}
