"""The switching filter over time: blocks of samples, ruptures, layers, answers.

A block's work is spread over samples: the one that fills it lets every hypothesis use
its force; the next reports ruptures; the one after that begins hypotheses of new events
and drops the least likely. Where a rupture is raised, or a layer is due, one more comes
between. Where the needle does not advance, the one that fills a block reports as well.
One more may look for moving tissue.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from identification.config import MultilayerConfig
from identification.estimate import (
    NO_EVENTS,
    NO_SAMPLE,
    Events,
    LayerEstimate,
    Outputs,
    Rupture,
    RuptureState,
    Sample,
)
from identification.multilayer import force_model as law
from identification.multilayer import force_split as samples
from identification.multilayer import layer_report as reports
from identification.multilayer.mixture import (
    KEPT,
    STEP_MM,
    Bank,
    BankMemory,
    Place,
    first_bank,
)
from identification.multilayer.noise_levels import (
    BEATS,
    COLOUR_S,
    DisturbanceLevels,
    transitions,
)
from identification.multilayer.speed_filter import NO_TREND, follow_speed
from identification.multilayer.tissue_motion import TissueMotion

_MM = 1e3
_HELD_DRIFT = 0.05  # relative change of cutting force, per square root of a mm
_RESUMED_MM = 0.6  # travel over which friction is as it was before a rest: twice that of presliding
_TURNED = 0.3  # What a reversal leaves instead of 1, as a rest does: it is over in half the travel
_SETTLED = 0.1  # of a rest or reversal is left in the friction when that counts as back
_USUAL_S = 10.0
_USUAL_MM = 3.0
"""The usual speed is the highest of so much time and travel: the approach may be
quick."""
_CREEP = 0.05
_SLOW = 0.15
_HALF = 0.3
"""Advancing means faster than this [mm/s] and than a part of the usual speed; new
hypotheses want more of it: at a stop the force falls without any rupture."""
_CHANNEL_MM = (
    0.02  # Behind the deepest point by more than this and the noise: in its own channel
)
_DEADBAND = (
    3.0  # deviations of the speed's noise within which it is the same, in moving tissue
)
_UNSETTLED = 0.3  # Error of friction while presliding turns or after a rest, as part of the force
_TAKEN_BACK = 0.9  # probability of fewer ruptures at which an alarm is taken back
# travel after a rupture at which its layer is reported
_PROVISIONAL_M = 1e-3
_FINAL_M = 3e-3
_REVISE_S = 0.1  # time between two revisions of the layers left
_MOTION_MM = (
    0.1  # Of tissue with the heart, one standard deviation, if the beat is not known
)
_SERIES_S = 3.0  # between two alarms that a heart or a quick breath may have raised
_FAR_MM = 1e9
_NOTHING, _BRANCH, _PRUNE, _FOLLOW = range(4)
# added where the layer left, or ruptures, are to be reported first
_LAYERS = 4
_RUPTURES = 8
Noise = tuple[
    float, float, float
]  # deviations of depth and speed; variance of force by motion


class SwitchingState(NamedTuple):
    """All that the switching filter remembers; immutable.

    Attributes:
        memory: What every sample changes, see `force_split`.
        answer: See `force_split`.
        tissue: Its motion by itself.
        trend: Of the needle's own speed, see `speed_filter`.
        place: Middle of the last block.
        stage: What is left to do for that block.
        deepest: Point so far [mm].
        spawned: Depth at which hypotheses began last [mm].
        force_std_in_air: Of the force's slow error before the contact [N].
        ruptures: In the hypotheses that the last report followed.
        alarm: The last one raised and not taken back.
    """

    bank: Bank
    memory: Array = samples.FIRST_MEMORY
    answer: Array = samples.NO_ANSWER
    levels: DisturbanceLevels = DisturbanceLevels()
    tissue: TissueMotion = TissueMotion()
    trend: Array = NO_TREND
    texture: DisturbanceLevels = DisturbanceLevels.of_texture()
    place: Place = Place(*(0.0,) * 10)
    stage: int = _NOTHING
    deepest: float = -_FAR_MM
    spawned: float = -_FAR_MM
    resumed: float = (
        0.0  # how much of a rest or reversal is left in the friction, 0 to 1
    )
    force_std_in_air: float = 0.0
    ruptures: int = 0
    alarm: Rupture | None = None
    layers: tuple[LayerEstimate, ...] = ()
    rupture_state: RuptureState = RuptureState.NO_RUPTURE

    @property
    def damage(self) -> str:
        """What is wrong with a restored one, if anything."""
        is_stage = self.stage in range(2 * _RUPTURES)
        return "" if is_stage else f"there is no stage {self.stage!r:.80}"


class SwitchingMethod:
    """The switching filter, sample by sample."""

    def __init__(self, config: MultilayerConfig) -> None:
        self._config = config
        self.restore(SwitchingState(first_bank()))

    @property
    def state(self) -> SwitchingState:
        """All that it remembers."""
        arrays = (
            self._bank.bank.copied(),
            np.array(self._memory),
            np.array(self._answer),
        )
        course = self._place, self._stage, self._deepest, self._spawned, self._resumed
        found = self._ruptures, self._alarm, self.layers, self._rupture_state
        learned = self._levels, self._tissue, self._trend, self._texture
        return SwitchingState(
            *arrays, *learned, *course, self._force_std_in_air, *found
        )

    @property
    def contact_depth_m(self) -> float | None:
        """Depth at which tissue was met first, as known now; None before."""
        met = self._answer[0]
        return float(met[samples.CONTACT_M]) if met[samples.IN_CONTACT] > 0.0 else None

    def restore(self, state: SwitchingState) -> None:
        """Go on from there."""
        self._bank = BankMemory(state.bank)
        self._memory = state.memory.copy()
        self._answer = state.answer.copy()
        self._events = NO_EVENTS
        self._levels = state.levels
        self._tissue = state.tissue
        self._trend = state.trend
        self._texture = state.texture
        self._place = state.place
        self._stage = state.stage
        self._resumed = state.resumed
        self._deepest = state.deepest
        self._spawned = state.spawned
        self._force_std_in_air = state.force_std_in_air
        self._rupture_state = state.rupture_state
        self._ruptures = state.ruptures
        self._alarm = state.alarm
        self._keep(state.layers)

    def _keep(self, layers: tuple[LayerEstimate, ...]) -> None:
        """Take these layers for those left, with what every sample needs of them."""
        self._left = np.zeros((len(layers), 4))
        self.layers = layers
        for row, layer in zip(
            self._left, layers, strict=True
        ):  # see `switching_outputs`
            coulomb = min(
                (layer.coulomb_N_per_m or 0.0) * layer.thickness_m, layer.friction_N
            )
            viscous = (layer.friction_N - coulomb) / max(
                _MM * layer.rupture.speed_m_s, 1e-3
            )
            row[:] = layer.start_depth_m, layer.thickness_m, coulomb, viscous

    @property
    def rupture_state(self) -> RuptureState:
        """Where it stands with respect to a rupture."""
        return self._rupture_state

    @property
    def events(self) -> Events:
        """What happened at the last sample."""
        return self._events

    def report(self) -> Outputs:
        """Return what there is to report without a sample."""
        return self._outputs(NO_SAMPLE)

    def update(self, sample: Sample) -> Outputs:
        """Use one sample; return what to report of it beside the events."""
        arm_m_s = sample.speed_m_s
        if self._tissue.is_known:
            place_m, speed_m_s = (
                part / _MM for part in self._tissue.at(sample.clock_s)
            )
            # As the tissue, which moves, meets the needle.
            sample = sample._replace(
                depth_m=sample.depth_m - place_m,
                speed_m_s=sample.speed_m_s - speed_m_s,
                raw_depth_m=sample.raw_depth_m - place_m,
            )
        known = self._memory, self._answer, self._left
        is_full, outputs = samples.update_switching(
            sample[2:9], arm_m_s, sample.dt_s, *known
        )
        if not is_full and self._stage == _NOTHING:
            self._events = NO_EVENTS
            return outputs
        self._events = NO_EVENTS
        while self._stage != _NOTHING:
            self._work(sample)
            if not is_full:  # else blocks are of one or two samples
                break
        if is_full:
            self._use_block(sample)
            if (
                self._stage < _RUPTURES
            ):  # it does not advance: the next sample has nothing to add
                self._report(sample)
        return self._outputs(sample)

    def _outputs(self, sample: Sample) -> Outputs:
        known = self._memory, self._answer, self._left
        return samples.switching_outputs(
            sample.depth_m, sample.speed_m_s, sample.force_N, *known
        )

    def _work(self, sample: Sample) -> None:
        """Do the next part of what is left to do for a block."""
        if self._stage >= _RUPTURES:
            self._stage -= _RUPTURES
            self._report(sample)
            return
        if self._stage >= _LAYERS:
            self._stage -= _LAYERS
            if self._alarm is not None:
                self._report_layer(self._alarm, sample.force_std_N)
            return
        clock_s = sample.clock_s
        if self._stage != _FOLLOW:
            if self._stage == _BRANCH and self._bank.size <= KEPT:
                self._branch()
            self._bank.prune(self._place)
            self._stage = self._after(clock_s)
            return
        before, self._stage, self._tissue = (
            self._tissue,
            _NOTHING,
            self._tissue.worked(clock_s),
        )
        if self._tissue.fit is not before.fit:
            # The needle stays where it is in the tissue that is now known to be
            # elsewhere.
            by_mm = before.at(clock_s)[0] - self._tissue.at(clock_s)[0]
            samples.shift_depth(self._memory, by_mm / _MM)
            self._deepest = self._deepest + by_mm
            self._spawned = self._spawned + by_mm

    def _after(self, clock_s: float) -> int:
        """What is left to do for a block once its bank is pruned."""
        return _FOLLOW if self._tissue.is_due(clock_s) else _NOTHING

    def _branch(self) -> None:
        """Begin hypotheses of what may have happened in the block's travel."""
        place = self._place
        begin = place._replace(depth=place.depth - 0.5 * place.speed * place.dt_s)
        is_fast = place.speed > _HALF * place.usual_speed
        if is_fast and begin.depth - self._spawned >= STEP_MM:
            left = self._levels.beside(self._tissue, place.time_s)
            moved = _tissue_speed(self._bank, place, left)
            self._bank.spawn(begin, self._spawned, moved, self._ruptures)
            self._spawned = begin.depth

    def _use_block(self, sample: Sample) -> None:
        """Let every hypothesis predict the force of the block, and learn from it."""
        clock_s = sample.clock_s
        last = self._place
        deepest = self._deepest
        bank = self._bank
        place, (depth_std, speed_std, by_motion) = _block(
            clock_s, self._memory, last.force
        )
        dt_s = place.dt_s
        z = place.depth
        v = place.speed
        fresh = max(z - deepest, 0.0) if deepest > -_FAR_MM else 0.0
        faded = math.exp(-dt_s / _USUAL_S - abs(v) * dt_s / _USUAL_MM)
        usual = max(last.usual_speed * faded, v)
        # What a gap says is not used.
        is_gap = dt_s > max(self._config.check.gap_s, 10.0 * last.dt_s)
        own = self._own_speed(place, (depth_std, speed_std), is_gap=is_gap)
        is_advancing = v > max(_CREEP + 2.0 * speed_std, _SLOW * usual) and not is_gap
        is_advancing &= z > deepest - _CHANNEL_MM - 4.0 * depth_std
        left = self._levels.beside(self._tissue, clock_s)
        self._deepest = max(deepest, z)
        by_speed = last.by_speed + _damping(bank, z) * (own - last.speed)
        place = place._replace(
            speed=own, usual_speed=usual, noise=left.noise, by_speed=by_speed
        )
        _predict(bank, place, fresh, left, self._tissue)
        is_met = self._answer[0][samples.IN_CONTACT] > 0.0
        self._stage = self._after(clock_s)
        if (is_advancing or not is_met) and not is_gap:
            self._resumed *= math.exp(-fresh / _RESUMED_MM)
            # A force that is being released is no noise, nor is what the speed does;
            # beats are.
            force = place.force - by_speed
            is_release = self._is_open and not self._is_series
            levels = self._levels
            levels = (
                levels.restarted() if is_release else levels.with_force(force, dt_s, v)
            )
            left = levels.beside(self._tissue, clock_s)
            self._levels = levels
            place = place._replace(noise=left.noise)
            # A speed is as late as its filter: where it changes it is off by a block's
            # change.
            law_std = math.hypot(2.0 * speed_std, own - last.speed)
            _learn(bank, place, left, self._resumed, (depth_std, law_std, by_motion))
            law.weigh(bank.store, bank.size, (z, own, dt_s, left.noise), is_advancing)
            self._stage = _RUPTURES + (_BRANCH if is_advancing else _PRUNE)
            self._texture = self._texture.with_force(force, fresh if is_met else 0.0, v)
        else:
            self._pause(place, fresh, is_gap=is_gap)
        self._force_std_in_air = (
            self._force_std_in_air if is_met else sample.force_std_N
        )
        axial = place.force - bank.likeliest[0][law.OFFSET]
        self._place = place._replace(
            law_error=self._texture.law_error(axial, sample.force_std_N)
        )
        if not is_gap:
            self._tissue = self._tissue.with_block(
                place._replace(speed=v), is_met=is_met
            )

    def _pause(self, place: Place, fresh: float, *, is_gap: bool) -> None:
        """A block from which nothing is learnt: after a gap, at rest, in a channel
        already cut.
        """
        self._levels = self._levels.restarted()
        self._texture = self._texture.restarted()
        if is_gap and fresh > _HALF * place.speed * place.dt_s > 0.0:
            # The needle went on: something may have happened half way or near the end,
            # dated alike, so that either may prove right without taking back an alarm.
            # The next block prunes.
            end_s = place.time_s + 0.5 * place.dt_s
            store = self._bank.store
            for ago_s in (0.5 * place.dt_s, 0.1 * place.dt_s):
                scene = place.depth - place.speed * ago_s, place.speed, place.deflection
                force = float(law.regressor(store[3][0], scene) @ store[0][0])
                self._place = place._replace(
                    time_s=end_s, dt_s=2.0 * ago_s, before=force
                )
                self._branch()
            is_new = store[4][:, law.RUPTURE_MM] > place.depth - fresh
            store[4][is_new, law.RUPTURE_S] = end_s - ago_s
            store[4][is_new, law.RUPTURE_MM] = scene[0]
            return
        # Tissue that overtakes a needle which goes on turns its friction, but relaxes
        # nothing.
        rate = self._tissue.at(place.time_s)[1] if self._tissue.is_known else -math.inf
        is_rest = is_gap or place.speed + rate < _HALF * place.usual_speed
        self._resumed = 1.0 if is_rest else max(self._resumed, _TURNED)

    def _own_speed(
        self, place: Place, noise: tuple[float, float], *, is_gap: bool
    ) -> float:
        """The needle's own speed, less jitter; less the tissue's, if that moves."""
        trend = NO_TREND if is_gap else self._trend
        tissue = self._tissue
        at_mm, rate = tissue.at(place.time_s) if tissue.is_known else (0.0, 0.0)
        around = place.raw + at_mm, place.speed + rate
        own, self._trend = follow_speed(trend, *around, noise, place.dt_s)
        if not tissue.is_known:
            return own
        # The tissue's speed is an estimate as well: only what noise does not explain is
        # a change.
        deadband = _DEADBAND * noise[1]
        return min(max(self._place.speed, own - rate - deadband), own - rate + deadband)

    @property
    def _is_open(self) -> bool:
        """Whether the layer of the last alarm is not among the layers yet."""
        return (
            self._alarm is not None
            and layers_traversed(self.layers) < self._alarm.layer
        )

    @property
    def _is_series(self) -> bool:
        """Whether the last alarm came so soon after another that a heart may have
        raised both.
        """
        if self._alarm is None:
            return False
        before = [
            layer.rupture.time_s
            for layer in self.layers
            if layer.layer < self._alarm.layer
        ]
        return bool(before) and self._alarm.time_s - before[-1] < _SERIES_S

    def _report(self, sample: Sample) -> None:
        """Raise or take back an alarm, report the layer left, answer for the next
        samples.
        """
        place = self._place
        alarm = self._alarm
        evidence = reports.evidence_of(self._bank.bank, alarm, self._ruptures)
        found = reports.count_ruptures(evidence, self._ruptures, place)
        now = RuptureState.EXPECTED if found.more > 0.5 else RuptureState.NO_RUPTURE
        self._rupture_state = (
            RuptureState.FORCE_DROP_MEASURING if self._is_open else now
        )
        if (
            found.more > self._config.alarm_probability
            and self._is_settled(evidence.bank, found.pick)
            and not reports.may_be_braking(
                evidence.bank, found, place, sample.clock_s, self._tissue
            )
        ):
            self._raise_alarm(evidence, sample, found)
            self._stage += (
                _RUPTURES  # the next sample answers: this one has had enough to do
            )
            return
        if alarm is not None and found.fewer > _TAKEN_BACK:
            # The force has come back: no rupture was there but for what is left of its
            # probability.
            gone = replace(alarm, probability=1.0 - found.fewer)
            self._events = self._events._replace(retracted=gone)
            self._keep(self.layers if self._is_open else self.layers[:-1])
            self._ruptures = min(found.best, self._ruptures - 1)
            self._alarm = None
        elif (
            alarm is not None
            and self._events.rupture is None
            and self._is_layer_due(alarm)
        ):
            self._stage += _LAYERS
        last = self._alarm or (self.layers[-1].rupture if self.layers else None)
        speed = 0.0 if last is None else _MM * last.speed_m_s
        counts = self._ruptures, layers_traversed(self.layers) + self._is_open
        answer = reports.answer_at(self._bank, evidence, place, counts, speed)
        self._answer = answer.copy()

    def _is_settled(self, bank: Bank, pick: int) -> bool:
        """Whether the needle advances, and far enough since a stop, which lets the
        force fall.
        """
        since_mm = self._place.depth - float(bank.records[pick, law.RUPTURE_MM])
        resumed_mm = -_RESUMED_MM * math.log(max(self._resumed, 1e-9))
        return resumed_mm > 0.0 and (since_mm < resumed_mm or self._resumed < _SETTLED)

    def _raise_alarm(
        self, evidence: reports.Evidence, sample: Sample, found: reports.Evaluation
    ) -> None:
        layers = self.layers
        identified = self._events.identified_layer
        if layers and not layers[-1].is_final:
            identified = replace(layers[-1], is_final=True)
            self._keep((*layers[:-1], identified))
        number = layers_traversed(layers) + 1
        at = (sample.time_s, sample.depth_m, sample.clock_s)
        self._alarm = reports.rupture_of(evidence, found.pick, number, found.more, at)
        self._ruptures = int(evidence.ruptures[found.pick])
        self._rupture_state = RuptureState.DETECTED
        self._events = Events(self._alarm, identified)
        # Every beat may raise an alarm until it is known: then the window has to grow
        # across them.
        if not self._is_series or self._tissue.is_known:
            self._tissue = self._tissue.restarted(sample.clock_s)

    def _is_final(self, alarm: Rupture) -> bool:
        """Whether the layer left is final now, so far behind its rupture."""
        is_far = not 0.0 <= self._place.depth / _MM - alarm.depth_m < _FINAL_M
        return is_far and not self._is_open and not self.layers[-1].is_final

    def _is_layer_due(self, alarm: Rupture) -> bool:
        """Whether the layer left is reported or revised now, so far behind its
        rupture.
        """
        if self._is_open:
            return self._place.depth / _MM - alarm.depth_m >= _PROVISIONAL_M
        is_revised = self._place.time_s % _REVISE_S < self._place.dt_s
        return is_revised or self._is_final(alarm)

    def _report_layer(self, alarm: Rupture, force_std: float) -> None:
        """Report the layer that the last rupture ended, provisional or final, or
        revise it.
        """
        layers = self.layers
        is_open = self._is_open
        is_due = self._is_final(alarm)
        evidence = reports.evidence_of(self._bank.bank, alarm, self._ruptures)
        # What the force's slow error grew by since the air is in the friction, and the
        # law's.
        grown = (
            max(force_std**2 - self._force_std_in_air**2, 0.0)
            + self._place.law_error**2
        )
        friction = reports.friction_left(evidence, self._ruptures, grown)
        if is_open:
            layer = friction and reports.layer_left(
                evidence, alarm, self._ruptures, friction
            )
            if layer is not None:
                self._keep((*layers, layer))
                self._events = self._events._replace(identified_layer=layer)
                self._rupture_state = RuptureState.FRICTION_IDENTIFIED
            return
        layer = (
            layers[-1]
            if friction is None
            else reports.with_friction(layers[-1], *friction)
        )
        if is_due:
            partial = reports.partial_rupture_probability(evidence, self._ruptures)
            rupture = replace(
                layer.rupture, is_final=True, partial_rupture_probability=partial
            )
            layer = replace(layer, is_final=True, rupture=rupture)
            self._events = self._events._replace(identified_layer=layer)
        kept = [*layers[:-1], layer]
        earlier = reports.friction_left(evidence, self._ruptures, grown, before=True)
        if earlier is not None and len(kept) > 1:
            kept[-2] = reports.with_friction(kept[-2], *earlier)
        self._keep(tuple(kept))


