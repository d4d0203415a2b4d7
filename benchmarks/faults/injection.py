"""Faults of sensors, wires, clocks, poses and loads, put into signals."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from benchmarks.insertion.signals import inverse_dynamics, tool_jacobians
from foundation.arrays import Array
from groundtruth import PLANT_MODELS, Motion, Run, Scenario
from groundtruth.arm_plant import lwr_bodies
from groundtruth.materials import gel
from groundtruth.motion import Move, Profile, Stroke, chain_strokes
from urdf import load_lwr

SERIES = ("dt_s", "q_rad", "dq_rad_s", "tau_Nm", "reference_N")
"""Fields of a stream with one entry per sample."""
PERIOD_s = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaultStream:
    """m samples of an arm with n joints, and the force without the fault.

    Attributes:
        dt_s: Time since the sample before, as the caller would report it, shape (m,).
        q_rad: positions, shape (m, n).
        dq_rad_s: velocities, shape (m, n).
        tau_Nm: torques, shape (m, n).
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

    @classmethod
    def of_run(
        cls, run: Run, first: int, last: int, reference_N: Array
    ) -> "FaultStream":
        """Return the samples of a run from ``first`` to before ``last``.

        The reference is of all samples.
        """
        sent = run.signals
        span = slice(first, last)
        assert sent.dq_rad_s is not None
        return cls(
            dt_s=np.full(last - first, PERIOD_s),
            q_rad=sent.q_rad[span],
            dq_rad_s=sent.dq_rad_s[span],
            tau_Nm=sent.tau_Nm[span],
            reference_N=reference_N[span],
        )

    def copy(self, start: int, stop: int) -> "FaultStream":
        """Return a copy with a fault from ``start`` to before ``stop``.

        Its arrays may be written.
        """
        copies = {name: getattr(self, name).copy() for name in SERIES}
        return replace(self, **copies, start=start, stop=stop)


Injection = Callable[[FaultStream, int], FaultStream]
"""Puts a fault into a stream from an index on."""
SHOULDER = 1
"""Joint whose torque carries most of a force along the needle."""


def stuck_torque(
    stream: FaultStream, at: int, *, samples: int, value: float | None = None
) -> FaultStream:
    """Let one torque read the same: a value, or what it read before."""
    bad = stream.copy(at, at + samples)
    stuck = bad.tau_Nm[at - 1, SHOULDER] if value is None else value
    bad.tau_Nm[at : at + samples, SHOULDER] = stuck
    return bad


