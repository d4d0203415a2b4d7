"""The needle goes in by itself and stops at the rupture of the first layer."""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from groundtruth.rig_arm import SimulatedArm
from groundtruth.tissue import Rupture
from needleforce import InsertionSession, control
from needleforce.cli.demos.result_page import DemoResult, NamedChart
from needleforce.cli.terminal import CommandError, Progress
from needleforce.control import AxialSpeed, Controller, Fixture, Limits, Posture
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    Note,
    Panel,
    Shading,
    palette,
    whole_range_of,
)

STANDOFF_M = 5e-3
"""Distance from the tissue at the start [m]."""

DURATION_S = 40.0
"""When the demonstration ends at the latest [s]."""

PLANT = "clean"
"""Plant model of the run that is drawn: a well-kept arm."""

NOISY_PLANT = "fri"
"""Plant model of a second run: errors as measured on the real arm."""

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
"""Every so many ticks of the whole insertion are drawn."""

BEFORE_MS = -10.0
AFTER_MS = 40.0
"""From when to when, since the rupture, the stop is drawn in detail [ms]."""

MIN_MARK_PT = 1.5
"""Least width of the mark of a rupture [pt]."""

M_TO_MM = 1e3
S_TO_MS = 1e3

COMMAND = LineStyle(color=palette.BLACK, dash=palette.DASHED, width_pt=1.2)


class StopRow(NamedTuple):
    """A tick of the insertion.

    Attributes:
        t_s: Time [s].
        depth_m: True depth of the tip [m].
        speed_m_s: True speed of the tip along the needle [m/s].
        command_m_s: Speed that is commanded along the needle [m/s].
        axial_N: Axial force as the virtual sensor measures it [N].
        tip_N: True force at the tip [N].
        estimated_tip_N: Force at the tip as it is identified [N].
        is_inserting: Whether the manager is in the state of insertion.
    """

    t_s: float
    depth_m: float
    speed_m_s: float
    command_m_s: float
    axial_N: float
    tip_N: float
    estimated_tip_N: float
    is_inserting: bool


class Stop(NamedTuple):
    """The stop at a rupture.

    Attributes:
        rupture: The rupture, in the ground truth.
        ruptures: Ruptures inside the tissue until the end.
        delay_s: From its onset to the request to stop [s]; nan without one.
        overshoot_m: From the depth of its onset to the greatest depth [m].
        rest_m: Depth at the end [m].
    """

    rupture: Rupture
    ruptures: int
    delay_s: float
    overshoot_m: float
    rest_m: float


class StoppedRun(NamedTuple):
    """An insertion and its stop.

    Attributes:
        rows: Its ticks.
        stop: How it stopped.
    """

    rows: list[StopRow]
    stop: Stop


def stop_after_rupture(progress: Progress) -> DemoResult:
    """Insert the needle until the first layer ruptures; return depth and force."""
    clean = insert_until_rupture(PLANT, lambda done: progress(done / 2.0))
    noisy = insert_until_rupture(NOISY_PLANT, lambda done: progress(0.5 + done / 2.0))
    return _result_of(clean, noisy.stop)


def insert_until_rupture(plant: str, progress: Progress) -> StoppedRun:
    """Insert the needle on a plant model until the program has stopped it.

    Raises:
        CommandError: No layer ruptured.
    """
    arm = SimulatedArm(
        "stack-glove-constant", plant, standoff_m=STANDOFF_M, duration_s=DURATION_S
    )
    rows = _insert_until_stopped(arm, progress)
    ruptures = [rupture for rupture in arm.tissue_truth().ruptures if rupture.layer]
    if not ruptures:
        raise CommandError("the insertion ended before any layer ruptured")
    return StoppedRun(rows, _stop_of(rows, ruptures))


