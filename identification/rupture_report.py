"""What the bank says: the shaft's friction at one depth, ruptures, and layers left.

Every answer is a mixture over the hypotheses: its mean is their mean, and where they differ its
standard deviation is wider than that of each.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification import hypothesis_filter as law
from identification.estimate import Array, LayerEstimate, Rupture
from identification.hypothesis_bank import LEAST_MM, Bank, BankMemory, Place
from identification.switching_update import IDENTIFIED, NO_ANSWER
from identification.tissue_motion import TissueMotion
from needleforce.jit import Matrix, Vector, compiled

_MM = 1e3
_LEAST_WEIGHT = 1e-3  # less likely hypotheses do not show in an answer
_CLEAR_SIGMAS, _CLEAR_N = 3.0, 0.1
"""Least released force of a rupture worth an alarm: in standard deviations of a block's force, and
two thirds of the least seen in real liver."""
_VISIBLE = 0.3  # Part of that by which the force must have fallen since: else it only grows slower
_LATE_S = 0.5  # An alarm after more travel, at the usual speed, wants a force lower than before
_EARLY_FALL, _FALL_RATE, _LARGE_FALL = 0.12, 1.5, 0.3
"""Of the force, no robot brakes so hard before its speed is known: a fall, and one per second; and
a fall that is large."""
_SPEED_LAG_S, _LAGS, _MOST_LAG_S = 0.1, 3.0, 0.3
"""By which a speed that nobody measures may be late: of the sensor, and of the travel filter."""
_LEAST_SLOWED = 0.02  # part of the speed lost that is no noise of a filtered speed
_SLOWED, _SLOWED_FAR = 3.0, 2.0
"""Fall of viscous friction, per part of the speed lost so far: the speed is late, and travel shows
its mean; of a large fall it must show half."""
_RECENT_S = 0.5  # For so long travel since the rupture shows the speed better than a noisy one
_LEAST_PROBABILITY = 0.3  # Of all hypotheses with the last rupture, together, to say what it was
_NAMES = ("stiffness", "coulomb", "viscous")
_UNITS = (("N_per_m", _MM), ("N_per_m", _MM), ("Ns_per_m2", _MM * _MM))
_TIP = slice(law.RELEASED, law.KEPT + 1)  # the tip's unknowns
_OF_COUNT = law.KIND, law.IS_HELD, law.RUPTURES, law.RELEASED, law.KEPT, law.HELD
"""Places, for compiled code: it does not use constants of another file."""


def answer_at(memory: BankMemory, place: Place, ruptures: int, speed: float) -> Array:
    """Friction of the shaft at a place, for the samples that follow; see `switching_update`.

    `ruptures` are known so far; the last was at a speed [mm/s], 0 before the first.
    """
    bank = memory.bank
    weights = bank.weights
    weights = np.where(weights > _LEAST_WEIGHT, weights, 0.0)
    weights /= weights.sum()
    answer, best = NO_ANSWER.copy(), int(weights.argmax())
    answer[1], answer[2:], all_met, contact = law.shaft_mixture(memory.store, weights, place.depth)
    diagonal = answer[2:].reshape(-1)[:: len(answer[1]) + 1]
    np.maximum(diagonal, 0.0, out=diagonal)
    row = law.regressor(bank.facts[best], (place.depth, place.speed, place.deflection))
    tip = float(row[_TIP] @ bank.means[best, _TIP])
    if all_met > 0.5:
        answer[0, :3] = 1.0, ruptures + 1, contact / _MM
    answer[0, 3:7] = place.depth, place.noise**2, tip, speed
    return answer


class Evaluation(NamedTuple):
    """What the hypotheses say of the number of ruptures."""

    more: float  # probability of one more than known, with a clear fall of the force
    fewer: float  # probability of fewer than known
    pick: int  # the likeliest of those hypotheses, -1 without any
    best: int  # ruptures of the likeliest of all


def denied(bank: Bank, alarm: Rupture, known: int) -> Bank:
    """The bank, but those that know only of a rupture clearly before the last alarm's deny it."""
    facts = bank.facts.copy()
    is_before = bank.records[:, law.RUPTURE_MM] < _MM * alarm.depth_m - LEAST_MM
    facts[is_before, law.RUPTURES] = np.minimum(facts[is_before, law.RUPTURES], known - 1.0)
    return bank._replace(facts=facts)


