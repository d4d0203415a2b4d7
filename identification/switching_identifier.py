"""The switching filter over time: blocks of samples, ruptures, layers, answers.

A block's work is spread over samples: the one that fills it absorbs its force and reports; in the
next hypotheses of new events begin and the least likely go; one more may look for moving tissue.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from identification import hypothesis_filter as law
from identification import rupture_report as reports
from identification import switching_update as samples
from identification.config import MultilayerConfig
from identification.disturbance_levels import BEATS, COLOUR_S, DisturbanceLevels, transitions
from identification.estimate import (
    Array,
    Events,
    LayerEstimate,
    Rupture,
    RuptureState,
    Sample,
    layers_traversed,
)
from identification.hypothesis_bank import STEP_MM, Bank, BankMemory, Place, first_bank
from identification.speed_trend import NO_TREND, follow_speed
from identification.tissue_motion import TissueMotion
from needleforce.jit import working_copy

_MM = 1e3
_HELD_DRIFT = 0.05  # relative change of cutting force, per square root of a mm
_RESUMED_MM = 0.6  # travel over which friction is as it was before a rest: twice that of presliding
_SETTLED = 0.1  # of a rest or reversal is left in the friction when that counts as back
_GAP_S = 0.25  # A longer block is a gap: what it says is not used
_USUAL_S, _USUAL_MM = 10.0, 3.0
"""The usual speed is the highest of so much time and travel: the approach may be quick."""
_CREEP, _SLOW, _HALF = 0.05, 0.15, 0.3
"""Advancing means faster than this [mm/s] and than a part of the usual speed; new hypotheses want
more of it: at a stop the force falls without any rupture."""
_CHANNEL_MM = 0.02  # Behind the deepest point by more than this and the noise: in its own channel
_DEADBAND = 3.0  # deviations of the speed's noise within which it is the same, in moving tissue
_UNSETTLED = 0.3  # Error of friction while presliding turns or after a rest, as part of the force
_TAKEN_BACK = 0.9  # probability of fewer ruptures at which an alarm is taken back
_PROVISIONAL_M, _FINAL_M = 1e-3, 3e-3  # travel after a rupture at which its layer is reported
_REVISE_S = 0.1  # time between two revisions of the layers left
_MOTION_MM = 0.1  # Of tissue with the heart, one standard deviation, if the beat is not known
_SERIES_S = 3.0  # between two alarms that a heart or a quick breath may have raised
_FAR_MM = 1e9
_NOTHING, _BRANCH, _PRUNE, _FOLLOW = range(4)


class Course(NamedTuple):
    """How the needle has moved so far, block by block."""

    deepest: float = -_FAR_MM  # [mm]
    spawned: float = -_FAR_MM  # depth at which hypotheses began last [mm]
    usual_speed: float = 0.0  # [mm/s]
    resumed: float = 0.0  # how much of a rest or reversal is left in the friction, 0 to 1
    trend: Array = NO_TREND  # of the needle's own speed, see `speed_trend`


class SwitchingState(NamedTuple):
    """All that the switching filter remembers; immutable."""

    bank: Bank
    memory: Array = samples.FIRST_MEMORY  # what every sample changes, see `switching_update`
    levels: DisturbanceLevels = DisturbanceLevels()
    tissue: TissueMotion = TissueMotion()  # its motion by itself
    course: Course = Course()
    place: Place = Place(*(0.0,) * 10)  # middle of the last block
    stage: int = _NOTHING  # what is left to do for that block
    answer: Array = samples.NO_ANSWER  # see `switching_update`
    ruptures: int = 0  # in the hypotheses that the last report followed
    alarm: Rupture | None = None  # the last one raised and not taken back
    layers: tuple[LayerEstimate, ...] = ()
    rupture_state: RuptureState = RuptureState.NO_RUPTURE
    force_std: float = 0.0  # of the force's slow error, now [N]
    force_std_in_air: float = 0.0  # before the contact: that error is part of the offset [N]
    events: Events = Events()  # of this sample

    @property
    def is_due(self) -> bool:
        """Whether the next sample finds work to do even if it fills no block."""
        return self.stage != _NOTHING or any(self.events)

    @property
    def is_open(self) -> bool:
        """Whether the layer of the last alarm is not among the layers yet."""
        return self.alarm is not None and layers_traversed(self.layers) < self.alarm.layer

    @property
    def is_series(self) -> bool:
        """Whether the last alarm came so soon after another that a heart may have raised both."""
        if self.alarm is None:
            return False
        before = [layer.rupture.time_s for layer in self.layers if layer.layer < self.alarm.layer]
        return bool(before) and self.alarm.time_s - before[-1] < _SERIES_S

    def friction_left(self, bank: Bank, *, before: bool = False) -> tuple[float, float] | None:
        """As `rupture_report.friction_left`, with what the force's error grew by since the air."""
        found = reports.friction_left(bank, self.ruptures, before=before)
        grown = max(self.force_std**2 - self.force_std_in_air**2, 0.0)
        return None if found is None else (found[0], math.sqrt(found[1] ** 2 + grown))


