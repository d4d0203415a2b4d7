"""The switching filter over time: blocks of samples, ruptures, layers, answers.

A block's work is spread over three samples: its force is absorbed in the sample that fills it;
hypotheses of new events begin in the next; the bank is pruned and reports in the one after.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from identification.config import MultilayerConfig
from identification.disturbance_levels import STEP_S, DisturbanceLevels
from identification.estimate import (
    Events,
    LayerEstimate,
    Rupture,
    RuptureState,
    Sample,
    layers_traversed,
)
from identification.hypothesis_bank import (
    STEP_MM,
    Bank,
    Place,
    first_bank,
    judge_fractions,
    prune,
    spawn,
)
from identification.hypothesis_filter import (
    AIR,
    BEATS,
    COULOMB,
    HELD,
    HELD_DRIFT,
    KIND,
    LAW_ERROR,
    LEFT_ERROR,
    OFFSET,
    OWN_COULOMB,
    OWN_VISCOUS,
    ROOT,
    RUPTURES,
    STIFFENING,
    STIFFNESS,
    TIP,
    VISCOUS,
    absorb,
    predict,
    regressors,
)
from identification.rupture_report import (
    Evaluation,
    answer_at,
    count_ruptures,
    friction_left,
    layer_left,
    may_be_braking,
    partial_rupture_probability,
    rupture_of,
    with_friction,
)
from identification.switching_update import (
    Answer,
    LeftLayer,
    SwitchingMemory,
    is_full,
    switching_outputs,
    update_switching,
)
from needleforce.jit import jit_arguments

_MM = 1e3
_RESUMED_MM = 0.6
"""Travel over which friction is as it was before a rest: twice that of presliding."""
_GAP_S = 0.25
"""A longer block is a gap: what it says is not used."""
_USUAL_S, _USUAL_MM = 10.0, 3.0
"""The usual speed is the highest of so much time and travel: the approach may be quick."""
_CREEP, _SLOW, _HALF = 0.05, 0.15, 0.3
"""Advancing means faster than this [mm/s] and than a part of the usual speed; new hypotheses want
more of it: at a stop the force falls without any rupture."""
_DEADBAND = 3.0
"""Standard deviations of the speed's noise within which the speed may not have changed."""
_CHANNEL_MM = 0.02
"""Behind the deepest point by more than this, and the noise, the tip is in its own channel."""
_UNSETTLED = 0.3
"""Error of the friction while presliding turns or after a rest, as part of the force."""
_TAKEN_BACK = 0.9
"""Probability of fewer ruptures at which an alarm is taken back."""
_PROVISIONAL_M, _FINAL_M = 1e-3, 3e-3
"""Travel after a rupture at which its layer is reported."""
_REVISE = 10.0
"""Blocks between two revisions of the layers left."""
_MOTION_MM = 0.1
"""Of tissue with the heart, one standard deviation, if its beat is not known better."""
_FAR_MM = 1e9
_NOTHING, _SPAWN, _PRUNE, _REPORT = range(4)


class Course(NamedTuple):
    """How the needle has moved so far, block by block."""

    deepest: float = -_FAR_MM  # [mm]
    spawned: float = -_FAR_MM  # depth at which hypotheses began last [mm]
    usual_speed: float = 0.0  # [mm/s]
    resumed: float = 0.0  # how much of a rest or reversal is left in the friction, 0 to 1
    speed: float = 0.0  # less the jitter of its measurement [mm/s]


class SwitchingState(NamedTuple):
    """All that the switching filter remembers; immutable."""

    bank: Bank
    levels: DisturbanceLevels = DisturbanceLevels()
    memory: SwitchingMemory = SwitchingMemory()  # what every sample changes
    course: Course = Course()
    place: Place = Place(*(0.0,) * 9)  # middle of the last block
    stage: int = _NOTHING  # what is left to do for that block
    answer: Answer = Answer()
    ruptures: int = 0  # in the hypotheses that the last report followed
    alarm: Rupture | None = None  # the last one raised and not taken back
    layers: tuple[LayerEstimate, ...] = ()
    rupture_state: RuptureState = RuptureState.NO_RUPTURE
    events: Events = Events()  # of this sample

    @property
    def is_due(self) -> bool:
        """Whether the next sample finds work to do even if it fills no block."""
        return self.stage != _NOTHING or any(self.events)


