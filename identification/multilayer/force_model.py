"""One hypothesis: what is unknown of the force, given a history of ruptures.

Given such a history the axial force is linear in twenty unknowns:

    f = o + C w + V v + R r(z) + L l(z) + U u(z) + T t(z) + K x + H x² + c y w + b y v +
    d + e

with o the offset; C, V Coulomb and viscous friction of the layers traversed; R the tip
force being released, L the part of it by which its release is longer than assumed, U
the part that stays and fades later, T the force held or needed to cut, K, H stiffness
and its growth; c, b friction per length of shaft in the layer; d disturbances: coloured
sensor noise, heartbeat, breathing, error of this law. Known are the presliding
deflection w (1 when sliding inwards), the speed v, the travel x of the tip and the
length y of shaft in the layer; e is white. An event (contact, rupture) is a linear map
of the unknowns that leaves the force as it is.

So each hypothesis is a Kalman filter (switching linear model, Shumway and Stoffer
1991), and how well it predicts the force is the evidence for it. Lengths are in mm,
speeds in mm/s, forces in N.
"""

import math
from typing import Any

import numpy as np

from foundation.arrays import (
    Matrix,
    Vector,
    WrittenBlocks,
    WrittenMatrix,
    WrittenVector,
)
from foundation.jit import compiled

# Indices of the unknowns. LEFT: friction [N] of the layer that the last rupture ended,
# of the shaft since the rupture reported before; EARLIER: the same for that earlier
# rupture.
OFFSET, COULOMB, VISCOUS, RELEASED, LONGER, HELD, STIFFNESS, STIFFENING, KEPT = range(9)
OWN_COULOMB, OWN_VISCOUS, LEFT, EARLIER = range(9, 13)
COLOUR, HEART, HEART_RATE, BREATH, BREATH_RATE, LAW, LAW_RATE = range(13, 20)
UNKNOWNS = 20
FACTS = 10
RECORDS = 16
_AFTER_TIP = KEPT + 1  # the tip's unknowns are those from RELEASED to before this

# Indices of a hypothesis's facts: what the tip is in (AIR, LAYER, MEMBRANE); depths
# [mm] at which the layer's friction (ROOT) and tip force (TIP) begin; depth and length
# of the last release [mm]; whether HELD is held force, not cutting; whether the prior
# of friction's fraction was applied; number of ruptures, at most one more than were
# reported; force of the layer before [N], until its release has been checked; whether
# the layer was entered through a membrane.
(
    KIND,
    ROOT,
    TIP,
    RELEASE,
    LENGTH,
    IS_HELD,
    IS_JUDGED,
    RUPTURES,
    OWN_FORCE,
    IS_PUNCTURED,
) = range(10)
AIR = 0.0
LAYER = 1.0
MEMBRANE = 2.0
CONTACT, EXIT, PARTIAL, MEETING = range(4)
"""Events: contact, end of a layer or membrane, partial rupture, membrane met under a
layer."""

# Indices of a hypothesis's record, for reports: time, depth, speed and force of the
# last rupture, whether it was partial; start, end and friction of the shaft since the
# rupture reported before; stiffness, Coulomb and viscous friction per length of its
# last part, each with its variance; depth of the first contact; least force since the
# last rupture.
RUPTURE_S, RUPTURE_MM, RUPTURE_SPEED, RUPTURE_FORCE, WAS_PARTIAL = range(5)
PART_START = 5
PART_END = 6
PART_FRICTION = 7
STIFFNESS_HERE = 8
CONTACT_MM = 14
LEAST_FORCE = 15

Store = tuple[WrittenMatrix, WrittenBlocks, WrittenVector, WrittenMatrix, WrittenMatrix]
"""Memory for hypotheses, a row each: means, covariances, log weights, facts,
records."""
Scene = tuple[float, float, float]  # depth, speed and presliding deflection
Moment = tuple[float, float, float, float, float, float, float]
"""A scene; time, standard deviation of the tissue's own speed, force, ruptures
reported."""
Event = tuple[
    int, float, bool
]  # which; what the tip is in after it; if some of its force stays

