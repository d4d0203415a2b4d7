"""Manual guidance through the residual, by simulated hands on hub, wrist and elbow.

Each run tares the virtual sensor over a stroke of 60 mm along the needle. *Drift*: the
fastest command in 60 s without a hand. *Breakaway*: force on the hub, growing by 1 N/s,
at which the arm begins to yield. *Stable*: hands of a stiffness pull aside by 20 mm and
rest; the figures are how far the held point still swings in the last half second, and
how far it has been from the resting hand, worst of directions. *In tissue*: 10 N on the
hub across a needle 40 mm deep, how far its axis leaves the entry.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np

from benchmarks.control.loop import SERVOS
from benchmarks.insertion.methods import on_lwr
from benchmarks.jobs import Figure, Job
from foundation.arrays import Array
from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import HandOnArm
from needleforce.control import (
    AxialSpeed,
    Controller,
    Fixture,
    Guidance,
    Limits,
    Posture,
    Task,
)
from residual import DEFAULT, Status, VirtualForceSensor

Place = Literal["hub", "wrist", "elbow"]
CASES = (
    *(f"{what} {servo}" for what in ("drift", "force", "tissue") for servo in "SI"),
    *(f"stable {servo} {at}" for servo in "SI" for at in ("hub", "wrist", "elbow")),
)
STIFFEST_N_per_m = {"S": 2000.0, "I": 1000.0}
STROKE_s = 4.0
HAND_N_per_m = 500.0
DRIFT_s = 60.0


class GuidedArm:
    """A tared arm with sensor, controller and guidance, held by a hand later.

    Attributes:
        begin_s: When guidance begins, on the rig's clock.
        hand: Does nothing until it is given a force or a path.
    """

    def __init__(
        self,
        servo: str,
        plant: str,
        seed: int,
        at: Place = "hub",
        scenario: str | None = None,
    ) -> None:
        self.begin_s = STROKE_s + (5.0 if scenario else 0.2)
        self.hand = HandOnArm(at=at, stiffness_N_per_m=HAND_N_per_m)
        self.rig = SimulatedArm(
            scenario,
            plant,
            seed,
            servo=SERVOS[servo],
            contacts=[self.hand],
            standoff_m=0.002 if scenario else None,
            duration_s=self.begin_s + DRIFT_s + 1.0,
        )
        self.control = Controller(self.rig.robot, Limits(self.rig.robot))
        for_guidance = replace(DEFAULT, smooth_momentum=False)
        self.sensor = VirtualForceSensor(self.rig.robot, on_lwr(for_guidance))
        self._above: list[Task] = []
        self._prepare(scenario is not None)

    def _prepare(self, is_inserted: bool) -> None:
        """Tare over a stroke away from the tissue and back; then perhaps insert."""
        control = self.control
        rig = self.rig
        control.tool.update(rig.home_rad)
        line = Fixture.here(control.tool)
        home = Posture(rig.home_rad)
        for sample in rig:
            self.sensor.update(*sample[1:], sample.dt_s)
            time_s = rig.time_s
            speed_m_s = 0.0
            if time_s < STROKE_s:
                turn = 2.0 * math.pi * time_s / STROKE_s
                speed_m_s = -math.pi * 0.06 / STROKE_s * math.sin(turn)
            elif not self.sensor.tared and time_s > STROKE_s + 0.1:
                self.sensor.tare()
            elif is_inserted and rig.truth.depth_m < 0.04:
                speed_m_s = 0.01
            stack = [line, AxialSpeed(speed_m_s), home]
            rig.send(control.update(sample, stack).dq_rad_s)
            if time_s >= self.begin_s:
                break
        if is_inserted:
            self._above = [Fixture.here(control.tool, 60.0), AxialSpeed(0.0)]

    def run(self, seconds: float) -> Iterator[float]:
        """Guide for some time; yields the time since guidance began [s]."""
        guidance = Guidance(self.rig.robot)
        for sample in self.rig:
            wrench = self.sensor.update(*sample[1:], sample.dt_s)
            is_valid = wrench.status is Status.OK
            wish = guidance.update(
                wrench.residual,
                self.sensor.residual_std_Nm,
                sample.dt_s,
                is_valid=is_valid,
            )
            self.rig.send(self.control.update(sample, [*self._above, wish]).dq_rad_s)
            now_s = self.rig.time_s - self.begin_s
            yield now_s
            if now_s >= seconds:
                return


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of one case."""
    kind, servo, *at = job.case.split()
    run = {"drift": _drift, "force": _force, "tissue": _tissue, "stable": _stability}[
        kind
    ]
    yield from run(servo, job.plant, job.seed, *at)


