"""Every chart of one run, drawn in the process that ran it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.charts.enhanced_drawings import Compared, draw_enhanced
from benchmarks.charts.force_drawings import draw_forces
from benchmarks.charts.offline_drawings import draw_offline
from benchmarks.charts.paper_figures import ENHANCED_FIGURES
from benchmarks.charts.sketchbook import Sketchbook
from benchmarks.charts.tuned_paper import tuned_paper
from benchmarks.drawing import Drawing
from benchmarks.job import Job
from benchmarks.methods.force_reading import ForceReading
from benchmarks.methods.identified import Identified
from benchmarks.metrics.identification_metrics import Signals
from benchmarks.signals.force_truth import ForceTruth
from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.verdict.scenario_groups import GELS
from identification import PAPER_KV

Array = NDArray[np.float64]
Found = Sequence[tuple[Signals, Sequence[Identified]]]
"""Of every source: what the methods were given, and what they made of it."""


def force_drawings(
    job: Job, folder: Path, truth: ForceTruth, readings: Sequence[ForceReading]
) -> tuple[Drawing, ...]:
    """The forces of a run."""
    book = Sketchbook(job, folder)
    draw_forces(book, truth, readings)
    return tuple(book.drawings)


def identification_drawings(
    job: Job,
    folder: Path,
    truth: InsertionTruth,
    commanded_m_s: Array,
    found: Found,
    ft: ForceReading | None = None,
) -> tuple[Drawing, ...]:
    """The identification in a run.

    Args:
        job: The run.
        folder: Where the drawings go.
        truth: Of the run.
        commanded_m_s: Speed as the robot was told, shape (n,).
        found: By source, the F/T sensor's first.
        ft: The F/T reading, if another source is among them.
    """
    book = Sketchbook(job, folder)
    draw_offline(book, found[0][0]["default"], truth)
    on_ft = {item.method: item for item in found[0][1]}["default"]
    for signals, identified in found:
        by_method = {item.method: item for item in identified}
        source = by_method["default"].source
        figure = ENHANCED_FIGURES.get((job.benchmark, source), "")
        if not figure and source != _usual_source(job, found):
            continue
        is_ft = source == "ft"
        given, has_kv = signals["paper"], bool(figure) and is_ft
        told = Compared(
            ours=by_method["default"],
            tuned=tuned_paper(given, truth, commanded_m_s, figure),
            published=by_method["paper"],
            kelvin_voigt=tuned_paper(given, truth, commanded_m_s, figure, PAPER_KV)
            if has_kv
            else None,
            ft=None if is_ft else ft,
            on_ft=None if is_ft else on_ft,
        )
        draw_enhanced(book, figure, truth, told)
    return tuple(book.drawings)


def _usual_source(job: Job, found: Found) -> str:
    """What is shown without a figure: the whole chain; of gels, for Table I, the F/T sensor."""
    return "ft" if job.benchmark in GELS or len(found) == 1 else "virtual"
