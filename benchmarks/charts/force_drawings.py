"""Draws the forces of one run: Figure 5, and the same for every other run."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.charts.force_chart import force_over_depth, force_over_time, rmse_N
from benchmarks.charts.paper_figures import FORCE_PANELS
from benchmarks.charts.sketchbook import Sketchbook
from benchmarks.drawing import Fact
from benchmarks.methods.force_reading import ForceReading
from benchmarks.metrics.force_lag import force_lag_s
from benchmarks.signals.force_truth import ForceTruth
from benchmarks.verdict.published import PUBLISHED_RMSE_N

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
        caption="Above the axial force, below its error against the true force; peaks where a "
        "layer gives way may leave the lower panel. RMSE from first contact to the end of the "
        "withdrawal.",
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
        _of_both(
            f"`{scenario}`: delay behind the true force [ms]",
            "–",
            [f"{1e3 * _delay_s(item, truth):.0f}" for item in (paper, ours)],
        ),
        _of_both(
            f"`{scenario}`: true force within 2 stated standard deviations [%]",
            "–",
            ["none stated", f"{100.0 * _share_within(ours, truth):.1f}"],
        ),
    )


def _fact(
    what: str,
    printed: str,
    truth: ForceTruth,
    both: tuple[ForceReading, ForceReading],
    target_N: Array,
) -> Fact:
    return _of_both(what, printed, [f"{rmse_N(item, truth, target_N):.4f}" for item in both])


def _of_both(what: str, printed: str, values: Sequence[str]) -> Fact:
    heads = ("published, here", "ours, here")
    return Fact(what=what, paper=printed, here=tuple(zip(heads, values, strict=True)))


def _delay_s(item: ForceReading, truth: ForceTruth) -> float:
    part = truth.judged
    return force_lag_s(truth.t_s[part], item.axial_N[part], truth.axial_N[part])


def _share_within(item: ForceReading, truth: ForceTruth) -> float:
    part = truth.judged
    error = np.abs(item.axial_N - truth.axial_N)[part]
    return float(np.mean(error <= 2.0 * item.std_N[part]))
