"""Faults of sensors, clocks, commands and devices in closed loop.

The needle must stop or hold. The faults are those of `benchmarks.faults.injection`,
made sample by sample, and those that only a loop has. A fault that the estimator
bridges must not move the needle off its course; any other must stop it, and the manager
must say why.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np

from benchmarks.control.loop import OPEN_N, SERVOS, STANDOFF_M, Insertion
from benchmarks.faults.injection import SHOULDER
from benchmarks.faults.study import without_part
from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from groundtruth.rig_arm import ArmSample, SimulatedArm
from needleforce.control import InsertionPlan, SafetyLimits, Situation, State
from needleforce.control.insertion_profile import Step
from urdf import load_lwr

SPEED_M_S = 5e-3

SampleChange = Callable[[int, ArmSample, ArmSample], ArmSample]
"""Returns what becomes of sample k of a fault; the last argument is the first one."""


def replace_torque(
    k: int, sample: ArmSample, before: ArmSample, *, value: float | None = None
) -> ArmSample:
    """Return the sample with another torque, by default the one before the fault."""
    tau = sample.tau_Nm.copy()
    tau[SHOULDER] = before.tau_Nm[SHOULDER] if value is None else value
    return sample._replace(tau_Nm=tau)


def add_spike(
    k: int,
    sample: ArmSample,
    before: ArmSample,
    *,
    q_rad: float = 0.0,
    tau_Nm: float = 0.0,
) -> ArmSample:
    """Return every hundredth sample with a spike."""
    if k % 100:
        return sample
    q = sample.q_rad.copy()
    tau = sample.tau_Nm.copy()
    q[SHOULDER] = q[SHOULDER] + q_rad
    tau[SHOULDER] = tau[SHOULDER] + tau_Nm
    return sample._replace(q_rad=q, tau_Nm=tau)


def freeze(k: int, sample: ArmSample, before: ArmSample) -> ArmSample:
    """Return the sample before the fault."""
    return before


def jitter(k: int, sample: ArmSample, before: ArmSample) -> ArmSample:
    """Return the sample with a time that is off by 0.2 ms, forth and back."""
    return sample._replace(dt_s=sample.dt_s + 2e-4 * (1.0 if k % 2 else -1.0))


def repeat_stamp(k: int, sample: ArmSample, before: ArmSample) -> ArmSample:
    """Return every tenth sample with the time stamp of the one before it."""
    return sample._replace(dt_s={0: 0.0, 1: 2e-3}.get(k % 10, sample.dt_s))


def turn_clock_back(k: int, sample: ArmSample, before: ArmSample) -> ArmSample:
    """Return the first sample 20 ms early, and the next in time again."""
    return sample._replace(dt_s=0.021 if k else -0.02)


def set_clock_back(k: int, sample: ArmSample, before: ArmSample) -> ArmSample:
    """Return the sample an hour early."""
    return sample._replace(dt_s=-3600.0)


class Reaction(StrEnum):
    """What the needle must do."""

    GO_ON = "goes on"
    STOP = "stops"
    EITHER = "either"


EFFORT_LIMIT_NM = float(load_lwr().effort_limit_Nm[SHOULDER])
SIGNALS: Mapping[str, tuple[SampleChange, float, Reaction]] = {
    "one torque NaN, 1 sample": (
        partial(replace_torque, value=math.nan),
        1e-3,
        Reaction.GO_ON,
    ),
    "one torque infinite, 100 ms": (
        partial(replace_torque, value=math.inf),
        0.1,
        Reaction.STOP,
    ),
    "one torque NaN, 1 s": (
        partial(replace_torque, value=math.nan),
        1.0,
        Reaction.STOP,
    ),
    "all signals frozen, 200 ms": (freeze, 0.2, Reaction.STOP),
    "all signals frozen, 2 s": (freeze, 2.0, Reaction.STOP),
    "one torque frozen, 2 s": (replace_torque, 2.0, Reaction.EITHER),
    "clock jitter of 0.2 ms, 1 s": (jitter, 1.0, Reaction.GO_ON),
    "time stamps repeated, 1 s": (repeat_stamp, 1.0, Reaction.GO_ON),
    "clock 20 ms back and forth": (turn_clock_back, 2e-3, Reaction.GO_ON),
    "clock set back by an hour": (set_clock_back, 1e-3, Reaction.GO_ON),
    "position spike of 0.05 rad": (
        partial(add_spike, q_rad=0.05),
        1e-3,
        Reaction.GO_ON,
    ),
    "torque spike of 30 Nm": (partial(add_spike, tau_Nm=30.0), 1e-3, Reaction.GO_ON),
    "ten torque spikes of 6 Nm, 1 s": (
        partial(add_spike, tau_Nm=6.0),
        1.0,
        Reaction.GO_ON,
    ),
    "one torque saturated, 500 ms": (
        partial(replace_torque, value=-EFFORT_LIMIT_NM),
        0.5,
        Reaction.STOP,
    ),
}
"""What becomes of samples, for how long [s], and what the needle must do."""
LOSSES: Mapping[str, tuple[float, Reaction]] = {
    "1 ms lost": (1e-3, Reaction.GO_ON),
    "10 ms lost": (0.01, Reaction.GO_ON),
    "100 ms lost": (0.1, Reaction.STOP),
    "500 ms lost": (0.5, Reaction.STOP),
}
"""For how long samples do not come [s], and what the needle must do."""
REFUSED = "commands refused, 500 ms"
DEVICE_GONE = "haptic device gone"
WRONG_PAYLOAD = "payload 100 g wrong"
EXPECTED: Mapping[str, Reaction] = {
    **{name: reaction for name, (_, _, reaction) in SIGNALS.items()},
    **{name: reaction for name, (_, reaction) in LOSSES.items()},
    REFUSED: Reaction.STOP,
    DEVICE_GONE: Reaction.STOP,
    WRONG_PAYLOAD: Reaction.EITHER,
}
"""What the needle must do, by the name of the fault."""
CASES = tuple(f"{servo} {fault}" for servo in SERVOS for fault in EXPECTED)


class Led(Insertion):
    """An insertion in teleoperation, at constant speed, by a device that may go."""

    def _step(self, situation: Situation, *beside: Any) -> Step:
        """Return what the program wants: constant speed in teleoperation."""
        if situation.state is State.IDLE and self.manager.session.tared:
            return Step(0.0, "teleoperate")
        if situation.state is State.TELEOP:
            return Step(SPEED_M_S)
        return super()._step(situation, *beside)


def run(job: Job, _: Progress) -> Iterator[Figure]:
    """Yield the numbers of one fault."""
    servo, fault = job.case.split(" ", 1)
    rig = SimulatedArm(
        "gel-70-constant",
        job.plant,
        job.seed,
        servo=SERVOS[servo],
        standoff_m=STANDOFF_M,
        duration_s=15.0,
    )
    kind = Led if fault == DEVICE_GONE else Insertion
    robot = rig.robot
    insertion = kind(
        rig,
        InsertionPlan(speed_m_s=SPEED_M_S, depth_m=25e-3),
        SafetyLimits(axial_N=OPEN_N),
        known=without_part(robot) if fault == WRONG_PAYLOAD else robot,
    )
    insertion.has_device = kind is Led
    struck_s = math.inf
    fastest_m_s = 0.0
    has_stopped = False
    for situation in insertion:
        is_inside = situation.state in (State.INSERTION, State.TELEOP)
        is_deep = situation.estimate.depth_m > 15e-3
        if math.isinf(struck_s) and is_inside and is_deep:
            struck_s = rig.time_s
            begin_fault(insertion, fault)
        if rig.time_s > struck_s:
            fastest_m_s = max(fastest_m_s, abs(rig.truth.speed_m_s))
        if situation.state in (State.STOPPED, State.FAULTED):
            has_stopped = bool(situation.reason)
        if rig.time_s > struck_s + 1.5:
            break
    expected = EXPECTED[fault]
    must_rest = expected is Reaction.STOP
    is_wrong = expected is not Reaction.EITHER and has_stopped != must_rest
    yield Figure("fault_reaction_wrong", is_wrong)
    yield Figure("fault_speed_max_mm_per_s", 1e3 * fastest_m_s)
    if math.isfinite(struck_s):
        depth_m = rig.depths_m[round(1e3 * struck_s) :]
        course_m = 0.0 if must_rest else SPEED_M_S * 1e-3 * np.arange(len(depth_m))
        ahead_mm = 1e3 * float(np.max(depth_m - depth_m[0] - course_m))
        yield Figure("fault_travel_excess_mm", ahead_mm)


def begin_fault(insertion: Insertion, fault: str) -> None:
    """Let a fault begin."""
    rig = insertion.rig
    if fault in SIGNALS:
        change, duration_s, _ = SIGNALS[fault]
        rig.inject(ChangedSamples(change), duration_s)
    elif fault in LOSSES:
        rig.lose("sample", LOSSES[fault][0])
    elif fault == REFUSED:
        rig.refuse_commands(0.5)
    elif fault == DEVICE_GONE:
        insertion.has_device = False


class ChangedSamples:
    """What becomes of the samples of a fault; counts them, and keeps the first."""

    def __init__(self, change: SampleChange) -> None:
        self._change = change
        self._count = -1
        self._before: ArmSample | None = None

    def __call__(self, sample: ArmSample) -> ArmSample:
        """Return what the sample becomes."""
        self._before = self._before or sample
        self._count = self._count + 1
        return self._change(self._count, sample, self._before)