CUTTING_ONSET_MM = (
    1.0  # Travel until a new layer's cutting force is full: a needle's diameter
)
LAW_ERROR = 0.03
LAW_MM = 5.0
LEFT_ERROR = 0.1
"""Relative error of the linear law; its correlation length [mm]; the fraction of this
error that friction of the layers traversed has, which depends on the motion alone."""
CUTTING = 0.03
CUTTING_STD = 0.15
CUTTING_MM = 2.0
"""Prior cutting force and its deviation [N]; its growth per growth of the stiffness
[mm]."""
OFFSET_WALK = 1e-6  # random walk of the sensor's zero, variance per time [N²/s]
KEPT_FRACTION = 0.45
KEPT_STD = 0.15
KEPT_MM = 5.0
"""Fraction of a tip force that stays after its rupture, its deviation, and the travel
over which it fades: chosen, between the 30 and 60 % that partial ruptures in liver
suggest."""
# depth that means "no release"; every release is deeper than NEVER
NO_RELEASE = -1e9
NEVER = -1e8
SHAPE_ERROR = 0.08
SHAPE_MM = 0.02
ONSET_ERROR = 0.1
"""Relative error of a release's shape, its correlation length [mm]; the same of a
cutting onset."""
LENGTH_ERROR = (
    0.12  # prior deviation of a release length's logarithm, between those assumed
)
TEMPER = 0.5  # exponent of the likelihood: errors of the law are alike from one block to the next
FREEDOM = 8.0  # degrees of freedom of Student's t: a single outlier proves little
SLOPE = 0.03
SLOPE_STD = 0.04
STIFFENING_STD = 1e-3
"""Prior growth of the force in a layer and its deviation [N/mm]; deviation of H
[N/mm²]."""
NO_FORCE = 0.02
NO_SLOPE = 0.002
"""Deviation with which a negative cutting force or friction [N], stiffness [N/mm],
is set to 0."""
FRACTION = 0.5
FRACTION_STD = 0.2
FRACTION_SPEED = 3.0
"""Prior part of friction in that growth (half: not known), its deviation; at this
speed [mm/s]."""
PUSHED_MM = 12.0  # a membrane is hardly pushed in further before it ruptures
# fraction of force a rupture releases; weight in an answer
LEAST_DROP = 0.12
LEAST_WEIGHT = 1e-3
COULOMB_SPEED = 3.4
COULOMB_LOG_STD = 1.4
"""Speed of equal Coulomb and viscous friction [mm/s], and the deviation of its
logarithm, a factor of 4: chosen, no measurement is known. The simulated gels have 1.5,
the liver 20."""


@compiled
def _times(spread: Matrix, row: Vector) -> Vector:
    """A symmetric matrix times a vector."""
    found = np.zeros(UNKNOWNS)
    for i in range(UNKNOWNS):
        if row[i] != 0.0:
            for j in range(UNKNOWNS):
                found[j] += row[i] * spread[i, j]
    return found


@compiled
def _measure(
    mean: WrittenVector,
    spread: WrittenMatrix,
    cross: Vector,
    error: float,
    variance: float,
) -> None:
    """Kalman update: error and variance of a measurement, `cross` its covariance
    with unknowns.
    """
    for i in range(UNKNOWNS):
        gain = cross[i] / variance
        mean[i] += gain * error
        for j in range(UNKNOWNS):
            spread[i, j] -= gain * cross[j]


@compiled
def _mapped(change: Matrix, matrix: Matrix) -> Matrix:
    """Transpose of a product, most of whose first factor is zero; twice it maps a
    covariance.
    """
    found = np.zeros((UNKNOWNS, UNKNOWNS))
    for i in range(UNKNOWNS):
        for j in range(UNKNOWNS):
            if change[i, j] != 0.0:
                for k in range(UNKNOWNS):
                    found[k, i] += change[i, j] * matrix[j, k]
    return found