class SwitchingMethod:
    """The switching filter, sample by sample; see `identification.identifier.Method`."""

    takes_filtered_travel = True

    def __init__(self, config: MultilayerConfig) -> None:
        self._config = config
        self.restore(SwitchingState(first_bank()))

    @property
    def state(self) -> SwitchingState:
        """All that it remembers."""
        return self._state._replace(memory=SwitchingMemory._make(self._memory))

    def restore(self, state: SwitchingState) -> None:
        """Go on from there."""
        self.before, self._sources = state, None
        self._keep(state)

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers left so far, as known now."""
        return self._state.layers

    def report(self) -> tuple[Any, ...]:
        """What there is to report without a sample."""
        outputs = switching_outputs((0.0, 0.0, 0.0, 0.0), 0.0, self._memory, *self._arguments)
        return (self._state.rupture_state, *outputs, None, None, None)

    def update(self, sample: Sample) -> tuple[Any, ...]:
        """Use one sample: what to report of it, from the rupture state to the events."""
        motion, force_N = sample[2:6], sample.force_N
        is_all, memory, outputs = update_switching(
            motion, force_N, sample.dt_s, self._memory, *self._arguments
        )
        if is_all:
            self._memory = memory
            return (self._state.rupture_state, *outputs, None, None, None)
        before, state = self.state, self._state
        if any(state.events):
            state = state._replace(events=Events())
        new = switching_step(state, SwitchingMemory._make(memory), sample, self._config)
        if new.events.rupture is not None:
            self.before = before
        if self._keep(new):
            outputs = switching_outputs(motion, force_N, self._memory, *self._arguments)
        return (new.rupture_state, *outputs, *new.events)

    def _keep(self, state: SwitchingState) -> bool:
        """Keep a state; whether what samples read of it is new."""
        self._state, self._memory, known = state, state.memory[:], self._sources
        self._sources = state.answer, state.layers
        if known is not None and all(a is b for a, b in zip(known, self._sources, strict=True)):
            return False
        left = None if known is None or known[1] is not state.layers else self._arguments[1]
        if left is None:
            left = jit_arguments(LeftLayer, *left_layers(state))
        self._arguments = (jit_arguments(Answer, state.answer), left)
        return True


def left_layers(state: SwitchingState) -> list[LeftLayer]:
    """Friction of the layers left, for the withdrawal."""
    found = []
    for layer in state.layers:
        coulomb = min((layer.coulomb_N_per_m or 0.0) * layer.thickness_m, layer.friction_N)
        viscous = (layer.friction_N - coulomb) / max(_MM * layer.rupture.speed_m_s, 1e-3)
        found.append(LeftLayer(layer.start_depth_m, layer.thickness_m, coulomb, viscous))
    return found


def switching_step(
    state: SwitchingState, memory: SwitchingMemory, sample: Sample, config: MultilayerConfig
) -> SwitchingState:
    """What is done once per block, in three parts."""
    state = state._replace(memory=memory)
    if is_full(memory[:]):
        while state.stage != _NOTHING:  # blocks of one or two samples
            state = _work(state, sample, config)
        state = _absorb(state, sample)
    elif state.stage != _NOTHING:
        state = _work(state, sample, config)
    return state._replace(memory=state.memory._replace(due=float(state.is_due)))


def _work(state: SwitchingState, sample: Sample, config: MultilayerConfig) -> SwitchingState:
    if state.stage == _SPAWN:
        return _branch(state)
    return _report(state, sample, config)


def _absorb(state: SwitchingState, sample: Sample) -> SwitchingState:
    """Let every hypothesis predict the force of the block, and learn from it."""
    memory, course, bank, levels = state.memory, state.course, state.bank, state.levels
    dt, last = memory.filled_s, course.deepest
    z, v, w = (
        x / dt for x in (_MM * memory.depth_sum, _MM * memory.speed_sum, memory.deflection_sum)
    )
    jitter, speed_noise = _MM * memory.depth_std_m, _MM * memory.speed_std_m_s
    # Friction at a noisy speed would seem to be the same at all speeds: only a change that noise
    # does not explain is one.
    deadband = _DEADBAND * speed_noise
    steady = v - deadband if course.speed < v - deadband else min(course.speed, v + deadband)
    usual = max(course.usual_speed * math.exp(-dt / _USUAL_S - abs(v) * dt / _USUAL_MM), v)
    fresh = max(z - last, 0.0) if last > -_FAR_MM else 0.0
    is_gap = dt > _GAP_S
    is_advancing = v > max(_CREEP + 2.0 * speed_noise, _SLOW * usual) and not is_gap
    is_advancing &= z > last - _CHANNEL_MM - 4.0 * jitter
    place = Place(
        sample.time_s - 0.5 * dt, dt, z, steady, w, memory.force_sum / dt, usual, levels.noise
    )
    course = course._replace(deepest=max(last, z), usual_speed=usual, speed=steady)
    emptied = memory._replace(
        filled_s=0.0, depth_sum=0.0, speed_sum=0.0, deflection_sum=0.0, force_sum=0.0
    )
    bank = _predicted(bank, place, fresh, levels)
    is_met = bool((bank.facts[:, KIND] != AIR).any() or (bank.facts[:, RUPTURES] > 0.0).any())
    is_used = (is_advancing or not is_met) and not is_gap
    if is_used:
        course = course._replace(resumed=course.resumed * math.exp(-fresh / _RESUMED_MM))
        levels = levels.with_force(place.force, dt, v)
        place = place._replace(noise=levels.noise)
        # A speed is as late as its filter: where it changes it is off by a block's change.
        speed_std = math.hypot(2.0 * speed_noise, steady - state.place.speed)
        bank = _absorbed(bank, place, levels, course.resumed, (jitter, speed_std))
    else:
        course, levels = course._replace(resumed=1.0), levels.restarted()
    stage = (_SPAWN if is_advancing else _PRUNE) if is_used else _REPORT
    return state._replace(
        bank=bank, levels=levels, memory=emptied, course=course, place=place, stage=stage
    )


def _predicted(bank: Bank, place: Place, fresh: float, levels: DisturbanceLevels) -> Bank:
    # Errors of the law are the same for all: what claims less would be believed more.
    best = bank.means[0]
    slope = max(best[STIFFNESS] + best[OWN_COULOMB] + best[OWN_VISCOUS] * place.speed, 0.004)
    held = fresh * (HELD_DRIFT * min(max(best[HELD], 0.02), 2.0 * slope)) ** 2
    left = place.deflection * best[COULOMB] + place.speed * best[VISCOUS]
    law = LAW_ERROR * (abs(place.force - best[OFFSET] - left) + LEFT_ERROR * abs(left))
    variances = np.array([*levels.levels[1:], law * law])
    # Before a few beats have been seen nobody knows whether the tissue moves.
    variances[1] = max(
        variances[1], (_MOTION_MM * slope) ** 2 if bank.facts[0, KIND] != AIR else 0.0
    )
    means, spreads = predict(
        bank.means,
        bank.spreads,
        np.where(bank.facts[:, KIND] != AIR, held, 0.0),
        place.dt_s,
        fresh,
        variances,
    )
    return bank._replace(means=means, spreads=spreads)


def _absorbed(
    bank: Bank, place: Place, levels: DisturbanceLevels, resumed: float, noise: tuple[float, float]
) -> Bank:
    (depth_std, speed_std), best, fact = noise, bank.means[0], bank.facts[0]
    damping = best[VISCOUS] + best[OWN_VISCOUS] * max(place.depth - fact[ROOT], 0.0)
    variance = max(levels.levels[0] * STEP_S / place.dt_s, 1e-8)
    variance += (damping * speed_std) ** 2
    if fact[KIND] != AIR:
        loose = _UNSETTLED * max(1.0 - place.deflection, resumed)
        variance += (loose * (place.force - best[OFFSET])) ** 2
    rows = regressors(bank.facts, place.depth, place.speed, place.deflection)
    measured = (place.force, float(variance), place.depth, depth_std)
    means, spreads, evidence = absorb(bank.means, bank.spreads, bank.facts, rows, measured)
    log_weights = bank.log_weights + evidence
    return bank._replace(means=means, spreads=spreads, log_weights=log_weights)


def _tissue_speed(bank: Bank, place: Place, levels: DisturbanceLevels) -> float:
    """Standard deviation of the speed at which tissue moves by itself [mm/s], as its force says."""
    best, fact = bank.means[0], bank.facts[0]
    travel, length = (max(place.depth - fact[at], 0.0) for at in (TIP, ROOT))
    slope = best[STIFFNESS] + 2.0 * best[STIFFENING] * travel
    slope += best[OWN_COULOMB] * place.deflection + best[OWN_VISCOUS] * place.speed
    damping, variance = max(best[VISCOUS] + best[OWN_VISCOUS] * length, 0.0), 0.0
    for level, (hz, _), most in zip(levels.levels[2:].tolist(), BEATS, (1.0, 4.0), strict=True):
        rate = 2.0 * math.pi * hz
        moved = level / (max(slope, 0.0) ** 2 + 1e-4 + (rate * damping) ** 2)
        variance += rate**2 * min(moved, most)
    return math.sqrt(min(variance, 25.0))


def _branch(state: SwitchingState) -> SwitchingState:
    """Begin hypotheses of what may have happened in the block's travel."""
    place, course, bank = state.place, state.course, state.bank
    is_fast = place.speed > _HALF * place.usual_speed
    if is_fast and place.depth - course.spawned >= STEP_MM:
        begin = place._replace(
            depth=place.depth - 0.5 * place.speed * place.dt_s,
            tissue_speed=_tissue_speed(bank, place, state.levels),
        )
        bank = spawn(bank, begin, course.spawned)
        course = course._replace(spawned=place.depth)
    return state._replace(bank=judge_fractions(bank, place), course=course, stage=_PRUNE)