def _insert_until_stopped(arm: SimulatedArm, progress: Progress) -> list[StopRow]:
    """Run the program to its stop and a little beyond; return all ticks."""
    limits = control.SafetyLimits(axial_N=MAX_AXIAL_N)
    manager = control.Manager(InsertionSession(arm.robot), limits)
    plan = control.InsertionPlan(speed_m_s=SPEED_M_S, depth_m=MAX_DEPTH_M, layer=LAYER)
    profile = control.InsertionProfile(plan)
    controller = Controller(arm.robot, Limits.of_arm(arm.robot, arm.preset))
    controller.tool.update(arm.home_rad)
    line = Fixture.here(controller.tool, GAIN_PER_S)
    posture = Posture(arm.home_rad)
    beside = control.Beside()
    rows: list[StopRow] = []
    stopped_s = math.inf
    for sample in arm:
        manager.heartbeat()
        situation = manager.update(sample, beside)
        step = profile.update(situation)
        if step.event:
            manager.request(step.event)
        tasks = [line, AxialSpeed(step.speed_m_s), posture]
        command = controller.update(sample, tasks)
        beside = control.Beside(
            accepted=arm.send(command.dq_rad_s),
            command_rad_s=command.dq_rad_s,
            loop_failure=command.loop_failure,
        )
        is_first_after = bool(rows) and rows[-1].is_inserting
        rows.append(_row_of(arm, situation, step.speed_m_s))
        if is_first_after and not rows[-1].is_inserting:
            stopped_s = arm.time_s
        progress(arm.time_s / DURATION_S)
        if arm.time_s > stopped_s + AFTER_STOP_S:
            break
    return rows


def _row_of(
    arm: SimulatedArm, situation: control.Situation, command_m_s: float
) -> StopRow:
    """Return a tick of the insertion."""
    truth = arm.truth
    estimate = situation.estimate
    return StopRow(
        t_s=truth.t_s,
        depth_m=truth.depth_m,
        speed_m_s=truth.speed_m_s,
        command_m_s=command_m_s,
        axial_N=estimate.wrench.axial,
        tip_N=truth.tissue.tip_N,
        estimated_tip_N=estimate.identification.tip_force_N,
        is_inserting=situation.state == control.State.INSERTION,
    )


def _stop_of(rows: list[StopRow], ruptures: list[Rupture]) -> Stop:
    """Return how the needle stopped at the first of its ruptures."""
    rupture = ruptures[0]
    deepest = max(rows, key=lambda row: row.depth_m)
    last_inserting_s = max((row.t_s for row in rows if row.is_inserting), default=0.0)
    is_after = last_inserting_s > rupture.onset_s
    return Stop(
        rupture=rupture,
        ruptures=len(ruptures),
        delay_s=last_inserting_s - rupture.onset_s if is_after else math.nan,
        overshoot_m=deepest.depth_m - rupture.onset_m,
        rest_m=rows[-1].depth_m,
    )


def _result_of(run: StoppedRun, noisy: Stop) -> DemoResult:
    """Return the answer, the table and the charts of an insertion.

    Args:
        run: The insertion that is drawn.
        noisy: The stop of the same insertion on an arm with the errors of an LWR.
    """
    stop = run.stop
    overshoot = f"{M_TO_MM * stop.overshoot_m:.2f} mm"
    noisy_overshoot = f"{M_TO_MM * noisy.overshoot_m:.2f} mm"
    delay = f"{S_TO_MS * stop.delay_s:.0f} ms"
    answer = (
        f"At {M_TO_MM * SPEED_M_S:g} mm/s the needle stops {overshoot} past the "
        f"rupture, which is recognised after {delay}; {noisy_overshoot} past it with "
        "the errors of an LWR's interface."
    )
    setting = (
        "The arm inserts the needle into three gels and is to stop once it has left "
        "the first one. It knows only its joint signals; true depth, speed and tip "
        "force are drawn for comparison. Drawn is a well-kept arm with little noise."
    )
    rest_m = stop.rest_m - stop.rupture.onset_m
    table = (
        ("ruptures passed", f"{stop.ruptures} (asked: 1)"),
        ("request to stop, after the rupture began", delay),
        ("overshoot past the rupture", overshoot),
        ("overshoot with the errors of an LWR's interface", noisy_overshoot),
        ("rest, past the rupture", f"{M_TO_MM * rest_m:.2f} mm"),
        ("force that the layer loses", f"{stop.rupture.drop_N:.2f} N"),
    )
    charts = (
        NamedChart(
            "stop",
            _stop_chart(run.rows, stop),
            "The stop in detail. The command turns back for a moment, because it is "
            "ahead of the tip; dip and peak of the measured force are the arm's own "
            "deceleration. The tip force stays where the needle stops in the tear.",
        ),
        NamedChart(
            "insertion",
            _insertion_chart(run.rows, stop),
            "The whole insertion: true depth of the tip, and measured axial force.",
        ),
    )
    return DemoResult("Autonomous insertion", table, charts, answer, setting)