@compiled
def _turn(spreads: WrittenBlocks, n: int, at: int, turn: Vector) -> None:
    """Map two neighbouring unknowns of n hypotheses by a 2x2 transition, `turn`'s
    first numbers.
    """
    a = turn[0]
    b = turn[1]
    c = turn[2]
    d = turn[3]
    for k in range(n):
        for j in range(UNKNOWNS):
            one = spreads[k, at, j]
            two = spreads[k, at + 1, j]
            spreads[k, at, j] = a * one + b * two
            spreads[k, at + 1, j] = c * one + d * two
        for j in range(UNKNOWNS):
            one = spreads[k, j, at]
            two = spreads[k, j, at + 1]
            spreads[k, j, at] = a * one + b * two
            spreads[k, j, at + 1] = c * one + d * two


@compiled
def regressor(fact: Vector, scene: Scene) -> Vector:
    """Row of a hypothesis at one place: force = row @ unknowns, shape (20,)."""
    depth, speed, deflection = scene
    row = np.zeros(UNKNOWNS)
    gone = min(max((depth - fact[RELEASE]) / fact[LENGTH], 0.0), 1.0)
    released = (1.0 - gone) ** 2
    travel = max(depth - fact[TIP], 0.0)
    length = max(depth - fact[ROOT], 0.0)
    if fact[IS_PUNCTURED] > 0.0:
        # Tissue that the membrane had pushed in springs back along the shaft with the
        # release.
        length *= 1.0 - released
    onset = min(travel / CUTTING_ONSET_MM, 1.0)
    row[OFFSET] = 1.0
    row[COULOMB] = deflection
    row[VISCOUS] = speed
    row[RELEASED] = released
    row[HELD] = 1.0 - released if fact[IS_HELD] > 0.0 else onset * (2.0 - onset)
    row[LONGER] = (
        2.0 * gone * (1.0 - gone)
    )  # derivative of `released` by the length's logarithm
    row[STIFFNESS] = travel
    row[STIFFENING] = travel * travel
    if fact[RELEASE] > NEVER:
        row[KEPT] = max(1.0 - (depth - fact[RELEASE]) / KEPT_MM, 0.0) ** 2 - released
    row[OWN_COULOMB] = deflection * length
    row[OWN_VISCOUS] = speed * length
    row[COLOUR] = row[HEART] = row[BREATH] = row[LAW] = 1.0
    return row


@compiled
def predict(
    store: Store, n: int, held: float, dt_s: float, colour: Vector, turns: Matrix
) -> None:
    """Move the unknowns of n hypotheses on by a block; see
    `noise_levels.transitions`.

    `held` is the variance added to the cutting force, `colour` the decay of the
    sensor's coloured noise over the block, and its variance.
    """
    mean = store[0][:n]
    spread = store[1][:n]
    is_tissue = store[3][:n, KIND] != AIR
    mean[:, COLOUR] *= colour[0]
    spread[:, COLOUR] *= colour[0]
    spread[:, :, COLOUR] *= colour[0]
    spread[:, OFFSET, OFFSET] += OFFSET_WALK * dt_s
    spread[:, HELD, HELD] += np.where(is_tissue, held, 0.0)
    spread[:, COLOUR, COLOUR] += (1.0 - colour[0] ** 2) * colour[1]
    for part in range(3):
        turn = turns[part]
        at = HEART + 2 * part
        one = mean[:, at].copy()
        two = mean[:, at + 1].copy()
        mean[:, at] = turn[0] * one + turn[1] * two
        mean[:, at + 1] = turn[2] * one + turn[3] * two
        _turn(store[1], n, at, turn)
        spread[:, at, at] += turn[4]
        spread[:, at, at + 1] += turn[5]
        spread[:, at + 1, at] += turn[5]
        spread[:, at + 1, at + 1] += turn[6]


