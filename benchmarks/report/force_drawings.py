"""Draws the forces of one run: Figure 5, and the same for every other run."""

from collections.abc import Sequence

from benchmarks.force_reading import ForceReading
from benchmarks.force_truth import ForceTruth
from benchmarks.published import PUBLISHED_RMSE_N
from benchmarks.report.drawing import Fact
from benchmarks.report.force_chart import force_over_depth, force_over_time, rmse_N
from benchmarks.report.paper_figures import FORCE_PANELS
from benchmarks.report.sketchbook import Sketchbook

ALT = "Axial force of the F/T sensor, the published and our virtual sensor beside the true force"


def draw_forces(
    book: Sketchbook, truth: ForceTruth, readings: Sequence[ForceReading], what: str
) -> None:
    """Force and error over time, and over depth where the paper shows it so."""
    panels = FORCE_PANELS.get(book.job.benchmark)
    figure, (over_time, over_depth) = ("5", panels) if panels else ("", ("", ""))
    title = book.title(figure, over_time, f"axial force over time, {what}")
    book.add(
        force_over_time(title, truth, readings),
        "force-time",
        figure=figure,
        alt=f"{ALT}, over time; below, the errors",
        caption="Above the axial force, below its error against the true force. RMSE from first "
        "contact to the end of the withdrawal.",
        facts=_facts(book.job.benchmark, truth, readings) if figure else (),
    )
    if panels:
        title = book.title(figure, over_depth, f"axial force over depth, {what}")
        book.add(
            force_over_depth(title, truth, readings),
            "force-depth",
            figure=figure,
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
    against_ft = [f"{rmse_N(item, truth, ft.axial_N):.4f}" for item in (paper, ours)]
    against_truth = [f"{rmse_N(item, truth):.4f}" for item in (paper, ours)]
    name = f"`{scenario}`: RMSE against"
    return (
        Fact(
            what=f"{name} the F/T sensor [N]",
            paper=f"{PUBLISHED_RMSE_N[scenario]:g}",
            published=against_ft[0],
            ours=against_ft[1],
        ),
        Fact(
            what=f"{name} the true force [N]",
            paper="–",
            published=against_truth[0],
            ours=against_truth[1],
        ),
    )
