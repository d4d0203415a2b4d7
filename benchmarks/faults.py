"""A fault, and what came of it."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from rich.table import Table
from scipy.signal import lfilter

from benchmarks.methods import on_lwr
from groundtruth import PLANT_MODELS, Motion, Run, Scenario, simulate
from groundtruth.arm_plant import lwr_bodies
from groundtruth.materials import gel
from groundtruth.motion import Profile, Stroke
from needleforce import InsertionSession, SessionEstimate, SessionSnapshot
from residual import DEFAULT, SensorWarning, Status, TareError
from urdf import Payload, Robot, load_lwr

# A stretch of joint signals that can be cut, bent and joined.


Array = NDArray[np.float64]

SERIES = ("dt_s", "q_rad", "dq_rad_s", "tau_Nm", "reference_N")
"""Fields of a stream with one entry per sample."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaultStream:
    """m samples of an arm with n joints, and what the force would be without the fault.

    Attributes:
        dt_s: Time since the sample before, as the caller would tell it, shape (m,).
        q_rad: Positions, shape (m, n).
        dq_rad_s: Velocities, shape (m, n).
        tau_Nm: Torques, shape (m, n).
        reference_N: Axial force to compare with, shape (m,).
        start: First sample of the fault.
        stop: First sample after it.
    """

    dt_s: Array
    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    reference_N: Array
    start: int = 0
    stop: int = 0

    def bent(self, start: int, stop: int) -> "FaultStream":
        """A copy with a fault from ``start`` to before ``stop``, whose arrays may be written."""
        copies = {name: getattr(self, name).copy() for name in SERIES}
        return replace(self, **copies, start=start, stop=stop)

    def without(self, first: int, last: int) -> "FaultStream":
        """The stream without the samples from ``first`` to before ``last``: they were lost.

        The time they took is that of the sample after them, and the fault ends with it.
        """
        kept = np.r_[0:first, last : len(self.dt_s)]
        dt_s = self.dt_s.copy()
        dt_s[last] += dt_s[first:last].sum()
        parts = {name: getattr(self, name)[kept] for name in SERIES} | {"dt_s": dt_s[kept]}
        return replace(self, **parts, start=first, stop=first + 1)

    def then(self, other: "FaultStream") -> "FaultStream":
        """Both, one after the other; the fault of the first counts."""
        joined = {n: np.concatenate((getattr(self, n), getattr(other, n))) for n in SERIES}
        return replace(self, **joined)


def stream_of(run: Run, first: int, last: int, reference_N: Array) -> FaultStream:
    """The samples of a run from ``first`` to before ``last``.

    Args:
        run: An insertion on an arm that sends velocities.
        first: First sample.
        last: First sample after.
        reference_N: For every sample of the run, shape (n,).
    """
    sent, part = run.signals, slice(first, last)
    assert sent.dq_rad_s is not None
    return FaultStream(
        dt_s=np.full(last - first, 1e-3),
        q_rad=sent.q_rad[part],
        dq_rad_s=sent.dq_rad_s[part],
        tau_Nm=sent.tau_Nm[part],
        reference_N=reference_N[part],
    )


def tare_index(run: Run) -> int:
    """The first sample of a run after the tare."""
    return int(np.searchsorted(run.signals.t_s, run.tare_end_s))


CLOSE_N = 0.1
"""An estimate has recovered when it stays this close to that of an undisturbed run."""
HOLD_S = 1.0
"""For at least this long after the fault the caller is listened to."""