def layers_traversed(layers: tuple[LayerEstimate, ...]) -> int:
    """How many layers have been traversed, those no longer kept included."""
    return layers[-1].layer if layers else 0


def _block(time_s: float, memory: Array, before: float) -> tuple[Place, Noise]:
    """Means of a block that is full; noise of depth, speed, force by motion; the
    next begins.
    """
    *sums, _, _, _, _, jitter, speed_noise, _, _, _ = np.array(memory).tolist()
    filled, z, v, w, force, raw, by_motion = sums
    memory[: len(sums)] = [0.0] * len(sums)
    z = _MM * z / filled
    v = _MM * v / filled
    raw = _MM * raw / filled
    jitter = _MM * jitter
    speed_noise = _MM * speed_noise
    # A filter that leaves so much noise in both is as slow as their ratio.
    lag_s = reports.speed_lag(jitter, speed_noise)
    at_s = time_s - 0.5 * filled
    w = w / filled
    force = force / filled
    place = Place(at_s, filled, z, v, w, force, 0.0, 0.0, raw, lag_s, before)
    return place, (jitter, speed_noise, by_motion / filled)


def _damping(bank: BankMemory, depth: float) -> float:
    """Viscous friction of the whole shaft [N/(mm/s)], by the likeliest hypothesis."""
    best = bank.store[0][0]
    fact = bank.store[3][0]
    return float(
        best[law.VISCOUS] + best[law.OWN_VISCOUS] * max(depth - fact[law.ROOT], 0.0)
    )