def count_ruptures(bank: Bank, known: int, place: Place) -> Evaluation:
    """Compare the number of ruptures known with those of the hypotheses."""
    least = max(_CLEAR_SIGMAS * place.noise, _CLEAR_N)
    force = bank.records[:, law.RUPTURE_FORCE]
    is_late = place.depth - bank.records[:, law.RUPTURE_MM] > _LATE_S * place.usual_speed
    # Where the force is higher again, a rupture thought of late is rather tissue that has changed.
    is_undone = is_late & (force <= place.force)
    most = np.where(is_undone, 0.0, force - bank.means[:, law.OFFSET])
    limits = float(known), least, law.LAYER
    found = Evaluation(*_counted(bank.weights, bank.facts, bank.means, most, limits, _OF_COUNT))
    lower = force[found.pick] - bank.records[found.pick, law.LEAST_FORCE]
    return found if lower > _VISIBLE * least else found._replace(more=0.0)


@compiled
def _counted(
    weights: Vector,
    facts: Matrix,
    means: Matrix,
    most: Vector,
    limits: tuple[float, float, float],
    places: tuple[int, int, int, int, int, int],
) -> tuple[float, float, int, int]:
    """An `Evaluation`, for the ruptures known, the least force released, and what a layer is.

    A rupture releases `most`: no more than the force there was, nothing where the force is back.
    """
    (known, least, layer), (kind, is_held, number, released, kept, held) = limits, places
    # After a partial rupture part of the force is held: what has fallen is the rest.
    is_partial = (facts[:, kind] == layer) & (facts[:, is_held] > 0.0)
    fallen = means[:, released] - means[:, kept] - np.where(is_partial, means[:, held], 0.0)
    fallen = np.minimum(fallen, most)
    ruptures = facts[:, number]
    is_more = (ruptures > known) & (fallen > least)
    pick = int(np.argmax(np.where(is_more, weights, -1.0))) if is_more.any() else -1
    more, fewer = weights[is_more].sum(), weights[ruptures < known].sum()
    return float(more), float(fewer), pick, int(ruptures[np.argmax(weights)])


def speed_lag(depth_std: float, speed_std: float) -> float:
    """By how much the speed may be late [s], from the noise that the travel filter leaves in both.

    That of the depth is noise of the speed over about as long as the filter is slow.
    """
    lag_s = _LAGS * depth_std / max(speed_std, 1e-9)
    return min(max(lag_s, _SPEED_LAG_S), _MOST_LAG_S)


def may_be_braking(
    bank: Bank, evaluation: Evaluation, place: Place, time_s: float, tissue: TissueMotion
) -> bool:
    """Whether a needle that slows down could make the fall of the force as well.

    The speed is known late, and friction falls with it at once: a fall that is small beside the
    force waits until the speed would show, and counts only if it is more than the speed explains.
    """
    record, offset = bank.records[evaluation.pick], float(bank.means[evaluation.pick, law.OFFSET])
    force = abs(float(record[law.RUPTURE_FORCE]) - offset)
    fall = float(record[law.RUPTURE_FORCE]) - place.force
    rupture_s, since_s = float(record[law.RUPTURE_S]), time_s - float(record[law.RUPTURE_S])
    if since_s < place.lag_s and fall < max(_EARLY_FALL, _FALL_RATE * since_s) * force:
        return True
    speed, before = place.speed, float(record[law.RUPTURE_SPEED])
    travel = place.raw - float(record[law.RUPTURE_MM])
    if tissue.is_known:  # only the needle's own speed is known late
        (start, rate), (end, rate_now) = tissue.at(rupture_s), tissue.at(place.time_s)
        speed, before, travel = speed + rate_now, before + rate, travel + end - start
    travelled_s = place.time_s - rupture_s
    if 0.0 < travelled_s < _RECENT_S:  # a filtered depth is as late as its speed
        speed = min(speed, travel / travelled_s)
    slowed = 1.0 - speed / max(before, 1e-3)
    most = (_SLOWED_FAR if fall > _LARGE_FALL * force else _SLOWED) * slowed * force
    return slowed > _LEAST_SLOWED and fall < most


def rupture_of(
    bank: Bank, pick: int, layer: int, probability: float, alarm: tuple[float, float, float]
) -> Rupture:
    """The rupture that hypothesis `pick` knows of.

    `alarm` is the time on the caller's clock, the depth [m] and the time since the reset.
    """
    record = bank.records[pick]
    since_s = max(alarm[2] - float(record[law.RUPTURE_S]), 0.0)
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
            bank, int(bank.facts[pick, law.RUPTURES])
        ),
    )


