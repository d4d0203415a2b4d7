"""The bank of hypotheses: what an event changes, what the force teaches, which of them stay."""

import numpy as np
import pytest

from identification import hypothesis_filter
from identification.disturbance_levels import DisturbanceLevels, transitions
from identification.hypothesis_bank import (
    CAPACITY,
    QUOTAS,
    Bank,
    BankMemory,
    Place,
    first_bank,
)
from identification.hypothesis_filter import (
    AIR,
    COLOUR,
    EXIT,
    HEART,
    IS_HELD,
    IS_JUDGED,
    KIND,
    LAW,
    LAYER,
    LEFT,
    LENGTH,
    MEMBRANE,
    OWN_COULOMB,
    OWN_VISCOUS,
    RELEASE,
    ROOT,
    RUPTURE_FORCE,
    RUPTURE_S,
    RUPTURE_SPEED,
    RUPTURES,
    STIFFNESS,
    TEMPER,
    TIP,
    UNKNOWNS,
    absorb,
    add_children,
    predict,
    regressor,
    weigh,
)
from identification.rupture_report import (
    Evaluation,
    answer_at,
    count_ruptures,
    friction_left,
    may_be_braking,
)
from identification.switching_update import COULOMB, IN_CONTACT, LAYER_NUMBER

PLACE = Place(
    time_s=3.0,
    dt_s=0.01,
    depth=12.0,
    speed=4.0,
    deflection=1.0,
    force=0.9,
    usual_speed=4.0,
    noise=0.01,
)


def hypothesis(seed, kind, *, is_held=False):
    """A bank of one hypothesis that has been in its layer for a while, its unknowns drawn."""
    rng = np.random.default_rng(seed)
    bank = first_bank()
    factor = 0.05 * rng.standard_normal((UNKNOWNS, UNKNOWNS))
    facts = bank.facts.copy()
    facts[0, [KIND, ROOT, TIP, IS_HELD]] = kind, 4.0, 5.0, is_held
    if kind == LAYER:
        facts[0, [RELEASE, LENGTH, RUPTURES]] = 5.0, 0.3, 1.0
    means = 0.1 * np.abs(rng.standard_normal((1, UNKNOWNS)))
    if kind != LAYER:
        means[0, [OWN_COULOMB, OWN_VISCOUS, STIFFNESS]] = 0.0
    return bank._replace(means=means, spreads=(factor @ factor.T)[None], facts=facts)


SCENE = (PLACE.depth, PLACE.speed, PLACE.deflection)


def spawn(bank, place, before):
    memory = BankMemory(bank)
    memory.spawn(place, before, 0.0)
    return memory.bank


def force_of(bank):
    rows = np.array([regressor(fact, SCENE) for fact in bank.facts])
    return np.einsum("ni,ni->n", rows, bank.means)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("kind", "is_held"), [(LAYER, False), (LAYER, True), (MEMBRANE, True)])
def test_the_force_goes_on_as_it_was_across_an_event(seed, kind, is_held):
    before = hypothesis(seed, kind, is_held=is_held)
    after = spawn(before, PLACE, PLACE.depth - 0.3)
    born = Bank(*(part[1:] for part in after))
    assert len(born.log_weights) > 2
    assert force_of(born) == pytest.approx(np.repeat(force_of(before), len(born.log_weights)))
    assert set(born.facts[:, RUPTURES] - before.facts[0, RUPTURES]) <= {0.0, 1.0}
    assert len(after.log_weights) <= CAPACITY


def test_first_contact_takes_nothing_from_the_force():
    before = first_bank()
    after = spawn(before, PLACE, PLACE.depth - 0.1)
    assert sorted(after.facts[1:, KIND]) == [LAYER, MEMBRANE]
    assert force_of(after) == pytest.approx(np.zeros(3))
    assert (after.facts[1:, [ROOT, TIP]] == PLACE.depth).all()


def test_the_friction_of_a_layer_left_stays_on_the_shaft_and_is_remembered():
    before = hypothesis(5, LAYER)
    born = spawn(before, PLACE, PLACE.depth - 0.3)
    exits = (born.facts[:, RUPTURES] == 2.0) & (born.facts[:, IS_HELD] == 0.0)
    length = PLACE.depth - 4.0
    own = before.means[0, OWN_COULOMB] + PLACE.speed * before.means[0, OWN_VISCOUS]
    assert born.means[exits, LEFT] == pytest.approx(np.full(exits.sum(), length * own))
    friction = friction_left(born._replace(log_weights=np.where(exits, 0.0, -50.0)), 2)
    assert friction is not None
    assert friction[0] == pytest.approx(length * own)


