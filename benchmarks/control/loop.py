"""One autonomous insertion of the simulated arm in closed loop.

Rig, manager, program and controller take turns.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from benchmarks.insertion.methods import on_lwr
from groundtruth.rig_arm import Servo, SimulatedArm
from identification import Estimate, Identifier, SampleStatus
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
from needleforce.control.insertion_profile import Step
from residual import DEFAULT, Status
from urdf import Robot

SERVOS: Mapping[str, Servo] = {"S": "stiff", "I": "impedance"}
"""Inner loops, by their letter in the names of cases."""
STANDOFF_M = 5e-3
"""Height of the tip above the tissue where it is tared."""
OPEN_N = 20.0
"""A force limit that no tissue here reaches."""


class Insertion:
    """A plan that is run on a rig; each step of the iteration is one cycle.

    Args:
        rig: The arm, and what is true of it.
        plan: What to do.
        limits: Of the manager.
        with_ft: Take the rig's F/T sensor for force and identification, zeroed over the
            tare stroke, over which the needle's weight and inertia do not show.
        known: The robot as the session is to know it, if not as it is.
        rest_s: Time after the end of the insertion for which it goes on; the arm has
            come to rest after 0.15 s.

    Attributes:
        manager: Of the run.
        ended_s: When the insertion ended, on the rig's clock; None before.
    """

    def __init__(
        self,
        rig: SimulatedArm,
        plan: InsertionPlan,
        limits: SafetyLimits,
        *,
        with_ft: bool = False,
        known: Robot | None = None,
        rest_s: float = 0.15,
    ) -> None:
        session = InsertionSession(
            rig.robot if known is None else known, on_lwr(DEFAULT)
        )
        self.manager = Manager(session, limits)
        self.rig = rig
        self._rest_s = rest_s
        self._profile = InsertionProfile(plan)
        self._with_ft = with_ft
        self._identifier = Identifier()
        self._sample_status = SampleStatus.OK
        self._free_N = list[float]()
        self._zero_N = 0.0
        self.ended_s: float | None = None

    def __iter__(self) -> Iterator[Situation]:
        """Run until the arm rests after the insertion, or the rig's time is over."""
        rig = self.rig
        manager = self.manager
        beside = Beside()
        control = Controller(rig.robot, Limits(rig.robot))
        control.tool.update(rig.home_rad)
        # With a higher gain, positions rounded to 1.75e-4 rad shake the needle.
        line = Fixture.here(control.tool, 20.0)
        posture = Posture(rig.home_rad)
        was_inside = False
        dq_rad_s = np.zeros(rig.robot.nv)
        for sample in rig:
            manager.heartbeat()
            axial_N = self._axial_N() if self._with_ft else None
            beside = beside._replace(
                axial_N=axial_N,
                sample_status=self._sample_status,
            )
            situation = manager.update(sample, beside)
            step = self._step(
                situation, *self._identify(situation, sample.dt_s, axial_N)
            )
            if step.event:
                manager.request(step.event)
            if (
                situation.estimate.status is not Status.REJECTED
                or situation.state is State.FAULTED
            ):
                stack = [line, AxialSpeed(step.speed_m_s), posture]
                command = control.update(
                    sample, [] if situation.state is State.FAULTED else stack
                )
                dq_rad_s = command.dq_rad_s
            # A sample that was rejected moves nothing: the last command stands until a
            # fault.
            beside = Beside(rig.send(dq_rad_s), dq_rad_s)
            is_inside = situation.state in (State.INSERTION, State.TELEOP)
            if was_inside and not is_inside and self.ended_s is None:
                self.ended_s = rig.time_s
            was_inside |= is_inside
            yield situation
            if self.ended_s is not None and rig.time_s > self.ended_s + self._rest_s:
                return

    def _step(self, situation: Situation, *beside: Any) -> Step:
        """Return what the program wants."""
        return self._profile.update(situation, *beside)

    def _axial_N(self) -> float | None:
        """Return the F/T sensor's force along the needle; None before it is zeroed."""
        reading_N = -float(self.rig.ft_wrench[2])
        if not self.manager.session.tared:
            self._free_N.append(reading_N)
            return None
        self._zero_N = self._zero_N or float(np.mean(self._free_N))
        return reading_N - self._zero_N

    def _identify(
        self, situation: Situation, dt_s: float, axial_N: float | None
    ) -> tuple[()] | tuple[Estimate, float]:
        """Return what the program is given beside the situation, if anything."""
        if axial_N is None:
            return ()
        estimate = situation.estimate
        identification = self._identifier.update(
            estimate.depth_m, estimate.speed_m_s, axial_N, dt_s
        )
        self._sample_status = identification.status
        return identification, axial_N
