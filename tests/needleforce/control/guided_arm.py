"""A tared arm that hands guide, in closed loop on the simulated arm."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

from benchmarks.control.loop import SERVOS
from benchmarks.insertion.methods import on_lwr
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