def later(bank, dt_s, travel, levels):
    memory = BankMemory(bank)
    turns = transitions(dt_s, travel, 5.0, tuple(levels[1:].tolist()))
    colour = np.array([np.exp(-dt_s / 0.025), levels[0]])
    predict(memory.store, 1, 0.0, dt_s, colour, turns)
    return memory.bank


def test_two_steps_of_time_and_travel_are_one():
    bank, levels = hypothesis(1, LAYER), np.array([1e-4, 2e-4, 3e-4, 4e-4])
    whole = later(bank, 0.02, 0.08, levels)
    half = later(later(bank, 0.01, 0.04, levels), 0.01, 0.04, levels)
    for one, other in zip(whole, half, strict=True):
        assert one == pytest.approx(other, abs=1e-12)
    late = later(bank, 60.0, 300.0, levels).spreads
    assert late[0, [COLOUR, HEART, LAW], [COLOUR, HEART, LAW]] == pytest.approx(levels[[0, 1, 3]])


def learned(bank, force):
    memory = BankMemory(bank)
    absorb(memory.store, 1, SCENE, force, 4e-4, 0.0)
    return memory.bank


def test_a_force_that_was_expected_teaches_as_kalman_says():
    bank = hypothesis(2, LAYER)
    row, spread, force = regressor(bank.facts[0], SCENE), bank.spreads[0], float(force_of(bank)[0])
    found = learned(bank, force)
    assert found.means[0] == pytest.approx(bank.means[0])
    variance = row @ spread @ row + 4e-4
    # Late in the layer nothing is being released, and no other noise comes on top.
    cross = spread @ row
    assert found.spreads[0] == pytest.approx(spread - np.outer(cross, cross) / variance)
    assert found.log_weights[0] == pytest.approx(-0.5 * TEMPER * np.log(variance))
    far = learned(bank, force + 1.0)
    assert far.log_weights[0] < found.log_weights[0]
    assert (row @ far.means[0] - force) > 0.0


ARGUMENTS = {
    absorb: (1, SCENE, 0.8, 1e-4, 0.01),
    predict: (1, 1e-4, 0.01, np.full(2, 0.1), transitions(0.01, 0.04, 5.0, (1e-4, 1e-4, 1e-4))),
    add_children: (0, 1, (EXIT, LAYER, True), (*SCENE, 3.0, 0.5, 0.9), np.array([0.3, 1.0]), 0.1),
    weigh: (1, (22.0, 4.0, 0.01, 0.01), True),
}


@pytest.mark.parametrize("function", ARGUMENTS, ids=lambda function: function.__name__)
def test_compiled_and_plain_arithmetic_agree(function):
    fast, slow = BankMemory(hypothesis(3, LAYER)), BankMemory(hypothesis(3, LAYER))
    function(fast.store, *ARGUMENTS[function])
    getattr(function, "py_func", function)(slow.store, *ARGUMENTS[function])
    for one, other in zip(fast.store, slow.store, strict=True):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-14)


def test_what_the_force_contradicts_is_dropped_and_the_rest_bounded():
    memory, rng = BankMemory(first_bank()), np.random.default_rng(4)
    for step in range(400):
        place = PLACE._replace(depth=0.04 * step, force=0.01 * rng.standard_normal())
        memory.spawn(place, place.depth - 0.04, 0.0)
        weigh(memory.store, memory.size, (place.depth, 4.0, 0.01, 0.01), False)
        memory.prune(place)
        scene = (place.depth, place.speed, 1.0)
        absorb(memory.store, memory.size, scene, place.force, 1e-4, 0.0)
        assert memory.size <= sum(QUOTAS)
    memory.prune(place)
    assert memory.bank.damage == ""
    assert memory.bank.facts[0, KIND] == AIR
    assert count_ruptures(memory.bank, 0, 0.01).more < 0.01