Injection = Callable[[FaultStream, int], FaultStream]
"""Bends a stream from an index on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultResult:
    """What came of one fault.

    Attributes:
        name: What was done, in a few words.
        worst_N: Largest error of the force while it lasted.
        worst_sigma: The same in its own standard deviations.
        recovery_s: Time after its end until the error stays within `CLOSE_N`; infinite if it does
            not.
        told: Statuses other than ok, and cautions, that the caller got from its start to `HOLD_S`
            after its end.
        is_finite: Whether every number handed out was.
        note: What else happened, in words.
    """

    name: str
    worst_N: float
    worst_sigma: float
    recovery_s: float
    told: tuple[str, ...]
    is_finite: bool
    note: str = ""


def feed(
    session: InsertionSession, stream: FaultStream, *, with_velocity: bool = True
) -> list[SessionEstimate]:
    """Estimates of every sample of a stream."""
    dq = stream.dq_rad_s if with_velocity else [None] * len(stream.dt_s)
    rows = zip(stream.q_rad, dq, stream.tau_Nm, stream.dt_s.tolist(), strict=True)
    return [session.update(*row) for row in rows]


def judge(
    name: str, stream: FaultStream, found: list[SessionEstimate], note: str = ""
) -> FaultResult:
    """Compare the estimates of a faulty stream with its reference."""
    error = np.abs(np.array([e.wrench.axial for e in found]) - stream.reference_N)
    std = np.array([e.wrench.axial_std for e in found])
    during = slice(stream.start, max(stream.stop, stream.start + 1))
    after = np.flatnonzero(error[stream.stop :] > CLOSE_N)
    elapsed = np.cumsum(np.nan_to_num(stream.dt_s[stream.stop :], posinf=0.0))
    if len(after) == 0:
        recovery = 0.0
    else:
        last = int(after[-1]) + 1
        recovery = float(elapsed[last]) if last < len(elapsed) else np.inf
    end = stream.stop + round(HOLD_S / 1e-3)
    worst = int(np.argmax(error[during])) + during.start
    return FaultResult(
        name=name,
        worst_N=float(error[worst]),
        worst_sigma=float(error[worst] / std[worst]),
        recovery_s=recovery,
        told=_told(found[stream.start : end]),
        is_finite=all(map(is_finite, found[stream.start : end])),
        note=note,
    )


def late(force_N: Array, *, with_velocity: bool = True) -> Array:
    """A force as late as an ideal arm would let the sensor read it, shape (n,), at 1 kHz.

    Args:
        force_N: The true force.
        with_velocity: Whether the arm sends velocities; without, position and torque are filtered.
    """
    assert isinstance(DEFAULT.gain_per_s, float)
    rates_per_s = [DEFAULT.gain_per_s]
    if not with_velocity:
        rates_per_s += [DEFAULT.velocity_bandwidth_per_s] * 2
    for rate in rates_per_s:
        decay = np.exp(-1e-3 * rate)
        force_N = np.asarray(lfilter([1.0 - decay], [1.0, -decay], force_N), dtype=np.float64)
    return force_N


def _told(found: list[SessionEstimate]) -> tuple[str, ...]:
    statuses = {e.status for e in found} - {Status.OK}
    warnings = SensorWarning.NONE
    for estimate in found:
        warnings |= estimate.warnings
    words = [status.value for status in Status if status in statuses]
    return (*words, *(str(one.name) for one in SensorWarning if one in warnings and one))


def is_finite(value: object) -> bool:
    """Whether every number in a nested result is finite."""
    if isinstance(value, np.ndarray):
        return bool(np.isfinite(value).all())
    if isinstance(value, float):
        return bool(np.isfinite(value))
    if isinstance(value, tuple):
        return all(map(is_finite, value))
    slots = getattr(type(value), "__slots__", ())
    return all(is_finite(getattr(value, name)) for name in slots if hasattr(value, name))


# Faults of sensors, wires and clocks, injected into a stream of good samples.


SHOULDER = 1
"""Joint whose torque carries most of a force along the needle."""


def not_finite(stream: FaultStream, at: int, *, samples: int, value: float) -> FaultStream:
    """One torque is no number for some samples."""
    bent = stream.bent(at, at + samples)
    bent.tau_Nm[at : at + samples, SHOULDER] = value
    return bent


def frozen(stream: FaultStream, at: int, *, samples: int, only_torque: bool) -> FaultStream:
    """The last sample again and again, or only the torque of one joint."""
    bent, part = stream.bent(at, at + samples), slice(at, at + samples)
    if only_torque:
        bent.tau_Nm[part, SHOULDER] = bent.tau_Nm[at - 1, SHOULDER]
        return bent
    for array in (bent.q_rad, bent.dq_rad_s, bent.tau_Nm):
        array[part] = array[at - 1]
    return bent


def lost(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """Samples that never came."""
    return stream.without(at, at + samples)


def jittering_clock(stream: FaultStream, at: int, *, samples: int, std_s: float) -> FaultStream:
    """Time stamps that are off at random."""
    bent = stream.bent(at, at + samples)
    error = np.zeros(len(bent.dt_s) + 1)
    noise = np.random.default_rng(0).normal(scale=std_s, size=samples)
    error[at : at + samples] = np.clip(noise, -0.45e-3, 0.45e-3)
    bent.dt_s[:] += np.diff(error, prepend=0.0)[: len(bent.dt_s)]
    return bent


def repeated_stamps(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """Every tenth time stamp comes twice, and the next one is right again."""
    bent = stream.bent(at, at + samples)
    twice = np.arange(at, at + samples, 10)
    bent.dt_s[twice] = 0.0
    bent.dt_s[twice + 1] += 1e-3
    return bent


def backward_stamp(stream: FaultStream, at: int, *, back_s: float, returns: bool) -> FaultStream:
    """The clock goes back once, and comes forward again or goes on from there."""
    bent = stream.bent(at, at + 1)
    bent.dt_s[at] = -back_s
    if returns:
        bent.dt_s[at + 1] += back_s + 1e-3
    return bent


def spike(
    stream: FaultStream, at: int, *, q_rad: float = 0.0, tau_Nm: float = 0.0, times: int = 1
) -> FaultStream:
    """Single samples that are far off, a tenth of a second apart."""
    where = at + 100 * np.arange(times)
    bent = stream.bent(at, int(where[-1]) + 1)
    bent.q_rad[where, SHOULDER] += q_rad
    bent.tau_Nm[where, SHOULDER] += tau_Nm
    return bent


def saturated(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """One torque reads its joint's effort limit."""
    bent = stream.bent(at, at + samples)
    bent.tau_Nm[at : at + samples, SHOULDER] = -load_lwr().effort_limit_Nm[SHOULDER]
    return bent


