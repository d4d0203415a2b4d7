"""The bank: hypotheses of which ruptures there have been, weighed by their evidence.

At every small step of fresh travel the likeliest hypothesis of each kind has children,
one for each event that may have happened there. Those that the force speaks against are
dropped; so are the least likely, class by class, since what an event was may show only
at the next one.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled
from identification.multilayer import force_model as law

STEP_MM = 0.02  # least travel between new hypotheses
HAZARD = 0.02  # prior rate of ruptures per mm of travel
RELEASES_MM = np.array([0.15, 0.3, 0.5, 1.0, 1.5, 2.0])
"""Travel of a release, one hypothesis each: gels take 0.1 to 0.5 mm, real liver up
to 2 mm."""
PARTIAL_RELEASES_MM = np.array(
    [0.5, 1.5]
)  # the same of a partial rupture: in liver 0.5 to 2 mm
_NO_RELEASES_MM = np.array([0.3])
PARTIAL_FRACTION = 0.15  # prior fraction of ruptures that are partial
KEPT_PROBABILITY = (
    0.2  # prior fraction of layer ends after which some tip force stays for a while
)
AIR_FRACTION = 0.25  # prior fraction of layer ends that lead into free air
MEMBRANE_FRACTION = 0.15  # prior number of membranes met under a layer, per rupture
MEMBRANE_STEP_MM = 0.25  # travel between hypotheses of a membrane met
LEAST_MM = 1.2  # least travel between two ruptures: about a needle diameter
QUOTAS = (60, 8, 16, 6)
"""Most hypotheses kept: with a recent event, a membrane just met, older events, older
membranes. What an event was shows only some tenths of a millimetre later; until then it
is protected."""
KEPT = sum(QUOTAS)
CAPACITY = KEPT + 120  # with the children of two steps, before they are pruned
NEGLIGIBLE = -30.0  # a hypothesis with a smaller logarithm of its weight is dropped
_LIKELY = 25.0  # a parent's log weight is at most so far below the largest
_OF_PARENT = law.RELEASE, law.LENGTH, law.KIND, law.IS_HELD
_OF_CLASS = law.TIP, law.KIND, int(law.MEMBRANE)
"""Indices for compiled code, which does not use constants of another file."""
Rows = NDArray[np.int64]  # Row numbers of hypotheses, shape (m,)


@compiled
def _probabilities(log_weights: Vector) -> Array:
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


class Bank(NamedTuple):
    """n hypotheses, once pruned the likeliest first; never more than `CAPACITY`.

    Attributes:
        means: Of the unknowns, shape (n, 20).
        spreads: Their covariances, shape (n, 20, 20).
        log_weights: Logarithm of each one's probability, shape (n,).
        facts: What it assumes to be known, shape (n, 10).
        records: What it knows of the last rupture, for reports, shape (n, 16).
    """

    means: Array
    spreads: Array
    log_weights: Array
    facts: Array
    records: Array

    @property
    def damage(self) -> str:
        """What is wrong with the arrays, if anything; checked before compiled code
        reads them.
        """
        n = len(self.log_weights)
        last = (law.UNKNOWNS, law.UNKNOWNS)
        shapes = ((n, law.UNKNOWNS), (n, *last), (n,), (n, law.FACTS), (n, law.RECORDS))
        if not 1 <= n <= CAPACITY or [np.shape(part) for part in self] != list(shapes):
            return f"its arrays have shapes {[np.shape(part) for part in self]}"
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", self.spreads), 1e-300))
        scaled = self.spreads / (scale[:, :, None] * scale[:, None, :])
        if not np.allclose(scaled, scaled.transpose(0, 2, 1), rtol=0.0, atol=1e-3):
            return "its covariances are not symmetric"
        is_kind = np.isin(self.facts[:, law.KIND], (law.AIR, law.LAYER, law.MEMBRANE))
        is_possible = (is_kind & (self.facts[:, law.LENGTH] > 0.0)).all()
        return "" if is_possible else "its facts are impossible"

    @property
    def weights(self) -> Array:
        """Probabilities, shape (n,)."""
        return _probabilities(self.log_weights)

    def copied(self) -> "Bank":
        """The same, in memory of its own."""
        return Bank(*(part.copy() for part in self))


class Place(NamedTuple):
    """Where the tip is at the middle of a block, as far as all hypotheses agree.

    Attributes:
        time_s: Since the reset.
        dt_s: Length of the block.
        depth: [mm].
        speed: [mm/s].
        deflection: Presliding deflection, -1 to 1.
        force: Mean over the block [N].
        usual_speed: Mean over the last ten seconds [mm/s].
        noise: Standard deviation of a block's force [N].
        raw: Unfiltered depth [mm].
        lag_s: By which the speed may be late.
        before: Mean force over the block before [N].
        law_error: Error of the law that the tissue's texture shows [N].
    """

    time_s: float
    dt_s: float
    depth: float
    speed: float
    deflection: float
    force: float
    usual_speed: float
    noise: float
    raw: float = 0.0
    lag_s: float = 0.0
    before: float = 0.0
    by_speed: float = (
        0.0  # shaft friction that changes of the speed have added so far [N]
    )
    law_error: float = 0.0


def first_bank() -> Bank:
    """One hypothesis: the tip is in free air, the offset unknown."""
    spreads = np.zeros((1, law.UNKNOWNS, law.UNKNOWNS))
    facts = np.zeros((1, law.FACTS))
    spreads[0, law.OFFSET, law.OFFSET] = 5.0**2
    facts[0, [law.RELEASE, law.LENGTH, law.IS_JUDGED]] = law.NO_RELEASE, 1.0, 1.0
    return Bank(
        np.zeros((1, law.UNKNOWNS)),
        spreads,
        np.zeros(1),
        facts,
        np.zeros((1, law.RECORDS)),
    )


class BankMemory:
    """Memory of a bank that changes in place; pruning copies what it keeps into a
    second one.
    """

    def __init__(self, bank: Bank) -> None:
        shapes = [(CAPACITY, *part.shape[1:]) for part in bank]
        stores = [tuple(np.zeros(shape) for shape in shapes) for _ in range(2)]
        self.store = Bank(*stores[0])[:]
        self._other = Bank(*stores[1])[:]
        for room, part in zip(self.store, bank, strict=True):
            room[: len(part)] = part
        self.size = len(bank.log_weights)

    @property
    def bank(self) -> Bank:
        """The hypotheses as they are now, not to be kept."""
        return Bank(*(part[: self.size] for part in self.store))

    @property
    def likeliest(self) -> tuple[list[float], list[float]]:
        """Means of the unknowns, and the facts, of the likeliest hypothesis."""
        return self.store[0][0].tolist(), self.store[3][0].tolist()

    def spawn(
        self, place: Place, before: float, tissue_speed: float, reported: int
    ) -> None:
        """Add hypotheses of what may have happened since the last call, at depth
        `before`.

        `tissue_speed` is a standard deviation [mm/s], `reported` the number of alarms
        so far.
        """
        facts = self.bank.facts
        log_weights = self.bank.log_weights
        parents = _parents(log_weights, facts, place.depth, _OF_PARENT).tolist()
        step = max(place.depth - max(before, place.depth - 1.0), STEP_MM)
        is_membrane_due = int(place.depth / MEMBRANE_STEP_MM) != int(
            before / MEMBRANE_STEP_MM
        )
        scene = place[2:5]
        time_s = place.time_s - 0.5 * place.dt_s
        # A release can be over within a block, so the force it fell from is the block's
        # before.
        moment = (*scene, time_s, tissue_speed, place.before, float(reported))
        for k in parents:
            happens = _events(facts[k].tolist(), place, HAZARD * step, is_membrane_due)
            for what, becomes, is_kept, releases, chance in happens:
                event = (what, becomes, is_kept)
                law.add_children(
                    self.store, k, self.size, event, moment, releases, chance
                )
                self.size += len(releases)

    def prune(self, place: Place) -> None:
        """Keep the likeliest of each class, best first."""
        bank = self.bank
        rows, log_weights = _ranked(
            bank.log_weights, bank.facts, place.depth, _OF_CLASS
        )
        for source, target in zip(bank, self._other, strict=True):
            source.take(rows, axis=0, out=target[: len(rows)], mode="clip")
        self._other[2][: len(rows)] = log_weights
        self.store, self._other = self._other, self.store
        self.size = len(rows)


def _events(
    fact: list[float], place: Place, chance: float, is_membrane_due: bool
) -> Iterator[tuple[int, float, bool, Array, float]]:
    """What may happen: event, what the tip is in then, if force stays, release
    lengths, chance.
    """
    kind = fact[law.KIND]
    if kind == law.AIR:
        if fact[law.RUPTURES]:
            chance *= 0.1  # gaps of air are rare
        is_near = fact[law.RUPTURES] and place.depth < fact[law.RELEASE] + 3.0
        if place.deflection >= 0.3 and not is_near:
            yield law.CONTACT, law.LAYER, False, _NO_RELEASES_MM, 0.7 * chance
            yield law.CONTACT, law.MEMBRANE, False, _NO_RELEASES_MM, 0.3 * chance
        return
    if place.depth <= fact[law.TIP] + LEAST_MM:
        return
    ends = (1.0 - PARTIAL_FRACTION) * chance / len(RELEASES_MM)
    further = ends * (1.0 - AIR_FRACTION)
    kept = KEPT_PROBABILITY if kind == law.LAYER else 0.0
    yield law.EXIT, law.LAYER, False, RELEASES_MM, further * (1.0 - kept)
    if kind == law.LAYER:
        yield law.EXIT, law.LAYER, True, RELEASES_MM, further * KEPT_PROBABILITY
        yield law.EXIT, law.AIR, False, RELEASES_MM, ends * AIR_FRACTION
        partial = PARTIAL_FRACTION * chance / len(PARTIAL_RELEASES_MM)
        yield law.PARTIAL, law.LAYER, False, PARTIAL_RELEASES_MM, partial
        if (
            is_membrane_due
            and place.depth > fact[law.ROOT] + 2.0
            and fact[law.IS_JUDGED]
        ):
            met = MEMBRANE_FRACTION * MEMBRANE_STEP_MM * HAZARD
            yield law.MEETING, law.MEMBRANE, False, _NO_RELEASES_MM, met


@compiled
def _parents(
    log_weights: Vector, facts: Matrix, depth: float, places: tuple[int, int, int, int]
) -> Rows:
    """The likeliest of each kind whose last release is over: until then its nature
    is open.
    """
    release, length, kind, is_held = places
    kinds = 2.0 * facts[:, kind] + facts[:, is_held]
    may = depth > facts[:, release] + np.maximum(facts[:, length], 0.3)
    may &= log_weights > log_weights.max() - _LIKELY
    rows = [np.flatnonzero(may & (kinds == one)) for one in range(6)]
    found = [mine[np.argmax(log_weights[mine])] for mine in rows if len(mine) > 0]
    best = np.array(found, dtype=np.int64)
    return best[np.argsort(-log_weights[best], kind="mergesort")]


@compiled
def _ranked(
    log_weights: Vector, facts: Matrix, depth: float, places: tuple[int, int, int]
) -> tuple[Rows, Vector]:
    """Rows of the likeliest, within the quota of each class, best first, and their
    log weights.
    """
    tip, kind, membrane = places
    is_pushed = facts[:, kind] == membrane
    is_old = depth - facts[:, tip] >= np.where(is_pushed, 1.5, 0.4)
    classes = 2 * is_old + 1 * is_pushed
    weights = log_weights - log_weights.max()
    weights -= math.log(np.exp(weights).sum())
    left = list(QUOTAS)
    kept = np.zeros(len(weights), dtype=np.int64)
    size = 0
    for k in np.argsort(-weights, kind="mergesort"):
        if weights[k] <= NEGLIGIBLE:
            break
        if left[classes[k]] > 0:
            left[classes[k]] -= 1
            kept[size] = k
            size += 1
    return kept[:size], weights[kept[:size]]