class SwitchingMethod:
    """The switching filter, sample by sample."""

    takes_filtered_travel = True

    def __init__(self, config: MultilayerConfig) -> None:
        self._config = config
        self.restore(SwitchingState(first_bank()))

    @property
    def state(self) -> SwitchingState:
        """All that it remembers."""
        return self._state._replace(bank=self._bank.bank.copied(), memory=np.array(self._memory))

    def restore(self, state: SwitchingState) -> None:
        """Go on from there."""
        self._bank, self._memory = BankMemory(state.bank), working_copy(state.memory)
        self._take(state)

    def _take(self, state: SwitchingState, last: SwitchingState | None = None) -> None:
        """Make of a state what every sample needs, where it differs from the last."""
        self._state, self._is_due, self._is_moving = state, state.is_due, state.tissue.is_known
        if last is None or state.layers is not last.layers:
            self._left = left_layers(state)
        if last is None or state.answer is not last.answer:
            self._answer = working_copy(state.answer)

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers left so far, as known now."""
        return self._state.layers

    def report(self) -> tuple[Any, ...]:
        """What there is to report without a sample."""
        return self._outputs((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))

    def update(self, sample: Sample) -> tuple[Any, ...]:
        """Use one sample: what to report of it, from the rupture state to the events."""
        state = self._state
        if self._is_moving:
            sample = _in_tissue(sample, state.tissue, sample[-1])
        motion = sample[2], sample[3], sample[4], sample[5], sample[8]
        known = self._memory, self._answer, self._left
        is_full, outputs = samples.update_switching(motion, sample[6], sample[1], *known)
        if not (is_full or self._is_due):
            return (state.rupture_state, *outputs, None, None, None)
        self._state = state._replace(events=Events())
        while self._state.stage != _NOTHING:
            self._work(sample)
            if not is_full:  # else blocks are of one or two samples
                break
        if is_full:
            self._absorb(sample)
        self._take(self._state, state)
        return self._outputs(sample)

    def _outputs(self, sample: Sample) -> tuple[Any, ...]:
        known = self._memory, self._answer, self._left
        outputs = samples.switching_outputs(sample[2], sample[3], sample[6], *known)
        return (self._state.rupture_state, *outputs, *self._state.events)

    def _work(self, sample: Sample) -> None:
        before, clock_s = self._state.tissue, sample[-1]
        if self._state.stage == _FOLLOW:
            self._state = self._state._replace(stage=_NOTHING, tissue=before.worked(clock_s))
        else:
            if self._state.stage == _BRANCH:
                self._branch()
            self._bank.prune(self._state.place)
            self._state = self._state._replace(stage=self._after(clock_s))
        if self._state.tissue.fit is not before.fit:
            # The needle stays where it is in the tissue that is now known to be elsewhere.
            by_mm = before.at(clock_s)[0] - self._state.tissue.at(clock_s)[0]
            samples.shift_depth(self._memory, by_mm / _MM)
            course = self._state.course
            course = course._replace(deepest=course.deepest + by_mm, spawned=course.spawned + by_mm)
            self._state = self._state._replace(course=course)

    def _absorb(self, sample: Sample) -> None:
        """Let every hypothesis predict the force of the block, and learn from it."""
        state, memory, bank = self._state, self._memory, self._bank
        course, levels, last = state.course, state.levels, state.course.deepest
        place, jitter, speed_noise = _block(sample[-1], memory, state.place.force)
        filled, z, v, force = place.dt_s, place.depth, place.speed, place.force
        faded = math.exp(-filled / _USUAL_S - abs(v) * filled / _USUAL_MM)
        usual = max(course.usual_speed * faded, v)
        fresh = max(z - last, 0.0) if last > -_FAR_MM else 0.0
        is_gap = filled > max(_GAP_S, 10.0 * state.place.dt_s)
        course = course._replace(trend=NO_TREND) if is_gap else course
        steady, trend = self._law_speed(course.trend, place, (jitter, speed_noise))
        is_advancing = v > max(_CREEP + 2.0 * speed_noise, _SLOW * usual) and not is_gap
        is_advancing &= z > last - _CHANNEL_MM - 4.0 * jitter
        left = levels.beside(state.tissue, sample[-1])
        place = place._replace(speed=steady, usual_speed=usual, noise=left.noise)
        course = course._replace(deepest=max(last, z), usual_speed=usual, trend=trend)
        _predict(bank, place, fresh, left, state.tissue)
        is_met, stage = state.answer[0, samples.IN_CONTACT] > 0.0, self._after(sample[-1])
        if (is_advancing or not is_met) and not is_gap:
            course = course._replace(resumed=course.resumed * math.exp(-fresh / _RESUMED_MM))
            # A force that is being released is no noise; beats are.
            is_release = state.is_open and not state.is_series
            levels = levels.restarted() if is_release else levels.with_force(force, filled, v)
            left = levels.beside(state.tissue, sample[-1])
            place = place._replace(noise=left.noise)
            # A speed is as late as its filter: where it changes it is off by a block's change.
            speed_std = math.hypot(2.0 * speed_noise, steady - state.place.speed)
            _learn(bank, place, left, course.resumed, (jitter, speed_std))
            bank.weigh(place, is_advancing=is_advancing)
            stage = _BRANCH if is_advancing else _PRUNE
        else:
            course, levels = course._replace(resumed=1.0), levels.restarted()
        in_air = state.force_std_in_air if is_met else sample[7]
        tissue = state.tissue
        if not is_gap:
            tissue = tissue.with_block(place._replace(speed=v), is_met=is_met)
        state = state._replace(force_std=sample[7], force_std_in_air=in_air, stage=stage)
        state = state._replace(levels=levels, course=course, place=place, tissue=tissue)
        self._state = report(state, bank, sample, self._config)

    def _after(self, clock_s: float) -> int:
        """What is left to do for a block once its bank is pruned."""
        return _FOLLOW if self._state.tissue.is_due(clock_s) else _NOTHING

    def _law_speed(
        self, trend: Array, place: Place, noise: tuple[float, float]
    ) -> tuple[float, Array]:
        """The needle's own speed, less jitter, and its trend; less the tissue's, if that moves."""
        tissue, last = self._state.tissue, self._state.place.speed
        if not self._is_moving:
            return follow_speed(trend, place.raw, place.speed, noise, place.dt_s)
        at_mm, speed = tissue.at(place.time_s)
        own, trend = follow_speed(trend, place.raw + at_mm, place.speed + speed, noise, place.dt_s)
        # The tissue's speed is an estimate as well: only what noise does not explain is a change.
        deadband = _DEADBAND * noise[1]
        return min(max(last, own - speed - deadband), own - speed + deadband), trend

    def _branch(self) -> None:
        """Begin hypotheses of what may have happened in the block's travel."""
        state, bank = self._state, self._bank
        place, course = state.place, state.course
        is_fast = place.speed > _HALF * place.usual_speed
        begin = place._replace(depth=place.depth - 0.5 * place.speed * place.dt_s)
        if is_fast and begin.depth - course.spawned >= STEP_MM:
            left = state.levels.beside(state.tissue, place.time_s)
            bank.spawn(begin, course.spawned, _tissue_speed(bank, place, left), state.ruptures)
            course = course._replace(spawned=begin.depth)
        self._state = state._replace(course=course)


