"""The bank: hypotheses of how the tissue gave way so far, weighed by their evidence.

At every small step of fresh travel the likeliest hypothesis of each kind has children, one for each
event that may have happened there. Those that the force speaks against are dropped; so are the
least likely, class by class, since what an event was may show only at the next one.
"""

import math
from collections.abc import Iterator
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
    NO_CUTTING,
    OFFSET,
    OWN_COULOMB,
    OWN_FORCE,
    OWN_VISCOUS,
    PARTIAL,
    RELEASE,
    RELEASED,
    ROOT,
    RUPTURES,
    STIFFNESS,
    TIP,
    UNKNOWNS,
    after_event,
    hold_cutting,
    judge_fraction,
    regressors,
    weigh,
)

STEP_MM = 0.02
"""Least travel between new hypotheses."""
HAZARD = 0.03
"""Ruptures per mm of travel, beforehand."""
RELEASES_MM = (0.15, 0.3, 0.5, 1.0, 2.0)
"""Of a layer's end or a membrane: gels release within 0.1 to 0.5 mm, real liver within 2 mm."""
PARTIAL_RELEASES_MM = (0.5, 1.5)
"""Of a partial rupture: within liver 0.5 to 2 mm."""
PARTIAL_FRACTION = 0.15
"""Of ruptures."""
KEPT_PROBABILITY = 0.2
"""Of ends of a layer after which some of the tip's force stays for a while."""
AIR_FRACTION = 0.25
"""Of ends into free air."""
MEMBRANE_FRACTION = 0.15
"""Membranes met under a layer, per rupture."""
MEMBRANE_STEP_MM = 0.25
"""Travel between hypotheses of a membrane met."""
LEAST_MM = 1.2
"""Least travel between two ruptures: about a needle diameter."""
QUOTAS = (60, 8, 16, 6)
"""Hypotheses kept: of events just past, of membranes just met, of older ones, of older membranes.
What an event was shows in some tenths of a millimetre; then it competes with the older ones."""
CAPACITY = sum(QUOTAS) + 90
"""With the children of one step, before they are pruned."""
NEGLIGIBLE = -30.0
"""Logarithm of a weight that no force will raise again."""
_NO_RELEASE = -1e9

# What a report needs: when, where, how fast and at which force the last rupture was, and whether
# it was partial; of the last part of a layer between two events where it begins and ends, its
# friction, stiffness, Coulomb and viscous friction per length and their variances; where tissue was
# first met.
RUPTURE_S, RUPTURE_MM, RUPTURE_SPEED, RUPTURE_FORCE, WAS_PARTIAL = range(5)
PART_START, PART_END, PART_FRICTION, STIFFNESS_HERE, CONTACT_MM = 5, 6, 7, 8, 14
RECORDS = 15


class Bank(NamedTuple):
    """n hypotheses, once pruned the likeliest first; never more than `CAPACITY`."""

    means: Array  # of the unknowns, shape (n, 19)
    spreads: Array  # their covariances, shape (n, 19, 19)
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
        if any(part.dtype != np.float64 for part in self):
            return f"its arrays hold {[str(part.dtype) for part in self]}, expected float64"
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
    tissue_speed: float = 0.0  # standard deviation of the speed at which tissue moves [mm/s]


def first_bank() -> Bank:
    """One hypothesis: the tip is in free air, the offset unknown."""
    spreads, facts = np.zeros((1, UNKNOWNS, UNKNOWNS)), np.zeros((1, FACTS))
    spreads[0, OFFSET, OFFSET] = 5.0**2
    facts[0, [RELEASE, LENGTH, IS_JUDGED]] = _NO_RELEASE, 1.0, 1.0
    return Bank(np.zeros((1, UNKNOWNS)), spreads, np.zeros(1), facts, np.zeros((1, RECORDS)))


class _Children(NamedTuple):
    """New hypotheses, part by part, as `Bank` has them."""

    means: list[Array]
    spreads: list[Array]
    log_weights: list[float]
    facts: list[list[float]]
    records: list[list[float]]


