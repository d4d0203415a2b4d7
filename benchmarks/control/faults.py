"""Faults of sensors, wires, clocks, commands and devices in closed loop: the needle
stops or holds.

The faults are those of `benchmarks.faults.injection`, made sample by sample, and those that only
a loop has. A fault that the estimator bridges must not move the needle off its course;
any other must stop it, and the manager must say why.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks.control.autonomous import OPEN_N, SERVOS
from benchmarks.control.loop import STANDOFF_M, Insertion
from benchmarks.faults.injection import SHOULDER
from benchmarks.faults.study import UNKNOWN_KG
from benchmarks.results import Measurement, our_measurement
from groundtruth.rig_arm import ArmSample, SimulatedArm
from needleforce.control import InsertionPlan, SafetyLimits, Situation, State
from needleforce.control.insertion_profile import Step
from urdf import Payload, Robot, load_lwr

SPEED_M_S = 5e-3
DEPTH_M = 25e-3
STRUCK_M = 15e-3
WATCHED_S = 1.5

Change = Callable[[int, ArmSample, ArmSample], ArmSample]
"""What becomes of sample k of a fault; given as well: the last one before it."""


def _torque(
    k: int, now: ArmSample, before: ArmSample, *, value: float | None = None
) -> ArmSample:
    tau = now.tau_Nm.copy()
    tau[SHOULDER] = before.tau_Nm[SHOULDER] if value is None else value
    return now._replace(tau_Nm=tau)


def _spike(
    k: int,
    now: ArmSample,
    before: ArmSample,
    *,
    q_rad: float = 0.0,
    tau_Nm: float = 0.0,
) -> ArmSample:
    if k % 100:
        return now
    q = now.q_rad.copy()
    tau = now.tau_Nm.copy()
    q[SHOULDER] = q[SHOULDER] + q_rad
    tau[SHOULDER] = tau[SHOULDER] + tau_Nm
    return now._replace(q_rad=q, tau_Nm=tau)


def _jitter(k: int, now: ArmSample, before: ArmSample) -> ArmSample:
    return now._replace(dt_s=now.dt_s + 2e-4 * (1.0 if k % 2 else -1.0))


def _repeated_stamp(k: int, now: ArmSample, before: ArmSample) -> ArmSample:
    return now._replace(dt_s={0: 0.0, 1: 2e-3}.get(k % 10, now.dt_s))


SIGNALS: Mapping[str, tuple[Change, float, str]] = {
    "one torque NaN, 1 sample": (partial(_torque, value=math.nan), 1e-3, "goes on"),
    "one torque infinite, 100 ms": (partial(_torque, value=math.inf), 0.1, "stops"),
    "one torque NaN, 1 s": (partial(_torque, value=math.nan), 1.0, "stops"),
    "all signals frozen, 200 ms": (lambda k, now, before: before, 0.2, "stops"),
    "all signals frozen, 2 s": (lambda k, now, before: before, 2.0, "stops"),
    "one torque frozen, 2 s": (_torque, 2.0, "either"),
    "clock jitter of 0.2 ms, 1 s": (_jitter, 1.0, "goes on"),
    "time stamps repeated, 1 s": (_repeated_stamp, 1.0, "goes on"),
    "clock 20 ms back and forth": (
        lambda k, now, before: now._replace(dt_s=0.021 if k else -0.02),
        2e-3,
        "goes on",
    ),
    "clock set back by an hour": (
        lambda k, now, before: now._replace(dt_s=-3600.0),
        1e-3,
        "goes on",
    ),
    "position spike of 0.05 rad": (partial(_spike, q_rad=0.05), 1e-3, "goes on"),
    "torque spike of 30 Nm": (partial(_spike, tau_Nm=30.0), 1e-3, "goes on"),
    "ten torque spikes of 6 Nm, 1 s": (partial(_spike, tau_Nm=6.0), 1.0, "goes on"),
    "one torque saturated, 500 ms": (
        partial(_torque, value=-float(load_lwr().effort_limit_Nm[SHOULDER])),
        0.5,
        "stops",
    ),
}
"""What is wrong with samples: the change, for how long, and what the needle must do."""
LOSSES = {
    "1 ms lost": (1e-3, "goes on"),
    "10 ms lost": (0.01, "goes on"),
    "100 ms lost": (0.1, "stops"),
    "500 ms lost": (0.5, "stops"),
}
OTHERS = (
    "commands refused, 500 ms",
    "haptic device gone",
    f"payload {1e3 * UNKNOWN_KG:g} g wrong",
)
CASES = tuple(
    f"{servo} {fault}" for servo in SERVOS for fault in (*SIGNALS, *LOSSES, *OTHERS)
)


class Led(Insertion):
    """An insertion in teleoperation, at constant speed, by a device that may go."""

    def _step(self, now: Situation, *beside: Any) -> Step:
        if now.state is State.IDLE and self.manager.session.tared:
            return Step(0.0, "teleoperate")
        if now.state is State.TELEOP:
            return Step(SPEED_M_S)
        return super()._step(now, *beside)


def measure(case: str, plant: str, seed: int) -> Iterator[Measurement]:
    """Numbers of one fault."""
    servo, fault = case.split(" ", 1)
    rig = SimulatedArm(
        "gel-70-constant",
        plant,
        seed,
        servo=SERVOS[servo],
        standoff_m=STANDOFF_M,
        duration_s=15.0,
    )
    plan = InsertionPlan(speed_m_s=SPEED_M_S, depth_m=DEPTH_M)
    limits = SafetyLimits(axial_N=OPEN_N)
    kind = Insertion
    known = rig.robot
    if fault == OTHERS[1]:
        kind = Led
    elif fault == OTHERS[2]:
        known = _lighter(rig.robot)
    run = kind(rig, plan, limits, known=known)
    run.has_device = kind is Led
    seen = _watch(run, fault)
    expected = SIGNALS.get(fault, (None, 0.0, ""))[2] or LOSSES.get(fault, (0.0, ""))[1]
    expected = expected or ("either" if fault == OTHERS[2] else "stops")
    is_wrong = expected != "either" and bool(seen.reason) != (expected == "stops")
    yield our_measurement("fault_reaction_wrong", is_wrong)
    yield our_measurement("fault_speed_max_mm_per_s", seen.fastest_mm_s)
    if math.isfinite(seen.struck_s):
        depth_m = rig.depths_m[round(1e3 * seen.struck_s) :]
        course_m = (
            0.0 if expected == "stops" else SPEED_M_S * 1e-3 * np.arange(len(depth_m))
        )
        ahead_mm = 1e3 * float(np.max(depth_m - depth_m[0] - course_m))
        yield our_measurement("fault_travel_excess_mm", ahead_mm)


class _Seen(NamedTuple):
    struck_s: float
    fastest_mm_s: float
    reason: str  # of a stop; empty without one


def _watch(run: Insertion, fault: str) -> _Seen:
    """Run an insertion through a fault."""
    struck_s = math.inf
    fastest_m_s = 0.0
    reason = ""
    for now in run:
        is_inside = now.state in (State.INSERTION, State.TELEOP)
        if math.isinf(struck_s) and is_inside and now.estimate.depth_m > STRUCK_M:
            struck_s = run.rig.time_s
            _strike(run, fault)
        if run.rig.time_s > struck_s:
            fastest_m_s = max(fastest_m_s, abs(run.rig.truth.speed_m_s))
        if now.state in (State.STOPPED, State.FAULTED):
            reason = now.reason
        if run.rig.time_s > struck_s + WATCHED_S:
            break
    return _Seen(struck_s, 1e3 * fastest_m_s, reason)


def _strike(run: Insertion, fault: str) -> None:
    """Let a fault begin."""
    if fault in SIGNALS:
        change, seconds, _ = SIGNALS[fault]
        run.rig.inject(_Struck(change), seconds)
    elif fault in LOSSES:
        run.rig.lose("sample", LOSSES[fault][0])
    elif fault == OTHERS[0]:
        run.rig.refuse_commands(0.5)
    elif fault == OTHERS[1]:
        run.has_device = False


class _Struck:
    """Counts the samples of a fault, and keeps the first."""

    def __init__(self, change: Change) -> None:
        self._change = change
        self._count = -1
        self._before: ArmSample | None = None

    def __call__(self, sample: ArmSample) -> ArmSample:
        self._before = self._before or sample
        self._count = self._count + 1
        return self._change(self._count, sample, self._before)


def _lighter(robot: Robot) -> Robot:
    known = robot.payload
    assert known is not None
    part = 1.0 - UNKNOWN_KG / known.mass_kg
    inertia = part * known.inertia_kg_m2
    return robot.with_payload(
        Payload(mass_kg=part * known.mass_kg, com_m=known.com_m, inertia_kg_m2=inertia)
    )
