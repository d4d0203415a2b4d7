"""A benchmark on the simulated arm: an insertion, the sensors that watch it, the metrics."""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.benchmark import Drawing, Findings, Job, Progress, progress_part
from benchmarks.force_metrics import residual_metrics, wrench_metrics
from benchmarks.identification_metrics import Signals, identification_metrics, identify_all
from benchmarks.methods import METHODS, ForceReading, ft_force, on_lwr, virtual_force
from benchmarks.metric_catalogue import Measurement
from benchmarks.plots import force_drawings, identification_drawings
from benchmarks.rows import Method, Source
from benchmarks.signals import (
    ForceTruth,
    JointSignals,
    MeasuredTravel,
    NeedleSignal,
    measured_travel,
    smoothed,
    truth_of_needle,
    truth_of_run,
)
from groundtruth import ForceNoise, NeedleRun, Run, Scenario, insert_needle, simulate
from groundtruth.force_noise import MINI45
from groundtruth.scenarios import DRAWN, named_scenario

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


# Identification on the simulated arm: joint signals in, enhanced force out.


PAPER_SPEED_s = 0.02
"""Time constant of the low-pass on the speed that the published method is given. It takes speed as
exact: as an arm measures it (0.12 mm/s of noise on 2.3 mm/s) its friction error on the 50 % gel is
125 %, through this low-pass 11 %. Ours has the same inside and is given the raw speed."""


def arm_signals(case: SimulatedCase) -> list[Signals]:
    """What identifiers get from the arm, one entry per source.

    Depth and speed come from measured joints through the estimator's own robot. The F/T reading
    is the same for both methods; the virtual force of a method is that of its own sensor, so that
    under `virtual` each whole chain is judged.
    """
    measured = measured_travel(case.run.robot, case.signals, case.run.tare_end_s)
    travel: dict[Method, MeasuredTravel] = {
        "default": measured,
        "published": smoothed(measured, case.signals.dt_s, PAPER_SPEED_s),
    }
    by_key = {(item.source, item.method): item for item in case.readings}
    ft = by_key["ft", "default"]
    wanted: list[tuple[Source, dict[Method, ForceReading]]] = [
        ("ft", {"default": ft, "published": ft}),
        (
            "virtual",
            {
                "default": by_key["virtual", "default"],
                "published": by_key["virtual", "published"],
            },
        ),
    ]
    return [
        {
            method: _signal(source, case.signals, travel[method], item)
            for method, item in readings.items()
        }
        for source, readings in wanted
    ]


def _signal(
    source: Source, signals: JointSignals, travel: MeasuredTravel, reading: ForceReading
) -> NeedleSignal:
    return NeedleSignal(
        source=source,
        t_s=signals.t_s,
        depth_m=travel.depth_m,
        speed_m_s=travel.speed_m_s,
        force_N=reading.axial_N,
    )


# A simulated needle without an arm: the identification alone, at half a second a run.


NEEDLE = "needle"
"""The plant of a needle-only simulation."""
NOISE_FACTOR = (0.5, 2.0)
"""Range of the noise of drawn runs, of white noise and drift each: a better and a worse sensor."""


def run_needle(job: Job, chosen: Scenario, progress: Progress, *, is_drawn: bool) -> Findings:
    """Insert, identify by both methods, measure, draw.

    Args:
        job: What to do; its seed is that of the noise.
        chosen: The scenario; without tissue there is nothing to identify.
        progress: Told the share done.
        is_drawn: Whether the noise level is drawn with the scenario.
    """
    if not chosen.layers:
        return Findings([])
    noise = drawn_noise(np.random.default_rng([job.seed, 1])) if is_drawn else MINI45
    run = insert_needle(chosen, seed=job.seed, noise=noise)
    progress(0.2)
    truth, signal = truth_of_needle(run), _signal_needle_benchmark(run)
    signals: Signals = {"default": signal, "published": signal}
    identified = identify_all(signals, truth)
    measured = list(identification_metrics(signals, identified, truth))
    if job.drawings is None:
        return Findings(measured)
    found = [(signals, identified)]
    commanded = chosen.motion.speed_m_s(truth.t_s)
    return Findings(measured, identification_drawings(job, job.drawings, truth, commanded, found))


def drawn_noise(rng: np.random.Generator) -> ForceNoise:
    """A sensor somewhat better or worse than the catalogued one."""
    white, drift = np.exp(rng.uniform(*np.log(NOISE_FACTOR), size=2)).tolist()
    return replace(
        MINI45,
        white_std_N=white * MINI45.white_std_N,
        drift_std_N_per_s=drift * MINI45.drift_std_N_per_s,
    )


def _signal_needle_benchmark(run: NeedleRun) -> NeedleSignal:
    """The zero of depth is where the tare ended: a user does not know the surface."""
    zero = run.depth_m[int(np.searchsorted(run.t_s, run.tare_end_s))]
    return NeedleSignal(
        source="ft",
        t_s=run.t_s,
        depth_m=run.depth_m - zero,
        speed_m_s=run.speed_m_s,
        force_N=run.force_N,
    )


# A job on simulated tissue, from its name to its numbers and its charts.


READING_SHARE = 0.85
"""Of a job's time until identification begins, for the progress bar."""


def run_simulated(job: Job, progress: Progress) -> Findings:
    """Simulate, read every sensor, identify, measure, draw."""
    chosen = named_scenario(job.benchmark, job.seed)
    if job.plant == NEEDLE:
        return run_needle(job, chosen, progress, is_drawn=job.benchmark in DRAWN)
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
