"""Benchmarks on simulated insertions, by the arm and by the needle alone."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.insertion.detection_limit import measure_limits
from benchmarks.insertion.methods import (
    IDENTIFIERS,
    METHODS,
    WARNINGS,
    ForceReading,
    Identified,
    SessionRun,
    best_gain,
    ft_force,
    identify,
    identify_as_run,
    run_session,
    wrench_metrics,
)
from benchmarks.insertion.metrics import measure_identification
from benchmarks.insertion.signals import (
    ForceTruth,
    InsertionTruth,
    JointSignals,
    NeedleSignal,
    insertion_truth,
)
from benchmarks.jobs import NEEDLE, Figure, Job, Method
from benchmarks.report import (
    draw_force,
    draw_identification,
    draw_offline,
    published_number,
)
from foundation.arrays import Array
from groundtruth import ForceNoise, Run, Scenario, insert_needle, scenario, simulate
from groundtruth.plant_model import MINI45
from groundtruth.scenarios import DRAWN


def run(job: Job) -> Iterator[Figure]:
    """Simulate, read every sensor and identify; then measure; then draw."""
    chosen = scenario(job.benchmark, job.seed)
    if job.plant == NEEDLE:
        yield from run_needle(job, chosen, is_drawn=job.benchmark in DRAWN)
        return
    run = simulate(chosen, job.plant, job.seed)
    case = read_sensors(run, ["ours"] if job.is_ours_only else tuple(METHODS))
    yield from simulated_metrics(case)
    if job.report is not None:
        draw_force(job, case.truth, case.readings)
    if chosen.layers:
        truth = insertion_truth(run)
        commanded_m_s = chosen.motion.speed_m_s(truth.t_s)
        sources = identify_sources(case)
        yield from measure_and_draw(job, truth, commanded_m_s, sources)
        ours = [item for items in sources for item in items if item.method == "ours"]
        yield from measure_limits(run, ours)


def measure_and_draw(
    job: Job,
    truth: InsertionTruth,
    commanded_m_s: Array,
    sources: Sequence[Sequence[Identified]],
) -> Iterator[Figure]:
    """Yield the numbers of every method on every source; draw them if wanted.

    Args:
        job: The run.
        truth: The insertion with its ground truth.
        commanded_m_s: Commanded speed, shape (n,).
        sources: What the methods made of each source, the F/T sensor's first.
    """
    for items in sources:
        for item in items:
            yield from measure_identification(item, truth)
        if job.report is not None:
            draw_identification(job, items[0].source, items, truth, commanded_m_s)
    if job.report is not None and published_number("offline", job.benchmark):
        draw_offline(job, sources[0][0].signal, truth)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedCase:
    """Everything that metrics and figures of one simulated insertion may use.

    Attributes:
        run: The insertion with its ground truth.
        truth: What force readings are judged against.
        sessions: Of every method, as a user has it.
        best_gain: By the published sensor with the gain that suits the run, where that
            method was run.
        ft: The F/T sensor's; None without tissue, where the wrist turns and the reading
            is mostly the needle's weight.
    """

    run: Run
    truth: ForceTruth
    sessions: dict[Method, SessionRun]
    best_gain: ForceReading | None
    ft: ForceReading | None

    @property
    def readings(self) -> list[ForceReading]:
        """Axial force of every source and method."""
        readings = [item.reading for item in self.sessions.values()]
        return readings + [one for one in (self.ft, self.best_gain) if one is not None]


def read_sensors(run: Run, methods: Sequence[Method] = tuple(METHODS)) -> SimulatedCase:
    """Run every method's session on what the arm sent, and read the F/T sensor."""
    signals = JointSignals.of_run(run)
    free = not run.scenario.layers
    # From first contact to the end of withdrawal; without tissue, all after the tare.
    start_s = run.tare_end_s if free else run.truth.contact_s
    truth = ForceTruth(
        t_s=run.truth.t_s,
        depth_m=run.truth.depth_m,
        axial_N=run.truth.axial_N,
        zeroed_s=run.tare_end_s,
        start_s=start_s,
        end_s=run.truth.t_s[-1] if free else run.truth.withdrawn_s,
    )
    place_m = run.scenario.motion.position_m
    contact_m = float(place_m(start_s) - place_m(run.tare_end_s))
    sessions: dict[Method, SessionRun] = {
        method: run_session(
            run.robot, signals, method, run.tare_end_s, contact_m=contact_m
        )
        for method in methods
    }
    published = sessions.get("published-one-setting")
    return SimulatedCase(
        run=run,
        truth=truth,
        sessions=sessions,
        best_gain=published and best_gain(published.reading, truth, signals.dt_s),
        ft=None if free else ft_force(run),
    )


