"""Forces that no tissue makes, in every phase of an insertion by itself.

A force sensor that steps or drifts towards a needle that is pulled, and a hand that
pushes at the hub, make the axial force fall as a rupture does. Counted are falls that
were taken for a rupture, what was reported, and the state at the end. A fall that
leaves a plausible force cannot always be told from a rupture.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from benchmarks.control.autonomous import OPEN_N
from benchmarks.control.loop import STANDOFF_M, Insertion
from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from foundation.arrays import Array
from groundtruth.rig_arm import ArmSample, SimulatedArm
from groundtruth.rig_contacts import HandOnArm
from identification import SampleStatus
from needleforce.control import (
    Controller,
    InsertionPlan,
    Limits,
    SafetyLimits,
    Situation,
    State,
)
from residual import SensorWarning

SCENARIO = "stack-glove-constant"
SPEED_M_S = 5e-3
DURATION_S = 40.0
"""Of a run, at most."""
STROKE_S = 2.0
"""Time of the tare stroke each way."""
PUSH_S = 1.0
"""A hand pushes for so long."""
WATCHED_S = 1.5
"""Time after the end of a fall for which the insertion is watched."""
ENDED_S = 0.4
"""A stopped needle is watched for so long: an alarm of the fall may be retracted."""
BEFORE_ONSET_S = 0.2
AFTER_ONSET_S = 1.5
"""Time before and after the onset of a rupture within which an alarm belongs to it."""


class Fall(NamedTuple):
    """A force that is added along the needle; negative, it pulls.

    Attributes:
        force_N: At its end.
        rise_s: Time in which it gets there.
        is_push: Whether a hand exerts it at the hub, and the sensors are right.
    """

    force_N: float
    rise_s: float = 0.0
    is_push: bool = False

    @property
    def lasts_s(self) -> float:
        """Time until it changes no more."""
        return PUSH_S if self.is_push else self.rise_s

    def at(self, since_s: float) -> float:
        """Return the force [N] a time after it began; for a hand that lets go, 0."""
        if since_s < 0.0 or (self.is_push and since_s > PUSH_S):
            return 0.0
        if since_s < self.rise_s:
            return self.force_N * since_s / self.rise_s
        return self.force_N


class Phase(NamedTuple):
    """Where in an insertion a fall begins.

    Attributes:
        state: Of the manager.
        depth_m: Of the tip below the surface, true; in a withdrawal at most so much.
        layer: At whose rupture the insertion ends; None for `DEPTH_M`.
    """

    state: State
    depth_m: float
    layer: int | None


DEPTH_M = 20e-3
"""Depth of a planned end, from the tare."""

FALLS: Mapping[str, Fall] = {
    "step -0.2 N": Fall(-0.2),
    "step -0.5 N": Fall(-0.5),
    "step -1 N": Fall(-1.0),
    "step -2 N": Fall(-2.0),
    "step -5 N": Fall(-5.0),
    "drift -5 N in 1 s": Fall(-5.0, rise_s=1.0),
    "drift -5 N in 4 s": Fall(-5.0, rise_s=4.0),
    "drift -5 N in 15 s": Fall(-5.0, rise_s=15.0),
    "push 2 N": Fall(-2.0, is_push=True),
    "push 10 N": Fall(-10.0, is_push=True),
}
"""Falls of the force by name."""

PHASES: Mapping[str, Phase] = {
    "air": Phase(State.INSERTION, -2e-3, 1),
    "sticking": Phase(State.INSERTION, 0.5e-3, 1),
    "cutting": Phase(State.INSERTION, 15e-3, 1),
    "membrane": Phase(State.INSERTION, 31e-3, 2),
    "deep": Phase(State.INSERTION, 50e-3, 3),
    "dwell": Phase(State.DWELL, 10e-3, None),
    "retreat": Phase(State.WITHDRAW, 12e-3, None),
}
"""Phases of an insertion by name."""

CASES = tuple(f"{phase}: {fall}" for phase in PHASES for fall in FALLS)


class FallOutcome(NamedTuple):
    """What an insertion made of a fall.

    Attributes:
        is_rupture: Whether it was taken for a rupture.
        is_pull: Whether the force was reported to pull at the needle.
        is_jump: Whether a torque sensor was reported to have jumped.
        report_s: Time from the beginning of the fall to the first report; infinite
            without one.
        state: Of the manager at the end.
    """

    is_rupture: bool
    is_pull: bool
    is_jump: bool
    report_s: float
    state: State

    @property
    def is_reported(self) -> bool:
        """Whether anything was reported."""
        return math.isfinite(self.report_s)


def run(job: Job, _: Progress) -> Iterator[Figure]:
    """Yield what came of one fall."""
    phase, fall = job.case.split(": ")
    outcome = PulledInsertion(PHASES[phase], FALLS[fall], job.plant, job.seed).run()
    if outcome is None:
        return
    yield Figure("pull_taken_as_rupture", outcome.is_rupture)
    yield Figure("pull_reported", outcome.is_reported)
    yield Figure("pull_status", outcome.is_pull)
    yield Figure("pull_as_torque_jump", outcome.is_jump)
    yield Figure("pull_ends_faulted", outcome.state is State.FAULTED)
    yield Figure("pull_ends_stopped", outcome.state is State.STOPPED)
    if outcome.is_reported:
        yield Figure("pull_report_ms", 1e3 * outcome.report_s)


class UnretractedAlarm(NamedTuple):
    """An alarm that has not been retracted.

    Attributes:
        layer: That is said to have ruptured.
        time_s: When it was raised, on the rig's clock.
    """

    layer: int
    time_s: float


class PulledInsertion:
    """An insertion with a fall of the force.

    Args:
        phase: Where it begins.
        fall: What is added to the force.
        plant: Name of the plant model.
        seed: Of the plant.
    """

    def __init__(self, phase: Phase, fall: Fall, plant: str, seed: int) -> None:
        self._phase = phase
        self._fall = fall
        self._struck_s = math.inf
        hand = HandOnArm(at="hub", force_N=self._pushed_N)
        self._rig = SimulatedArm(
            SCENARIO,
            plant,
            seed,
            standoff_m=STANDOFF_M,
            contacts=[hand] if fall.is_push else [],
            duration_s=DURATION_S,
        )
        self._tool = Controller(self._rig.robot, Limits(self._rig.robot)).tool
        plan = InsertionPlan(
            speed_m_s=SPEED_M_S,
            depth_m=DEPTH_M if phase.layer is None else 0.12,
            layer=phase.layer,
            stroke_s=STROKE_S,
        )
        limits = SafetyLimits(axial_N=OPEN_N)
        self._insertion = Insertion(self._rig, plan, limits, rest_s=DURATION_S)
        self._last_state = State.IDLE
        self._is_stopped_by_rupture = False
        self._alarms: list[UnretractedAlarm] = []
        self._is_pull = False
        self._is_jump = False
        self._report_s = math.inf

    def run(self) -> FallOutcome | None:
        """Run it and return what came of the fall; None if it did not get so far."""
        rig = self._rig
        rest_s = 0.0
        state = State.IDLE
        for situation in self._insertion:
            self._strike(situation)
            if rig.time_s > self._struck_s:
                self._watch(situation)
            state = situation.state
            is_stopped = state in (State.FAULTED, State.STOPPED)
            rest_s = situation.state_s if is_stopped else 0.0
            over_s = self._struck_s + self._fall.lasts_s + WATCHED_S
            if rest_s > ENDED_S or rig.time_s > over_s:
                break
        if math.isinf(self._struck_s):
            return None
        is_held = state in (State.FAULTED, State.STOPPED)
        is_rupture = bool(self._alarms_without_rupture()) or (
            self._is_stopped_by_rupture and not is_held
        )
        return FallOutcome(
            is_rupture, self._is_pull, self._is_jump, self._report_s, state
        )

    def _strike(self, situation: Situation) -> None:
        """Let the fall begin where the phase says."""
        rig = self._rig
        phase = self._phase
        is_there = situation.state is phase.state and (
            rig.truth.depth_m <= phase.depth_m
            if phase.state is State.WITHDRAW
            else rig.truth.depth_m >= phase.depth_m
        )
        if math.isfinite(self._struck_s) or not is_there:
            return
        self._struck_s = rig.time_s
        if self._fall.is_push:
            return
        rig.inject(self._add_force, DURATION_S)

    def _add_force(self, sample: ArmSample) -> ArmSample:
        """Return a sample whose torques read as a force along the needle."""
        tool = self._tool
        tool.update(sample.q_rad)
        torque_Nm = tool.jacobian[:3].T @ tool.axis
        force_N = self._fall.at(self._rig.time_s - self._struck_s)
        return sample._replace(tau_Nm=sample.tau_Nm + force_N * torque_Nm)

    def _pushed_N(self, time_s: float) -> Array:
        """Return the force of the hand, base axes: along the needle, inwards."""
        force_N = self._fall.at(time_s - self._struck_s)
        return -force_N * self._rig.truth.rotation[:, 2]

    def _watch(self, situation: Situation) -> None:
        """Keep what is reported of a cycle."""
        state = situation.state
        identification = situation.estimate.identification
        if identification.rupture is not None:
            layer = identification.rupture.layer
            self._alarms.append(UnretractedAlarm(layer, self._rig.time_s))
        if identification.retracted is not None:
            layer = identification.retracted.layer
            self._alarms = [alarm for alarm in self._alarms if alarm.layer != layer]
        is_pull = identification.status is SampleStatus.NEEDLE_PULLED
        is_jump = SensorWarning.TORQUE_JUMP in situation.estimate.warnings
        has_begun = state is not self._last_state
        if has_begun and state is State.DWELL and self._phase.layer is not None:
            self._is_stopped_by_rupture = not self._has_ruptured()
        self._last_state = state
        self._is_pull = self._is_pull or is_pull
        self._is_jump = self._is_jump or is_jump
        if is_pull or is_jump or state in (State.FAULTED, State.STOPPED):
            since_s = self._rig.time_s - self._struck_s
            self._report_s = min(self._report_s, since_s)

    def _onsets_s(self) -> list[float]:
        """Return when the tissue has ruptured."""
        return [rupture.onset_s for rupture in self._rig.tissue_truth().ruptures]

    def _has_ruptured(self) -> bool:
        """Return whether the tissue has ruptured since the fall began."""
        return any(onset_s > self._struck_s for onset_s in self._onsets_s())

    def _alarms_without_rupture(self) -> list[UnretractedAlarm]:
        """Return the alarms, not retracted, that belong to no rupture."""
        return [
            alarm
            for alarm in self._alarms
            if not any(
                -BEFORE_ONSET_S < alarm.time_s - onset_s < AFTER_ONSET_S
                for onset_s in self._onsets_s()
            )
        ]