SIGNAL_FAULTS: dict[str, Injection] = {
    "one torque NaN, 1 sample": partial(not_finite, samples=1, value=np.nan),
    "one torque infinite, 100 ms": partial(not_finite, samples=100, value=np.inf),
    "one torque NaN, 1 s": partial(not_finite, samples=1000, value=np.nan),
    "all signals frozen, 200 ms": partial(frozen, samples=200, only_torque=False),
    "all signals frozen, 2 s": partial(frozen, samples=2000, only_torque=False),
    "one torque frozen, 2 s": partial(frozen, samples=2000, only_torque=True),
    "1 ms lost": partial(lost, samples=1),
    "10 ms lost": partial(lost, samples=10),
    "100 ms lost": partial(lost, samples=100),
    "500 ms lost": partial(lost, samples=500),
    "clock jitter of 0.2 ms, 2 s": partial(jittering_clock, samples=2000, std_s=2e-4),
    "time stamps repeated, 1 s": partial(repeated_stamps, samples=1000),
    "clock 20 ms back and forth": partial(backward_stamp, back_s=0.02, returns=True),
    "clock set back by an hour": partial(backward_stamp, back_s=3600.0, returns=False),
    "position spike of 0.05 rad": partial(spike, q_rad=0.05),
    "torque spike of 30 Nm": partial(spike, tau_Nm=30.0),
    "ten torque spikes of 6 Nm, 1 s": partial(spike, tau_Nm=6.0, times=10),
    "one torque saturated, 500 ms": partial(saturated, samples=500),
}
"""By what was done."""


# An insertion that does everything an insertion is not supposed to do.


SPEED_M_S = 5e-3
STANDOFF_M = 5e-3
FIRST_STOP_M, TURN_M, DEEPEST_M, AGAIN_M = 15e-3, 10e-3, 42e-3, 20e-3
TARE_M, TARE_S = 100e-3, 4.0

PARTS = ("stopped for 60 s", "reversed by 5 mm and in again", "withdrawn", "inserted again")