def spawn(bank: Bank, place: Place, before: float) -> Bank:
    """Add what may have happened since the hypotheses spawned last, at depth `before`."""
    facts, order = bank.facts, np.argsort(-bank.log_weights, kind="stable")
    likely = bank.log_weights > bank.log_weights[order[0]] - 25.0
    likely &= place.depth > facts[:, RELEASE] + np.maximum(facts[:, LENGTH], 0.3)
    parents: dict[tuple[float, float], int] = {}
    for k in order[likely[order]].tolist():  # what it was may only show at its end
        parents.setdefault((float(facts[k, KIND]), float(facts[k, IS_HELD])), k)
    step = max(place.depth - max(before, place.depth - 1.0), STEP_MM)
    is_membrane_due = int(place.depth / MEMBRANE_STEP_MM) != int(before / MEMBRANE_STEP_MM)
    rows = regressors(facts, place.depth, place.speed, place.deflection)
    children = _Children([], [], [], [], [])
    for (kind, _), k in parents.items():
        for event, becomes, is_kept, chances in _events(
            facts[k].tolist(), place, HAZARD * step, is_membrane_due
        ):
            change = (event, kind, becomes, is_kept)
            _add_child(children, bank, k, place, rows[k], change, chances)
    if not children.means:
        return bank
    return Bank(*(np.concatenate(parts) for parts in zip(bank, children, strict=True)))


def _events(
    fact: list[float], place: Place, chance: float, is_membrane_due: bool
) -> Iterator[tuple[int, float, bool, dict[float, float]]]:
    """What may happen to one hypothesis.

    Yields:
        Event, what the tip is in then, whether some of its force stays, and chances by release.
    """
    kind = fact[KIND]
    if kind == AIR:
        if fact[RUPTURES]:
            chance *= 0.1  # gaps of air are rare
        is_near = fact[RUPTURES] and place.depth < fact[RELEASE] + 3.0
        if place.deflection >= 0.3 and not is_near:
            yield CONTACT, LAYER, False, {0.3: 0.7 * chance}
            yield CONTACT, MEMBRANE, False, {0.3: 0.3 * chance}
        return
    if place.depth <= fact[TIP] + LEAST_MM:
        return
    ends = (1.0 - PARTIAL_FRACTION) * chance / len(RELEASES_MM)
    further = ends * (1.0 - AIR_FRACTION)
    yield EXIT, LAYER, False, dict.fromkeys(RELEASES_MM, further)
    if kind == LAYER:
        yield EXIT, LAYER, True, dict.fromkeys(RELEASES_MM, further * KEPT_PROBABILITY)
        yield EXIT, AIR, False, dict.fromkeys(RELEASES_MM, ends * AIR_FRACTION)
        yield (
            PARTIAL,
            LAYER,
            False,
            dict.fromkeys(
                PARTIAL_RELEASES_MM, PARTIAL_FRACTION * chance / len(PARTIAL_RELEASES_MM)
            ),
        )
        if is_membrane_due and place.depth > fact[ROOT] + 2.0 and fact[IS_JUDGED]:
            yield MEETING, MEMBRANE, False, {0.3: MEMBRANE_FRACTION * MEMBRANE_STEP_MM * HAZARD}


