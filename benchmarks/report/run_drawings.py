"""Every chart of one run, drawn in the process that ran it."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.force_reading import ForceReading
from benchmarks.force_truth import ForceTruth
from benchmarks.identification_metrics import Signals
from benchmarks.identified import Identified, identify
from benchmarks.insertion_truth import InsertionTruth
from benchmarks.job import Job
from benchmarks.report.drawing import Drawing
from benchmarks.report.enhanced_drawings import draw_enhanced
from benchmarks.report.force_drawings import draw_forces
from benchmarks.report.offline_drawings import draw_offline
from benchmarks.report.paper_figures import ENHANCED_FIGURES
from benchmarks.report.sketchbook import Sketchbook
from identification import PAPER_KV

Found = Sequence[tuple[Signals, Sequence[Identified]]]
"""Of every source: what the methods were given, and what they made of it."""


def force_drawings(
    job: Job, folder: Path, truth: ForceTruth, readings: Sequence[ForceReading], what: str
) -> tuple[Drawing, ...]:
    """The forces of a run."""
    book = Sketchbook(job, folder)
    draw_forces(book, truth, readings, what)
    return tuple(book.drawings)


def identification_drawings(
    job: Job,
    folder: Path,
    truth: InsertionTruth,
    found: Found,
    ft: ForceReading | None = None,
) -> tuple[Drawing, ...]:
    """The identification in a run.

    Args:
        job: The run.
        folder: Where the drawings go.
        truth: Of the run.
        found: The F/T sensor's first.
        ft: The F/T reading, if another source is among them.
    """
    book = Sketchbook(job, folder)
    on_ft = {item.method: item for item in found[0][1]}["default"]
    draw_offline(book, found[0][0]["default"], truth)
    for signals, identified in found:
        by_method = {item.method: item for item in identified}
        ours, published = by_method["default"], by_method["paper"]
        figure = ENHANCED_FIGURES.get((job.benchmark, ours.source), "")
        is_ft = ours.source == "ft"
        # Runs beside the paper's are shown once: by the whole chain, if there is one.
        if not figure and is_ft and len(found) > 1:
            continue
        kv = identify(signals["paper"], truth, "paper", PAPER_KV) if figure and is_ft else None
        draw_enhanced(
            book,
            figure,
            truth,
            published,
            ours,
            kelvin_voigt=kv,
            ft=None if is_ft else ft,
            on_ft=None if is_ft else on_ft,
        )
    return tuple(book.drawings)
