"""The bank of hypotheses: what an event changes, what the force teaches, which of
them stay."""

import numpy as np
import pytest

from identification.multilayer import force_model as law
from identification.multilayer import force_split as samples
from identification.multilayer.layer_report import (
    Evaluation,
    count_ruptures,
    evidence_of,
    friction_left,
    may_be_braking,
    rupture_of,
    speed_lag,
)
from identification.multilayer.mixture import (
    CAPACITY,
    Bank,
    BankMemory,
    Place,
    first_bank,
)
from identification.multilayer.noise_levels import DisturbanceLevels, transitions
from identification.multilayer.tissue_motion import TissueMotion

PLACE = Place(
    *(3.0, 0.01, 12.0, 4.0, 1.0, 0.9), usual_speed=4.0, noise=0.01, before=1.1
)


def hypothesis(seed, kind, *, is_held=False):
    """A bank of one hypothesis that has been in its layer for a while, its unknowns
    drawn."""
    rng = np.random.default_rng(seed)
    bank = first_bank()
    factor = 0.05 * rng.standard_normal((law.UNKNOWNS, law.UNKNOWNS))
    facts = bank.facts.copy()
    facts[0, [law.KIND, law.ROOT, law.TIP, law.IS_HELD]] = kind, 4.0, 5.0, is_held
    if kind == law.LAYER:
        facts[0, [law.RELEASE, law.LENGTH, law.RUPTURES]] = 5.0, 0.3, 1.0
    means = 0.1 * np.abs(rng.standard_normal((1, law.UNKNOWNS)))
    if kind != law.LAYER:
        means[0, [law.OWN_COULOMB, law.OWN_VISCOUS, law.STIFFNESS]] = 0.0
    return bank._replace(means=means, spreads=(factor @ factor.T)[None], facts=facts)


SCENE = (PLACE.depth, PLACE.speed, PLACE.deflection)


def spawn(bank, back, ruptures):
    """The bank after an event at `PLACE` that began so far back [mm], so many being
    reported."""
    memory = BankMemory(bank)
    memory.spawn(PLACE, PLACE.depth - back, 0.0, ruptures)
    return memory.bank


def force_of(bank):
    rows = np.array([law.regressor(fact, SCENE) for fact in bank.facts])
    return np.einsum("ni,ni->n", rows, bank.means)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("kind", "is_held"), [(law.LAYER, False), (law.LAYER, True), (law.MEMBRANE, True)]
)
def test_the_force_goes_on_as_it_was_across_an_event(seed, kind, is_held):
    before = hypothesis(seed, kind, is_held=is_held)
    after = spawn(before, 0.3, int(before.facts[0, law.RUPTURES]))
    born = Bank(*(part[1:] for part in after))
    assert len(born.log_weights) > 2
    assert force_of(born) == pytest.approx(
        np.repeat(force_of(before), len(born.log_weights))
    )
    assert set(born.facts[:, law.RUPTURES] - before.facts[0, law.RUPTURES]) <= {
        0.0,
        1.0,
    }
    assert len(after.log_weights) <= CAPACITY


def test_the_friction_of_a_layer_left_stays_on_the_shaft_and_is_remembered():
    before = hypothesis(5, law.LAYER)
    born = spawn(before, 0.3, 1)
    exits = (born.facts[:, law.RUPTURES] == 2.0) & (born.facts[:, law.IS_HELD] == 0.0)
    assert set(born.records[exits, law.RUPTURE_FORCE]) == {1.1}  # of the block before
    length = PLACE.depth - 4.0
    own = (
        before.means[0, law.OWN_COULOMB]
        + PLACE.speed * before.means[0, law.OWN_VISCOUS]
    )
    assert born.means[exits, law.LEFT] == pytest.approx(
        np.full(exits.sum(), length * own)
    )
    likely = born._replace(log_weights=np.where(exits, 0.0, -50.0))
    friction = friction_left(evidence_of(likely, None, 0), 2, 0.0)
    assert friction is not None
    assert friction[0] == pytest.approx(length * own)


def later(bank, dt_s, travel, levels):
    memory = BankMemory(bank)
    turns = transitions(dt_s, travel, 5.0, tuple(levels[1:].tolist()))
    colour = np.array([np.exp(-dt_s / 0.025), levels[0]])
    law.predict(memory.store, 1, 0.0, dt_s, colour, turns)
    return memory.bank


def test_two_steps_of_time_and_travel_are_one():
    bank = hypothesis(1, law.LAYER)
    levels = np.array([1e-4, 2e-4, 3e-4, 4e-4])
    whole = later(bank, 0.02, 0.08, levels)
    half = later(later(bank, 0.01, 0.04, levels), 0.01, 0.04, levels)
    for one, other in zip(whole, half, strict=True):
        assert one == pytest.approx(other, abs=1e-12)
    late = later(bank, 60.0, 300.0, levels).spreads
    parts = [law.COLOUR, law.HEART, law.LAW]
    assert late[0, parts, parts] == pytest.approx(levels[[0, 1, 3]])


