"""A benchmark on the simulated arm: an insertion, the sensors that watch it, the metrics."""

from dataclasses import dataclass

from benchmarks.job import Job, Progress, progress_part
from benchmarks.methods.force_reading import ForceReading
from benchmarks.methods.ft_force import ft_force
from benchmarks.methods.sensor_settings import METHODS, on_lwr
from benchmarks.methods.virtual_force import virtual_force
from benchmarks.metrics.measurement import Measurement
from benchmarks.metrics.residual_metrics import residual_metrics
from benchmarks.metrics.wrench_metrics import wrench_metrics
from benchmarks.signals.force_truth import ForceTruth
from benchmarks.signals.joint_signals import JointSignals
from groundtruth import Run, Scenario, simulate

SIMULATION_SHARE = 0.5
"""Of a job's time, for the progress bar."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedCase:
    """Everything that metrics and pictures of one simulated insertion may look at.

    Attributes:
        run: The insertion with its truth.
        signals: What the arm sent.
        truth: What force readings are judged against.
        readings: Axial force of every source and method.
    """

    run: Run
    signals: JointSignals
    truth: ForceTruth
    readings: tuple[ForceReading, ...]


def simulated_case(job: Job, chosen: Scenario, progress: Progress) -> SimulatedCase:
    """Simulate a scenario and read every sensor."""
    run = simulate(chosen, job.plant, job.seed, progress_part(progress, 0.0, SIMULATION_SHARE))
    signals = JointSignals.of_run(run)
    # Where the wrist turns, the F/T reading is mostly the needle's weight.
    readings = [ft_force(run)] if chosen.layers else []
    start = SIMULATION_SHARE
    for method, config in METHODS.items():
        end = start + (1.0 - SIMULATION_SHARE) / len(METHODS)
        part = progress_part(progress, start, end)
        reading = virtual_force(run.robot, signals, on_lwr(config), method, run.tare_end_s, part)
        readings.append(reading)
        start = end
    return SimulatedCase(run=run, signals=signals, truth=_truth(run), readings=tuple(readings))


def simulated_metrics(case: SimulatedCase) -> list[Measurement]:
    """Every number of one simulated insertion."""
    found = residual_metrics(case.run, case.signals)
    for reading in case.readings:
        found += wrench_metrics(reading, case.truth)
    return found


def _truth(run: Run) -> ForceTruth:
    """From first contact to the end of withdrawal; without tissue, all after the tare."""
    free = not run.scenario.layers
    return ForceTruth(
        t_s=run.truth.t_s,
        depth_m=run.truth.depth_m,
        axial_N=run.truth.axial_N,
        zeroed_s=run.tare_end_s,
        start_s=run.tare_end_s if free else run.contact_s,
        end_s=run.truth.t_s[-1] if free else run.withdrawn_s,
    )
