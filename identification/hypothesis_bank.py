"""The bank: hypotheses of how the tissue gave way so far, weighed by their evidence.

At every small step of fresh travel the likeliest hypothesis of each kind has children, one for each
event that may have happened there. Those that the force speaks against are dropped; so are the
least likely, class by class, since what an event was may show only at the next one.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.estimate import Array
from identification.hypothesis_filter import (
    AIR,
    CONTACT,
    EXIT,
    FACTS,
    HELD,
    IS_HELD,
    IS_JUDGED,
    IS_PUNCTURED,
    KIND,
    LAYER,
    LEFT,
    LENGTH,
    MEETING,
    MEMBRANE,
    OFFSET,
    OWN_COULOMB,
    OWN_FORCE,
    OWN_VISCOUS,
    RELEASE,
    RELEASED,
    ROOT,
    RUPTURES,
    STIFFENING,
    STIFFNESS,
    TEAR,
    TIP,
    UNKNOWNS,
    after_event,
    judge_fraction,
    regressors,
)

STEP_MM = 0.02
"""Least travel between new hypotheses."""
HAZARD = 0.03
"""Ruptures per mm of travel, beforehand."""
RELEASES_MM = (0.15, 0.3, 0.5)
"""Of a layer's end or a membrane: gels and layers release within 0.1 to 0.5 mm."""
TEARS_MM = (0.5, 1.5)
"""Of a tear: within liver 0.5 to 2 mm."""
TEAR_SHARE = 0.15
"""Of ruptures."""
AIR_SHARE = 0.25
"""Of ends into free air."""
MEMBRANE_SHARE = 0.15
"""Membranes met under a layer, per rupture."""
MEMBRANE_STEP_MM = 0.25
"""Travel between hypotheses of a membrane met."""
LEAST_MM = 1.2
"""Least travel between two ruptures: about a needle diameter."""
PUSHED_MM = 12.0
"""A membrane hardly gives more."""
LEAST_DROP = 0.12
"""Of a layer's force, released at its rupture."""
QUOTAS = (30, 8, 12, 6)
"""Hypotheses kept: of events just past, of membranes just met, of older ones, of older membranes.
What an event was shows in some tenths of a millimetre; then it competes with the older ones."""
CAPACITY = sum(QUOTAS) + 40
"""With the children of one step, before they are pruned."""
NEGLIGIBLE = -30.0
"""Logarithm of a weight that no force will raise again."""
_NO_RELEASE = -1e9

# What a report needs: when, where, how fast and at which force the last rupture was, and whether
# it was a tear; of the last part of a layer between two events where it begins and ends, its
# friction, stiffness, Coulomb and viscous friction per length and their variances; where tissue was
# first met.
RUPTURE_S, RUPTURE_MM, RUPTURE_SPEED, RUPTURE_FORCE, WAS_TEAR = range(5)
PART_START, PART_END, PART_FRICTION, STIFFNESS_HERE, CONTACT_MM = 5, 6, 7, 8, 14
RECORDS = 15


