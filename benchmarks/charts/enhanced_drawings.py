"""Draws the friction compensation in one run: Figures 8, 9, 11 to 14, and other runs."""

import math
from dataclasses import dataclass

from benchmarks.charts.enhanced_chart import READINGS, enhanced_chart
from benchmarks.charts.paper_figures import (
    FRICTION_IN_PAPER,
    RESIDUE_IN_PAPER,
    RUPTURES_IN_PAPER,
)
from benchmarks.charts.parameter_chart import parameter_chart
from benchmarks.charts.sketchbook import Sketchbook
from benchmarks.charts.true_friction import true_friction
from benchmarks.charts.tuned_paper import sigma1_N
from benchmarks.drawing import Fact
from benchmarks.methods.alarm import cumulative_friction_Ns_per_m
from benchmarks.methods.force_reading import ForceReading
from benchmarks.methods.identified import Identified
from benchmarks.metrics.enhanced_metrics import enhanced_metrics
from benchmarks.signals.insertion_truth import InsertionTruth

OURS, PUBLISHED = "ours", "as published"
ALT = "Axial force given, predicted and without friction, beside the truth, "
PARAMETERS = (
    "What was identified, from above: stiffness and friction of the layer the tip is in, and the "
    "friction of all layers left. At constant speed the first two are one number until a rupture "
    "tells them apart, hence the broad band. Transients may leave the panel."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """What several methods made of one force.

    Attributes:
        ours: One setting for everything.
        tuned: The published method as its authors ran it.
        published: The published method with one setting and the measured speed.
        kelvin_voigt: `tuned` with the Kelvin-Voigt model, if it is to be shown.
        ft: The F/T reading, where the force was another.
        on_ft: Ours on the F/T reading, likewise.
    """

    ours: Identified
    tuned: Identified
    published: Identified
    kelvin_voigt: Identified | None = None
    ft: ForceReading | None = None
    on_ft: Identified | None = None


def draw_enhanced(book: Sketchbook, figure: str, truth: InsertionTruth, told: Compared) -> None:
    """The forces by each method; for a figure of the paper the parameters as well.

    Args:
        book: Where to draw.
        figure: Of the paper; empty for none.
        truth: Of the run.
        told: By the methods.
    """
    _draw_published(book, figure, truth, told)
    _draw_ours(book, figure, truth, told)
    if figure:
        _draw_parameters(book, figure, truth, told)


def _draw_published(book: Sketchbook, figure: str, truth: InsertionTruth, told: Compared) -> None:
    source, item = told.ours.source, told.tuned
    panel = "a" if figure else ""
    title = book.title(figure, panel, f"{READINGS[source]}, {PUBLISHED}")
    none = "" if item.alarms else " No rupture was detected, so nothing is taken off."
    friction = cumulative_friction_Ns_per_m(item.alarms)
    book.add(
        enhanced_chart(title, truth, item, told.kelvin_voigt, told.ft, has_speed=figure == "9"),
        f"{source}-paper",
        figure=figure,
        panel=panel,
        alt=ALT + PUBLISHED,
        caption="The published method as its authors ran it: commanded speed, "
        f"σ₁ = {sigma1_N(figure, source):g} N.{none}",
        tuned_friction_Ns_per_m=friction if source == "ft" else math.nan,
    )


def _draw_ours(book: Sketchbook, figure: str, truth: InsertionTruth, told: Compared) -> None:
    source = told.ours.source
    panel = "a" if figure else ""
    title = book.title(figure, panel, f"{READINGS[source]}, {OURS}")
    book.add(
        enhanced_chart(title, truth, told.ours, None, told.ft, has_speed=figure == "9"),
        f"{source}-default",
        figure=figure,
        panel=panel,
        alt=ALT + OURS,
        caption="Ours: measured speed, one setting for every recording.",
        facts=_facts(figure, truth, told) if figure else (),
    )


def _draw_parameters(book: Sketchbook, figure: str, truth: InsertionTruth, told: Compared) -> None:
    source = told.ours.source
    title = book.title(figure, "b", f"parameters from the {READINGS[source]}")
    book.add(
        parameter_chart(title, truth, told.ours, told.tuned, told.kelvin_voigt, told.on_ft),
        f"{source}-parameters",
        figure=figure,
        panel="b",
        alt="Stiffness, friction per length and cumulative friction over time, both methods",
        caption=PARAMETERS,
    )


def _facts(figure: str, truth: InsertionTruth, told: Compared) -> tuple[Fact, ...]:
    methods = {
        "published, tuned, here": told.tuned,
        "published, one setting, here": told.published,
        "ours, one setting, here": told.ours,
    }
    _, steps = true_friction(truth)["cumulative_friction_Ns_per_m"]
    return (
        Fact(
            what=f"ruptures detected (true: {len(truth.ruptures)})",
            paper=RUPTURES_IN_PAPER[figure],
            here=tuple((head, _ruptures(item, truth)) for head, item in methods.items()),
        ),
        Fact(
            what=f"cumulative friction in the end (true: {steps[-1]:.0f}) [Ns/m]",
            paper=FRICTION_IN_PAPER.get(figure, "not stated"),
            here=tuple(
                (head, f"{cumulative_friction_Ns_per_m(item.alarms):.0f}")
                for head, item in methods.items()
            ),
        ),
        Fact(
            what="|enhanced force| after the last exit, of the force there [%]",
            paper=RESIDUE_IN_PAPER[figure],
            here=tuple((head, _residue(item, truth)) for head, item in methods.items()),
        ),
    )


def _ruptures(item: Identified, truth: InsertionTruth) -> str:
    """Those of the insertion; on the way out there are none to find."""
    inside = [alarm.alarm_s for alarm in item.alarms if alarm.alarm_s <= truth.insertion_end_s]
    times = ", ".join(f"{alarm_s - truth.tare_end_s:.1f}" for alarm_s in inside)
    return f"{len(inside)}, at {times} s" if inside else "none"


def _residue(item: Identified, truth: InsertionTruth) -> str:
    return f"{enhanced_metrics(item, truth).get('exit_residue_pct', math.nan):.1f}"
