"""A hand drives the needle through three gels and feels the force at its tip."""

from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from groundtruth.rig_arm import SimulatedArm
from needleforce.cli.demos.hand_driven import (
    STANDOFF_M,
    HandPlan,
    RuptureFelt,
    Teleinsertion,
    ruptures_felt,
    teleoperate,
)
from needleforce.cli.demos.result_page import DemoResult, NamedChart
from needleforce.cli.terminal import Progress
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    Panel,
    Shading,
    palette,
    whole_range_of,
)

SEED = 1
NEEDLE_SPEED_M_S = 4e-3
NEEDLE_TRAVEL_M = 108e-3
"""Travel through the three gels and beyond [m]."""

SCALE = 0.4
"""Needle travel per travel of the hand."""

DELAY_S = 0.01
"""Delay each way [s]."""

DRAWN_TICKS = 5
"""Every so many ticks are drawn."""

MIN_MARK_PT = 1.5
"""Least width of the mark of a rupture [pt]."""

M_TO_MM = 1e3
J_TO_MJ = 1e3

GIVEN = palette.OURS
GOT = LineStyle(color=palette.VERMILION, dash=palette.DASHED, width_pt=1.4)


class HandEnergy(NamedTuple):
    """Energy through the handle since the hand took over; arrays have shape (n,).

    Attributes:
        from_hand_J: What came from the hand.
        to_hand_J: What was delivered to the hand.
    """

    from_hand_J: Array
    to_hand_J: Array

    @property
    def most_owed_J(self) -> float:
        """The most by which the hand had ever got more than it had given."""
        return float(np.max(self.to_hand_J - self.from_hand_J))


def energy_of(run: Teleinsertion) -> HandEnergy:
    """Return the energy that came from the hand, and what was delivered to it."""
    steps_J = np.diff(run.rows("energy_J"), prepend=0.0)
    return HandEnergy(
        from_hand_J=np.cumsum(np.maximum(steps_J, 0.0)),
        to_hand_J=np.cumsum(np.maximum(-steps_J, 0.0)),
    )


def teleoperate_needle(progress: Progress) -> DemoResult:
    """Drive the needle by an emulated hand; return what it felt."""
    arm = SimulatedArm("stack-glove-constant", "clean", SEED, standoff_m=STANDOFF_M)
    hand = HandPlan(
        needle_speed_m_s=NEEDLE_SPEED_M_S, needle_travel_m=NEEDLE_TRAVEL_M, scale=SCALE
    )
    run = teleoperate(arm, hand, seed=SEED, delay_s=DELAY_S, progress=progress)
    felt = ruptures_felt(run)
    energy = energy_of(run)
    from_hand = f"{J_TO_MJ * energy.from_hand_J[-1]:.1f} mJ"
    to_hand = f"{J_TO_MJ * energy.to_hand_J[-1]:.1f} mJ"
    is_passive = energy.most_owed_J <= 0.0 <= run.least_energy_J
    rows: dict[str, str] = {}
    for number, rupture in enumerate(felt, 1):
        label = f"rupture {number}: contrast with, without compensation"
        rows[label] = (
            f"{100 * rupture.shown_drop:.0f} %, {100 * rupture.raw_drop:.0f} %"
        )
    rows["alarms for ruptures"] = f"{len(run.alarms_s)} for {len(felt)}"
    rows["energy from the hand, in all"] = from_hand
    rows["energy delivered to the hand, in all"] = to_hand
    energy_mJ = J_TO_MJ * run.least_energy_J
    rows["least energy at the hand's port"] = f"{energy_mJ:.3f} mJ"
    rows["largest force at the hand"] = f"{run.rows('felt_N').max():.2f} N"
    rows["largest force at the base"] = f"{run.rows('raw_N').max():.2f} N"
    drift_mm = M_TO_MM * abs(run.drift_m)
    rows["drift between hand and needle"] = f"{drift_mm:.2f} mm"
    answer = _answer_of(felt, from_hand, to_hand, is_passive=is_passive)
    setting = (
        "An emulated hand drives the needle through three gels, scaled by 0.4, over "
        "a line with 10 ms of delay each way. It feels the estimated force at the "
        "tip, from joint torques alone, instead of the force at the needle's base."
    )
    return DemoResult(
        "Teleoperation, 10 ms of delay each way",
        tuple(rows.items()),
        _charts_of(run, energy),
        answer,
        setting,
    )