def _across(seed: int) -> Array:
    """Draw a horizontal direction."""
    angle = 2.0 * math.pi * np.random.default_rng(seed).random()
    return np.array((math.cos(angle), math.sin(angle), 0.0))


def _drift(servo: str, plant: str, seed: int) -> Iterator[Figure]:
    """Guide without a hand."""
    arm = GuidedArm(servo, plant, seed)
    # The command that ended the stroke is braked first.
    fastest_rad_s = max(
        np.abs(arm.control.last_rad_s).max()
        for now_s in arm.run(DRIFT_s)
        if now_s > 0.1
    )
    yield Figure("idle_command_max_rad_per_s", fastest_rad_s)


def _force(servo: str, plant: str, seed: int) -> Iterator[Figure]:
    """Pull slowly until the tip moves, and at 100 mm/s, across the needle."""
    across = _across(seed)
    arm = GuidedArm(servo, plant, seed)
    begin_s = arm.begin_s
    arm.hand.force_N = lambda time_s: max(time_s - begin_s, 0.0) * across
    # What was left of the stroke's speed is gone by then.
    yields = (t for t in arm.run(5.0) if t > 0.1 and arm.control.last_rad_s.any())
    yield Figure("breakaway_force_N", next(yields, math.nan))
    for stiffness in (HAND_N_per_m, STIFFEST_N_per_m[servo]):
        arm = GuidedArm(servo, plant, seed)
        arm.hand.stiffness_N_per_m = stiffness
        arm.hand.path_m = lambda time_s: 0.1 * max(time_s - begin_s - 0.1, 0.0) * across
        led = np.array([arm.hand.applied_N for now_s in arm.run(1.4) if now_s > 0.6])
        if stiffness == HAND_N_per_m:
            mean_N = float(np.linalg.norm(led, axis=1).mean())
            yield Figure("leading_force_N", mean_N)
        else:
            swing_N = float(np.sqrt(led.var(axis=0).sum()))
            yield Figure("leading_force_swing_rms_N", swing_N)


def _stability(servo: str, plant: str, seed: int, at: Place) -> Iterator[Figure]:
    """Let a stiff hand pull aside along each axis and rest."""
    worst_m = furthest_m = 0.0
    stiffness = STIFFEST_N_per_m[servo]
    for direction in np.eye(3):
        arm = GuidedArm(servo, plant, seed, at)
        begin_s = arm.begin_s
        arm.hand.stiffness_N_per_m = stiffness
        arm.hand.path_m = lambda time_s, way=direction, begin_s=begin_s: (
            0.02 * min(max(time_s - begin_s, 0.0) / 0.4, 1.0) * way
        )
        # After half a second the hand rests. An arm further from it than it has pulled,
        # 20 mm, has run away; it may then stand still because the sensor takes nothing
        # in, so its swing alone says nothing.
        stretch = np.array(
            [arm.hand.stretch_m for now_s in arm.run(2.5) if now_s > 0.5]
        )
        furthest_m = max(furthest_m, float(np.linalg.norm(stretch, axis=1).max()))
        worst_m = max(worst_m, float(np.ptp(stretch[-500:], axis=0).max()))
    yield Figure("hand_swing_mm", 1e3 * worst_m)
    yield Figure("hand_distance_max_mm", 1e3 * furthest_m)


def _tissue(servo: str, plant: str, seed: int) -> Iterator[Figure]:
    """Push the hub across while the needle is in tissue."""
    across = _across(seed)
    arm = GuidedArm(servo, plant, seed, scenario="stack-glove-constant")
    truth = arm.rig.truth
    begin_s = arm.begin_s
    entry_m = truth.tip_m - truth.depth_m * truth.rotation[:, 2]
    arm.hand.force_N = lambda time_s: (
        10.0 * min(max(time_s - begin_s, 0.0) / 0.2, 1.0) * across
    )
    worst_m = max(arm.rig.distance_to_axis_m(entry_m) for _ in arm.run(2.0))
    yield Figure("entry_deviation_max_mm", 1e3 * worst_m)
