"""The needle turns about its entry while the tip draws a circle, by several arms."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from groundtruth.plant_model import PLANT_MODELS, PlantModel
from groundtruth.rig_arm import SimulatedArm, with_kinematic_error
from groundtruth.rig_contacts import Trocar
from needleforce import control
from needleforce.cli.demos.result_page import DemoResult, NamedChart
from needleforce.cli.terminal import Progress
from needleforce.control import Controller, Limits, Posture, Task
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    Panel,
    SpaceAxes,
    SpaceChart,
    SpaceCurve,
    palette,
)

CIRCLE_M = 40e-3 / 2
"""Radius of the circle [m]."""

CIRCLE_S = 8.0
"""Time for the circle [s]."""

SETTLE_S = 0.5
"""Rest before the circle, over which the measured start is averaged [s]."""

DURATION_S = SETTLE_S + CIRCLE_S + 0.5
"""Of a run, with a rest at the end [s]."""

ENTRY_M = 80e-3
"""Distance from the tip to the entry point [m]."""

SHOWN_BEHIND_M = 40e-3
"""Length of the needle behind the entry that is drawn [m]."""

ROOM_M = 5e-3
"""Room around what is drawn in space [m]."""

GAIN_PER_S = 20.0
"""Gain that holds tip and entry [1/s]."""

TICKS_PER_S = 1e3
"""Samples that the simulated arm sends [1/s]."""

DRAWN_TICKS = 10
"""Every so many ticks are drawn over time."""

NEEDLES = 12
"""Needles that are drawn over the circle."""

MIN_DRAWN_UM = 0.01
"""A smaller error is drawn as this on the logarithmic axis [µm]."""

MAX_DRAWN_UM = 1e5
"""Upper end of that axis [µm]."""

M_TO_MM = 1e3
M_TO_UM = 1e6

NEEDLE = LineStyle(color=palette.BLUE, width_pt=0.8, opacity=0.6)
CIRCLE = LineStyle(color=palette.BLACK, width_pt=1.8)
ENTRY = LineStyle(color=palette.VERMILION, marker="o", width_pt=0.5, size_pt=6.0)
AT_ENTRY = LineStyle(color=palette.VERMILION, width_pt=1.4)


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


class CircleCase(NamedTuple):
    """An arm and a controller that draw the circle.

    Attributes:
        label: Their name.
        plant: Plant model of the arm.
        style: Line of the error.
        has_entry: Whether the controller holds the entry, with priority over the tip.
    """

    label: str
    plant: PlantModel
    style: LineStyle
    has_entry: bool = True


PERFECT = CircleCase(
    "perfect arm", PLANT_MODELS["ideal"], LineStyle(color=palette.BLACK, width_pt=0.9)
)
NOISY = CircleCase("noise of an LWR's interface", PLANT_MODELS["fri"], palette.OURS)
MISPLACED = CircleCase(
    "the same and kinematic error",
    with_kinematic_error(PLANT_MODELS["fri"]),
    LineStyle(color=palette.ORANGE, dash=palette.DASHED, width_pt=1.6),
)
NAIVE = CircleCase(
    "naive: tip alone, perfect arm",
    PLANT_MODELS["ideal"],
    LineStyle(color=palette.VERMILION, dash=palette.DASH_DOTTED, width_pt=1.4),
    has_entry=False,
)
CASES = (PERFECT, NOISY, MISPLACED, NAIVE)


@dataclass(kw_only=True)
class CircleRun:
    """A circle, one row per tick; positions are true ones.

    Attributes:
        case: Who drew it.
        entry_m: Where the axis was when the circle began, shape (3,).
        t_s: Time since then [s].
        error_m: Distance of the needle's axis from the entry [m].
        tip_error_m: Distance of the tip from the circle's point of that time [m].
        tip_m: Position of the tip, shape (3,).
        axis: Direction of the needle, shape (3,).
    """

    case: CircleCase
    entry_m: Array
    t_s: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    tip_error_m: list[float] = field(default_factory=list)
    tip_m: list[Array] = field(default_factory=list)
    axis: list[Array] = field(default_factory=list)

    @property
    def largest_mm(self) -> float:
        """Largest distance of the axis from the entry [mm]."""
        return M_TO_MM * max(self.error_m)

    @property
    def largest_tip_mm(self) -> float:
        """Largest distance of the tip from its place on the circle [mm]."""
        return M_TO_MM * max(self.tip_error_m)


def draw_circle(case: CircleCase) -> CircleRun:
    """Let an arm draw the circle."""
    trocar = Trocar(behind_tip_m=ENTRY_M)
    arm = SimulatedArm(None, case.plant, contacts=[trocar], duration_s=DURATION_S)
    controller = Controller(arm.robot, Limits.of_arm(arm.robot, arm.preset))
    tool = controller.tool
    still = [next(arm).q_rad for _ in range(round(SETTLE_S * TICKS_PER_S))]
    tool.update(np.mean(still[len(still) // 2 :], axis=0))
    start_m = tool.tip_m.copy()
    tip = control.TipVelocity((0.0, 0.0, 0.0), start_m, gain_per_s=GAIN_PER_S)
    tasks: list[Task] = [tip, Posture(arm.home_rad)]
    if case.has_entry:
        entry_m = start_m - ENTRY_M * tool.axis
        tasks.insert(0, control.RemoteCentre(entry_m, GAIN_PER_S))
    truth = arm.truth
    true_start_m = truth.tip_m
    run = CircleRun(case=case, entry_m=true_start_m - ENTRY_M * truth.rotation[:, 2])
    for sample in arm:
        time_s = arm.time_s - SETTLE_S
        point = circle_point(time_s)
        tip.goal_m = start_m + point.offset_m
        tip.rate = point.velocity_m_s
        arm.send(controller.update(sample, tasks).dq_rad_s)
        truth = arm.truth
        run.t_s.append(time_s)
        run.error_m.append(arm.distance_to_axis_m(run.entry_m))
        run.tip_error_m.append(math.dist(truth.tip_m, true_start_m + point.offset_m))
        run.tip_m.append(truth.tip_m)
        run.axis.append(truth.rotation[:, 2].copy())
    return run


def turn_about_entry(progress: Progress) -> DemoResult:
    """Draw the circle in every case; return the errors of entry and tip."""
    runs: list[CircleRun] = []
    for done, case in enumerate(CASES, 1):
        runs.append(draw_circle(case))
        progress(done / len(CASES))
    return _result_of(runs)


def _result_of(runs: list[CircleRun]) -> DemoResult:
    """Return the answer, the table and the charts of the circles."""
    largest_mm = {run.case.label: run.largest_mm for run in runs}
    answer = (
        f"The needle turns about its entry within {largest_mm[NOISY.label]:.3f} mm "
        f"with the noise of an LWR, within {largest_mm[MISPLACED.label]:.2f} mm where "
        "the arm's kinematics are off as well; without the remote centre its axis "
        f"leaves the entry by {largest_mm[NAIVE.label]:.0f} mm."
    )
    setting = (
        "The tip draws a circle of 40 mm in 8 s, 80 mm below an entry that a trocar of "
        "1000 N/m holds. The controller sees measured joint positions; errors are "
        "those of the true needle. Kinematic error: 0.2 mm and 0.3 mrad at each "
        "joint, unknown to the controller."
    )
    rows: list[tuple[str, str]] = []
    for run in runs:
        label = run.case.label
        rows.append((f"{label}: entry, largest error", f"{run.largest_mm:.3f} mm"))
        rows.append((f"{label}: tip, largest error", f"{run.largest_tip_mm:.3f} mm"))
    of_case = {run.case.label: run for run in runs}
    charts = (
        NamedChart(
            "rcm",
            _space_chart(
                of_case[MISPLACED.label], "Held: every needle meets the entry"
            ),
            "The needle at twelve instants, seen to scale, on the arm with noise and "
            "kinematic error.",
        ),
        NamedChart(
            "naive",
            _space_chart(of_case[NAIVE.label], "Naive: the tip alone is commanded"),
            "The same circle without the remote centre, on a perfect arm: the needle "
            "moves sideways through the skin.",
        ),
        NamedChart(
            "error",
            _error_chart(runs),
            "Distance of the needle's true axis from its entry, on a logarithmic axis.",
        ),
    )
    return DemoResult("Remote centre of motion", tuple(rows), charts, answer, setting)


def _error_chart(runs: list[CircleRun]) -> Chart:
    """Return the errors at the entry over time, on a logarithmic axis."""
    curves = tuple(
        Curve(
            style=run.case.style,
            x=np.array(run.t_s)[::DRAWN_TICKS],
            y=np.maximum(M_TO_UM * np.array(run.error_m), MIN_DRAWN_UM)[::DRAWN_TICKS],
            label=run.case.label,
        )
        for run in runs
    )
    panel = Panel(
        y_label="axis to entry [µm]",
        curves=curves,
        limits=(MIN_DRAWN_UM, MAX_DRAWN_UM),
        is_log=True,
    )
    return Chart(
        title="How far the axis is from its entry\ncircle of 40 mm in 8 s",
        x_label="time since the circle began [s]",
        panels=(panel,),
    )


def _space_chart(run: CircleRun, title: str) -> SpaceChart:
    """Return needles, circle and entry in space, the entry at the origin."""
    tips_mm = M_TO_MM * (np.array(run.tip_m) - run.entry_m)
    axes = np.array(run.axis)
    # The needle's point at the height of the entry, and one behind it.
    at_entry_mm = tips_mm - (tips_mm[:, 2] / axes[:, 2])[:, None] * axes
    behind_mm = at_entry_mm - M_TO_MM * SHOWN_BEHIND_M * axes
    end = int(np.searchsorted(run.t_s, CIRCLE_S))
    in_plane_mm = (tips_mm[:end] - tips_mm[0])[:, :2]
    travel_mm = np.cumsum(np.linalg.norm(np.diff(in_plane_mm, axis=0), axis=1))
    places = np.linspace(0.0, travel_mm[-1], NEEDLES, endpoint=False)
    needles = [
        SpaceCurve(NEEDLE, np.array((tips_mm[tick], behind_mm[tick])), label)
        for tick, label in zip(
            np.searchsorted(travel_mm, places),
            ["needle", *[None] * (NEEDLES - 1)],
            strict=True,
        )
    ]
    drawn = slice(None, None, DRAWN_TICKS)
    shown = np.concatenate((tips_mm, behind_mm, at_entry_mm))
    room_mm = M_TO_MM * ROOM_M
    return SpaceChart(
        title=f"{title}\naxis off the entry by {run.largest_mm:.2f} mm at most",
        axes=SpaceAxes("x [mm]", "y [mm]", "height [mm]"),
        curves=(
            *needles,
            SpaceCurve(CIRCLE, tips_mm[drawn], "path of the tip"),
            SpaceCurve(AT_ENTRY, at_entry_mm[drawn], "needle at the entry's height"),
            SpaceCurve(ENTRY, np.zeros((1, 3)), "entry"),
        ),
        low=shown.min(axis=0) - room_mm,
        high=shown.max(axis=0) + room_mm,
    )