def _predict(
    bank: BankMemory,
    place: Place,
    fresh: float,
    levels: DisturbanceLevels,
    tissue: TissueMotion,
) -> None:
    # Errors of the law are the same for all: what claims less would be believed more.
    best, fact = bank.likeliest
    slope = (
        best[law.STIFFNESS]
        + best[law.OWN_COULOMB]
        + best[law.OWN_VISCOUS] * place.speed
    )
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
    noise: Noise,
) -> None:
    depth_std, speed_std, by_motion = noise
    best, fact = bank.likeliest
    damping = _damping(bank, place.depth)
    white = float(levels.levels[0]) * levels.step_s / place.dt_s
    variance = max(white, 1e-8) + (damping * speed_std) ** 2 + by_motion
    if fact[law.KIND] != law.AIR:
        loose = _UNSETTLED * max(1.0 - place.deflection, resumed)
        variance += (loose * (place.force - best[law.OFFSET])) ** 2
    scene = (place.depth, place.speed, place.deflection)
    block = (abs(place.speed) * place.dt_s, variance, depth_std)
    law.correct(bank.store, bank.size, scene, place.force, block)


def _tissue_speed(bank: BankMemory, place: Place, levels: DisturbanceLevels) -> float:
    """Standard deviation of the speed at which tissue moves by itself [mm/s], as its
    force says.
    """
    best, fact = bank.likeliest
    travel, length = (max(place.depth - fact[at], 0.0) for at in (law.TIP, law.ROOT))
    slope = best[law.STIFFNESS] + 2.0 * best[law.STIFFENING] * travel
    slope += (
        best[law.OWN_COULOMB] * place.deflection + best[law.OWN_VISCOUS] * place.speed
    )
    damping = max(best[law.VISCOUS] + best[law.OWN_VISCOUS] * length, 0.0)
    variance = 0.0
    for level, (hz, _), most in zip(
        levels.levels[2:].tolist(), BEATS, (1.0, 4.0), strict=True
    ):
        rate = 2.0 * math.pi * hz
        moved = level / (max(slope, 0.0) ** 2 + 1e-4 + (rate * damping) ** 2)
        variance += rate**2 * min(moved, most)
    return math.sqrt(min(variance, 25.0))
