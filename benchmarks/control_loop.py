"""One autonomous insertion of the simulated arm: rig, manager, program and controller in a loop."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.methods import on_lwr
from groundtruth.rig_arm import SimulatedArm
from identification import Estimate, Identifier
from needleforce import InsertionSession
from needleforce.control import (
    AxialSpeed,
    Beside,
    Controller,
    Fixture,
    InsertionPlan,
    InsertionProfile,
    Limits,
    Manager,
    Posture,
    SafetyLimits,
    Situation,
    State,
)
from residual import DEFAULT

SERVOS = {"S": "stiff", "I": "impedance"}
STANDOFF_M = 5e-3
"""Height of the tip above the tissue where it is tared."""
TARE_S = 3.0
"""The F/T sensor is zeroed over so much of the end of the tare stroke."""


class Insertion:
    """Runs a plan on a rig; each step of the iteration is one cycle.

    Attributes:
        rig: The arm, and what is true of it.
        manager: Of the run.
        since_s: Time of the rig when the manager left the insertion; None before.
    """

    def __init__(
        self, rig: SimulatedArm, plan: InsertionPlan, limits: SafetyLimits, *, with_ft: bool = False
    ) -> None:
        self.rig, self._with_ft = rig, with_ft
        session = InsertionSession(rig.robot, on_lwr(DEFAULT))
        self.manager = Manager(rig.robot, limits, session=session)
        self._profile = InsertionProfile(plan)
        self._control = Controller(rig.robot, Limits(rig.robot))
        self._identifier = Identifier()
        self._free_N: list[float] = []
        self.since_s: float | None = None

    def __iter__(self) -> Iterator[Situation]:
        """Run to the end of the plan, or of the rig's time."""
        rig, beside = self.rig, Beside()
        posture = Posture(rig.home_rad)
        line = Fixture.here(self._control.tool)
        for sample in rig:
            self.manager.heartbeat()
            axial_N = self._axial_N()
            now = self.manager.update(sample, beside._replace(axial_N=axial_N))
            found = self._identified(now, sample.dt_s, axial_N)
            step = self._profile.update(now, found, axial_N)
            if step.event:
                self.manager.request(step.event)
            stack = [line, AxialSpeed(step.speed_m_s), posture]
            command = self._control.update(sample, [] if now.state is State.FAULTED else stack)
            accepted = rig.send(command.dq_rad_s)
            beside = Beside(accepted, command.dq_rad_s)
            yield now