def _is_meeting(bank: Bank) -> NDArray[np.bool_]:
    """Which hypotheses say that the tip pushes a membrane under the last layer."""
    return (bank.facts[:, law.KIND] == law.MEMBRANE) & (bank.facts[:, law.IS_HELD] > 0.0)


def _weights_of(bank: Bank, known: int) -> Array:
    """Probabilities of the hypotheses that know of so many ruptures, of others 0, shape (n,)."""
    return np.where(bank.facts[:, law.RUPTURES] == known, bank.weights, 0.0)


def friction_left(
    bank: Bank, known: int, force_variance: float, *, before: bool = False
) -> tuple[float, float] | None:
    """Friction of the layer that the last rupture ended, or of the one `before`, and its deviation.

    None where other hypotheses are likelier than those that know of this rupture as the last.
    """
    weights, is_meeting = _weights_of(bank, known), _is_meeting(bank)
    if before:
        weights[is_meeting] = 0.0
    total = float(weights.sum())
    if total < _LEAST_PROBABILITY:
        return None
    rows, fraction = np.arange(len(weights)), weights / total
    place = np.where(is_meeting | before, law.EARLIER, law.LEFT)
    values, variances = bank.means[rows, place], bank.spreads[rows, place, place]
    mean = float(fraction @ values)
    variance = float(fraction @ (np.maximum(variances, 0.0) + (values - mean) ** 2))
    return mean, math.sqrt(variance + force_variance)


def layer_left(
    bank: Bank, rupture: Rupture, known: int, friction: tuple[float, float]
) -> LayerEstimate | None:
    """The layer, or the part of one, that the last rupture ended, with the friction it left.

    None where no hypothesis knows of it.
    """
    weights = np.where(_is_meeting(bank), 0.0, _weights_of(bank, known))
    if not weights.any():
        return None
    best = int(np.argmax(weights))
    record = bank.records[best]
    thickness = max(float(record[law.RUPTURE_MM] - record[law.PART_START]), 1e-3)
    fields: dict[str, float | bool] = {}
    for k, (name, (unit, factor)) in enumerate(zip(_NAMES, _UNITS, strict=True)):
        value, variance = record[law.STIFFNESS_HERE + 2 * k :][:2].tolist()
        value, deviation = factor * max(value, 0.0), factor * math.sqrt(max(variance, 0.0))
        fields[f"{name}_{unit}"], fields[f"{name}_std_{unit}"] = value, deviation
        fields[f"{name}_identified"] = deviation <= IDENTIFIED * value
    layer = LayerEstimate(
        layer=rupture.layer,
        is_final=False,
        start_depth_m=float(record[law.PART_START]) / _MM,
        thickness_m=thickness / _MM,
        rupture=rupture,
        force_drop_N=float(bank.means[best, law.RELEASED]),
        force_drop_std_N=math.sqrt(max(float(bank.spreads[best, law.RELEASED, law.RELEASED]), 0.0)),
        friction_Ns_per_m2=0.0,
        friction_identified=False,
        friction_N=max(float(record[law.PART_FRICTION]), 0.0),
        **fields,  # type: ignore[arg-type]
    )
    return with_friction(layer, *friction)


def with_friction(layer: LayerEstimate, friction: float, std: float) -> LayerEstimate:
    """The same layer with its friction known better; Coulomb and viscous part in proportion."""
    friction = max(friction, 0.0)
    scale = friction / layer.friction_N if layer.friction_N > 0.0 else 1.0
    per_length = 1.0 / (layer.thickness_m * max(layer.rupture.speed_m_s, 1e-6))
    return replace(
        layer,
        friction_N=friction,
        friction_std_N=std,
        friction_Ns_per_m2=per_length * friction,
        friction_std_Ns_per_m2=per_length * std,
        friction_identified=std <= IDENTIFIED * friction,
        coulomb_N_per_m=scale * (layer.coulomb_N_per_m or 0.0),
        viscous_Ns_per_m2=scale * (layer.viscous_Ns_per_m2 or 0.0),
    )


def partial_rupture_probability(bank: Bank, known: int) -> float:
    """How likely the last rupture was a partial one, not the end of a layer."""
    weights = _weights_of(bank, known)
    total = float(weights.sum())
    return float(weights @ bank.records[:, law.WAS_PARTIAL]) / total if total > 0.0 else 0.0