class _Way:
    """Strokes one after the other, from above the tissue."""

    def __init__(self) -> None:
        self.strokes: list[Stroke] = []

    def go(self, to_m: float, seconds: float, profile: Profile = "quintic") -> float:
        """Go to a depth in a time; returns when the needle is there [s]."""
        start_s, start_m = 0.0, -STANDOFF_M - TARE_M
        if self.strokes:
            start_s, start_m = self.strokes[-1].end_s, self.strokes[-1].end_m
        self.strokes.append(
            Stroke(
                profile=profile,
                start_s=start_s,
                duration_s=seconds,
                start_m=start_m,
                travel_m=to_m - start_m,
            )
        )
        return self.strokes[-1].end_s

    def along(self, to_m: float) -> float:
        """Go to a depth at about `SPEED_M_S`."""
        return self.go(to_m, abs(to_m - self.strokes[-1].end_m) / SPEED_M_S / 0.9, "cruise")

    def rest(self, seconds: float) -> float:
        """Stay where the needle is."""
        where_m = self.strokes[-1].end_m if self.strokes else -STANDOFF_M - TARE_M
        return self.go(where_m, seconds, "rest")


def troubled_scenario() -> tuple[Scenario, dict[str, tuple[float, float]]]:
    """The insertion, and when each of its `PARTS` begins and ends [s]."""
    way, tare_end_s = _Way(), 0.0
    way.rest(1.0)
    for to_m in (-STANDOFF_M, -STANDOFF_M - TARE_M, -STANDOFF_M):
        tare_end_s = way.go(to_m, TARE_S)
    stopped_s = way.along(FIRST_STOP_M)
    moving_s = way.rest(60.0)
    way.along(TURN_M)
    returned_s = way.along(FIRST_STOP_M)
    insertion_end_s = way.along(DEEPEST_M)
    withdrawing_s = way.rest(1.0)
    withdrawn_s = way.along(-STANDOFF_M)
    again_s = way.rest(1.0)
    inside_s = way.along(AGAIN_M)
    way.rest(1.0)
    end_s = way.along(-STANDOFF_M)
    way.rest(0.5)
    motion = Motion(
        strokes=tuple(way.strokes),
        tare_end_s=tare_end_s,
        insertion_end_s=insertion_end_s,
        withdrawal_start_s=withdrawing_s,
        withdrawal_end_s=end_s,
    )
    spans = zip(
        PARTS,
        (
            (stopped_s, moving_s),
            (moving_s, returned_s),
            (withdrawing_s, withdrawn_s),
            (again_s, inside_s),
        ),
        strict=True,
    )
    title = "70 % gel: stopped, reversed, withdrawn, inserted again"
    return Scenario(id="troubled", title=title, layers=(gel(70),), motion=motion), dict(spans)


def motion_results(arm: str, *, with_velocity: bool = True) -> list[FaultResult]:
    """What comes of each part, against the true force as late as the sensor is."""
    scenario, spans = troubled_scenario()
    run = simulate(scenario, arm, 0)
    tare = tare_index(run)
    session = InsertionSession(run.robot, on_lwr(DEFAULT))
    nothing = np.zeros(len(run.signals.t_s))
    found = feed(session, stream_of(run, 0, tare, nothing), with_velocity=with_velocity)
    session.tare()
    rest = stream_of(run, tare, len(nothing), nothing)
    found += feed(session, rest, with_velocity=with_velocity)
    whole = stream_of(run, 0, len(nothing), late(run.truth.axial_N, with_velocity=with_velocity))
    ruptures = [k for k, e in enumerate(found) if e.identification.rupture is not None]
    results = []
    for name, (begin_s, end_s) in spans.items():
        start, stop = (int(np.searchsorted(run.signals.t_s, t)) for t in (begin_s, end_s))
        part = whole.bent(start, stop)
        inside = sum(start <= k < stop for k in ruptures)
        true = sum(begin_s <= one.onset_s < end_s for one in run.truth.ruptures)
        note = "" if inside == true else f"{inside} ruptures raised, {true} true"
        results.append(judge(name, part, found, note))
    return results