def _add_child(
    children: _Children,
    bank: Bank,
    k: int,
    place: Place,
    row: Array,
    change: tuple[int, float, float, bool],
    chances: dict[float, float],
) -> None:
    """Add hypotheses of one event in hypothesis k, one for each release length."""
    event, was, becomes, is_kept = change
    before, spread_before = bank.means[k], bank.spreads[k]
    fact, record, depth = bank.facts[k].tolist(), bank.records[k].tolist(), place.depth
    begin = max(fact[ROOT], record[PART_END]) if was == LAYER else depth
    is_met = was == MEMBRANE and fact[IS_HELD] > 0.0
    length = max(depth - fact[ROOT], 0.0)
    at = (place.deflection, place.speed, place.tissue_speed, place.force)
    what, now = (event, was, becomes, is_met, is_kept), (length, depth - begin, *at)
    mean, spread = after_event(before, spread_before, row, what, now)
    if event in (EXIT, PARTIAL):
        own = slice(RELEASED, OWN_VISCOUS + 1)
        fact[RELEASE], fact[OWN_FORCE] = depth, float(row[own] @ before[own])
        fact[RUPTURES] += 1.0
    else:
        fact[RELEASE] = _NO_RELEASE
    part = (begin, float(mean[LEFT]), before, spread_before)
    _write_record(record, place, change, part, is_first=not fact[RUPTURES])
    if event != PARTIAL:
        # The layer behind a membrane has rubbed since the membrane was met.
        fact[ROOT] = fact[TIP] if event == EXIT and was == MEMBRANE else depth
        fact[IS_JUDGED] = float(becomes != LAYER)
    fact[TIP], fact[KIND] = depth, becomes
    fact[IS_HELD] = float(event in (PARTIAL, MEETING))
    fact[IS_PUNCTURED] = float(event == EXIT and was == MEMBRANE)
    weight, n = float(bank.log_weights[k]), len(chances)
    children.means.extend([mean] * n)
    children.spreads.extend([spread] * n)
    children.log_weights.extend(weight + math.log(chance) for chance in chances.values())
    children.facts.extend([*fact[:LENGTH], release, *fact[LENGTH + 1 :]] for release in chances)
    children.records.extend([record] * n)


def _write_record(
    record: list[float],
    place: Place,
    change: tuple[int, float, float, bool],
    part: tuple[float, float, Array, Array],
    *,
    is_first: bool,
) -> None:
    """Write down what a report may need of an event and of the part of a layer that it ends."""
    event, was, _, _ = change
    begin, friction, mean, spread = part
    if event in (EXIT, PARTIAL):
        moment = (place.time_s - 0.5 * place.dt_s, place.depth, place.speed, place.force)
        record[RUPTURE_S : WAS_PARTIAL + 1] = (*moment, float(event == PARTIAL))
    if was == LAYER:
        record[PART_START : PART_FRICTION + 1] = begin, place.depth, friction
        for n, j in enumerate((STIFFNESS, OWN_COULOMB, OWN_VISCOUS)):
            at = STIFFNESS_HERE + 2 * n
            record[at], record[at + 1] = float(mean[j]), float(spread[j, j])
    elif event == CONTACT:
        record[PART_START:CONTACT_MM] = [0.0] * (CONTACT_MM - PART_START)
        record[PART_START] = record[PART_END] = place.depth
        if is_first:
            record[CONTACT_MM] = place.depth


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


def _without_negative_cutting(bank: Bank) -> Bank:
    std = np.sqrt(np.maximum(bank.spreads[:, HELD, HELD], 0.0))
    is_cutting = (bank.facts[:, KIND] == LAYER) & (bank.facts[:, IS_HELD] == 0.0)
    due = np.flatnonzero(is_cutting & (bank.means[:, HELD] < -NO_CUTTING - std))
    if not due.size:
        return bank
    means, spreads, weights = bank.means.copy(), bank.spreads.copy(), bank.log_weights.copy()
    for k in due.tolist():
        change, means[k], spreads[k] = hold_cutting(means[k], spreads[k])
        weights[k] += change
    return bank._replace(means=means, spreads=spreads, log_weights=weights)


def prune(bank: Bank, place: Place) -> Bank:
    """Weigh down what no tissue does, and keep the likeliest of each class, best first."""
    bank = _without_negative_cutting(bank)
    now = (place.depth, place.speed, place.dt_s, place.noise)
    weights, facts = weigh(bank.means, bank.spreads, bank.facts, bank.log_weights, now)
    travel, is_membrane = place.depth - facts[:, TIP], facts[:, KIND] == MEMBRANE
    order = np.argsort(-weights, kind="stable")
    order = order[weights[order] > NEGLIGIBLE]
    pushed = is_membrane[order]
    young = travel[order] < np.where(pushed, 1.5, 0.4)
    classes = (young & ~pushed, young & pushed, ~young & ~pushed, ~young & pushed)
    kept = [np.flatnonzero(some)[:most] for some, most in zip(classes, QUOTAS, strict=True)]
    return bank._replace(log_weights=weights, facts=facts).take(
        order[np.sort(np.concatenate(kept))]
    )