def frozen(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """Repeat the last sample again and again."""
    bad = stream.copy(at, at + samples)
    for array in (bad.q_rad, bad.dq_rad_s, bad.tau_Nm):
        array[at : at + samples] = array[at - 1]
    return bad


def lost(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """Take samples out.

    The time they took is that of the sample after them, and the fault ends with it.
    """
    end = at + samples
    received = np.r_[0:at, end : len(stream.dt_s)]
    dt_s = stream.dt_s.copy()
    dt_s[end] += dt_s[at:end].sum()
    parts = {name: getattr(stream, name)[received] for name in SERIES} | {
        "dt_s": dt_s[received]
    }
    return replace(stream, **parts, start=at, stop=at + 1)


def jittering_clock(
    stream: FaultStream, at: int, *, samples: int, std_s: float
) -> FaultStream:
    """Put time stamps off at random."""
    bad = stream.copy(at, at + samples)
    error = np.zeros(len(bad.dt_s) + 1)
    noise = np.random.default_rng(0).normal(scale=std_s, size=samples)
    error[at : at + samples] = np.clip(noise, -0.45e-3, 0.45e-3)
    bad.dt_s[:] += np.diff(error, prepend=0.0)[: len(bad.dt_s)]
    return bad


def repeated_stamps(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """Let every tenth time stamp come twice; the next one is right again."""
    bad = stream.copy(at, at + samples)
    twice = np.arange(at, at + samples, 10)
    bad.dt_s[twice] = 0.0
    bad.dt_s[twice + 1] += PERIOD_s
    return bad


def backward_stamp(
    stream: FaultStream, at: int, *, back_s: float, returns: bool
) -> FaultStream:
    """Set the clock back once; it comes forward again or goes on from there."""
    bad = stream.copy(at, at + 1)
    bad.dt_s[at] = -back_s
    if returns:
        bad.dt_s[at + 1] += back_s + PERIOD_s
    return bad


def spike(
    stream: FaultStream,
    at: int,
    *,
    q_rad: float = 0.0,
    tau_Nm: float = 0.0,
    times: int = 1,
) -> FaultStream:
    """Put single samples far off, a tenth of a second apart."""
    where = at + 100 * np.arange(times)
    bad = stream.copy(at, int(where[-1]) + 1)
    bad.q_rad[where, SHOULDER] += q_rad
    bad.tau_Nm[where, SHOULDER] += tau_Nm
    return bad


def saturated(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """Let one torque read its joint's effort limit."""
    limit_Nm = load_lwr().effort_limit_Nm[SHOULDER]
    return stuck_torque(stream, at, samples=samples, value=-limit_Nm)


SIGNAL_FAULTS: Mapping[str, Injection] = {
    "one torque NaN, 1 sample": partial(stuck_torque, samples=1, value=np.nan),
    "one torque infinite, 100 ms": partial(stuck_torque, samples=100, value=np.inf),
    "one torque NaN, 1 s": partial(stuck_torque, samples=1000, value=np.nan),
    "all signals frozen, 200 ms": partial(frozen, samples=200),
    "all signals frozen, 2 s": partial(frozen, samples=2000),
    "one torque frozen, 2 s": partial(stuck_torque, samples=2000),
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
"""What sensors, wires and clocks do, by name."""


def loaded(
    run: Run, stream: FaultStream, at: int, samples: int, force_in_base_N: Array
) -> FaultStream:
    """Put a force on the tool beside that of the tissue, for some samples."""
    bad = stream.copy(at, at + samples)
    span = slice(at, at + samples)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    bad.tau_Nm[span] -= (
        force_in_base_N @ tool_jacobians(run.robot, bad.q_rad[span], axes)[:, :3]
    )
    return bad


def detour(
    run: Run, stream: FaultStream, target_rad: Array, stop_Nm: Array
) -> FaultStream:
    """Put a motion in free air to a pose and back before a stream.

    The stream starts at rest in free air. The fault ends when the arm is back. Torques
    are those of the true arm, with the sensors' noise and the offset that they show
    where the motion begins, and of an end stop at the pose.
    """
    start_rad = stream.q_rad[0]
    way_rad = target_rad - start_rad
    fraction, rate_per_s, change_per_s2 = there_and_back()
    q = fraction[:, None] * way_rad + start_rad
    dq = rate_per_s[:, None] * way_rad + 0.0
    ddq = change_per_s2[:, None] * way_rad + 0.0
    mass_seed, _ = np.random.SeedSequence(run.seed).spawn(2)
    level = PLANT_MODELS[run.plant]
    model = lwr_bodies(run.tool, level, np.random.default_rng(mass_seed)).model()
    # It begins at rest: the first torque is that of gravity.
    tau = inverse_dynamics(model, q, dq, ddq)
    offset_Nm = stream.tau_Nm[:20].mean(axis=0) - tau[0]
    is_at_stop = fraction > 1.0 - 1e-9
    tau += offset_Nm - is_at_stop[:, None] * stop_Nm
    rng = np.random.default_rng(0)
    motion = FaultStream(
        dt_s=np.full(len(q), PERIOD_s),
        q_rad=q + level.position_noise_std_rad * rng.normal(size=q.shape),
        dq_rad_s=dq
        + (level.velocity_noise_std_rad_s or 0.0) * rng.normal(size=q.shape),
        tau_Nm=tau + np.array(level.torque_noise_std_Nm) * rng.normal(size=q.shape),
        reference_N=np.zeros(len(q)),
        stop=len(q),
    )
    joined = {
        name: np.concatenate((getattr(motion, name), getattr(stream, name)))
        for name in SERIES
    }
    return replace(motion, **joined)


def there_and_back() -> tuple[Array, Array, Array]:
    """Return a course: quintic out, a stay of a second, quintic back.

    The fraction of the way, its derivative [1/s], and the derivative of that, shape
    (m,) each.
    """
    travel_s = 3.0
    back_s = travel_s + 1.0
    t_s = np.arange(0.0, back_s + travel_s, PERIOD_s, dtype=np.float64)
    out, back = (Stroke("quintic", at_s, travel_s, 0.0, 1.0) for at_s in (0.0, back_s))
    fraction, rate_per_s = np.subtract(out.evaluate(t_s), back.evaluate(t_s))
    return fraction, rate_per_s, np.gradient(rate_per_s, PERIOD_s)


def wrist_at_limit(run: Run, stream: FaultStream) -> FaultStream:
    """Move the wrist to its upper limit, and press it against the stop with 2 Nm."""
    wrist = 5
    target = stream.q_rad[0].copy()
    stop = np.zeros(run.robot.nv)
    target[wrist] = run.robot.position_upper_rad[wrist]
    stop[wrist] = -2.0
    return detour(run, stream, target, stop)


def stretched(run: Run, stream: FaultStream) -> FaultStream:
    """Stretch the arm out along the needle: a force along it loads no joint."""
    return detour(run, stream, np.full(run.robot.nv, 0.01), np.zeros(run.robot.nv))


_TOP_M = -105e-3
"""Where it begins: a tare stroke of 100 mm above 5 mm from the tissue."""
_STROKES: tuple[tuple[str, float, Profile, float], ...] = (
    # Name of its end, where it leads, how, and how long it takes; a cruise has its own
    # speed.
    ("at rest", _TOP_M, "rest", 1.0),
    ("down", -5e-3, "quintic", 4.0),
    ("up", _TOP_M, "quintic", 4.0),
    ("tared", -5e-3, "quintic", 4.0),
    ("stopped", 15e-3, "cruise", math.nan),
    ("moving", 15e-3, "rest", 60.0),
    ("turned", 10e-3, "cruise", math.nan),
    ("returned", 15e-3, "cruise", math.nan),
    ("inserted", 42e-3, "cruise", math.nan),
    ("withdrawing", 42e-3, "rest", 1.0),
    ("withdrawn", -5e-3, "cruise", math.nan),
    ("again", -5e-3, "rest", 1.0),
    ("inside", 20e-3, "cruise", math.nan),
    ("inside at rest", 20e-3, "rest", 1.0),
    ("end", -5e-3, "cruise", math.nan),
    ("after", -5e-3, "rest", 0.5),
)
PARTS = {
    "stopped for 60 s": ("stopped", "moving"),
    "reversed by 5 mm and in again": ("moving", "returned"),
    "withdrawn": ("withdrawing", "withdrawn"),
    "inserted again": ("again", "inside"),
}
"""What is judged of it: from the end of one stroke to the end of another."""


def troubled_scenario() -> tuple[Scenario, dict[str, tuple[float, float]]]:
    """Return an insertion with stop, reversal, withdrawal and second insertion.

    Returns:
        The scenario, and when each of its `PARTS` begins and ends [s].
    """
    moves: list[Move] = []
    at_m = _TOP_M
    for _, to_m, profile, given_s in _STROKES:
        seconds = abs(to_m - at_m) / 5e-3 / 0.9 if profile == "cruise" else given_s
        moves.append(Move(profile, seconds, to_m - at_m))
        at_m = to_m
    strokes = chain_strokes(_TOP_M, moves)
    ends = {
        name: stroke.end_s for (name, *_), stroke in zip(_STROKES, strokes, strict=True)
    }
    motion = Motion(
        strokes=strokes,
        tare_end_s=ends["tared"],
        insertion_end_s=ends["inserted"],
        withdrawal_start_s=ends["withdrawing"],
        withdrawal_end_s=ends["end"],
    )
    title = "70 % gel: stopped, reversed, withdrawn, inserted again"
    scenario = Scenario(id="troubled", title=title, layers=(gel(70),), motion=motion)
    return scenario, {
        name: (ends[begin], ends[end]) for name, (begin, end) in PARTS.items()
    }