# Faults of pose and load: a joint at its limit, an arm stretched out, a weight, a push aside.


WRIST = 5
STOP_NM = 2.0
"""Torque with which the wrist is pressed against its end stop."""
WAY_S, STAY_S, TICK_S = 3.0, 1.0, 1e-3


def loaded(
    run: Run, stream: FaultStream, at: int, samples: int, force_in_base_N: Array
) -> FaultStream:
    """A force on the tool beside that of the tissue, for some samples."""
    bent = stream.bent(at, at + samples)
    data = run.robot.create_data()
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for k in range(at, at + samples):
        jacobian = pin.computeFrameJacobian(
            run.robot.model, data, bent.q_rad[k], run.robot.tool_frame_id, axes
        )
        bent.tau_Nm[k] -= jacobian[:3].T @ force_in_base_N
    return bent


def detour(run: Run, stream: FaultStream, target_rad: Array, stop_Nm: Array) -> FaultStream:
    """A motion in free air to a pose and back, before a stream that starts at rest in free air.

    The fault ends when the arm is back.

    Torques are those of the true arm, with the sensors' noise and the offset that they show where
    the motion begins.

    Args:
        run: Gives the arm.
        stream: What follows.
        target_rad: The pose, shape (n,).
        stop_Nm: Torque of an end stop on the joints there, shape (n,).
    """
    start = stream.q_rad[0]
    share, rate, change = _there_and_back()
    q = start + share[:, None] * (target_rad - start)
    dq, ddq = rate[:, None] * (target_rad - start), change[:, None] * (target_rad - start)
    mass_seed, _ = np.random.SeedSequence(run.seed).spawn(2)
    level = PLANT_MODELS[run.plant]
    model = lwr_bodies(run.tool, level, np.random.default_rng(mass_seed)).model()
    data = model.createData()
    ideal = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    rest = pin.computeGeneralizedGravity(model, data, start)
    offset = stream.tau_Nm[:20].mean(axis=0) - rest
    rng = np.random.default_rng(0)
    pressed = share > 1.0 - 1e-9
    made = FaultStream(
        dt_s=np.full(len(q), TICK_S),
        q_rad=q + level.position_noise_std_rad * rng.normal(size=q.shape),
        dq_rad_s=dq + (level.velocity_noise_std_rad_s or 0.0) * rng.normal(size=q.shape),
        tau_Nm=ideal
        + offset
        - pressed[:, None] * stop_Nm
        + np.array(level.torque_noise_std_Nm) * rng.normal(size=q.shape),
        reference_N=np.zeros(len(q)),
        start=0,
        stop=len(q),
    )
    return made.then(stream)


def _there_and_back() -> tuple[Array, Array, Array]:
    """Share of the way, its rate and that one's rate: quintic out, a stay, quintic back."""
    s = np.arange(0.0, 1.0, TICK_S / WAY_S)
    way = s**3 * (10.0 + s * (6.0 * s - 15.0))
    rate = 30.0 * (s * (1.0 - s)) ** 2 / WAY_S
    change = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / WAY_S**2
    stay = round(STAY_S / TICK_S)
    still = np.zeros(stay)
    return (
        np.concatenate((way, np.ones(stay), way[::-1])),
        np.concatenate((rate, still, -rate[::-1])),
        np.concatenate((change, still, change[::-1])),
    )


def wrist_at_limit(run: Run, stream: FaultStream) -> FaultStream:
    """The wrist goes to its upper limit and is pressed against the stop."""
    target, stop = stream.q_rad[0].copy(), np.zeros(run.robot.nv)
    target[WRIST] = run.robot.position_upper_rad[WRIST]
    stop[WRIST] = -STOP_NM
    return detour(run, stream, target, stop)


def stretched(run: Run, stream: FaultStream) -> FaultStream:
    """The arm stretches out along the needle: no joint feels a force along it."""
    return detour(run, stream, np.full(run.robot.nv, 0.01), np.zeros(run.robot.nv))


def heavier(run: Run, stream: FaultStream, at: int) -> FaultStream:
    """A cable of 50 g comes to hang on the needle's mount for 2 s, after the tare."""
    return loaded(run, stream, at, 2000, 0.05 * run.robot.gravity_m_s2)


