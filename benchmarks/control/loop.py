"""One autonomous insertion of the simulated arm in closed loop.

Rig, manager, program and controller take turns.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from benchmarks.insertion.methods import on_lwr
from groundtruth.rig_arm import Servo, SimulatedArm
from identification import Identifier
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
from residual import DEFAULT, Status

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

    Attributes:
        rig: The same.
        ended_s: When the insertion ended, on the rig's clock; None before.
    """

    def __init__(
        self,
        rig: SimulatedArm,
        plan: InsertionPlan,
        limits: SafetyLimits,
        *,
        with_ft: bool = False,
    ) -> None:
        self._manager = Manager(InsertionSession(rig.robot, on_lwr(DEFAULT)), limits)
        self._profile = InsertionProfile(plan)
        self._with_ft = with_ft
        self._free_N = list[float]()
        self._zero_N = 0.0
        self.rig = rig
        self.ended_s: float | None = None

    def __iter__(self) -> Iterator[Situation]:
        """Run until the arm rests after the insertion, or the rig's time is over."""
        rig = self.rig
        manager = self._manager
        identifier = Identifier()
        control = Controller(rig.robot, Limits(rig.robot))
        control.tool.update(rig.home_rad)
        # With a higher gain, positions rounded to 1.75e-4 rad shake the needle.
        line = Fixture.here(control.tool, 20.0)
        posture = Posture(rig.home_rad)
        rest_s = 0.15  # in which the arm comes to rest after the insertion
        beside = Beside()
        was_inside = False
        dq_rad_s = np.zeros(rig.robot.nv)
        for sample in rig:
            manager.heartbeat()
            beside = beside._replace(axial_N=self._read_axial_N())
            situation = manager.update(sample, beside)
            estimate = situation.estimate
            sample_status = beside.sample_status
            if beside.axial_N is None:
                step = self._profile.update(situation)
            else:
                identification = identifier.update(
                    estimate.depth_m, estimate.speed_m_s, beside.axial_N, sample.dt_s
                )
                sample_status = identification.status
                step = self._profile.update(situation, identification, beside.axial_N)
            if step.event:
                manager.request(step.event)
            is_faulted = situation.state is State.FAULTED
            # A sample that was rejected moves nothing: the last command stands until a
            # fault.
            if is_faulted or estimate.status is not Status.REJECTED:
                stack = [line, AxialSpeed(step.speed_m_s), posture]
                command = control.update(sample, [] if is_faulted else stack)
                dq_rad_s = command.dq_rad_s
            beside = Beside(rig.send(dq_rad_s), dq_rad_s, sample_status=sample_status)
            is_inside = situation.state in (State.INSERTION, State.TELEOP)
            if was_inside and not is_inside and self.ended_s is None:
                self.ended_s = rig.time_s
            was_inside |= is_inside
            yield situation
            if self.ended_s is not None and rig.time_s > self.ended_s + rest_s:
                return

    def _read_axial_N(self) -> float | None:
        """Return the F/T sensor's force along the needle; None before it is zeroed."""
        if not self._with_ft:
            return None
        reading_N = -float(self.rig.ft_wrench[2])
        if not self._manager.session.tared:
            self._free_N.append(reading_N)
            return None
        self._zero_N = self._zero_N or float(np.mean(self._free_N))
        return reading_N - self._zero_N