@compiled
def correct(
    store: Store, n: int, scene: Scene, force: float, block: tuple[float, float, float]
) -> None:
    """Update n hypotheses with a block's force; `block`: travel, variance, deviation
    of depth.
    """
    means, spreads, log_weights, facts, records = store
    travel, variance, depth_std = block
    shape = SHAPE_ERROR * math.sqrt(max(SHAPE_MM / max(travel, 0.1 * SHAPE_MM), 1.0))
    for k in range(n):
        mean = means[k]
        spread = spreads[k]
        fact = facts[k]
        records[k, LEAST_FORCE] = min(records[k, LEAST_FORCE], force)
        row = regressor(fact, scene)
        early = max(1.0 - max(scene[0] - fact[TIP], 0.0) / CUTTING_ONSET_MM, 0.0)
        noise = variance + (shape * mean[RELEASED]) ** 2 * 2.0 * row[LONGER]
        noise += (ONSET_ERROR * mean[HELD] * early) ** 2
        noise += (2.0 * mean[RELEASED] / fact[LENGTH] * depth_std) ** 2 * row[RELEASED]
        cross = _times(spread, row)
        total = max(np.dot(row, cross), 0.0) + noise
        error = force - np.dot(row, mean)
        surprise = error * error / total
        evidence = -0.5 * (
            math.log(total) + (FREEDOM + 1.0) * math.log1p(surprise / FREEDOM)
        )
        log_weights[k] += TEMPER * evidence
        total *= max((FREEDOM + surprise) / (FREEDOM + 1.0), 1.0)
        _measure(mean, spread, cross, error, total)


@compiled
def friction_fraction(speed: float) -> tuple[float, float, float]:
    """Friction's fraction of the force's growth at a speed, its deviation, Coulomb's
    part of it.
    """
    odds = FRACTION / (1.0 - FRACTION)
    odds *= (COULOMB_SPEED + speed) / (COULOMB_SPEED + FRACTION_SPEED)
    fraction = odds / (1.0 + odds)
    std = FRACTION_STD * fraction * (1.0 - fraction) / (FRACTION * (1.0 - FRACTION))
    return fraction, std, COULOMB_SPEED / (COULOMB_SPEED + speed)


@compiled
def _add_prior(
    mean: WrittenVector,
    spread: WrittenMatrix,
    speed: float,
    kind: float,
    is_partial: bool,
) -> None:
    """Add what is known beforehand of a layer or a membrane; a partial rupture keeps
    friction.
    """
    if kind != LAYER:
        if kind == MEMBRANE:
            mean[STIFFNESS] = 0.05
            mean[STIFFENING] = 0.01
            spread[STIFFNESS, STIFFNESS] = 0.1**2
            spread[STIFFENING, STIFFENING] = 0.02**2
        return
    fraction, _, coulomb = friction_fraction(max(speed, 0.1))
    viscous = 1.0 - coulomb
    pace = max(speed, 0.5)
    std = 0.7 * SLOPE_STD
    mean[STIFFNESS] += (1.0 - fraction) * SLOPE
    spread[STIFFNESS, STIFFNESS] += std**2
    spread[STIFFENING, STIFFENING] += STIFFENING_STD**2
    if not is_partial:
        mean[OWN_COULOMB] += fraction * coulomb * SLOPE
        spread[OWN_COULOMB, OWN_COULOMB] += (std * coulomb) ** 2
        mean[OWN_VISCOUS] += fraction * viscous * SLOPE / pace
        spread[OWN_VISCOUS, OWN_VISCOUS] += (std * viscous / pace) ** 2
        mean[HELD] += CUTTING
        spread[HELD, HELD] += CUTTING_STD**2
        # Stiff tissue is hard to cut.
        spread[:, HELD] += CUTTING_MM * spread[:, STIFFNESS]
        spread[HELD, :] += CUTTING_MM * spread[STIFFNESS, :]


