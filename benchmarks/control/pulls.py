"""Forces that no tissue makes, in every phase of an insertion by itself.

A force sensor that steps or drifts towards a needle that is pulled, and a hand that
pushes at the hub, make the axial force fall as a rupture does. Counted are falls that
were taken for a rupture, what was reported, and the state at the end. A fall that
leaves a plausible force cannot always be told from a rupture.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from benchmarks.control.loop import OPEN_N, STANDOFF_M, Insertion
from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from foundation.arrays import Array
from groundtruth.rig_arm import ArmSample, SimulatedArm
from groundtruth.rig_contacts import HandOnArm
from groundtruth.rupture_match import EARLY_s, LATE_s
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

DURATION_S = 40.0
"""Of a run, at most."""
PUSH_S = 1.0
"""A hand pushes for so long."""


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

PHASES: Mapping[str, tuple[State, float, int | None]] = {
    "air": (State.INSERTION, -2e-3, 1),
    "sticking": (State.INSERTION, 0.5e-3, 1),
    "cutting": (State.INSERTION, 15e-3, 1),
    "membrane": (State.INSERTION, 31e-3, 2),
    "deep": (State.INSERTION, 50e-3, 3),
    "dwell": (State.DWELL, 10e-3, None),
    "retreat": (State.WITHDRAW, 12e-3, None),
}
"""Where in an insertion a fall begins: state of the manager; true depth of the tip
below the surface [m], in a withdrawal at most so much; the layer at whose rupture the
insertion ends, None for a planned depth."""

CASES = tuple(f"{phase}: {fall}" for phase in PHASES for fall in FALLS)


def run(job: Job, _: Progress) -> Iterator[Figure]:
    """Yield what came of one fall; nothing if the insertion did not get so far."""
    phase, fall = job.case.split(": ")
    insertion = PulledInsertion(phase, FALLS[fall], job.plant, job.seed)
    state = insertion.run()
    if math.isinf(insertion.struck_s):
        return
    is_held = state in (State.FAULTED, State.STOPPED)
    is_rupture = insertion.has_false_alarm() or (
        insertion.is_stopped_by_rupture and not is_held
    )
    is_reported = math.isfinite(insertion.report_s)
    yield Figure("pull_taken_as_rupture", is_rupture)
    yield Figure("pull_reported", is_reported)
    yield Figure("pull_status", insertion.is_pull)
    yield Figure("pull_as_torque_jump", insertion.is_jump)
    yield Figure("pull_ends_faulted", state is State.FAULTED)
    yield Figure("pull_ends_stopped", state is State.STOPPED)
    if is_reported:
        yield Figure("pull_report_ms", 1e3 * insertion.report_s)
        late_s = insertion.report_s - insertion.unexplained_s
        if math.isfinite(late_s):
            yield Figure("pull_unexplained_ms", 1e3 * max(late_s, 0.0))


class PulledInsertion:
    """An insertion with a fall of the force.

    Args:
        phase: Where it begins, one of `PHASES`.
        fall: What is added to the force.
        plant: Name of the plant model.
        seed: Of the plant.

    Attributes:
        struck_s: When the fall began, on the rig's clock; infinite if it did not.
        is_stopped_by_rupture: Whether the program stopped where nothing had ruptured.
        is_pull: Whether the force was reported to pull at the needle.
        is_jump: Whether a torque sensor was reported to have jumped.
        report_s: Time from the beginning of the fall to the first report; infinite
            without one.
        unexplained_s: Time from there until the force that is read is, by more than
            three standard deviations, below the friction of the layers that are known,
            at rest below zero: until then a layer that softens would make it, too.
    """

    def __init__(self, phase: str, fall: Fall, plant: str, seed: int) -> None:
        self._state, self._depth_m, self._layer = PHASES[phase]
        self._fall = fall
        self.struck_s = math.inf
        hand = HandOnArm(at="hub", force_N=self._pushed_N)
        self._rig = SimulatedArm(
            "stack-glove-constant",
            plant,
            seed,
            standoff_m=STANDOFF_M,
            contacts=[hand] if fall.is_push else [],
            duration_s=DURATION_S,
        )
        self._tool = Controller(self._rig.robot, Limits(self._rig.robot)).tool
        plan = InsertionPlan(
            speed_m_s=5e-3,
            depth_m=20e-3 if self._layer is None else 0.12,
            layer=self._layer,
            stroke_s=2.0,
        )
        limits = SafetyLimits(axial_N=OPEN_N)
        self._insertion = Insertion(self._rig, plan, limits, rest_s=DURATION_S)
        self._last_state = State.IDLE
        self.is_stopped_by_rupture = False
        self._alarms_s: list[tuple[int, float]] = []
        self.is_pull = False
        self.is_jump = False
        self.report_s = math.inf
        self.unexplained_s = math.inf

    def run(self) -> State:
        """Run it; return the state of the manager at the end."""
        rig = self._rig
        rest_s = 0.0
        state = State.IDLE
        for situation in self._insertion:
            self._strike(situation)
            if rig.time_s > self.struck_s:
                self._watch(situation)
            state = situation.state
            is_stopped = state in (State.FAULTED, State.STOPPED)
            rest_s = situation.state_s if is_stopped else 0.0
            over_s = self.struck_s + self._fall.lasts_s + 1.5
            # A stopped needle is watched: an alarm of the fall may be retracted.
            if rest_s > 0.4 or rig.time_s > over_s:
                break
        return state

    def _strike(self, situation: Situation) -> None:
        """Let the fall begin where the phase says."""
        rig = self._rig
        is_there = situation.state is self._state and (
            rig.truth.depth_m <= self._depth_m
            if self._state is State.WITHDRAW
            else rig.truth.depth_m >= self._depth_m
        )
        if math.isfinite(self.struck_s) or not is_there:
            return
        self.struck_s = rig.time_s
        if self._fall.is_push:
            return
        rig.inject(self._add_force, DURATION_S)

    def _add_force(self, sample: ArmSample) -> ArmSample:
        """Return a sample whose torques read as a force along the needle."""
        tool = self._tool
        tool.update(sample.q_rad)
        torque_Nm = tool.jacobian[:3].T @ tool.axis
        force_N = self._fall.at(self._rig.time_s - self.struck_s)
        return sample._replace(tau_Nm=sample.tau_Nm + force_N * torque_Nm)

    def _pushed_N(self, time_s: float) -> Array:
        """Return the force of the hand, base axes: along the needle, inwards."""
        force_N = self._fall.at(time_s - self.struck_s)
        return -force_N * self._rig.truth.rotation[:, 2]

    def _watch(self, situation: Situation) -> None:
        """Keep what is reported of a cycle."""
        state = situation.state
        identification = situation.estimate.identification
        if identification.rupture is not None:
            layer = identification.rupture.layer
            self._alarms_s.append((layer, self._rig.time_s))
        if identification.retracted is not None:
            layer = identification.retracted.layer
            self._alarms_s = [alarm for alarm in self._alarms_s if alarm[0] != layer]
        is_pull = identification.status is SampleStatus.NEEDLE_PULLED
        is_jump = SensorWarning.TORQUE_JUMP in situation.estimate.warnings
        has_begun = state is not self._last_state
        if has_begun and state is State.DWELL and self._layer is not None:
            self.is_stopped_by_rupture = not any(
                onset_s > self.struck_s for onset_s in self._onsets_s()
            )
        self._last_state = state
        layers = self._insertion.manager.session.layers
        wrench = situation.estimate.wrench
        least_N = sum(
            layer.friction_N - 3.0 * (layer.friction_std_N or 0.0) for layer in layers
        )
        if state is not State.INSERTION:
            least_N = 0.0
        too_low_N = max(least_N, 0.0) - 3.0 * wrench.axial_std
        if state is not State.WITHDRAW and wrench.axial < too_low_N:
            since_s = self._rig.time_s - self.struck_s
            self.unexplained_s = min(self.unexplained_s, since_s)
        self.is_pull = self.is_pull or is_pull
        self.is_jump = self.is_jump or is_jump
        if is_pull or is_jump or state in (State.FAULTED, State.STOPPED):
            since_s = self._rig.time_s - self.struck_s
            self.report_s = min(self.report_s, since_s)

    def _onsets_s(self) -> list[float]:
        """Return when the tissue has ruptured."""
        return [rupture.onset_s for rupture in self._rig.tissue_truth().ruptures]

    def has_false_alarm(self) -> bool:
        """Return whether an alarm, not retracted, belongs to no rupture."""
        return any(
            not any(
                -EARLY_s < time_s - onset_s < LATE_s for onset_s in self._onsets_s()
            )
            for _, time_s in self._alarms_s
        )
