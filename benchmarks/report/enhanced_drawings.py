"""Draws the friction compensation in one run: Figures 8, 9, 11 to 14, and other runs."""

import numpy as np

from benchmarks.enhanced_metrics import enhanced_metrics
from benchmarks.force_reading import ForceReading
from benchmarks.identified import Identified
from benchmarks.insertion_truth import InsertionTruth
from benchmarks.report.drawing import Fact
from benchmarks.report.enhanced_chart import READINGS, enhanced_chart
from benchmarks.report.paper_figures import (
    FRICTION_IN_PAPER,
    RESIDUE_IN_PAPER,
    RUPTURES_IN_PAPER,
)
from benchmarks.report.parameter_chart import parameter_chart
from benchmarks.report.sketchbook import Sketchbook
from benchmarks.report.true_friction import true_friction

OURS, PUBLISHED = "ours", "as published"
MARKS = (
    "Continuous lines: ruptures as they were detected; dashed ones: friction is identified and "
    "taken off from there on, by ours twice for each layer. Grey: when the layer really gave way."
)
NOTHING_FOUND = " No rupture was detected, so nothing is taken off."
RETUNED = (
    " One setting of the published method, that of the paper's text, serves every run here; its "
    "authors changed σ₁ and β from recording to recording."
)


def draw_enhanced(
    book: Sketchbook,
    figure: str,
    truth: InsertionTruth,
    published: Identified,
    ours: Identified,
    kelvin_voigt: Identified | None = None,
    ft: ForceReading | None = None,
    on_ft: Identified | None = None,
) -> None:
    """The forces by each method, and the parameters of all.

    Args:
        book: Where to draw.
        figure: Of the paper; empty for none, then the parameters are not drawn.
        truth: Of the run.
        published: By the published method.
        ours: By ours.
        kelvin_voigt: By the published method with the Kelvin-Voigt model.
        ft: The F/T reading, where the force was another.
        on_ft: By ours on the F/T reading, likewise.
    """
    source = ours.source
    for item, who in ((published, PUBLISHED), (ours, OURS)):
        title = book.title(figure, "a" if figure else "", f"{READINGS[source]}, {who}")
        other = kelvin_voigt if item is published else None
        note = (RETUNED if item is published else "") if item.alarms else NOTHING_FOUND
        book.add(
            enhanced_chart(title, truth, item, other, ft, has_speed=figure == "9"),
            f"{source}-{item.method}",
            figure=figure,
            alt=f"Axial force given, predicted and without friction, {who}, beside the truth",
            caption=f"Forces, {who}. {MARKS}{note}",
            facts=_facts(figure, truth, published, ours) if figure and item is ours else (),
        )
    if not figure:
        return
    title = book.title(figure, "b", f"parameters from the {READINGS[source]}")
    book.add(
        parameter_chart(title, truth, ours, published, kelvin_voigt, on_ft),
        f"{source}-parameters",
        figure=figure,
        alt="Stiffness, friction per length and cumulative friction over time, both methods",
        caption="What was identified, from above: stiffness and friction of the layer the tip is "
        "in, and the friction of all layers left. At constant speed the first two are one number "
        "until a rupture tells them apart, hence the broad band. Transients may leave the panel.",
    )


def _facts(
    figure: str, truth: InsertionTruth, published: Identified, ours: Identified
) -> tuple[Fact, ...]:
    both = (published, ours)
    residues = [enhanced_metrics(item, truth).get("exit_residue_pct", np.nan) for item in both]
    _, steps = true_friction(truth)["cumulative_friction_Ns_per_m"]
    frictions = [f"{_friction(item):.0f}" for item in both]
    return (
        Fact(
            what=f"ruptures detected (true: {len(truth.ruptures)})",
            paper=RUPTURES_IN_PAPER[figure],
            published=_ruptures(published, truth),
            ours=_ruptures(ours, truth),
        ),
        Fact(
            what=f"cumulative friction in the end (true: {steps[-1]:.0f}) [Ns/m]",
            paper=FRICTION_IN_PAPER.get(figure, "not stated"),
            published=frictions[0],
            ours=frictions[1],
        ),
        Fact(
            what="enhanced force after the last exit, of the force there [%]",
            paper=RESIDUE_IN_PAPER[figure],
            published=f"{residues[0]:.1f}",
            ours=f"{residues[1]:.1f}",
        ),
    )


def _ruptures(item: Identified, truth: InsertionTruth) -> str:
    times = ", ".join(f"{alarm.alarm_s - truth.tare_end_s:.1f}" for alarm in item.alarms)
    return f"{len(item.alarms)}, at {times} s" if times else "none"


def _friction(item: Identified) -> float:
    """Sum over the layers left, each at the speed of its rupture."""
    layers = [alarm.layer for alarm in item.alarms if alarm.layer is not None]
    return sum(layer.friction_N / max(layer.rupture.speed_m_s, 1e-9) for layer in layers)