def simulated_metrics(case: SimulatedCase) -> Iterator[Figure]:
    """Measure the force of one simulated insertion, and false warnings."""
    for reading in case.readings:
        yield from wrench_metrics(reading, case.truth)
    for method, item in case.sessions.items():
        yield Figure("tare_refused", item.was_refused, method=method)
    for name in WARNINGS:
        yield Figure(name, name in case.sessions["ours"].warned)


def identify_sources(case: SimulatedCase) -> list[list[Identified]]:
    """Run every method on the F/T force, then on the virtual one.

    There each whole session is judged, by its own identification of its own force. On
    the F/T force the same identifiers get depth and speed of the same sessions.
    """
    assert case.ft is not None, "without tissue there is nothing to identify"
    truth = insertion_truth(case.run)
    commanded_m_s = case.run.scenario.motion.speed_m_s(truth.t_s)
    on_ft: list[Identified] = []
    on_virtual: list[Identified] = []
    for method, session in case.sessions.items():
        felt = replace(session.signal, source="ft", force_N=case.ft.axial_N)
        on_ft.append(identify(felt, truth, method))
        on_virtual.append(
            identify(session.signal, truth, method, result=session.result)
        )
    if case.best_gain is not None:
        on_ft.append(identify_as_run(on_ft[0].signal, truth, commanded_m_s))
        published = on_virtual[-1].signal
        on_virtual.append(identify_as_run(published, truth, commanded_m_s))
        best = replace(published, force_N=case.best_gain.axial_N)
        on_virtual.append(
            identify_as_run(best, truth, commanded_m_s, "published-best-gain")
        )
    return [on_ft, on_virtual]


def run_needle(job: Job, chosen: Scenario, *, is_drawn: bool) -> Iterator[Figure]:
    """Identify alone, at half a second a run: insert, identify, measure.

    Without tissue there is nothing to identify. The seed is that of the noise, whose
    level may be drawn as well.
    """
    if not chosen.layers:
        return
    noise = drawn_noise(np.random.default_rng([job.seed, 1])) if is_drawn else MINI45
    run = insert_needle(chosen, seed=job.seed, noise=noise)
    # The zero of depth is where the tare ended: a user does not know the surface.
    zero = run.depth_m[int(np.searchsorted(run.t_s, run.tare_end_s))]
    signal = NeedleSignal("ft", run.t_s, run.depth_m - zero, run.speed_m_s, run.force_N)
    truth = insertion_truth(run)
    identified = [identify(signal, truth, method) for method in IDENTIFIERS]
    identified.append(identify_as_run(signal, truth, run.speed_m_s))
    commanded_m_s = chosen.motion.speed_m_s(truth.t_s)
    yield from measure_and_draw(job, truth, commanded_m_s, [identified])


def drawn_noise(rng: np.random.Generator) -> ForceNoise:
    """Draw a sensor somewhat better or worse than the catalogued one."""
    # Factors on white noise and drift.
    white, drift = np.exp(rng.uniform(*np.log((0.5, 2.0)), size=2)).tolist()
    return replace(
        MINI45,
        white_std_N=white * MINI45.white_std_N,
        drift_std_N_per_s=drift * MINI45.drift_std_N_per_s,
    )
