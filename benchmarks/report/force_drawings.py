"""Draws the forces of one run: Figure 5, and the same for every other run."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.force_reading import ForceReading
from benchmarks.force_truth import ForceTruth
from benchmarks.published import PUBLISHED_RMSE_N
from benchmarks.report.drawing import Fact
from benchmarks.report.force_chart import force_over_depth, force_over_time, rmse_N
from benchmarks.report.paper_figures import FORCE_PANELS
from benchmarks.report.sketchbook import Sketchbook

Array = NDArray[np.float64]

ALT = "Axial force of the F/T sensor, the published and our virtual sensor beside the true force"


def draw_forces(book: Sketchbook, truth: ForceTruth, readings: Sequence[ForceReading]) -> None:
    """Force and error over time, and over depth where the paper shows it so."""
    panels = FORCE_PANELS.get(book.job.benchmark)
    figure, (over_time, over_depth) = ("5", panels) if panels else ("", ("", ""))
    title = book.title(figure, over_time, "axial force over time")
    book.add(
        force_over_time(title, truth, readings),
        "force-time",
        figure=figure,
        panel=over_time,
        alt=f"{ALT}, over time; below, the errors",
        caption="Above the axial force, below its error against the true force. RMSE from first "
        "contact to the end of the withdrawal.",
        facts=_facts(book.job.benchmark, truth, readings) if figure else (),
    )
    if panels:
        title = book.title(figure, over_depth, "axial force over depth")
        book.add(
            force_over_depth(title, truth, readings),
            "force-depth",
            figure=figure,
            panel=over_depth,
            alt=f"{ALT}, over depth; below, the errors",
            caption="The same over depth: the upper branch on the way in, the lower on the way "
            "out, where friction holds the needle back.",
        )


def _facts(scenario: str, truth: ForceTruth, readings: Sequence[ForceReading]) -> tuple[Fact, ...]:
    by_key = {(item.source, item.method): item for item in readings}
    ft, paper, ours = (
        by_key.get(key) for key in (("ft", "default"), ("virtual", "paper"), ("virtual", "default"))
    )
    if ft is None or paper is None or ours is None:
        return ()
    name = f"`{scenario}`: RMSE against"
    printed = f"{PUBLISHED_RMSE_N[scenario]:g}"
    return (
        _fact(f"{name} the F/T sensor [N]", printed, truth, (paper, ours), ft.axial_N),
        _fact(f"{name} the true force [N]", "–", truth, (paper, ours), truth.axial_N),
    )


def _fact(
    what: str,
    printed: str,
    truth: ForceTruth,
    both: tuple[ForceReading, ForceReading],
    target_N: Array,
) -> Fact:
    values = [f"{rmse_N(item, truth, target_N):.4f}" for item in both]
    heads = ("published, here", "ours, here")
    return Fact(what=what, paper=printed, here=tuple(zip(heads, values, strict=True)))