class Bank(NamedTuple):
    """n hypotheses, once pruned the likeliest first; never more than `CAPACITY`."""

    means: Array  # of the unknowns, shape (n, 18)
    spreads: Array  # their covariances, shape (n, 18, 18)
    log_weights: Array  # logarithm of each one's probability, shape (n,)
    facts: Array  # what it takes for certain, shape (n, 10)
    records: Array  # what it says of the last rupture, shape (n, 15)

    @property
    def damage(self) -> str:
        """What is wrong with the arrays, if anything; checked before compiled code reads them."""
        n, last = len(self.log_weights), (UNKNOWNS, UNKNOWNS)
        shapes = ((n, UNKNOWNS), (n, *last), (n,), (n, FACTS), (n, RECORDS))
        if not 1 <= n <= CAPACITY or [np.shape(part) for part in self] != list(shapes):
            return f"its arrays have shapes {[np.shape(part) for part in self]}"
        if not all(np.isfinite(part).all() for part in self):
            return "it has numbers that are not finite"
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", self.spreads), 1e-300))
        scaled = self.spreads / (scale[:, :, None] * scale[:, None, :])
        if not np.allclose(scaled, scaled.transpose(0, 2, 1), rtol=0.0, atol=1e-3):
            return "its covariances are not symmetric"
        is_kind = np.isin(self.facts[:, KIND], (AIR, LAYER, MEMBRANE))
        return "" if (is_kind & (self.facts[:, LENGTH] > 0.0)).all() else "its facts are impossible"

    def take(self, index: NDArray[np.intp]) -> "Bank":
        """Some of them."""
        return Bank(*(part[index] for part in self))

    @property
    def weights(self) -> Array:
        """Probabilities, shape (n,)."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        return weights / weights.sum()


class Place(NamedTuple):
    """Where the tip is at the middle of a block, as far as all hypotheses agree."""

    time_s: float  # on the caller's clock
    dt_s: float  # length of the block
    depth: float  # [mm]
    speed: float  # [mm/s]
    deflection: float  # presliding, -1 to 1
    force: float  # mean over the block [N]
    usual_speed: float  # of the last ten seconds [mm/s]
    noise: float  # standard deviation of a block's force [N]


def first_bank() -> Bank:
    """One hypothesis: the tip is in free air, the offset unknown."""
    spreads, facts = np.zeros((1, UNKNOWNS, UNKNOWNS)), np.zeros((1, FACTS))
    spreads[0, OFFSET, OFFSET] = 5.0**2
    facts[0, [RELEASE, LENGTH, IS_JUDGED]] = _NO_RELEASE, 1.0, 1.0
    return Bank(np.zeros((1, UNKNOWNS)), spreads, np.zeros(1), facts, np.zeros((1, RECORDS)))


def spawn(bank: Bank, place: Place, before: float) -> Bank:
    """Add what may have happened since the hypotheses spawned last, at depth `before`."""
    facts, order = bank.facts, np.argsort(-bank.log_weights, kind="stable")
    likely = bank.log_weights > bank.log_weights[order[0]] - 25.0
    likely &= place.depth > facts[:, RELEASE] + np.maximum(facts[:, LENGTH], 0.3)
    parents: dict[tuple[float, float], int] = {}
    for k in order[likely[order]].tolist():  # what it was may only show at its end
        parents.setdefault((facts[k, KIND], facts[k, IS_HELD]), k)
    step = max(place.depth - max(before, place.depth - 1.0), STEP_MM)
    is_membrane_due = int(place.depth / MEMBRANE_STEP_MM) != int(before / MEMBRANE_STEP_MM)
    children = [bank]
    for k in parents.values():
        kind = facts[k, KIND]
        if kind == AIR:
            children += _contacts(bank, k, place, HAZARD * step)
        elif place.depth > facts[k, TIP] + LEAST_MM:
            children += _ruptures(bank, k, place, HAZARD * step)
            is_known = place.depth > facts[k, ROOT] + 2.0 and facts[k, IS_JUDGED]
            if kind == LAYER and is_membrane_due and is_known:
                chance = MEMBRANE_SHARE * MEMBRANE_STEP_MM * HAZARD
                children.append(_child(bank, k, place, MEETING, MEMBRANE, {0.3: chance}))
    return Bank(*(np.concatenate(parts) for parts in zip(*children, strict=True)))


def _contacts(bank: Bank, k: int, place: Place, chance: float) -> list[Bank]:
    """The tip meets a layer, or a membrane on it."""
    if bank.facts[k, RUPTURES]:
        if place.depth < bank.facts[k, RELEASE] + 3.0:
            return []
        chance *= 0.1  # gaps of air are rare
    if place.deflection < 0.3:
        return []
    return [
        _child(bank, k, place, CONTACT, LAYER, {0.3: 0.7 * chance}),
        _child(bank, k, place, CONTACT, MEMBRANE, {0.3: 0.3 * chance}),
    ]


def _ruptures(bank: Bank, k: int, place: Place, chance: float) -> list[Bank]:
    """The tip leaves a layer or a membrane, or tears a layer."""
    ends = (1.0 - TEAR_SHARE) * chance / len(RELEASES_MM)
    found = [
        _child(bank, k, place, EXIT, LAYER, dict.fromkeys(RELEASES_MM, ends * (1.0 - AIR_SHARE)))
    ]
    if bank.facts[k, KIND] == LAYER:
        into_air = dict.fromkeys(RELEASES_MM, ends * AIR_SHARE)
        tears = dict.fromkeys(TEARS_MM, TEAR_SHARE * chance / len(TEARS_MM))
        found.append(_child(bank, k, place, EXIT, AIR, into_air))
        found.append(_child(bank, k, place, TEAR, LAYER, tears))
    return found


def _child(
    bank: Bank, k: int, place: Place, event: int, becomes: float, chances: dict[float, float]
) -> Bank:
    """Hypotheses of one event in hypothesis k, with their release lengths and chances."""
    fact, record = bank.facts[k].copy(), bank.records[k].copy()
    before, spread_before = bank.means[k], bank.spreads[k]
    depth, was = place.depth, fact[KIND]
    row = regressors(bank.facts[k : k + 1], depth, place.speed, place.deflection)[0]
    length = max(depth - fact[ROOT], 0.0)
    begin = max(fact[ROOT], record[PART_END]) if was == LAYER else depth
    mean, spread = after_event(
        before,
        spread_before,
        row,
        (event, float(was), becomes, bool(was == MEMBRANE and fact[IS_HELD])),
        (length, depth - begin, place.deflection, place.speed, place.force),
    )
    if event in (EXIT, TEAR):
        own = slice(RELEASED, OWN_VISCOUS + 1)
        fact[[RELEASE, OWN_FORCE]] = depth, row[own] @ before[own]
        fact[RUPTURES] += 1.0
        moment = (place.time_s - 0.5 * place.dt_s, depth, place.speed, place.force)
        record[RUPTURE_S : WAS_TEAR + 1] = *moment, float(event == TEAR)
    else:
        fact[RELEASE] = _NO_RELEASE
    if was == LAYER:
        record[[PART_START, PART_END, PART_FRICTION]] = begin, depth, mean[LEFT]
        per_length = [STIFFNESS, OWN_COULOMB, OWN_VISCOUS]
        record[STIFFNESS_HERE:CONTACT_MM:2] = before[per_length]
        record[STIFFNESS_HERE + 1 : CONTACT_MM : 2] = spread_before[per_length, per_length]
    elif event == CONTACT:
        record[PART_START:CONTACT_MM] = 0.0
        record[[PART_START, PART_END]] = depth
        if not fact[RUPTURES]:
            record[CONTACT_MM] = depth
    # The layer behind a membrane has rubbed since the membrane was met.
    start = fact[TIP] if event == EXIT and was == MEMBRANE else depth
    if event != TEAR:
        fact[ROOT] = start
        fact[IS_JUDGED] = float(becomes != LAYER)
    fact[[TIP, KIND]] = depth, becomes
    fact[IS_HELD] = float(event in (TEAR, MEETING))
    fact[IS_PUNCTURED] = float(event == EXIT and was == MEMBRANE)
    n = len(chances)
    facts = np.repeat(fact[None], n, axis=0)
    facts[:, LENGTH] = list(chances)
    log_weights = bank.log_weights[k] + np.log(list(chances.values()))
    repeated = [np.repeat(part[None], n, axis=0) for part in (mean, spread, record)]
    return Bank(*repeated[:2], log_weights, facts, repeated[2])


def judge_fractions(bank: Bank, place: Place) -> Bank:
    """Apply the prior of friction's fraction to every hypothesis that knows its layer's slope."""
    travel = place.depth - bank.facts[:, TIP]
    due = np.flatnonzero((bank.facts[:, IS_JUDGED] == 0.0) & (travel > 1.0))
    if not due.size:
        return bank
    means, spreads, facts = bank.means.copy(), bank.spreads.copy(), bank.facts.copy()
    for k in due.tolist():
        is_judged, means[k], spreads[k] = judge_fraction(
            means[k], spreads[k], place.speed, bool(travel[k] >= 10.0)
        )
        facts[k, IS_JUDGED] = float(is_judged)
    return bank._replace(means=means, spreads=spreads, facts=facts)


def prune(bank: Bank, place: Place) -> Bank:
    """Weigh down what no tissue does, and keep the likeliest of each class, best first."""
    facts, weights = bank.facts.copy(), bank.log_weights.copy()
    travel = place.depth - facts[:, TIP]
    is_membrane = facts[:, KIND] == MEMBRANE
    due = facts[:, OWN_FORCE] > 0.0
    due &= place.depth > facts[:, RELEASE] + facts[:, LENGTH] + 0.1
    least = np.maximum(LEAST_DROP * facts[:, OWN_FORCE], 2.0 * place.noise)
    weights[due & (bank.means[:, RELEASED] < least)] -= 12.0
    facts[due, OWN_FORCE] = 0.0
    variance = np.maximum(bank.spreads[:, STIFFNESS, STIFFNESS], 0.0)
    is_odd = bank.means[:, STIFFNESS] + 2.0 * np.sqrt(variance) < 0.0
    is_odd |= bank.means[:, OWN_COULOMB] + bank.means[:, OWN_VISCOUS] * place.speed < -0.003
    weights[is_odd & (facts[:, KIND] != AIR) & (travel > 2.0)] -= 0.1
    weights[is_membrane & (travel > PUSHED_MM)] -= 0.3
    weights -= weights.max()
    weights -= math.log(np.exp(weights).sum())
    order = np.argsort(-weights, kind="stable")
    order = order[weights[order] > NEGLIGIBLE]
    pushed = is_membrane[order]
    young = travel[order] < np.where(pushed, 1.5, 0.4)
    classes = (young & ~pushed, young & pushed, ~young & ~pushed, ~young & pushed)
    kept = [np.flatnonzero(some)[:most] for some, most in zip(classes, QUOTAS, strict=True)]
    return bank._replace(log_weights=weights, facts=facts).take(
        order[np.sort(np.concatenate(kept))]
    )