def _block(time_s: float, memory: Array, before: float) -> tuple[Place, float, float]:
    """Means of a block that is full, and noise of its depth and speed; the next one begins."""
    filled, z, v, w, force, raw, *_, jitter, speed_noise = np.array(memory).tolist()
    memory[: samples.RAW_SUM + 1] = [0.0] * (samples.RAW_SUM + 1)
    z, v, raw = _MM * z / filled, _MM * v / filled, _MM * raw / filled
    jitter, speed_noise = _MM * jitter, _MM * speed_noise
    # A filter that leaves so much noise in both is as slow as their ratio.
    lag_s = reports.speed_lag(jitter, speed_noise)
    at_s, w, force = time_s - 0.5 * filled, w / filled, force / filled
    return Place(at_s, filled, z, v, w, force, 0.0, 0.0, raw, lag_s, before), jitter, speed_noise


def _in_tissue(sample: Sample, tissue: TissueMotion, clock_s: float) -> Sample:
    """A sample as the tissue, which moves, meets it."""
    time_s, dt_s, depth_m, speed_m_s = sample[:4]
    place, speed = tissue.at(clock_s)
    depth_m, speed_m_s = depth_m - place / _MM, speed_m_s - speed / _MM
    return time_s, dt_s, depth_m, speed_m_s, *sample[4:8], sample[8] - place / _MM, clock_s


