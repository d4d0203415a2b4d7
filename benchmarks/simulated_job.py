"""A job on simulated tissue, from its name to its numbers and its charts."""

from benchmarks.arm_identification import arm_signals
from benchmarks.benchmark import Findings
from benchmarks.identification_metrics import identification_metrics, identify_all
from benchmarks.insertion_truth import truth_of_run
from benchmarks.job import Job, Progress, progress_part
from benchmarks.measurement import Measurement
from benchmarks.needle_benchmark import NEEDLE, run_needle
from benchmarks.report.drawing import Drawing
from benchmarks.report.run_drawings import force_drawings, identification_drawings
from benchmarks.simulated import SimulatedCase, simulated_case, simulated_metrics
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
