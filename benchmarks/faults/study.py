"""What faults do to a running insertion: errors, recovery, what is reported."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.faults.injection import (
    SIGNAL_FAULTS,
    FaultStream,
    PERIOD_s,
    loaded,
    stretched,
    troubled_scenario,
    wrist_at_limit,
)
from benchmarks.insertion.methods import on_lwr
from benchmarks.insertion.signals import lagging
from benchmarks.jobs import Job, Progress, progress_part
from benchmarks.report.tables import NOTHING, ResultTable
from benchmarks.results import Figure
from foundation.arrays import Array
from groundtruth import Run, simulate
from needleforce import InsertionSession, SessionEstimate, SessionSnapshot
from residual import DEFAULT, SensorWarning, Status, TareError
from urdf import Robot

SCENARIO = "gel-70-constant"
PLANT = "clean"
DEPTH_M = 20e-3
"""Where the faults strike: in the gel, which ends at 32 mm."""
LEAD = 300
BEYOND = 3000
"""Samples before a fault, and after the end of the layer."""
CLOSE_N = 0.1
"""An estimate has recovered when it stays this close to that of an undisturbed run."""
UNSMOOTHED = replace(on_lwr(DEFAULT), force_bandwidth_per_s=None)  # its lag is known
HOLD_S = 1.0
"""For so long after the fault, statuses and warnings count as caused by it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultResult:
    """What came of one fault.

    Attributes:
        name: What was done, in a few words.
        worst_N: Largest error of the force while it lasted.
        worst_sigma: The same in its own standard deviations.
        recovery_s: Time after its end until the error stays within `CLOSE_N`; infinite
            if it does not.
        reported: Statuses other than ok, and warnings, from its start to `HOLD_S` after
            its end.
        is_finite: Whether every number handed out was.
        note: What else happened, in words.
    """

    name: str
    worst_N: float
    worst_sigma: float
    recovery_s: float
    reported: tuple[str, ...]
    is_finite: bool
    note: str = ""


def tare_index(run: Run) -> int:
    """Return the first sample of a run after the tare."""
    return int(np.searchsorted(run.signals.t_s, run.tare_end_s))


def feed(
    session: InsertionSession, stream: FaultStream, *, with_velocity: bool = True
) -> list[SessionEstimate]:
    """Return the estimates of every sample of a stream."""
    dq = stream.dq_rad_s if with_velocity else [None] * len(stream.dt_s)
    rows = zip(stream.q_rad, dq, stream.tau_Nm, stream.dt_s.tolist(), strict=True)
    return [session.update(*row) for row in rows]


def rupture_note(estimates: Sequence[SessionEstimate], true: int) -> str:
    """Return a note where more or fewer ruptures were raised than there were."""
    raised = sum(e.identification.rupture is not None for e in estimates)
    return "" if raised == true else f"{raised} ruptures raised, {true} true"


def judge(
    name: str, stream: FaultStream, estimates: Sequence[SessionEstimate], note: str = ""
) -> FaultResult:
    """Compare the estimates of a faulty stream with its reference."""
    error = np.abs(np.array([e.wrench.axial for e in estimates]) - stream.reference_N)
    during = error[stream.start : max(stream.stop, stream.start + 1)]
    worst = int(np.argmax(during)) + stream.start
    after = np.flatnonzero(error[stream.stop :] > CLOSE_N)
    elapsed = np.cumsum(np.nan_to_num(stream.dt_s[stream.stop :], posinf=0.0))
    recovery_s = 0.0
    if len(after) > 0:
        settled = int(after[-1]) + 1
        recovery_s = float(elapsed[settled]) if settled < len(elapsed) else np.inf
    heard = estimates[stream.start : stream.stop + round(HOLD_S / PERIOD_s)]
    statuses = {e.status for e in heard}
    warnings = SensorWarning.NONE
    for estimate in heard:
        warnings |= estimate.warnings
    return FaultResult(
        name=name,
        worst_N=float(error[worst]),
        worst_sigma=float(error[worst] / estimates[worst].wrench.axial_std),
        recovery_s=recovery_s,
        reported=(
            *(status.name for status in Status if status in statuses - {Status.OK}),
            *(
                str(warning.name)
                for warning in SensorWarning
                if warning and warning in warnings
            ),
        ),
        is_finite=all(map(is_finite, heard)),
        note=note,
    )


def is_finite(value: object) -> bool:
    """Whether every number in a nested result is finite."""
    if isinstance(value, np.ndarray | float):
        return (
            math.isfinite(value)
            if isinstance(value, float)
            else bool(np.isfinite(value).all())
        )
    if isinstance(value, tuple):
        return all(map(is_finite, value))
    slots = getattr(type(value), "__slots__", ())
    return all(
        is_finite(getattr(value, name)) for name in slots if hasattr(value, name)
    )


