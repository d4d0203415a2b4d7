"""Benchmarks on simulated insertions: by the arm, by the needle alone, and of the observers."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from benchmarks.benchmark import Drawing, Findings, Job, Progress, progress_part
from benchmarks.force_plots import force_figures
from benchmarks.identification_figures import draw_identification
from benchmarks.identification_metrics import Signals, identify_all, measure_identification
from benchmarks.methods import (
    METHODS,
    ForceReading,
    ft_force,
    on_lwr,
    residual_metrics,
    virtual_force,
    wrench_metrics,
)
from benchmarks.rows import Measurement, Method, Source
from benchmarks.signals import (
    ForceTruth,
    InsertionTruth,
    JointSignals,
    NeedleSignal,
    insertion_truth,
    measured_travel,
    smoothed,
    tool_jacobians,
)
from groundtruth import (
    PLANT_MODELS,
    ForceNoise,
    PlantModel,
    Run,
    Scenario,
    insert_needle,
    simulate,
)
from groundtruth.force_noise import MINI45
from groundtruth.scenarios import DRAWN, named_scenario
from residual import KalmanObserver, MomentumObserver

Array = NDArray[np.float64]

NEEDLE = "needle"
"""The plant of a simulation without an arm."""
SIMULATION_PART, READING_PART = 0.5, 0.85
"""Of a job's time until the simulation has ended and until identification begins, for the progress
bar."""


def run_simulated(job: Job, progress: Progress) -> Findings:
    """Simulate, read every sensor, identify, measure, draw."""
    chosen = named_scenario(job.benchmark, job.seed)
    if job.plant == NEEDLE:
        return run_needle(job, chosen, progress, is_drawn=job.benchmark in DRAWN)
    case = simulated_case(job, chosen, progress_part(progress, 0.0, READING_PART))
    drawings: tuple[Drawing, ...] = ()
    if job.drawings is not None:
        drawings += force_figures(job, job.drawings, case.truth, case.readings)
    measured = simulated_metrics(case)
    if chosen.layers:
        ft = next(item for item in case.readings if item.source == "ft")
        truth = insertion_truth(case.run)
        found = _identify(job, arm_signals(case), truth, case.run.scenario, ft)
        measured += found.measurements
        drawings += found.drawings
    return Findings(measured, drawings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedCase:
    """Everything that metrics and figures of one simulated insertion may use."""

    run: Run  # the insertion with its ground truth
    signals: JointSignals  # what the arm sent
    truth: ForceTruth  # what force readings are judged against
    readings: tuple[ForceReading, ...]  # axial force of every source and method


def simulated_case(job: Job, chosen: Scenario, progress: Progress) -> SimulatedCase:
    """Simulate a scenario and read every sensor."""
    run = simulate(chosen, job.plant, job.seed, progress_part(progress, 0.0, SIMULATION_PART))
    signals = JointSignals.of_run(run)
    # Where the wrist turns, the F/T reading is mostly the needle's weight.
    readings = [ft_force(run)] if chosen.layers else []
    ends = np.linspace(SIMULATION_PART, 1.0, len(METHODS) + 1).tolist()
    for k, (method, config) in enumerate(METHODS.items()):
        part = progress_part(progress, ends[k], ends[k + 1])
        reading = virtual_force(run.robot, signals, on_lwr(config), method, run.tare_end_s, part)
        readings.append(reading)
    # From first contact to the end of withdrawal; without tissue, all after the tare.
    free = not chosen.layers
    truth = ForceTruth(
        t_s=run.truth.t_s,
        depth_m=run.truth.depth_m,
        axial_N=run.truth.axial_N,
        zeroed_s=run.tare_end_s,
        start_s=run.tare_end_s if free else run.contact_s,
        end_s=run.truth.t_s[-1] if free else run.withdrawn_s,
    )
    return SimulatedCase(run=run, signals=signals, truth=truth, readings=tuple(readings))


def simulated_metrics(case: SimulatedCase) -> list[Measurement]:
    """Every number of residual and force of one simulated insertion."""
    forces = [item for reading in case.readings for item in wrench_metrics(reading, case.truth)]
    return residual_metrics(case.run, case.signals) + forces


PUBLISHED_SPEED_s = 0.02
"""Time constant of the low-pass on the speed that the published method is given. It takes speed as
exact: as an arm measures it (0.12 mm/s of noise on 2.3 mm/s) its friction error on the 50 % gel is
125 %, through this low-pass 11 %. Ours has the same inside and is given the raw speed."""


def arm_signals(case: SimulatedCase) -> list[Signals]:
    """What identifiers get from the arm, one entry per source.

    Depth and speed come from measured joints through the estimator's own robot. The F/T reading
    is the same for both methods; the virtual force of a method is that of its own sensor, so that
    under `virtual` each whole chain is judged.
    """
    signals = case.signals
    measured = measured_travel(case.run.robot, signals, case.run.tare_end_s)
    travel = {"default": measured, "published": smoothed(measured, signals.dt_s, PUBLISHED_SPEED_s)}
    force = {(item.source, item.method): item.axial_N for item in case.readings}
    force["ft", "published"] = force["ft", "default"]

    def signal(source: Source, method: Method) -> NeedleSignal:
        return NeedleSignal(
            source=source,
            t_s=signals.t_s,
            depth_m=travel[method].depth_m,
            speed_m_s=travel[method].speed_m_s,
            force_N=force[source, method],
        )

    sources: tuple[Source, ...] = ("ft", "virtual")
    return [{method: signal(source, method) for method in METHODS} for source in sources]


def _identify(
    job: Job,
    sources: Sequence[Signals],
    truth: InsertionTruth,
    scenario: Scenario,
    ft: ForceReading | None = None,
) -> Findings:
    """Online identification on every source: numbers and figures."""
    measured: list[Measurement] = []
    found = []
    for signals in sources:
        identified = identify_all(signals, truth)
        measured += measure_identification(signals, identified, truth)
        found.append((signals, identified))
    if job.drawings is None:
        return Findings(measured)
    commanded = scenario.motion.speed_m_s(truth.t_s)
    drawings = draw_identification(job, job.drawings, truth, commanded, found, ft)
    return Findings(measured, drawings)


NOISE_FACTOR = (0.5, 2.0)
"""Range of the noise of drawn runs, of white noise and drift each: a better and a worse sensor."""


def run_needle(job: Job, chosen: Scenario, progress: Progress, *, is_drawn: bool) -> Findings:
    """Identification alone, at half a second a run: insert, identify by both methods, measure.

    Without tissue there is nothing to identify. The seed is that of the noise, whose level may be
    drawn as well.
    """
    if not chosen.layers:
        return Findings([])
    noise = drawn_noise(np.random.default_rng([job.seed, 1])) if is_drawn else MINI45
    run = insert_needle(chosen, seed=job.seed, noise=noise)
    progress(0.2)
    # The zero of depth is where the tare ended: a user does not know the surface.
    zero = run.depth_m[int(np.searchsorted(run.t_s, run.tare_end_s))]
    signal = NeedleSignal(
        source="ft",
        t_s=run.t_s,
        depth_m=run.depth_m - zero,
        speed_m_s=run.speed_m_s,
        force_N=run.force_N,
    )
    signals: Signals = {"default": signal, "published": signal}
    return _identify(job, [signals], insertion_truth(run), chosen)


def drawn_noise(rng: np.random.Generator) -> ForceNoise:
    """A sensor somewhat better or worse than the catalogued one."""
    white, drift = np.exp(rng.uniform(*np.log(NOISE_FACTOR), size=2)).tolist()
    return replace(
        MINI45,
        white_std_N=white * MINI45.white_std_N,
        drift_std_N_per_s=drift * MINI45.drift_std_N_per_s,
    )


OBSERVED = "gel-70-constant"
"""The insertion of the benchmark ``observers``, that of the published Figure 5."""
SLOW_SAMPLES = 3001
GAINS_per_s = (20.0, 30.0, 50.0, 70.0)
RANDOM_WALKS_per_sqrt_s = (1.0, 2.0, 4.0)
"""Random walk of the external torque in units of a joint's torque noise, for the Kalman form."""


