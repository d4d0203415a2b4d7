"""A job on simulated tissue, from its name to its numbers and its pictures."""

from pathlib import Path

from benchmarks.arm_identification import arm_signals
from benchmarks.benchmark import Findings
from benchmarks.identification_metrics import identification_metrics, identify_all
from benchmarks.insertion_truth import truth_of_run
from benchmarks.job import Job, Progress
from benchmarks.measurement import Measurement
from benchmarks.needle_benchmark import NEEDLE, run_needle
from benchmarks.progress_part import progress_part
from benchmarks.simulated import (
    RANDOM_STACK,
    SimulatedCase,
    scenario_of,
    simulated_case,
    simulated_metrics,
)

READING_SHARE = 0.85
"""Of a job's time until identification begins, for the progress bar."""


def run_simulated(job: Job, progress: Progress) -> Findings:
    """Simulate, read every sensor, identify, measure, draw."""
    chosen = scenario_of(job)
    if job.plant == NEEDLE:
        return run_needle(job, chosen, progress, is_drawn=job.benchmark == RANDOM_STACK)
    case = simulated_case(job, chosen, progress_part(progress, 0.0, READING_SHARE))
    pictures: list[Path] = []
    picture = job.picture()
    if picture is not None:
        # Lazily: without --report nobody waits for matplotlib.
        from benchmarks.force_figure import save_force_figure

        save_force_figure(picture, _title(case), case.truth, case.readings)
        pictures.append(picture)
    measured = simulated_metrics(case)
    if chosen.layers:
        measured += _identify(job, case, pictures)
    return Findings(measured, tuple(pictures))


def _identify(job: Job, case: SimulatedCase, pictures: list[Path]) -> list[Measurement]:
    """Numbers of online identification on every source; its picture is appended."""
    truth = truth_of_run(case.run)
    measured: list[Measurement] = []
    drawn = []
    for signals in arm_signals(case):
        identified = identify_all(signals, truth)
        measured += identification_metrics(signals, identified, truth)
        drawn += identified
    picture = job.picture("identification")
    if picture is not None:
        from benchmarks.identification_figure import save_identification_figure

        save_identification_figure(picture, _title(case), truth, drawn)
        pictures.append(picture)
    return measured


def _title(case: SimulatedCase) -> str:
    return f"{case.run.scenario.title} ({case.run.arm} arm, seed {case.run.seed})"