def left_layers(state: SwitchingState) -> Array:
    """Friction of the layers left, for the withdrawal; see `switching_outputs`."""
    found = np.zeros((len(state.layers), 4))
    for row, layer in zip(found, state.layers, strict=True):
        coulomb = min((layer.coulomb_N_per_m or 0.0) * layer.thickness_m, layer.friction_N)
        viscous = (layer.friction_N - coulomb) / max(_MM * layer.rupture.speed_m_s, 1e-3)
        row[:] = layer.start_depth_m, layer.thickness_m, coulomb, viscous
    return found


def _predict(
    bank: BankMemory, place: Place, fresh: float, levels: DisturbanceLevels, tissue: TissueMotion
) -> None:
    # Errors of the law are the same for all: what claims less would be believed more.
    best, fact = bank.likeliest
    slope = best[law.STIFFNESS] + best[law.OWN_COULOMB] + best[law.OWN_VISCOUS] * place.speed
    slope = max(slope, 0.004)
    held = fresh * (_HELD_DRIFT * min(max(best[law.HELD], 0.02), 2.0 * slope)) ** 2
    left = place.deflection * best[law.COULOMB] + place.speed * best[law.VISCOUS]
    tip = abs(place.force - best[law.OFFSET] - left)
    error = law.LAW_ERROR * (tip + law.LEFT_ERROR * abs(left))
    _, colour, heart, breath = levels.levels.tolist()
    if fact[law.KIND] != law.AIR and not tissue.is_known:
        # Before a few beats have been seen nobody knows whether the tissue moves.
        heart = max(heart, (_MOTION_MM * slope) ** 2)
    turns = transitions(place.dt_s, fresh, law.LAW_MM, (heart, breath, error * error))
    kept = np.array([math.exp(-place.dt_s / COLOUR_S), colour])
    law.predict(bank.store, bank.size, held, place.dt_s, kept, turns)


def _learn(
    bank: BankMemory,
    place: Place,
    levels: DisturbanceLevels,
    resumed: float,
    noise: tuple[float, float],
) -> None:
    (depth_std, speed_std), (best, fact) = noise, bank.likeliest
    damping = best[law.VISCOUS] + best[law.OWN_VISCOUS] * max(place.depth - fact[law.ROOT], 0.0)
    white = float(levels.levels[0]) * levels.step_s / place.dt_s
    variance = max(white, 1e-8) + (damping * speed_std) ** 2
    if fact[law.KIND] != law.AIR:
        loose = _UNSETTLED * max(1.0 - place.deflection, resumed)
        variance += (loose * (place.force - best[law.OFFSET])) ** 2
    scene = (place.depth, place.speed, place.deflection)
    block = (abs(place.speed) * place.dt_s, variance, depth_std)
    law.absorb(bank.store, bank.size, scene, place.force, block)


def _tissue_speed(bank: BankMemory, place: Place, levels: DisturbanceLevels) -> float:
    """Standard deviation of the speed at which tissue moves by itself [mm/s], as its force says."""
    best, fact = bank.likeliest
    travel, length = (max(place.depth - fact[at], 0.0) for at in (law.TIP, law.ROOT))
    slope = best[law.STIFFNESS] + 2.0 * best[law.STIFFENING] * travel
    slope += best[law.OWN_COULOMB] * place.deflection + best[law.OWN_VISCOUS] * place.speed
    damping, variance = max(best[law.VISCOUS] + best[law.OWN_VISCOUS] * length, 0.0), 0.0
    for level, (hz, _), most in zip(levels.levels[2:].tolist(), BEATS, (1.0, 4.0), strict=True):
        rate = 2.0 * math.pi * hz
        moved = level / (max(slope, 0.0) ** 2 + 1e-4 + (rate * damping) ** 2)
        variance += rate**2 * min(moved, most)
    return math.sqrt(min(variance, 25.0))