def _answer_of(
    felt: list[RuptureFelt], from_hand: str, to_hand: str, *, is_passive: bool
) -> str:
    """Return in a sentence what the hand felt, and whether it was passive."""
    shown = 100 * min((item.shown_drop for item in felt), default=0.0)
    raw = 100 * max((item.raw_drop for item in felt), default=0.0)
    passivity = (
        "never got more than it had given"
        if is_passive
        else "at times got more than it had given"
    )
    return (
        f"At a rupture the force at the hand falls by at least {shown:.0f} %, where "
        f"the force at the base falls by at most {raw:.0f} %; the hand gave "
        f"{from_hand}, got {to_hand} back and {passivity}."
    )


def _charts_of(run: Teleinsertion, energy: HandEnergy) -> tuple[NamedChart, ...]:
    """Return the charts of force, and of energy and travel, over time."""
    marks = _marks_of(run)
    raw = _curve(run, run.rows("raw_N"), "force at the base, raw", palette.READING)
    felt = _curve(run, run.rows("felt_N"), "force at the hand", palette.OURS)
    true = _curve(run, run.rows("tip_N"), "true force at the tip", palette.TRUE_PART)
    forces = (
        Panel(
            y_label="raw\nforce [N]",
            curves=(raw, true),
            limits=whole_range_of((raw, true)),
        ),
        Panel(
            y_label="compensated\nforce [N]",
            curves=(felt, true),
            limits=whole_range_of((felt, true)),
        ),
        _travel_panel(run),
    )
    contrast = Chart(
        title="What the hand feels\nneedle driven by a hand, three gels, 10 ms delay",
        x_label=palette.TIME,
        panels=forces,
        shadings=marks,
        height_in=5.0,
    )
    given = _curve(run, J_TO_MJ * energy.from_hand_J, "came from the hand", GIVEN)
    got = _curve(run, J_TO_MJ * energy.to_hand_J, "delivered to the hand", GOT)
    passive = Chart(
        title="Energy through the handle\n"
        "passive as long as less is delivered than came",
        x_label=palette.TIME,
        panels=(
            Panel(
                y_label="energy [mJ]",
                curves=(given, got),
                limits=whole_range_of((given, got)),
            ),
        ),
        shadings=marks,
    )
    return (
        NamedChart(
            "contrast",
            contrast,
            "Above, the force that friction hides ruptures in; its peaks are friction "
            "too, which grows with speed: after a rupture the hand moves on quickly. "
            "In the middle what the device shows; its peak behind the open clutch is "
            "damping of the hand's quick motion. Each panel has its own scale.",
        ),
        NamedChart(
            "energy",
            passive,
            "True energy through the handle, force times travel, summed apart by its "
            "direction. With the clutch open the hand works against damping of at most "
            "0.5 N.",
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


def _travel_panel(run: Teleinsertion) -> Panel:
    """Return the travel of the needle since the hand took over."""
    depth_m: Array = run.rows("depth_m")
    travel_mm = M_TO_MM * (depth_m - depth_m[0])
    curves = (_curve(run, travel_mm, None, palette.OURS),)
    return Panel(
        y_label="needle's\ntravel [mm]", curves=curves, limits=whole_range_of(curves)
    )


def _curve(
    run: Teleinsertion, values: Array, label: str | None, style: LineStyle
) -> Curve:
    """Return a curve of values at all ticks, shape (n,), over time.

    Of every `DRAWN_TICKS` ticks the largest value is drawn, so that no peak is lost.
    """
    t_s: Array = run.rows("t_s")
    starts = np.arange(0, len(t_s), DRAWN_TICKS)
    return Curve(
        style=style, x=t_s[starts], y=np.maximum.reduceat(values, starts), label=label
    )