@compiled
def after_event(
    mean: Vector,
    spread: Matrix,
    fact: Vector,
    moment: Moment,
    event: Event,
    passed: float,
) -> tuple[Vector, Matrix]:
    """Mean and covariance of a hypothesis after an event, which leaves the force as it
    is.

    `passed` is the length of shaft that entered the layer since the last event.
    """
    what, becomes, is_kept = event
    was = fact[KIND]
    row = regressor(fact, moment[:3])
    depth, speed, deflection, _, unseen, force, reported = moment
    change = np.eye(UNKNOWNS)
    noise = np.zeros(UNKNOWNS)
    tip = np.zeros(UNKNOWNS)
    tip[RELEASED:_AFTER_TIP] = row[RELEASED:_AFTER_TIP]
    change[RELEASED:_AFTER_TIP] = 0.0
    if what in (
        EXIT,
        PARTIAL,
    ):  # the law's error belonged to the tip force and ends with it
        noise[LONGER] = (LENGTH_ERROR * np.dot(tip, mean)) ** 2
        tip[LAW] = 1.0
        change[LAW : LAW_RATE + 1] = 0.0
        noise[LAW] = (
            LAW_ERROR * LEFT_ERROR * (force - mean[OFFSET] - np.dot(tip, mean))
        ) ** 2
        noise[LAW_RATE] = noise[LAW] / LAW_MM**2
    if what == PARTIAL:
        change[RELEASED] = tip
        change[HELD] = 0.5 * tip
        noise[HELD] = (0.25 * np.dot(tip, mean)) ** 2 + 1e-4
    else:
        change[OWN_COULOMB : OWN_VISCOUS + 1] = 0.0
    if what == CONTACT:
        noise[COULOMB] = (
            0.2 * (1.0 - deflection)
        ) ** 2  # the log may begin inside tissue
    elif what != PARTIAL:
        if was == LAYER:
            length = max(depth - fact[ROOT], 0.0)
            change[COULOMB, OWN_COULOMB] = length
            change[VISCOUS, OWN_VISCOUS] = length
        change[HELD if what == MEETING else RELEASED] = tip
    change[KEPT] = (KEPT_FRACTION if is_kept else 0.0) * tip
    noise[KEPT] = ((KEPT_STD if is_kept else 0.0) * np.dot(tip, mean)) ** 2
    # A membrane met ends a layer before its puncture does; a rupture not reported ends
    # none.
    if fact[RUPTURES] <= reported and (
        was == LAYER or (what == EXIT and fact[IS_HELD] == 0.0)
    ):
        change[LEFT : EARLIER + 1] = 0.0
        change[EARLIER, LEFT] = 1.0
    if was == LAYER:
        change[LEFT, OWN_COULOMB] = passed * deflection
        change[LEFT, OWN_VISCOUS] = passed * speed
        noise[LEFT] = (passed * mean[OWN_VISCOUS] * unseen) ** 2
    mean = np.dot(change, mean)
    spread = _mapped(change, _mapped(change, spread)) + np.diag(noise)
    _add_prior(mean, spread, speed, becomes, what == PARTIAL)
    return mean, spread


@compiled
def add_children(
    store: Store,
    k: int,
    n: int,
    event: Event,
    moment: Moment,
    releases: Vector,
    chance: float,
) -> None:
    """Write, from row n on, what hypothesis k becomes by an event, one for each
    release length.
    """
    means, spreads, log_weights, facts, records = store
    what, becomes, _ = event
    depth, speed, _, time_s, _, force, reported = moment
    fact = facts[k].copy()
    record = records[k].copy()
    was = facts[k, KIND]
    begin = max(fact[ROOT], record[PART_END]) if was == LAYER else depth
    mean, spread = after_event(means[k], spreads[k], fact, moment, event, depth - begin)
    fact[RELEASE] = NO_RELEASE
    is_puncture = what == EXIT and was == MEMBRANE
    if what in (EXIT, PARTIAL):
        part = slice(RELEASED, OWN_VISCOUS + 1)
        fact[OWN_FORCE] = np.dot(regressor(facts[k], moment[:3])[part], means[k, part])
        fact[RUPTURES] = min(fact[RUPTURES], reported) + 1.0
        fact[RELEASE] = depth
        record[RUPTURE_S] = time_s
        record[RUPTURE_MM] = depth
        record[RUPTURE_SPEED] = speed
        record[RUPTURE_FORCE] = force
        record[WAS_PARTIAL] = 1.0 if what == PARTIAL else 0.0
        record[LEAST_FORCE] = force
    if was == LAYER:
        start = begin if facts[k, RUPTURES] <= reported else record[PART_START]
        record[PART_START] = start
        record[PART_END] = depth
        record[PART_FRICTION] = mean[LEFT]
        for i, j in enumerate((STIFFNESS, OWN_COULOMB, OWN_VISCOUS)):
            record[STIFFNESS_HERE + 2 * i] = means[k, j]
            record[STIFFNESS_HERE + 2 * i + 1] = spreads[k, j, j]
    elif what == CONTACT:
        record[PART_START:CONTACT_MM] = 0.0
        record[PART_START] = record[PART_END] = depth
        record[CONTACT_MM] = record[CONTACT_MM] if fact[RUPTURES] else depth
    if what != PARTIAL:
        # The layer behind a membrane has rubbed since the membrane was met.
        fact[ROOT] = fact[TIP] if is_puncture else depth
        fact[IS_JUDGED] = 0.0 if becomes == LAYER else 1.0
    fact[TIP] = depth
    fact[KIND] = becomes
    fact[IS_HELD] = 1.0 if what in (PARTIAL, MEETING) else 0.0
    fact[IS_PUNCTURED] = 1.0 if is_puncture else 0.0
    for i in range(len(releases)):
        means[n + i] = mean
        spreads[n + i] = spread
        facts[n + i] = fact
        records[n + i] = record
        log_weights[n + i] = log_weights[k] + math.log(chance)
        facts[n + i, LENGTH] = releases[i]