def test_hypotheses_that_differ_make_an_answer_less_certain():
    one, other = hypothesis(6, LAYER), hypothesis(6, LAYER)
    other.means[0, OWN_COULOMB] += 0.02
    both = Bank(*(np.concatenate(parts) for parts in zip(one, other, strict=True)))
    alone, mixed = (answer_at(BankMemory(bank), PLACE, 1, 0.0) for bank in (one, both))
    length = PLACE.depth - 4.0
    assert mixed[1, COULOMB] == pytest.approx(alone[1, COULOMB] + 0.01 * length)
    variances = [answer[2 + COULOMB, COULOMB] for answer in (alone, mixed)]
    assert variances[1] == pytest.approx(variances[0] + (0.01 * length) ** 2)
    assert mixed[0, [IN_CONTACT, LAYER_NUMBER]].tolist() == [1.0, 2.0]


def test_the_fraction_of_friction_is_a_prior_that_waits_for_the_slope():
    bank = hypothesis(7, LAYER)
    bank.facts[0, IS_JUDGED] = 0.0
    vague, known = (BankMemory(bank._replace(spreads=k * bank.spreads)) for k in (1e4, 1.0))
    weigh(vague.store, 1, (14.0, 4.0, 0.01, 0.01), True)
    assert vague.bank.facts[0, IS_JUDGED] == 0.0
    weigh(known.store, 1, (16.0, 4.0, 0.01, 0.01), True)
    assert known.bank.facts[0, IS_JUDGED] == 1.0
    mean, spread = known.bank.means[0], known.bank.spreads[0]
    assert np.trace(spread) < np.trace(bank.spreads[0])
    slope = [mean[STIFFNESS], mean[OWN_COULOMB] + 4.0 * mean[OWN_VISCOUS]]
    was = bank.means[0, [STIFFNESS, OWN_COULOMB, OWN_VISCOUS]] @ [0.0, 1.0, 4.0]
    before = was / (was + bank.means[0, STIFFNESS])
    assert abs(slope[1] / sum(slope) - 0.55) < abs(before - 0.55)


def test_noise_is_learned_part_by_part_and_a_ramp_is_none():
    rng = np.random.default_rng(8)
    levels, ramp = DisturbanceLevels(), DisturbanceLevels()
    t = 0.01 * np.arange(2000)
    beat = 0.05 * np.sin(2.0 * np.pi * 1.2 * t)
    for force, place in zip(
        (beat + 0.01 * rng.standard_normal(2000)).tolist(), t.tolist(), strict=True
    ):
        levels = levels.with_force(force, 0.01, 2.0)
        ramp = ramp.with_force(0.1 * place, 0.01, 2.0)
    white, colour, heart, _ = np.sqrt(levels.levels)
    assert white == pytest.approx(0.01, rel=0.15)
    assert colour < 0.008
    assert 0.02 < heart < 0.08
    assert np.sqrt(ramp.levels).max() < 1e-6
    assert levels.restarted().with_force(1.0, 0.01, 2.0).steps == 1.0


@pytest.mark.parametrize(
    "change",
    [
        {"means": np.zeros((2, UNKNOWNS))},
        {"spreads": np.full((1, UNKNOWNS, UNKNOWNS), np.nan)},
        {"facts": np.zeros((1, hypothesis_filter.FACTS))},
        {"records": np.zeros((1, hypothesis_filter.RECORDS - 1))},
    ],
)
def test_a_damaged_bank_says_so(change):
    assert first_bank().damage == ""
    assert first_bank()._replace(**change).damage != ""


@pytest.mark.parametrize(
    ("since_s", "speed", "fall_N", "braking"),
    [
        (0.05, 2.3, 0.05, True),  # the speed may be late
        (0.05, 2.3, 0.20, False),  # too much for any brake in this time
        (0.15, 2.3, 0.05, False),  # the needle has not slowed down
        (0.15, 1.9, 0.20, True),  # by 17 %: friction falls as far
        (0.15, 2.2, 0.20, False),  # by 4 %: it does not
        (0.15, 1.0, 0.40, False),
    ],
)
def test_a_fall_that_braking_explains_is_no_rupture_yet(since_s, speed, fall_N, braking):
    bank = first_bank()
    bank.records[0, [RUPTURE_S, RUPTURE_SPEED, RUPTURE_FORCE]] = 10.0, 2.3, 1.0
    place = Place(10.0 + since_s, 0.01, 50.0, speed, 1.0, 1.0 - fall_N, 2.3, 0.004)
    evaluation = Evaluation(more=0.99, fewer=0.0, pick=0, best=1)
    assert may_be_braking(bank, evaluation, place) == braking