def pushed_aside(run: Run, stream: FaultStream, at: int) -> FaultStream:
    """Somebody pushes the needle aside with 1 N for 2 s."""
    return loaded(run, stream, at, 2000, np.array([1.0, 0.0, 0.0]))


# A tare that is asked for in the wrong place, or with the wrong payload.


UNKNOWN_KG = 0.1
"""A third of what the tool weighs."""


def tare_in_contact(run: Run, at: int) -> FaultResult:
    """Tare in the tissue for the first time; then withdraw, tare in free air, insert again.

    Args:
        run: An insertion.
        at: Sample before which the first tare is asked for, in the tissue.
    """
    count, nothing = len(run.signals.t_s), np.zeros(len(run.signals.t_s))
    session = InsertionSession(run.robot, on_lwr(DEFAULT))
    before = feed(session, stream_of(run, 0, at, nothing))[-1]
    told = ""
    try:
        session.tare()
    except TareError:
        told = "TareError"
    after = feed(session, stream_of(run, at, count, nothing))
    session.start_tare_recording()
    # The robot is driven back to the start while nobody listens.
    again = stream_of(run, 0, tare_index(run), nothing)
    again.dt_s[0] = 1.0
    feed(session, again)
    session.tare()
    result = _insert(session, run, "tare asked for in the tissue")
    return FaultResult(
        name=result.name,
        worst_N=abs(after[0].wrench.axial - before.wrench.axial),
        worst_sigma=abs(after[0].wrench.axial - before.wrench.axial) / after[0].wrench.axial_std,
        recovery_s=result.recovery_s,
        told=(told, after[0].status.value) if told else (after[0].status.value,),
        is_finite=result.is_finite and all(map(is_finite, after[:1000])),
        note="recovery: after a tare in free air",
    )


def wrong_payload(run: Run) -> FaultResult:
    """The tool is heavier than the estimator knows, from the start."""
    session = InsertionSession(_lighter(run.robot), on_lwr(DEFAULT))
    tare = tare_index(run)
    feed(session, stream_of(run, 0, tare, np.zeros(len(run.signals.t_s))))
    session.tare()
    return _insert(session, run, f"payload {1e3 * UNKNOWN_KG:g} g wrong from the start")


def _insert(session: InsertionSession, run: Run, name: str) -> FaultResult:
    """The insertion after the tare; it is all fault, and its recovery that of its whole length."""
    tare, count = tare_index(run), len(run.signals.t_s)
    forces = late(run.truth.axial_N)
    insertion = stream_of(run, tare, count, forces)
    found = feed(session, insertion)
    worst = judge(name, insertion.bent(0, count - tare), found)
    lasting = judge(name, insertion.bent(0, 0), found)
    return FaultResult(
        name=name,
        worst_N=worst.worst_N,
        worst_sigma=worst.worst_sigma,
        recovery_s=lasting.recovery_s,
        told=worst.told,
        is_finite=worst.is_finite,
    )


def _lighter(robot: Robot) -> Robot:
    """The robot with less of a tool than it really carries."""
    known = robot.payload
    assert known is not None
    share = 1.0 - UNKNOWN_KG / known.mass_kg
    return robot.with_payload(
        Payload(
            mass_kg=share * known.mass_kg,
            com_m=known.com_m,
            inertia_kg_m2=share * known.inertia_kg_m2,
        )
    )


# All faults, one after the other, on the same insertion.


SCENARIO, ARM = "gel-70-constant", "clean"
DEPTH_M = 20e-3
"""Where the faults strike: in the gel, which ends at 32 mm."""
LEAD, BEYOND = 300, 3000
"""Samples before a fault, and after the end of the layer."""