@compiled
def _condition(
    mean: WrittenVector, spread: WrittenMatrix, row: Vector, variance: float
) -> None:
    """Measure row @ unknowns as zero, with a variance."""
    cross = _times(spread, row)
    _measure(mean, spread, cross, -np.dot(row, mean), np.dot(row, cross) + variance)


@compiled
def _judge_fraction(
    mean: WrittenVector, spread: WrittenMatrix, speed: float, is_due: bool
) -> bool:
    """Apply the prior of friction's fraction of the force's growth, once that growth
    is known.
    """
    row = np.zeros(UNKNOWNS)
    row[STIFFNESS] = 1.0
    row[OWN_COULOMB] = 1.0
    row[OWN_VISCOUS] = speed
    slope = np.dot(row, mean)
    variance = np.dot(row, _times(spread, row))
    if variance > (0.2 * max(slope, 0.004)) ** 2 and not is_due:
        return False
    slope = max(slope, 2e-3)
    speed = max(speed, 0.1)
    fraction, std, coulomb = friction_fraction(speed)
    row[STIFFNESS] = -fraction
    row[OWN_COULOMB] = 1.0 - fraction
    row[OWN_VISCOUS] = (1.0 - fraction) * speed
    _condition(mean, spread, row, (std * slope) ** 2)
    row[STIFFNESS] = 0.0
    row[OWN_COULOMB] = 1.0 - coulomb
    row[OWN_VISCOUS] = -coulomb * speed
    std = coulomb * (1.0 - coulomb) * COULOMB_LOG_STD * fraction * slope
    _condition(mean, spread, row, std**2)
    return True


@compiled
def _hold(mean: WrittenVector, spread: WrittenMatrix, is_cutting: bool) -> float:
    """Set to zero what is negative but cannot be; returns the change of the log
    weight.
    """
    added = 0.0
    for at, none in ((COULOMB, NO_FORCE), (STIFFNESS, NO_SLOPE), (HELD, NO_FORCE)):
        variance = max(spread[at, at], 0.0)
        value = mean[at]
        # With its onset a negative cutting force would look like a slow release.
        if value < -none - math.sqrt(variance) and (is_cutting or at != HELD):
            _measure(mean, spread, spread[:, at].copy(), -value, variance + none**2)
            added -= 0.5 * value**2 / (variance + none**2)
    return added