def _report(state: SwitchingState, sample: Sample, config: MultilayerConfig) -> SwitchingState:
    """Prune; raise or take back an alarm, report the layer left, answer for the next samples."""
    bank, place = state.bank, state.place
    if state.stage != _REPORT:
        bank = prune(bank, place)
    evaluation = count_ruptures(bank, state.ruptures, place.noise)
    now = RuptureState.EXPECTED if evaluation.more > 0.5 else RuptureState.NO_RUPTURE
    if _is_open(state):
        now = RuptureState.FORCE_DROP_MEASURING
    state = state._replace(bank=bank, stage=_NOTHING, rupture_state=now)
    if evaluation.more > config.alarm_probability and not may_be_braking(bank, evaluation, place):
        state = _raise_alarm(state, sample, evaluation)
    elif state.alarm is not None and evaluation.fewer > _TAKEN_BACK:
        state = _take_back(state, evaluation.best, 1.0 - evaluation.fewer)
    elif state.alarm is not None:
        state = _report_layer(state, state.alarm)
    answer = answer_at(bank, place, layers_traversed(state.layers) + _is_open(state))
    if state.alarm is not None:
        answer = answer._replace(cumulative_speed=_MM * state.alarm.speed_m_s)
    return state._replace(answer=answer)


def _is_open(state: SwitchingState) -> bool:
    """Whether the layer of the last alarm is not among the layers yet."""
    alarm = state.alarm
    return alarm is not None and layers_traversed(state.layers) < alarm.layer