def _column(rows: list[StopRow], name: str) -> Array:
    """Return a field of all ticks, shape (n,)."""
    return np.array([getattr(row, name) for row in rows], dtype=float)


def _stop_chart(rows: list[StopRow], stop: Stop) -> Chart:
    """Return speed, force and depth around the rupture."""
    onset_s = stop.rupture.onset_s
    seen = [
        row for row in rows if BEFORE_MS <= S_TO_MS * (row.t_s - onset_s) <= AFTER_MS
    ]
    t_ms = S_TO_MS * (_column(seen, "t_s") - onset_s)

    def curve(style: LineStyle, values: Array, label: str | None = None) -> Curve:
        return Curve(style=style, x=t_ms, y=values, label=label)

    speeds = (
        curve(palette.OURS, M_TO_MM * _column(seen, "speed_m_s"), "true speed"),
        curve(COMMAND, M_TO_MM * _column(seen, "command_m_s"), "command"),
    )
    forces = (
        curve(palette.READING, _column(seen, "axial_N"), "axial force, measured"),
        curve(
            palette.PREDICTED, _column(seen, "estimated_tip_N"), "tip force, estimated"
        ),
        curve(palette.TRUE_PART, _column(seen, "tip_N"), "tip force, true"),
    )
    past_mm = M_TO_MM * (_column(seen, "depth_m") - stop.rupture.onset_m)
    depths = (curve(palette.OURS, past_mm),)
    peak_mm = M_TO_MM * stop.overshoot_m
    level = LineStyle(color=palette.VERMILION, dash=palette.DOTTED, width_pt=1.2)
    ends_ms = np.array((0.0, AFTER_MS))
    overshoot = Curve(style=level, x=ends_ms, y=np.full(2, peak_mm))
    note = Note(
        BEFORE_MS,
        0.86 * peak_mm,
        f"overshoot {peak_mm:.2f} mm",
        palette.VERMILION,
    )
    request_ms = S_TO_MS * stop.delay_s
    return Chart(
        title="The stop at the rupture\ninsertion at 5 mm/s",
        x_label="time since the rupture began [ms]",
        panels=(
            Panel(
                y_label="speed\n[mm/s]", curves=speeds, limits=whole_range_of(speeds)
            ),
            Panel(
                y_label="force\n[N]",
                curves=forces,
                limits=whole_range_of(forces),
                height=1.3,
            ),
            Panel(
                y_label="past the\nrupture [mm]",
                curves=(*depths, overshoot),
                limits=whole_range_of((*depths, overshoot)),
                notes=(note,),
            ),
        ),
        shadings=(
            Shading("stop requested", palette.GREY, ((request_ms, request_ms),), 1.2),
        ),
        x_limits=(BEFORE_MS, AFTER_MS),
        height_in=4.6,
    )


def _insertion_chart(rows: list[StopRow], stop: Stop) -> Chart:
    """Return depth and force over the whole insertion."""
    first_s = next((row.t_s for row in rows if row.is_inserting), rows[0].t_s)
    seen = [row for row in rows if row.t_s >= first_s][::DRAWN_TICKS]
    t_s = _column(seen, "t_s") - first_s
    depth = Curve(style=palette.OURS, x=t_s, y=M_TO_MM * _column(seen, "depth_m"))
    axial = Curve(
        style=palette.READING,
        x=t_s,
        y=_column(seen, "axial_N"),
        label="axial force, measured",
    )
    tip = Curve(
        style=palette.TRUE_PART,
        x=t_s,
        y=_column(seen, "tip_N"),
        label="tip force, true",
    )
    onset_s = stop.rupture.onset_s - first_s
    return Chart(
        title="The whole insertion\nfirst gel of three, stop after its rupture",
        x_label=palette.INSERTION_TIME,
        panels=(
            Panel(
                y_label="depth [mm]", curves=(depth,), limits=whole_range_of((depth,))
            ),
            Panel(
                y_label="force [N]",
                curves=(axial, tip),
                limits=whole_range_of((axial, tip)),
            ),
        ),
        shadings=(
            Shading(
                "the layer ruptures",
                palette.TRUE_RUPTURE,
                ((onset_s, float(t_s[-1])),),
                MIN_MARK_PT,
            ),
        ),
        x_limits=(0.0, float(t_s[-1])),
        height_in=4.2,
    )