def learned(bank, force):
    memory = BankMemory(bank)
    law.correct(memory.store, 1, SCENE, force, (0.02, 4e-4, 0.0))
    return memory.bank


def test_a_force_that_was_expected_teaches_as_kalman_says():
    bank = hypothesis(2, law.LAYER)
    row = law.regressor(bank.facts[0], SCENE)
    spread = bank.spreads[0]
    force = float(force_of(bank)[0])
    found = learned(bank, force)
    assert found.means[0] == pytest.approx(bank.means[0])
    variance = row @ spread @ row + 4e-4
    # Late in the layer nothing is being released, and no other noise comes on top.
    cross = spread @ row
    assert found.spreads[0] == pytest.approx(spread - np.outer(cross, cross) / variance)
    assert found.log_weights[0] == pytest.approx(-0.5 * law.TEMPER * np.log(variance))
    far = learned(bank, force + 1.0)
    assert far.log_weights[0] < found.log_weights[0]
    assert (row @ far.means[0] - force) > 0.0


def test_noise_is_learned_part_by_part_and_neither_a_ramp_nor_chance_is_a_motion():
    levels, ramp, chance = (DisturbanceLevels() for _ in range(3))
    motions = []
    for k, noise in enumerate(
        (0.01 * np.random.default_rng(9).standard_normal(2000)).tolist()
    ):
        beat = 0.05 * np.sin(2.0 * np.pi * 1.2 * 0.01 * k)
        levels = levels.with_force(beat + noise, 0.01, 2.0)
        ramp = ramp.with_force(0.001 * k, 0.01, 2.0)
        chance = chance.with_force(noise, 0.01, 2.0)
        motions.append(chance.levels[2:].any())
    white, colour, heart, _ = np.sqrt(levels.levels)
    assert white == pytest.approx(0.01, rel=0.15)
    assert colour < 0.008
    assert 0.02 < heart < 0.08
    assert np.sqrt(ramp.levels).max() < 1e-6
    assert np.mean(motions) < 0.1
    assert levels.restarted().with_force(1.0, 0.01, 2.0).steps == 1.0


def test_texture_shows_an_error_of_the_law_and_noise_and_a_bend_do_not():
    smooth = rough = DisturbanceLevels.of_texture()
    rng = np.random.default_rng(2)
    error = 0.0
    slope = 0.0
    a, b, c, d, *noise = transitions(1.0, 0.05, law.LAW_MM, (0.0, 0.0, 0.2**2))[2]
    spread = np.array([noise[:2], noise[1:]])
    found = []
    for k, white in enumerate((0.005 * rng.standard_normal(4000)).tolist()):
        mixed = np.array([[a, b], [c, d]]) @ (error, slope)
        error, slope = mixed + rng.multivariate_normal((0.0, 0.0), spread)
        smooth = smooth.with_force(
            white + 0.03 * 0.05 * k + 1e-5 * (0.05 * k) ** 2, 0.05, 5.0
        )
        rough = rough.with_force(white + error, 0.05, 5.0)
        found.append((smooth.law_error(1.0, 0.0), rough.law_error(1.0, 0.0)))
    assert np.max(found, axis=0)[0] < 0.03
    assert np.mean(found, axis=0)[1] == pytest.approx(0.2, rel=0.25)
    assert rough.law_error(1.0, 0.3) == 0.0


@pytest.mark.parametrize(
    ("since_s", "speed", "fall_N", "braking"),
    [
        (0.05, 2.3, 0.05, True),  # the speed may be late
        (0.05, 2.3, 0.20, False),  # too much for a speed that has not fallen
        (0.15, 2.3, 0.05, False),  # the needle has not slowed down
        (0.15, 1.9, 0.20, True),  # by 17 %: friction falls as far
        (0.15, 2.2, 0.20, False),  # by 4 %: it does not
        (0.15, 1.0, 0.40, True),  # by more than half, friction by less
        (0.15, 1.9, 0.40, False),
        (0.15, 2.3, 0.40, False),
    ],
)
def test_a_fall_that_braking_explains_is_no_rupture_yet(
    since_s, speed, fall_N, braking
):
    bank = first_bank()
    bank.records[0, [law.RUPTURE_S, law.RUPTURE_SPEED, law.RUPTURE_FORCE]] = (
        10.0,
        2.3,
        1.0,
    )
    place = Place(
        10.0 + since_s, 0.01, 50.0, speed, 1.0, 1.0 - fall_N, 2.3, 0.004, 50.0, 0.1
    )
    evaluation = Evaluation(more=0.99, fewer=0.0, pick=0, best=1)
    assert (
        may_be_braking(bank, evaluation, place, place.time_s, TissueMotion()) == braking
    )
    if not braking:
        # The travel of a needle that has nearly stopped shows it, whatever a late speed
        # says.
        bank.records[0, law.RUPTURE_MM] = 50.0 - 0.4 * since_s
        assert may_be_braking(bank, evaluation, place, place.time_s, TissueMotion())