def _raise_alarm(state: SwitchingState, sample: Sample, evaluation: Evaluation) -> SwitchingState:
    events, layers = state.events, state.layers
    if layers and not layers[-1].is_final:
        layers = (*layers[:-1], replace(layers[-1], is_final=True))
        events = events._replace(identified_layer=layers[-1])
    at = (sample.time_s, sample.depth_m)
    number = layers_traversed(layers) + 1
    rupture = rupture_of(state.bank, evaluation.pick, number, evaluation.more, at)
    return state._replace(
        alarm=rupture,
        ruptures=int(state.bank.facts[evaluation.pick, RUPTURES]),
        layers=layers,
        rupture_state=RuptureState.DETECTED,
        events=events._replace(rupture=rupture),
    )


def _take_back(state: SwitchingState, ruptures: int, left: float) -> SwitchingState:
    """The force has come back: no rupture was there but for what is `left` of its probability."""
    layers, alarm = state.layers, state.alarm
    if alarm is not None and layers_traversed(layers) == alarm.layer:
        layers = layers[:-1]
    return state._replace(
        alarm=None,
        ruptures=ruptures,
        layers=layers,
        events=state.events._replace(retracted=alarm and replace(alarm, probability=left)),
    )


def _report_layer(state: SwitchingState, alarm: Rupture) -> SwitchingState:
    """Report the layer that the last rupture ended, twice, and keep what is known of it."""
    bank, layers, events = state.bank, state.layers, state.events
    travel = state.place.depth / _MM - alarm.depth_m
    if _is_open(state):
        layer = layer_left(bank, alarm, state.ruptures) if travel >= _PROVISIONAL_M else None
        if layer is None:
            return state
        return state._replace(
            layers=(*layers, layer),
            events=events._replace(identified_layer=layer),
            rupture_state=RuptureState.FRICTION_IDENTIFIED,
        )
    is_due = not layers[-1].is_final and (travel >= _FINAL_M or travel < 0.0)
    if not is_due and state.levels.steps % _REVISE != 0.0:
        return state
    friction = friction_left(bank, state.ruptures)
    layer = layers[-1] if friction is None else with_friction(layers[-1], *friction)
    if is_due:
        rupture = replace(
            layer.rupture,
            is_final=True,
            partial_rupture_probability=partial_rupture_probability(bank, state.ruptures),
        )
        layer = replace(layer, is_final=True, rupture=rupture)
        events = events._replace(identified_layer=layer)
    kept = [*layers[:-1], layer]
    earlier = friction_left(bank, state.ruptures, before=True)
    if earlier is not None and len(kept) > 1:
        kept[-2] = with_friction(kept[-2], *earlier)
    return state._replace(layers=tuple(kept), events=events)