def late(force_N: Array, *, with_velocity: bool = True) -> Array:
    """Return a force as late as the sensor reads it on an ideal arm, shape (n,).

    It is sampled at 1 kHz. On an arm without velocities, position and torque are
    filtered.
    """
    assert isinstance(DEFAULT.gain_per_s, float)
    rates_per_s = [DEFAULT.gain_per_s]
    if not with_velocity:
        rates_per_s += [DEFAULT.velocity_bandwidth_per_s] * 2
    t_s = PERIOD_s * np.arange(len(force_N), dtype=np.float64)
    for rate in rates_per_s:
        force_N = lagging(force_N, t_s, 1.0 / rate)
    return force_N


class FaultStudy:
    """One insertion, undisturbed, and what it needs to be repeated with a fault.

    A repetition goes on to the end of the layer, whose rupture must be found, or only a
    little beyond the fault.
    """

    def __init__(
        self,
        progress: Callable[[float], None] = lambda fraction: None,
        *,
        with_velocity: bool = True,
        through_layer: bool = True,
        seed: int = 0,
    ) -> None:
        self._with_velocity = with_velocity
        self._through = through_layer
        self._seed = seed
        self.run: Run = simulate(SCENARIO, PLANT, seed, progress)
        truth = self.run.truth
        self.at = int(np.argmax(truth.depth_m > DEPTH_M))
        self._tare = tare_index(self.run)
        end = int(np.argmax(truth.layer > 1)) if through_layer else self.at
        self._last = end + BEYOND
        session = InsertionSession(self.run.robot, on_lwr(DEFAULT))
        forces = self._go_on(session, 0, self._tare)
        session.tare()
        self._tared = session.snapshot()
        forces += self._go_on(session, self._tare, self.at - LEAD)
        self._inserted = session.snapshot()
        forces += self._go_on(session, self.at - LEAD, self._last)
        self._undisturbed_N = np.array(forces)

    def _go_on(self, session: InsertionSession, first: int, last: int) -> list[float]:
        """Feed samples of the run to a session; return the axial forces [N]."""
        stream = FaultStream.of_run(self.run, first, last, self.run.truth.axial_N)
        return [
            e.wrench.axial
            for e in feed(session, stream, with_velocity=self._with_velocity)
        ]

    def results(self) -> Iterator[FaultResult]:
        """Yield every fault's result, in the order of the table."""
        yield from self.session_results()
        yield tare_in_contact(self.run, self.at)
        yield wrong_payload(self.run)
        yield from motion_results(with_velocity=self._with_velocity, seed=self._seed)

    def session_results(self) -> Iterator[FaultResult]:
        """Yield what sensors, wires, clocks, poses and loads do after the tare."""
        run = self.run
        tare = self._tare
        good = FaultStream.of_run(run, self.at - LEAD, self._last, self._undisturbed_N)
        for name, inject in SIGNAL_FAULTS.items():
            yield self._result(name, inject(good, LEAD), self._inserted)
        free = FaultStream.of_run(run, tare, tare + BEYOND, self._undisturbed_N)
        hung = loaded(run, good, LEAD, 2000, 0.05 * run.robot.gravity_m_s2)
        pushed = loaded(run, good, LEAD, 2000, np.array([1.0, 0.0, 0.0]))
        for name, stream, start in (
            ("wrist pressed to its limit, 1 s", wrist_at_limit(run, free), self._tared),
            ("arm stretched along the needle, 1 s", stretched(run, free), self._tared),
            ("50 g hung on the tool, 2 s", hung, self._inserted),
            ("pushed aside with 1 N, 2 s", pushed, self._inserted),
        ):
            yield self._result(name, stream, start)

    def _result(
        self, name: str, stream: FaultStream, start: SessionSnapshot
    ) -> FaultResult:
        """Feed a faulty stream to a session that goes on from a snapshot."""
        session = InsertionSession(self.run.robot, on_lwr(DEFAULT))
        session.restore(start)
        estimates = feed(session, stream, with_velocity=self._with_velocity)
        true = int(start is self._inserted and self._through)
        return judge(name, stream, estimates, rupture_note(estimates, true))


def motion_results(*, with_velocity: bool = True, seed: int = 0) -> list[FaultResult]:
    """Return what stop, reversal and second insertion do.

    They are judged against the true force as late as the observer is.
    """
    scenario, spans = troubled_scenario()
    run = simulate(scenario, PLANT, seed)
    tare = tare_index(run)
    count = len(run.signals.t_s)
    session = InsertionSession(run.robot, UNSMOOTHED)
    whole = FaultStream.of_run(
        run, 0, count, late(run.truth.axial_N, with_velocity=with_velocity)
    )
    parts = [
        FaultStream.of_run(run, *at, whole.reference_N)
        for at in ((0, tare), (tare, count))
    ]
    estimates = feed(session, parts[0], with_velocity=with_velocity)
    session.tare()
    estimates += feed(session, parts[1], with_velocity=with_velocity)
    results = []
    for name, (begin_s, end_s) in spans.items():
        start, stop = np.searchsorted(run.signals.t_s, (begin_s, end_s)).tolist()
        true = sum(begin_s <= rupture.onset_s < end_s for rupture in run.truth.ruptures)
        note = rupture_note(estimates[start:stop], true)
        results.append(judge(name, whole.copy(start, stop), estimates, note))
    return results