def test_a_coarse_encoder_makes_the_speed_later_and_what_falls_slowly_waits_for_it():
    assert (speed_lag(0.0, 0.0), speed_lag(1.0, 1e-9)) == (0.1, 0.3)
    assert speed_lag(0.0041, 0.0558) == pytest.approx(0.22, abs=1e-3)
    bank = first_bank()
    at = [law.RUPTURE_S, law.RUPTURE_MM, law.RUPTURE_SPEED, law.RUPTURE_FORCE]
    bank.records[0, at] = 10.0, 49.66, 2.3, 1.0
    evaluation = Evaluation(more=0.99, fewer=0.0, pick=0, best=1)
    for fall_N, lag_s, waits in (
        (0.2, 0.1, False),
        (0.2, 0.22, True),
        (0.25, 0.22, False),
    ):
        place = Place(
            10.15, 0.01, 50.0, 2.3, 1.0, 1.0 - fall_N, 2.3, 0.004, 50.01, lag_s
        )
        assert may_be_braking(bank, evaluation, place, 10.15, TissueMotion()) == waits


@pytest.mark.parametrize(
    ("since_s", "force", "least", "more"),
    [
        (0.1, 1.1, 0.9, 1.0),
        (0.1, 1.1, 0.98, 0.0),
        (0.6, 0.8, 0.8, 1.0),
        (0.6, 1.1, 0.8, 0.0),
    ],
)
def test_a_rupture_counts_only_where_the_force_was_lower_and_late_is(
    since_s, force, least, more
):
    bank = first_bank()
    bank.facts[0, [law.KIND, law.RUPTURES]] = law.LAYER, 1.0
    bank.means[0, law.RELEASED] = 0.3
    at = [law.RUPTURE_S, law.RUPTURE_FORCE, law.LEAST_FORCE]
    bank.records[0, at] = PLACE.time_s - since_s, 1.0, least
    evidence = evidence_of(bank, None, 0)
    assert count_ruptures(evidence, 0, PLACE._replace(force=force)).more == more


@pytest.mark.parametrize(
    ("reported", "left", "earlier"), [(1, 0.16, 0.3), (0, 0.46, 0.5)]
)
def test_friction_of_a_rupture_not_reported_counts_with_the_next(
    reported, left, earlier
):
    bank = hypothesis(
        5, law.LAYER
    )  # knows of one rupture, and has 8 mm of shaft in the layer
    own = [law.OWN_COULOMB, law.OWN_VISCOUS, law.LEFT, law.EARLIER]
    bank.means[0, own] = 0.02, 0.0, 0.3, 0.5
    found = spawn(bank, 0.1, reported)
    ended = found.facts[:, law.RELEASE] == PLACE.depth
    assert (found.facts[ended, law.RUPTURES] == reported + 1.0).all()
    assert np.allclose(found.means[ended][:, [law.LEFT, law.EARLIER]], (left, earlier))
    assert ended.any()


def test_who_knows_only_of_an_older_rupture_denies_the_alarm():
    bank = spawn(hypothesis(5, law.LAYER), 0.1, 0)
    alarm = rupture_of(evidence_of(bank, None, 0), 1, 1, 0.99, (3.0, 0.012, 3.0))
    seen = evidence_of(bank, alarm, 1)
    assert seen.ruptures[:2].tolist() == [0.0, 1.0]
    assert count_ruptures(seen, 1, PLACE).fewer > 0.9


@pytest.mark.parametrize("friction", [0.2, 1.0, 1.4])
def test_a_law_that_errs_leaves_no_tip_force_below_zero(friction):
    memory = samples.FIRST_MEMORY.copy()
    answer = samples.NO_ANSWER.copy()
    memory[samples._DEFLECTION] = 1.0
    memory[samples._DEEPEST] = 0.02
    answer[0, samples.IN_CONTACT] = 1.0
    answer[0, samples._LAW] = 0.3**2
    answer[1, samples.COULOMB] = friction
    answer[2 + samples.COULOMB, samples.COULOMB] = 0.3**2
    found = samples.switching_outputs(
        0.02, 0.005, 1.1, memory, answer, np.zeros((0, 4))
    )
    tips = np.random.default_rng(3).normal(1.1 - friction, 0.3, 1_000_000)
    tips = tips[tips > 0.0]
    excess = max(friction - 1.1, 0.0)
    assert found[4:8:2] == pytest.approx((tips.mean(), 1.1 - tips.mean()), abs=2e-3)
    assert found[5:8:2] == pytest.approx([np.hypot(tips.std(), excess)] * 2, abs=2e-3)