def report(
    state: SwitchingState, memory: BankMemory, sample: Sample, config: MultilayerConfig
) -> SwitchingState:
    """Raise or take back an alarm, report the layer left, answer for the next samples."""
    bank, place = memory.bank, state.place
    if state.alarm is not None:
        bank = reports.denied(bank, state.alarm, state.ruptures)
    evaluation = reports.count_ruptures(bank, state.ruptures, place)
    now = RuptureState.EXPECTED if evaluation.more > 0.5 else RuptureState.NO_RUPTURE
    if state.is_open:
        now = RuptureState.FORCE_DROP_MEASURING
    state = state._replace(rupture_state=now)
    is_likely = evaluation.more > config.alarm_probability
    if (
        is_likely
        and _is_settled(state.course, bank, evaluation.pick, place)
        and not reports.may_be_braking(bank, evaluation, place, sample[-1], state.tissue)
    ):
        state = _raise_alarm(state, bank, sample, evaluation)
    elif state.alarm is not None and evaluation.fewer > _TAKEN_BACK:
        state = _take_back(state, state.alarm, evaluation)
    elif state.alarm is not None:
        state = _report_layer(state, bank, state.alarm)
    last = state.alarm or (state.layers[-1].rupture if state.layers else None)
    speed = 0.0 if last is None else _MM * last.speed_m_s
    ruptures = layers_traversed(state.layers) + state.is_open
    return state._replace(answer=reports.answer_at(memory, place, ruptures, speed))


def _is_settled(course: Course, bank: Bank, pick: int, place: Place) -> bool:
    """Whether the needle advances, and if the rupture was before a stop, far enough since.

    A needle that does not advance ruptures nothing, and one that stopped lets the force fall: once
    friction is back the force itself says what fell.
    """
    since_mm = place.depth - float(bank.records[pick, law.RUPTURE_MM])
    resumed_mm = -_RESUMED_MM * math.log(max(course.resumed, 1e-9))
    return resumed_mm > 0.0 and (since_mm < resumed_mm or course.resumed < _SETTLED)


def _raise_alarm(
    state: SwitchingState, bank: Bank, sample: Sample, evaluation: reports.Evaluation
) -> SwitchingState:
    events, layers = state.events, state.layers
    if layers and not layers[-1].is_final:
        layers = (*layers[:-1], replace(layers[-1], is_final=True))
        events = events._replace(identified_layer=layers[-1])
    number = layers_traversed(layers) + 1
    at = (sample[0], sample[2], sample[-1])
    rupture = reports.rupture_of(bank, evaluation.pick, number, evaluation.more, at)
    state = state._replace(
        alarm=rupture,
        ruptures=int(bank.facts[evaluation.pick, law.RUPTURES]),
        layers=layers,
        rupture_state=RuptureState.DETECTED,
        events=events._replace(rupture=rupture),
    )
    # Every beat may raise an alarm until it is known: then the window has to grow across them.
    is_beat = state.is_series and not state.tissue.is_known
    return state if is_beat else state._replace(tissue=state.tissue.restarted(sample[-1]))


def _take_back(
    state: SwitchingState, alarm: Rupture, evaluation: reports.Evaluation
) -> SwitchingState:
    """The force has come back: no rupture was there but for what is left of its probability."""
    retracted = replace(alarm, probability=1.0 - evaluation.fewer)
    return state._replace(
        alarm=None,
        ruptures=min(evaluation.best, state.ruptures - 1),
        layers=state.layers if state.is_open else state.layers[:-1],
        events=state.events._replace(retracted=retracted),
    )


def _report_layer(state: SwitchingState, bank: Bank, alarm: Rupture) -> SwitchingState:
    """Report the layer that the last rupture ended, twice, and keep what is known of it."""
    layers, events = state.layers, state.events
    travel = state.place.depth / _MM - alarm.depth_m
    if state.is_open:
        if travel < _PROVISIONAL_M:
            return state
        known = state.friction_left(bank)
        layer = None if known is None else reports.layer_left(bank, alarm, state.ruptures, known)
        if layer is None:
            return state
        return state._replace(
            layers=(*layers, layer),
            events=events._replace(identified_layer=layer),
            rupture_state=RuptureState.FRICTION_IDENTIFIED,
        )
    is_due = not layers[-1].is_final and (travel >= _FINAL_M or travel < 0.0)
    if not is_due and state.place.time_s % _REVISE_S >= state.place.dt_s:
        return state
    friction = state.friction_left(bank)
    layer = layers[-1] if friction is None else reports.with_friction(layers[-1], *friction)
    if is_due:
        partial = reports.partial_rupture_probability(bank, state.ruptures)
        rupture = replace(layer.rupture, is_final=True, partial_rupture_probability=partial)
        layer = replace(layer, is_final=True, rupture=rupture)
        events = events._replace(identified_layer=layer)
    kept = [*layers[:-1], layer]
    earlier = state.friction_left(bank, before=True)
    if earlier is not None and len(kept) > 1:
        kept[-2] = reports.with_friction(kept[-2], *earlier)
    return state._replace(layers=tuple(kept), events=events)
