"""A hand drives the needle through three gels and feels the force at its tip."""

import numpy as np

from foundation.arrays import Array
from groundtruth.rig_arm import SimulatedArm
from needleforce.cli.demos.hand_driven import (
    STANDOFF_M,
    HandPlan,
    Teleinsertion,
    ruptures_felt,
    teleoperate,
)
from needleforce.cli.demos.result_page import DemoResult, NamedChart
from needleforce.cli.terminal import Progress
from needleforce.plots import Chart, Curve, LineStyle, Panel, Shading, palette

SEED = 1
NEEDLE_SPEED_M_S = 4e-3
NEEDLE_TRAVEL_M = 108e-3
"""Travel through the three gels and beyond [m]."""

SCALE = 0.4
"""Needle travel per travel of the hand."""

DELAY_S = 0.01
"""Delay each way [s]."""

DRAWN_TICKS = 20
"""Every so many ticks are drawn, as the mean of so many."""

MIN_MARK_PT = 1.5
"""Least width of the mark of a rupture [pt]."""

M_TO_MM = 1e3
J_TO_MJ = 1e3


def teleoperate_needle(progress: Progress) -> DemoResult:
    """Drive the needle by an emulated hand; return what it felt."""
    arm = SimulatedArm("stack-glove-constant", "clean", SEED, standoff_m=STANDOFF_M)
    hand = HandPlan(
        needle_speed_m_s=NEEDLE_SPEED_M_S, needle_travel_m=NEEDLE_TRAVEL_M, scale=SCALE
    )
    run = teleoperate(arm, hand, seed=SEED, delay_s=DELAY_S, progress=progress)
    felt = ruptures_felt(run)
    rows: dict[str, str] = {}
    for number, rupture in enumerate(felt, 1):
        label = f"rupture {number}: contrast with, without compensation"
        rows[label] = (
            f"{100 * rupture.shown_drop:.0f} %, {100 * rupture.raw_drop:.0f} %"
        )
    rows["alarms for ruptures"] = f"{len(run.alarms_s)} for {len(felt)}"
    energy_mJ = J_TO_MJ * run.least_energy_J
    rows["least energy at the hand's port"] = f"{energy_mJ:.3f} mJ"
    drift_mm = M_TO_MM * abs(run.drift_m)
    rows["drift between hand and needle"] = f"{drift_mm:.2f} mm"
    title = "Teleoperation, 10 ms of delay each way"
    return DemoResult(title, tuple(rows.items()), _charts_of(run))


def _charts_of(run: Teleinsertion) -> tuple[NamedChart, ...]:
    """Return the charts of force, and of energy and travel, over time."""
    marks = _marks_of(run)
    contrast = Chart(
        title="What the surgeon feels\n"
        "needle driven by a hand, three gels, 10 ms delay",
        x_label=palette.TIME,
        panels=(_force_panel(run),),
        shadings=marks,
    )
    energy_curve = _mean_curve(run, "energy_J", "", palette.OURS, J_TO_MJ)
    energy = Chart(
        title="Energy that the hand has put in, and depth\nnever below zero: passive",
        x_label=palette.TIME,
        panels=(
            Panel(y_label="energy [mJ]", curves=(energy_curve,)),
            _travel_panel(run),
        ),
        shadings=marks,
    )
    return (
        NamedChart(
            "contrast",
            contrast,
            "Force before and after each rupture, with friction and without.",
        ),
        NamedChart(
            "energy", energy, "Energy through the hand's port and travel of the needle."
        ),
    )


def _marks_of(run: Teleinsertion) -> tuple[Shading, ...]:
    """Return when layers rupture, and when the clutch is open."""
    t_s = run.rows("t_s")
    ruptures = tuple(
        (rupture.onset_s, rupture.end_s) for rupture in run.ruptures if rupture.layer
    )
    changes = np.flatnonzero(np.diff(run.rows("is_open"), prepend=False, append=False))
    open_spans = tuple(
        (float(t_s[start]), float(t_s[end - 1]))
        for start, end in changes.reshape(-1, 2)
    )
    return (
        Shading("a layer ruptures", palette.TRUE_RUPTURE, ruptures, MIN_MARK_PT),
        Shading("clutch open: the hand goes back", palette.TARE, open_spans),
    )


def _force_panel(run: Teleinsertion) -> Panel:
    """Return measured, shown and true force."""
    raw = _mean_curve(
        run, "raw_N", "without compensation: force at the base", palette.READING
    )
    shown = _mean_curve(
        run, "shown_N", "with compensation: shown to the hand", palette.OURS
    )
    true = _mean_curve(run, "tip_N", "true force at the tip", palette.TRUE_PART)
    return Panel(y_label="force [N]", curves=(raw, shown, true))


def _travel_panel(run: Teleinsertion) -> Panel:
    """Return the travel of the needle since the hand took over."""
    depth_m: Array = run.rows("depth_m")
    travel_mm = M_TO_MM * (depth_m - depth_m[0])
    curve = Curve(
        style=palette.OURS,
        x=run.rows("t_s")[::DRAWN_TICKS],
        y=travel_mm[::DRAWN_TICKS],
        label="needle",
    )
    return Panel(y_label="travel [mm]", curves=(curve,))


def _mean_curve(
    run: Teleinsertion, name: str, label: str, style: LineStyle, factor: float = 1.0
) -> Curve:
    """Return a curve of means over `DRAWN_TICKS` of a list of the run."""
    window = np.full(DRAWN_TICKS, 1.0 / DRAWN_TICKS)
    mean = np.convolve(run.rows(name), window, "same")[::DRAWN_TICKS]
    t_s = run.rows("t_s")[::DRAWN_TICKS]
    return Curve(style=style, x=t_s, y=factor * mean, label=label)
