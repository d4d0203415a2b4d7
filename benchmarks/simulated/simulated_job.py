"""A job on simulated tissue, from its name to its numbers and its charts."""

from benchmarks.benchmark import Findings
from benchmarks.charts.run_drawings import force_drawings, identification_drawings
from benchmarks.drawing import Drawing
from benchmarks.job import Job, Progress, progress_part
from benchmarks.metrics.identification_metrics import identification_metrics, identify_all
from benchmarks.metrics.measurement import Measurement
from benchmarks.signals.insertion_truth import truth_of_run
from benchmarks.simulated.arm_case import SimulatedCase, simulated_case, simulated_metrics
from benchmarks.simulated.arm_identification import arm_signals
from benchmarks.simulated.needle_benchmark import NEEDLE, run_needle
from groundtruth.named_scenario import named_scenario
from groundtruth.random_stack import RANDOM_STACK

READING_SHARE = 0.85
"""Of a job's time until identification begins, for the progress bar."""


def run_simulated(job: Job, progress: Progress) -> Findings:
    """Simulate, read every sensor, identify, measure, draw."""
    chosen = named_scenario(job.benchmark, job.seed)
    if job.plant == NEEDLE:
        return run_needle(job, chosen, progress, is_drawn=job.benchmark == RANDOM_STACK)
    case = simulated_case(job, chosen, progress_part(progress, 0.0, READING_SHARE))
    drawings: tuple[Drawing, ...] = ()
    if job.drawings is not None:
        drawings += force_drawings(job, job.drawings, case.truth, case.readings)
    measured = simulated_metrics(case)
    if chosen.layers:
        found = _identify(job, case)
        measured += found.measurements
        drawings += found.drawings
    return Findings(measured, drawings)


def _identify(job: Job, case: SimulatedCase) -> Findings:
    """Online identification on every source."""
    truth = truth_of_run(case.run)
    measured: list[Measurement] = []
    found = []
    for signals in arm_signals(case):
        identified = identify_all(signals, truth)
        measured += identification_metrics(signals, identified, truth)
        found.append((signals, identified))
    if job.drawings is None:
        return Findings(measured)
    ft = next(item for item in case.readings if item.source == "ft")
    commanded = case.run.scenario.motion.speed_m_s(truth.t_s)
    drawings = identification_drawings(job, job.drawings, truth, commanded, found, ft)
    return Findings(measured, drawings)
