"""What the bank says: the shaft's friction at one depth, ruptures, and layers
traversed.

Every answer is a mixture over the hypotheses: its mean is their mean, and where they
differ its standard deviation is wider than that of each.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled
from identification.estimate import LayerEstimate, Rupture
from identification.multilayer import force_model as law
from identification.multilayer.force_split import (
    COULOMB,
    IDENTIFIED,
    LEFT_COULOMB,
    NO_ANSWER,
)
from identification.multilayer.mixture import LEAST_MM, Bank, BankMemory, Place
from identification.multilayer.tissue_motion import TissueMotion

_MM = 1e3
_CLEAR_SIGMAS = 3.0
_CLEAR_N = 0.1
"""Least released force for an alarm: in standard deviations of a block's force, and in
newtons (two thirds of the least rupture seen in real liver)."""
_VISIBLE = (
    0.3  # Fraction of it by which the force must have fallen: else it only grows slower
)
_LATE_S = 0.5  # If an alarm comes later than this, the force must still be lower
_EARLY_FALL = 0.12
_FALL_RATE = 1.5
_LARGE_FALL = 0.3
"""Falls, as fractions of the force: one, and one per second [1/s], that no robot makes
by braking before its speed is known; and one that counts as large."""
_SPEED_LAG_S = 0.1
_LAGS = 3.0
_MOST_LAG_S = 0.3
"""Lag of the speed: at least; per ratio of the filter's noise of depth and of speed;
at most."""
_LEAST_SLOWED = (
    0.02  # fraction of the speed lost below which it is noise of the filtered speed
)
_SLOWED = 3.0
_SLOWED_FAR = 2.0
"""Largest relative fall that braking explains, per fraction of the speed lost: more
than 1, since the speed is late and travel shows its mean. The second is for a large
fall."""
_STEADY = 0.9  # of the usual speed; slower, friction's dependence on the speed may look like a fall
_LEAST_TRUSTED = (
    1e-6  # Probability of all hypotheses that the answer's mean may rest on
)
_RECENT_S = 0.5  # So long after a rupture the travel since then shows the speed better, less noisy
_LEAST_PROBABILITY = (
    0.3  # Total of all hypotheses with the last rupture, to say what it was
)
_OF_MEAN = (law.RELEASED, law.KEPT, law.HELD, law.OFFSET)
_OF_FACT = (law.KIND, law.IS_HELD)
_OF_RECORD = (law.RUPTURE_S, law.RUPTURE_FORCE, law.LEAST_FORCE)
_LAYER = int(law.LAYER)
"""Indices for compiled code, which does not use constants of another file."""
_NAMES = ("stiffness", "coulomb", "viscous")
_UNITS = (("N_per_m", _MM), ("N_per_m", _MM), ("Ns_per_m2", _MM * _MM))


class Evidence(NamedTuple):
    """The bank, the probability of each of its n hypotheses, and how many ruptures
    each counts.

    Attributes:
        weights: probabilities, shape (n,).
        ruptures: Number of ruptures, shape (n,); see `evidence_of`.
    """

    bank: Bank
    weights: Array
    ruptures: Array


def evidence_of(bank: Bank, alarm: Rupture | None, known: int) -> Evidence:
    """Evidence of the bank after the last of `known` alarms; `alarm` is None before the
    first.

    A hypothesis whose last rupture lies clearly before the alarm's counts as denying
    that one.
    """
    before_mm = -math.inf if alarm is None else _MM * alarm.depth_m - LEAST_MM
    ruptures = bank.facts[:, law.RUPTURES]
    rupture_mm = bank.records[:, law.RUPTURE_MM]
    denied = np.minimum(ruptures, known - 1.0)
    return Evidence(
        bank, bank.weights, np.where(rupture_mm < before_mm, denied, ruptures)
    )


def answer_at(
    memory: BankMemory,
    evidence: Evidence,
    place: Place,
    counts: tuple[int, int],
    speed: float,
) -> Array:
    """Friction of the shaft at a place, for the samples that follow; see
    `force_split`.

    `counts` are ruptures the hypotheses were reported to have, and layers left; the
    last rupture was at a speed [mm/s], 0 before the first. A rupture that is not
    reported and may be a needle that slowed down does not count: a hand that feels the
    tip's force vanish for it pushes.
    """
    scene = (place.depth, place.speed, place.deflection)
    answer = NO_ANSWER.copy()
    reported, known = counts
    slowest = np.minimum(evidence.bank.records[:, law.RUPTURE_SPEED], place.speed)
    is_slow = slowest < _STEADY * place.usual_speed
    weights = evidence.weights
    trusted = np.where((evidence.ruptures <= reported) | ~is_slow, weights, 0.0)
    rows = trusted if trusted.sum() > _LEAST_TRUSTED else weights, weights
    answer[1], answer[2:], all_met, contact, tip = law.shaft_mixture(
        memory.store, *rows, scene
    )
    # Friction is known no better than the law is, whose error the texture shows.
    law_variance = all_met * place.law_error**2
    answer[(2 + LEFT_COULOMB, 2 + COULOMB), (LEFT_COULOMB, COULOMB)] += law_variance
    if all_met > 0.5:
        answer[0, :3] = 1.0, known + 1, contact / _MM
    answer[0, 3:] = place.depth, place.noise**2, tip, speed, law_variance
    return answer


class Evaluation(NamedTuple):
    """What the hypotheses say about the number of ruptures.

    Attributes:
        more: Probability of one more than known, with a clear fall of the force.
        fewer: Probability of fewer than known.
        pick: The likeliest of those hypotheses, -1 without any.
        best: Number of ruptures of the likeliest of all.
    """

    more: float
    fewer: float
    pick: int
    best: int


@compiled
def _evaluate(
    parts: tuple[Matrix, Matrix, Matrix, Vector, Vector],
    known: float,
    now: tuple[float, float, float],
    places: tuple[
        tuple[int, int, int, int], tuple[int, int], tuple[int, int, int], int
    ],
) -> tuple[float, float, int]:
    """The first three numbers of an `Evaluation`; `now`: time, force, least fall
    that is clear.
    """
    means, facts, records, weights, ruptures = parts
    time_s, force, least = now
    (
        (released, kept, held, offset),
        (kind, is_held),
        (rupture_s, before, lowest),
        layer,
    ) = places
    # After a partial rupture part of the force is held: what has fallen is the rest.
    is_partial = (facts[:, kind] == layer) & (facts[:, is_held] > 0.0)
    fallen = (
        means[:, released] - means[:, kept] - np.where(is_partial, means[:, held], 0.0)
    )
    fallen = np.minimum(
        fallen, records[:, before] - means[:, offset]
    )  # At most all of the force
    # If the force is higher again, a late hypothesis of a rupture is rather a change of
    # the tissue.
    is_undone = (time_s - records[:, rupture_s] > _LATE_S) & (
        records[:, before] <= force
    )
    is_more = (ruptures > known) & (fallen > least) & ~is_undone
    more = np.where(is_more, weights, 0.0)
    fewer = np.where(ruptures < known, weights, 0.0).sum()
    if not is_more.any():
        return 0.0, fewer, -1
    pick = int(np.argmax(np.where(is_more, weights, -1.0)))
    is_visible = records[pick, before] - records[pick, lowest] > _VISIBLE * least
    return more.sum() if is_visible else 0.0, fewer, pick


def count_ruptures(evidence: Evidence, known: int, place: Place) -> Evaluation:
    """Compare the number of ruptures known with those of the hypotheses."""
    bank, weights, ruptures = evidence
    least = max(_CLEAR_SIGMAS * place.noise, _CLEAR_N)
    parts = bank.means, bank.facts, bank.records, weights, ruptures
    places = _OF_MEAN, _OF_FACT, _OF_RECORD, _LAYER
    found = _evaluate(parts, float(known), (place.time_s, place.force, least), places)
    return Evaluation(*found, int(ruptures[weights.argmax()]))


def speed_lag(depth_std: float, speed_std: float) -> float:
    """By how much the speed may be late [s], from the noise that the travel filter
    leaves in both.

    Their ratio is about the time constant of the filter.
    """
    lag_s = _LAGS * depth_std / max(speed_std, 1e-9)
    return min(max(lag_s, _SPEED_LAG_S), _MOST_LAG_S)


def may_be_braking(
    bank: Bank,
    evaluation: Evaluation,
    place: Place,
    time_s: float,
    tissue: TissueMotion,
) -> bool:
    """Whether a needle that slows down could explain the fall of the force.

    Friction falls with the speed at once, but the speed is known late. So a relatively
    small fall waits until the speed would show braking, and counts only if it exceeds
    what that explains.
    """
    record = bank.records[evaluation.pick]
    offset = float(bank.means[evaluation.pick, law.OFFSET])
    force = abs(float(record[law.RUPTURE_FORCE]) - offset)
    fall = float(record[law.RUPTURE_FORCE]) - place.force
    rupture_s = float(record[law.RUPTURE_S])
    since_s = time_s - float(record[law.RUPTURE_S])
    if since_s < place.lag_s and fall < max(_EARLY_FALL, _FALL_RATE * since_s) * force:
        return True
    speed = place.speed
    before = float(record[law.RUPTURE_SPEED])
    travel = place.raw - float(record[law.RUPTURE_MM])
    if tissue.is_known:  # only the needle's own speed is known late
        start, rate = tissue.at(rupture_s)
        end, rate_now = tissue.at(place.time_s)
        speed = speed + rate_now
        before = before + rate
        travel = travel + end - start
    travelled_s = place.time_s - rupture_s
    if 0.0 < travelled_s < _RECENT_S:  # a filtered depth is as late as its speed
        speed = min(speed, travel / travelled_s)
    slowed = 1.0 - speed / max(before, 1e-3)
    most = (_SLOWED_FAR if fall > _LARGE_FALL * force else _SLOWED) * slowed * force
    return slowed > _LEAST_SLOWED and fall < most


def rupture_of(
    evidence: Evidence,
    pick: int,
    layer: int,
    probability: float,
    alarm: tuple[float, float, float],
) -> Rupture:
    """The last rupture of hypothesis `pick`.

    `alarm` is the time on the caller's clock, the depth [m] and the time since the
    reset.
    """
    record = evidence.bank.records[pick]
    since_s = max(alarm[2] - float(record[law.RUPTURE_S]), 0.0)
    ruptures = evidence.ruptures[pick]
    return Rupture(
        layer=layer,
        alarm_s=alarm[0],
        alarm_depth_m=alarm[1],
        time_s=alarm[0] - since_s,
        depth_m=float(record[law.RUPTURE_MM]) / _MM,
        force_N=float(record[law.RUPTURE_FORCE]),
        speed_m_s=float(record[law.RUPTURE_SPEED]) / _MM,
        probability=min(probability, 1.0),
        contact_depth_m=float(record[law.CONTACT_MM]) / _MM,
        partial_rupture_probability=partial_rupture_probability(
            evidence, int(ruptures)
        ),
    )


def _weights_of(evidence: Evidence, known: int) -> tuple[Array, NDArray[np.bool_]]:
    """Probabilities of those with `known` ruptures, of others 0; which push a
    membrane; (n,).
    """
    facts = evidence.bank.facts
    is_meeting = (facts[:, law.KIND] == law.MEMBRANE) & (facts[:, law.IS_HELD] > 0.0)
    return np.where(evidence.ruptures == known, evidence.weights, 0.0), is_meeting


def friction_left(
    evidence: Evidence, known: int, force_variance: float, *, before: bool = False
) -> tuple[float, float] | None:
    """Friction of the layer that the last rupture ended, or of the one `before`, and
    its deviation.

    None where other hypotheses are likelier than those that know of this rupture as the
    last.
    """
    bank = evidence.bank
    weights, is_meeting = _weights_of(evidence, known)
    if before:
        weights[is_meeting] = 0.0
    total = float(weights.sum())
    if total < _LEAST_PROBABILITY:
        return None
    rows = np.arange(len(weights))
    fraction = weights / total
    place = np.where(is_meeting | before, law.EARLIER, law.LEFT)
    values = bank.means[rows, place]
    variances = bank.spreads[rows, place, place]
    mean = float(fraction @ values)
    variance = float(fraction @ (np.maximum(variances, 0.0) + (values - mean) ** 2))
    return mean, math.sqrt(variance + force_variance)


def layer_left(
    evidence: Evidence, rupture: Rupture, known: int, friction: tuple[float, float]
) -> LayerEstimate | None:
    """The layer, or the part of one, that the last rupture ended, with the friction it
    left.

    None where no hypothesis knows of it.
    """
    bank = evidence.bank
    weights, is_meeting = _weights_of(evidence, known)
    weights[is_meeting] = 0.0
    if not weights.any():
        return None
    best = int(np.argmax(weights))
    record = bank.records[best].tolist()
    thickness = max(record[law.RUPTURE_MM] - record[law.PART_START], 1e-3) / _MM
    fields: dict[str, float | bool] = {}
    for k, (name, (unit, factor)) in enumerate(zip(_NAMES, _UNITS, strict=True)):
        value, variance = record[law.STIFFNESS_HERE + 2 * k :][:2]
        value = factor * max(value, 0.0)
        deviation = factor * math.sqrt(max(variance, 0.0))
        fields[f"{name}_{unit}"] = value
        fields[f"{name}_std_{unit}"] = deviation
        fields[f"{name}_identified"] = deviation <= IDENTIFIED * value
    before = max(record[law.PART_FRICTION], 0.0)
    own = before, fields["coulomb_N_per_m"], fields["viscous_Ns_per_m2"]
    fields |= _friction(friction, own, thickness, rupture.speed_m_s)
    return LayerEstimate(
        layer=rupture.layer,
        is_final=False,
        start_depth_m=record[law.PART_START] / _MM,
        thickness_m=thickness,
        rupture=rupture,
        force_drop_N=float(bank.means[best, law.RELEASED]),
        force_drop_std_N=math.sqrt(
            max(float(bank.spreads[best, law.RELEASED, law.RELEASED]), 0.0)
        ),
        **fields,  # type: ignore[arg-type]
    )


def _friction(
    friction: tuple[float, float],
    own: tuple[float, float, float],
    thickness_m: float,
    speed: float,
) -> dict[str, float | bool]:
    """Fields of a layer that its friction and its deviation [N] say.

    `own` are the friction known before, and its Coulomb and viscous part: those keep
    their ratio.
    """
    mean, std = friction
    before, coulomb, viscous = own
    mean = max(mean, 0.0)
    scale = mean / before if before > 0.0 else 1.0
    per_length = 1.0 / (thickness_m * max(speed, 1e-6))
    return {
        "friction_N": mean,
        "friction_std_N": std,
        "friction_Ns_per_m2": per_length * mean,
        "friction_std_Ns_per_m2": per_length * std,
        "friction_identified": std <= IDENTIFIED * mean,
        "coulomb_N_per_m": scale * coulomb,
        "viscous_Ns_per_m2": scale * viscous,
    }


def with_friction(layer: LayerEstimate, friction: float, std: float) -> LayerEstimate:
    """The same layer with its friction known better; Coulomb and viscous part in
    proportion.
    """
    own = layer.friction_N, layer.coulomb_N_per_m or 0.0, layer.viscous_Ns_per_m2 or 0.0
    speed = layer.rupture.speed_m_s
    return replace(layer, **_friction((friction, std), own, layer.thickness_m, speed))


def partial_rupture_probability(evidence: Evidence, known: int) -> float:
    """How likely the last rupture was a partial one, not the end of a layer."""
    weights = np.where(evidence.ruptures == known, evidence.weights, 0.0)
    total = float(weights.sum())
    was_partial = evidence.bank.records[:, law.WAS_PARTIAL]
    return float(weights @ was_partial) / total if total > 0.0 else 0.0