@compiled
def weigh(
    store: Store, n: int, place: tuple[float, float, float, float], is_advancing: bool
) -> None:
    """Lower weights of what no tissue does; `place`: depth, speed, length of block,
    force noise.
    """
    means, spreads, log_weights, facts, _ = store
    depth, speed, dt_s, noise = place
    for k in range(n):
        mean = means[k]
        fact = facts[k]
        kind = facts[k, KIND]
        travel = depth - facts[k, TIP]
        if is_advancing and fact[IS_JUDGED] == 0.0 and travel > 1.0:
            fact[IS_JUDGED] = _judge_fraction(mean, spreads[k], speed, travel >= 10.0)
        is_held = fact[IS_HELD] > 0.0
        own = fact[OWN_FORCE]
        log_weights[k] += _hold(mean, spreads[k], kind == LAYER and not is_held)
        if own > 0.0 and depth > fact[RELEASE] + fact[LENGTH] + 0.1:
            held = mean[HELD] if kind == LAYER and is_held else 0.0
            if mean[RELEASED] - mean[KEPT] - held < max(LEAST_DROP * own, 2.0 * noise):
                log_weights[k] -= 12.0
            fact[OWN_FORCE] = 0.0
        if kind != AIR and travel > 2.0:
            std = math.sqrt(max(spreads[k, STIFFNESS, STIFFNESS], 0.0))
            friction = mean[OWN_COULOMB] + mean[OWN_VISCOUS] * speed
            if mean[STIFFNESS] + 2.0 * std < 0.0 or friction < -0.003:
                log_weights[k] -= 0.1
        if kind == MEMBRANE and travel > PUSHED_MM:
            log_weights[k] -= 0.3 * min(dt_s * max(speed, 0.0) / 0.04, 2.0)


@compiled
def shaft_mixture(
    store: Store, trusted: Vector, weights: Vector, scene: Scene
) -> tuple[Any, ...]:
    """Friction of the shaft at a place: mixture of all hypotheses but the least likely.

    Returns mean and covariance of the offset, C, V, Coulomb and viscous friction of the
    whole shaft, c, b and the stiffness at the tip, shapes (8,) and (8, 8); the
    probability that tissue has been met, and its depth; and the tip force of the
    likeliest hypothesis. The means are of the `trusted`, with their weights, the
    covariance is of all hypotheses around those means.
    """
    means, spreads, _, facts, records = store
    found = np.zeros((len(weights), 8))
    total = np.zeros(8)
    spread = np.zeros((8, 8))
    trusted = np.where(trusted > LEAST_WEIGHT * trusted.sum(), trusted, 0.0)
    weights = np.where((weights > LEAST_WEIGHT) | (trusted > 0.0), weights, 0.0)
    trusted = trusted / trusted.sum()
    weights = weights / weights.sum()
    all_met = 0.0
    contact = 0.0
    rows = np.flatnonzero(weights)
    for k in rows:
        row = np.zeros((8, UNKNOWNS))
        length = max(scene[0] - facts[k, ROOT], 0.0)
        met = 1.0 if facts[k, KIND] != AIR or facts[k, RUPTURES] > 0.0 else 0.0
        if met > 0.0 and all_met == 0.0:
            contact = records[k, CONTACT_MM]
        all_met += trusted[k] * met
        row[0, OFFSET] = 1.0
        row[1, COULOMB] = row[2, VISCOUS] = row[3, COULOMB] = row[4, VISCOUS] = met
        row[3, OWN_COULOMB] = row[4, OWN_VISCOUS] = met * length
        row[5, OWN_COULOMB] = row[6, OWN_VISCOUS] = met
        row[7, STIFFNESS] = 1.0 if facts[k, KIND] != AIR else 0.0
        row[7, STIFFENING] = (
            row[7, STIFFNESS] * 2.0 * max(scene[0] - facts[k, TIP], 0.0)
        )
        found[k] = np.dot(row, means[k])
        total += trusted[k] * found[k]
        spread += weights[k] * np.dot(
            np.dot(row, spreads[k]), np.ascontiguousarray(row.T)
        )
    for k in rows:
        spread += weights[k] * np.outer(found[k] - total, found[k] - total)
    np.fill_diagonal(spread, np.maximum(np.diag(spread), 0.0))
    best = np.argmax(trusted)
    tip = slice(RELEASED, _AFTER_TIP)
    force = np.dot(regressor(facts[best], scene)[tip], means[best, tip])
    return total, spread, all_met, contact, force