def tare_in_contact(run: Run, at: int) -> FaultResult:
    """Tare in the tissue before sample `at`, then in free air, and insert again."""
    count = len(run.signals.t_s)
    nothing = np.zeros(len(run.signals.t_s))
    session = InsertionSession(run.robot, UNSMOOTHED)
    estimate_before = feed(session, FaultStream.of_run(run, 0, at, nothing))[-1]
    errors: tuple[str, ...] = ()
    try:
        session.tare()
    except TareError:
        errors = ("TareError",)
    estimates_after = feed(session, FaultStream.of_run(run, at, count, nothing))
    session.start_tare_recording()
    # The robot is driven back to the start while nobody listens.
    again = FaultStream.of_run(run, 0, tare_index(run), nothing)
    again.dt_s[0] = 1.0
    feed(session, again)
    session.tare()
    result = _insert(session, run, "tare asked for in the tissue")
    jump_N = abs(estimates_after[0].wrench.axial - estimate_before.wrench.axial)
    return replace(
        result,
        worst_N=jump_N,
        worst_sigma=jump_N / estimates_after[0].wrench.axial_std,
        reported=(*errors, estimates_after[0].status.name),
        is_finite=result.is_finite and all(map(is_finite, estimates_after[:1000])),
        note="recovery: after a tare in free air",
    )


def wrong_payload(run: Run) -> FaultResult:
    """Insert with a tool heavier than the estimator knows, from the start."""
    session = InsertionSession(without_part(run.robot), UNSMOOTHED)
    feed(
        session,
        FaultStream.of_run(run, 0, tare_index(run), np.zeros(len(run.signals.t_s))),
    )
    session.tare()
    return _insert(session, run, "payload 100 g wrong from the start")


def without_part(robot: Robot) -> Robot:
    """Return the robot with a payload that lacks 0.1 kg, a third of the tool."""
    known = robot.payload
    assert known is not None
    mass_kg = known.mass_kg - 0.1
    inertia_kg_m2 = mass_kg / known.mass_kg * known.inertia_kg_m2
    lighter = replace(known, mass_kg=mass_kg, inertia_kg_m2=inertia_kg_m2)
    return robot.with_payload(lighter)


def _insert(session: InsertionSession, run: Run, name: str) -> FaultResult:
    """Insert after the tare.

    The insertion is all fault, and its recovery is that of its whole length.
    """
    tare = tare_index(run)
    count = len(run.signals.t_s)
    insertion = FaultStream.of_run(run, tare, count, late(run.truth.axial_N))
    estimates = feed(session, insertion)
    lasting = judge(name, insertion.copy(0, 0), estimates)
    worst = judge(name, insertion.copy(0, count - tare), estimates)
    return replace(worst, recovery_s=lasting.recovery_s)


def recovery(seconds: float) -> str:
    """Return a time of recovery as it is printed."""
    if math.isinf(seconds):
        return "never"
    return "at once" if seconds == 0.0 else f"{1e3 * seconds:.0f} ms"


def fault_table(results: Sequence[FaultResult]) -> ResultTable:
    """Return the table for the terminal, or in Markdown."""
    return ResultTable(
        title="Faults in a running insertion",
        heads=(
            "fault",
            "worst error, N",
            "in σ",
            "recovered after",
            "reported to the caller",
            "",
        ),
        align="LrrrLL",
        lines=tuple(
            (
                result.name,
                f"{result.worst_N:.2f}",
                f"{result.worst_sigma:.0f}",
                recovery(result.recovery_s),
                ", ".join(result.reported) or NOTHING,
                result.note if result.is_finite else f"not finite; {result.note}",
            )
            for result in results
        ),
    )


WITHOUT_VELOCITY = "without velocity"
CASES = ("", WITHOUT_VELOCITY)


def measure_faults(
    progress: Progress, *, with_velocity: bool, seed: int = 0
) -> list[FaultResult]:
    """Break the signals of a running insertion in every way."""
    study = FaultStudy(
        progress_part(progress, 0.0, 0.2), with_velocity=with_velocity, seed=seed
    )
    results: list[FaultResult] = []
    for result in study.results():
        results.append(result)
        # There are about 30 faults.
        progress(min(0.2 + 0.8 * len(results) / 30, 1.0))
    return results


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Break the signals, with velocities from the arm or without.

    The numbers of a fault stand under its name as the source.
    """
    with_velocity = job.case != WITHOUT_VELOCITY
    for result in measure_faults(progress, with_velocity=with_velocity, seed=job.seed):
        name = result.name
        yield Figure("fault_force_error_max_N", result.worst_N, name)
        yield Figure("fault_force_error_max_sigma", result.worst_sigma, name)
        yield Figure("fault_recovery_ms", 1e3 * result.recovery_s, name)
        yield Figure("fault_outputs_not_finite", not result.is_finite, name)