def run_observers(job: Job, progress: Progress) -> Findings:
    """Three observers of the external torque on the same samples, each at its best setting.

    They are judged on the axial force by what noise and lag leave: errors slower than 3 s, those
    of the bias, are the same for all and taken out. Nothing on an arm without velocities or noise.
    """
    level = PLANT_MODELS[job.plant]
    if not level.velocity_noise_std_rad_s:
        progress(1.0)
        return Findings([])
    run = simulate(OBSERVED, job.plant, job.seed)
    # Weights of the joints in the axial force at every sample, shape (n, 7).
    along = tool_jacobians(run.robot, run.signals.q_rad)[:, 2]
    pushed = -along / np.array(level.torque_noise_std_Nm) ** 2
    weights = pushed / np.vecdot(pushed, -along)[:, None]
    progress(0.3)
    found = []
    for k, (name, observers) in enumerate(_observers(run, level).items()):
        least = min(_quick_error_N(run, weights, observer) for observer in observers)
        found.append(Measurement("virtual", "default", f"observer_{name}_rmse_N", least))
        progress(0.3 + 0.7 * (k + 1) / 3)
    return Findings(found)


def _observers(
    run: Run, level: PlantModel
) -> dict[str, Iterable[MomentumObserver | KalmanObserver]]:
    robot, noise = run.robot, np.array(level.torque_noise_std_Nm)
    speed_noise = level.velocity_noise_std_rad_s or 0.0
    plain, smoothing = (
        [MomentumObserver(robot, gain, alignment="hold") for gain in GAINS_per_s] for _ in range(2)
    )
    for observer in smoothing:
        observer.smooth_momentum(np.full(robot.nv, speed_noise), run.signals.q_rad[0])
    return {
        "momentum": plain,
        "smoothed": smoothing,
        "kalman": [
            KalmanObserver(
                robot,
                torque_noise_Nm=noise,
                velocity_noise_rad_s=speed_noise,
                walk_Nm_per_sqrt_s=walk * noise,
                alignment="hold",
            )
            for walk in RANDOM_WALKS_per_sqrt_s
        ],
    }


def _quick_error_N(run: Run, weights: Array, observer: MomentumObserver | KalmanObserver) -> float:
    """Root mean square of the quick part of the axial error in contact."""
    sent, truth = run.signals, run.truth
    assert sent.dq_rad_s is not None, "this arm sends velocities"
    samples = zip(sent.q_rad, sent.dq_rad_s, sent.tau_Nm, strict=True)
    torque = np.array([observer.update(*sample, 1e-3) for sample in samples])
    error = np.vecdot(weights, torque) - truth.axial_N
    quick = error - uniform_filter1d(error, SLOW_SAMPLES)
    touching = (truth.t_s >= run.contact_s) & (truth.t_s <= run.withdrawn_s)
    return float(np.sqrt(np.mean(quick[touching] ** 2)))