class FaultStudy:
    """One insertion, undisturbed, and what it needs to be repeated with a fault.

    Args:
        progress: Told the share of the simulation that is done.
        with_velocity: Whether the arm sends velocities.
        through_layer: Whether every repetition goes on to the end of the layer, so that its rupture
            must be found, or only a little beyond the fault.
    """

    def __init__(
        self,
        progress: Callable[[float], None] = lambda share: None,
        *,
        with_velocity: bool = True,
        through_layer: bool = True,
    ) -> None:
        self._with_velocity, self._through = with_velocity, through_layer
        self.run: Run = simulate(SCENARIO, ARM, 0, progress)
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

    def results(self) -> Iterator[FaultResult]:
        """Every fault's result, in the order of the table."""
        yield from self.signal_results()
        yield from self.pose_results()
        yield tare_in_contact(self.run, self.at)
        yield wrong_payload(self.run)
        yield from motion_results(ARM, with_velocity=self._with_velocity)

    def signal_results(self) -> Iterator[FaultResult]:
        """What sensors, wires and clocks do."""
        good = self._part(self.at - LEAD, self._last, self._undisturbed_N)
        for name, inject in SIGNAL_FAULTS.items():
            yield self._result(name, inject(good, LEAD), self._inserted)

    def pose_results(self) -> Iterator[FaultResult]:
        """What poses and loads do."""
        good = self._part(self.at - LEAD, self._last, self._undisturbed_N)
        free = self._part(self._tare, self._tare + BEYOND, self._undisturbed_N)
        run = self.run
        for name, stream, start in (
            ("wrist pressed to its limit, 1 s", wrist_at_limit(run, free), self._tared),
            ("arm stretched along the needle, 1 s", stretched(run, free), self._tared),
            ("50 g hung on the tool, 2 s", heavier(run, good, LEAD), self._inserted),
            ("pushed aside with 1 N, 2 s", pushed_aside(run, good, LEAD), self._inserted),
        ):
            yield self._result(name, stream, start)

    def _result(self, name: str, stream: FaultStream, start: SessionSnapshot) -> FaultResult:
        session = InsertionSession(self.run.robot, on_lwr(DEFAULT))
        session.restore(start)
        found = feed(session, stream, with_velocity=self._with_velocity)
        result = judge(name, stream, found)
        ruptures = sum(e.identification.rupture is not None for e in found)
        expected = int(start is self._inserted and self._through)
        note = "" if ruptures == expected else f"{ruptures} ruptures raised, {expected} true"
        return replace(result, note=note)

    def _part(self, first: int, last: int, reference_N: np.ndarray) -> FaultStream:
        return stream_of(self.run, first, last, reference_N)

    def _go_on(self, session: InsertionSession, first: int, last: int) -> list[float]:
        stream = self._part(first, last, self.run.truth.axial_N)
        found = feed(session, stream, with_velocity=self._with_velocity)
        return [estimate.wrench.axial for estimate in found]


# The table of faults: for the terminal, and for docs/loop.md.


COLUMNS = ("fault", "worst error, N", "in σ", "recovered after", "what the caller is told", "")


def cells(result: FaultResult) -> tuple[str, ...]:
    """One row, in the order of `COLUMNS`."""
    told = ", ".join(result.told) or "–"
    note = result.note if result.is_finite else f"not finite; {result.note}"
    return (
        result.name,
        f"{result.worst_N:.2f}",
        f"{result.worst_sigma:.0f}",
        recovery(result.recovery_s),
        told,
        note,
    )


def recovery(seconds: float) -> str:
    """A time of recovery as it is printed."""
    if math.isinf(seconds):
        return "never"
    return "at once" if seconds == 0.0 else f"{1e3 * seconds:.0f} ms"


def fault_table(results: Iterable[FaultResult]) -> Table:
    """For the terminal."""
    table = Table(title="Faults in a running insertion")
    for name in COLUMNS:
        table.add_column(name, justify="right" if name in COLUMNS[1:4] else "left")
    for result in results:
        table.add_row(*cells(result))
    return table


def fault_lines(results: Iterable[FaultResult]) -> list[str]:
    """Lines of the same table in Markdown."""
    rule = "| --- | ---: | ---: | ---: | --- | --- |"
    rows = ["| " + " | ".join(cells(result)) + " |" for result in results]
    return ["| " + " | ".join(COLUMNS) + " |", rule, *rows]
