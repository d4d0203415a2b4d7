"""One hypothesis: what is unknown of the force, once it is given how the tissue gave way.

Given a history of events the axial force is linear in nineteen unknowns:

    f = o + C w + V v + R r(z) + U u(z) + T t(z) + K x + H x² + c y w + b y v + d + e

with o the offset; C, V Coulomb and viscous friction of the layers left; R the tip force being
released, U what of it stays and fades later, T the force held or needed to cut, K, H stiffness; c,
b friction per length of shaft in the layer; d disturbances: the colour of the sensor's noise,
heartbeat, breathing, and the error of this law. Known are w, the presliding deflection (1 when
sliding inwards), v the speed, x the travel of the tip and y the length of shaft in the layer, and e
is white. An event (contact, the end of a layer, a partial rupture, a membrane met) is a linear map
of the unknowns that leaves the force as it is.

So each hypothesis is a Kalman filter (switching linear model, Shumway and Stoffer 1991), and how
well it predicts the force is the evidence for it. Lengths are in mm, speeds in mm/s, forces in N.
"""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from needleforce.jit import Matrix, Vector, WrittenMatrix, WrittenVector, compiled

# Places of the unknowns. LEFT: friction, at the last rupture, of the shaft since the rupture
# before; EARLIER: the same of the one before.
OFFSET, COULOMB, VISCOUS, RELEASED, HELD, STIFFNESS, STIFFENING, KEPT = range(8)
OWN_COULOMB, OWN_VISCOUS, LEFT, EARLIER = range(8, 12)
COLOUR, HEART, HEART_RATE, BREATH, BREATH_RATE, LAW, LAW_RATE = range(12, 19)
UNKNOWNS = 19
_AFTER_TIP = KEPT + 1  # the tip's unknowns are those from RELEASED to before this

# Places of what a hypothesis takes for certain: where its tip is; depth at which the shaft's
# friction and the tip's force in the layer begin; depth and length of the last release; whether
# HELD is held force, not cutting; whether the friction's fraction has been judged; how many
# ruptures there have been; force of the layer before the last until its release has been judged;
# whether the layer was entered through a membrane.
KIND, ROOT, TIP, RELEASE, LENGTH, IS_HELD, IS_JUDGED, RUPTURES, OWN_FORCE, IS_PUNCTURED = range(10)
FACTS = 10
AIR, LAYER, MEMBRANE = 0.0, 1.0, 2.0
CONTACT, EXIT, PARTIAL, MEETING = range(4)
"""Events; a membrane is met under a layer that goes on pushing, and its puncture is an exit."""

Spreads = Annotated[NDArray[np.float64], 3]
"""Covariances of n hypotheses, shape (n, 19, 19)."""

CUTTING_ONSET_MM = 1.0
"""Travel over which the cutting force of a fresh layer builds up: about a needle diameter."""
BEATS = ((1.2, 0.3), (0.3, 0.5))
"""Frequency [Hz] and damping of the tissue's own motion: heartbeat, breathing."""
COLOUR_S = 0.025
"""Correlation time of a force sensor's noise behind its filter."""
LAW_ERROR = 0.03
"""Relative error of the linear law, the same over `LAW_MM` of travel."""
LAW_MM = 5.0
LEFT_ERROR = 0.1
"""Of that, as part, for friction of the layers left: it depends on the motion alone."""
CUTTING, CUTTING_STD, CUTTING_MM = 0.03, 0.15, 2.0
"""Cutting force [N], and the travel over which stiffness would reach what it is more or less."""
OFFSET_WALK = 1e-6
"""Drift of the sensor's zero [N²/s]."""
HELD_DRIFT = 0.05
"""Relative change of cutting force, per square root of a mm."""
KEPT_FRACTION, KEPT_STD, KEPT_MM = 0.45, 0.15, 5.0
"""Of a tip force that stays after its rupture, and the travel over which it fades: chosen, between
the 30 and 60 % that partial ruptures in liver suggest."""
NEVER = -1e8
"""Depth of a release before any."""
SHAPE_ERROR = 0.1
"""Of a release or an onset of cutting, as part of its force."""
TEMPER = 0.5
"""Weight of evidence: errors of the law are alike from one block to the next."""
FREEDOM = 8.0
"""Degrees of freedom of Student's t: a single surprise proves little."""
SLOPE, SLOPE_STD = 0.03, 0.04
"""Growth of the force in a layer, before data [N/mm]."""
STIFFENING_STD = 1e-3
"""Of the growth of that growth [N/mm²]."""
NO_CUTTING = 0.02
"""Cutting force that counts as none [N]; it is never negative."""
FRACTION, FRACTION_STD, FRACTION_SPEED = 0.55, 0.2, 3.0
"""Of friction in that growth, at a speed [mm/s]; only the viscous part grows with speed."""
PUSHED_MM = 12.0
"""A membrane hardly gives more."""
LEAST_DROP = 0.12
"""Of a layer's force, released at its rupture."""
COULOMB_SPEED, COULOMB_LOG_STD = 3.4, 0.8
"""Speed at which Coulomb and viscous friction are equal [mm/s]: 1.5 in gels, 7.5 in liver."""


@compiled
def oscillation(dt_s: float, hz: float, damping: float) -> tuple[float, float, float, float]:
    """Transition of a damped oscillator's deflection and rate, row by row."""
    w = 2.0 * math.pi * hz
    d = w * math.sqrt(1.0 - damping**2)
    decay, cosine, sine = math.exp(-damping * w * dt_s), math.cos(d * dt_s), math.sin(d * dt_s)
    return (
        decay * (cosine + damping * w / d * sine),
        decay * sine / d,
        -decay * w * w / d * sine,
        decay * (cosine - damping * w / d * sine),
    )


@compiled
def smooth_walk(travel: float, length: float) -> tuple[float, float, float, float]:
    """Transition of a critically damped value and its slope (Matern 3/2), row by row."""
    reach = travel / length
    decay = math.exp(-reach)
    slope = -decay * reach / length
    return decay * (1.0 + reach), decay * travel, slope, decay * (1.0 - reach)


@compiled
def regressors(facts: Matrix, depth: float, speed: float, deflection: float) -> Matrix:
    """Rows of every hypothesis at one place: force = row @ unknowns, shape (n, 19)."""
    rows = np.zeros((len(facts), UNKNOWNS))
    gone = np.minimum(np.maximum((depth - facts[:, RELEASE]) / facts[:, LENGTH], 0.0), 1.0)
    released = (1.0 - gone) ** 2
    travel = np.maximum(depth - facts[:, TIP], 0.0)
    length = np.maximum(depth - facts[:, ROOT], 0.0)
    # What a membrane had pushed in springs back along the shaft as its force is released.
    length *= np.where(facts[:, IS_PUNCTURED] > 0.0, 1.0 - released, 1.0)
    onset = np.minimum(travel / CUTTING_ONSET_MM, 1.0)
    rows[:, OFFSET] = 1.0
    rows[:, COULOMB] = deflection
    rows[:, VISCOUS] = speed
    rows[:, RELEASED] = released
    rows[:, HELD] = np.where(facts[:, IS_HELD] > 0.0, 1.0 - released, onset * (2.0 - onset))
    rows[:, STIFFNESS] = travel
    rows[:, STIFFENING] = travel * travel
    faded = np.maximum(1.0 - (depth - facts[:, RELEASE]) / KEPT_MM, 0.0) ** 2
    rows[:, KEPT] = np.where(facts[:, RELEASE] > NEVER, faded - released, 0.0)
    rows[:, OWN_COULOMB] = deflection * length
    rows[:, OWN_VISCOUS] = speed * length
    rows[:, COLOUR] = 1.0
    rows[:, HEART] = 1.0
    rows[:, BREATH] = 1.0
    rows[:, LAW] = 1.0
    return rows


@compiled
def predict(
    means: Matrix, spreads: Spreads, held: Vector, dt_s: float, travel: float, levels: Vector
) -> tuple[Matrix, Spreads]:
    """Unknowns a time and a travel later.

    Args:
        means: Of every hypothesis, shape (n, 19).
        spreads: Their covariances.
        held: Variance by which the cutting force changes, shape (n,).
        dt_s: Time.
        travel: Fresh travel of the tip.
        levels: Variances of colour, heartbeat, breathing and of the law's error.
    """
    keep = np.ones(UNKNOWNS)
    keep[COLOUR] = math.exp(-dt_s / COLOUR_S)
    means, spreads = means * keep, spreads * (keep.reshape(-1, 1) * keep)
    spreads[:, OFFSET, OFFSET] += OFFSET_WALK * dt_s
    spreads[:, HELD, HELD] += held
    spreads[:, COLOUR, COLOUR] += (1.0 - keep[COLOUR] ** 2) * levels[0]
    for k in range(3):
        at, hz, damping = HEART + 2 * k, BEATS[min(k, 1)][0], BEATS[min(k, 1)][1]
        turn, rate = oscillation(dt_s, hz, damping), 2.0 * math.pi * hz
        if k == 2:
            turn, rate = smooth_walk(travel, LAW_MM), 1.0 / LAW_MM
        a, b, c, d = turn
        one, two = means[:, at].copy(), means[:, at + 1].copy()
        means[:, at], means[:, at + 1] = a * one + b * two, c * one + d * two
        first, second = spreads[:, at].copy(), spreads[:, at + 1].copy()
        spreads[:, at], spreads[:, at + 1] = a * first + b * second, c * first + d * second
        first, second = spreads[:, :, at].copy(), spreads[:, :, at + 1].copy()
        spreads[:, :, at], spreads[:, :, at + 1] = a * first + b * second, c * first + d * second
        # Noise that leaves the stationary variances `level` and `level * rate**2` as they are.
        level, fast = levels[1 + k], levels[1 + k] * rate**2
        spreads[:, at, at] += level - a * a * level - b * b * fast
        spreads[:, at, at + 1] -= a * c * level + b * d * fast
        spreads[:, at + 1, at] -= a * c * level + b * d * fast
        spreads[:, at + 1, at + 1] += fast - c * c * level - d * d * fast
    return means, spreads


@compiled
def absorb(
    means: Matrix,
    spreads: Spreads,
    facts: Matrix,
    rows: Matrix,
    measured: tuple[float, float, float, float],
) -> tuple[Matrix, Spreads, Vector]:
    """Use the mean force of a block.

    Args:
        means: Of every hypothesis, shape (n, 19).
        spreads: Their covariances.
        facts: What they take for certain, shape (n, 10).
        rows: Their regressors, shape (n, 19).
        measured: Force, its variance for all hypotheses, depth, standard deviation of its noise.

    Returns:
        New means and covariances, and the logarithm of the evidence, shape (n,).
    """
    force, common, depth, depth_std = measured
    gone = np.minimum(np.maximum((depth - facts[:, RELEASE]) / facts[:, LENGTH], 0.0), 1.0)
    early = np.maximum(1.0 - np.maximum(depth - facts[:, TIP], 0.0) / CUTTING_ONSET_MM, 0.0)
    noise = common + (SHAPE_ERROR * means[:, RELEASED]) ** 2 * 4.0 * gone * (1.0 - gone)
    noise += (SHAPE_ERROR * means[:, HELD] * early) ** 2
    noise += (2.0 * means[:, RELEASED] * (1.0 - gone) / facts[:, LENGTH] * depth_std) ** 2
    found, narrowed = np.empty_like(means), np.empty_like(spreads)
    evidence = np.empty(len(means))
    for k in range(len(means)):
        cross = np.dot(spreads[k], rows[k])
        variance = max(np.dot(rows[k], cross), 0.0) + noise[k]
        error = force - np.dot(rows[k], means[k])
        surprise = error * error / variance
        evidence[k] = -0.5 * math.log(variance)
        evidence[k] -= 0.5 * (FREEDOM + 1.0) * math.log1p(surprise / FREEDOM)
        gain = cross / (variance * max((FREEDOM + surprise) / (FREEDOM + 1.0), 1.0))
        found[k] = means[k] + gain * error
        narrowed[k] = spreads[k] - np.outer(gain, cross)
    return found, narrowed, TEMPER * evidence


@compiled
def friction_fraction(speed: float) -> tuple[float, float, float]:
    """Friction in the growth of the force at a speed, its deviation, and Coulomb's part of it."""
    odds = FRACTION / (1.0 - FRACTION)
    odds *= (COULOMB_SPEED + speed) / (COULOMB_SPEED + FRACTION_SPEED)
    fraction = odds / (1.0 + odds)
    std = FRACTION_STD * fraction * (1.0 - fraction) / (FRACTION * (1.0 - FRACTION))
    return fraction, std, COULOMB_SPEED / (COULOMB_SPEED + speed)


@compiled
def add_prior(
    mean: WrittenVector, spread: WrittenMatrix, speed: float, kind: float, is_partial: bool
) -> None:
    """Add what is known beforehand of a layer or a membrane; a partial rupture keeps friction."""
    if kind == MEMBRANE:
        mean[STIFFNESS], mean[STIFFENING] = 0.05, 0.01
        spread[STIFFNESS, STIFFNESS], spread[STIFFENING, STIFFENING] = 0.1**2, 0.02**2
    if kind != LAYER:
        return
    fraction, _, coulomb = friction_fraction(max(speed, 0.1))
    viscous, pace, std = 1.0 - coulomb, max(speed, 0.5), 0.7 * SLOPE_STD
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
    row: Vector,
    event: tuple[int, float, float, bool, bool],
    now: tuple[float, float, float, float, float, float],
) -> tuple[Vector, Matrix]:
    """Unknowns of a hypothesis after an event; the force goes on as it was.

    Args:
        mean: Before it, shape (19,).
        spread: Before it, shape (19, 19).
        row: Regressor where it happens, shape (19,).
        event: Which, in what the tip was before and is after, whether it was in a membrane met
            under a layer, and whether some of its force stays for a while.
        now: Length of shaft in the layer, that since the last event, deflection, speed, standard
            deviation of the tissue's own speed, force.
    """
    what, was, becomes, is_met, is_kept = event
    length, passed, deflection, speed, unseen, force = now
    change, noise, tip = np.eye(UNKNOWNS), np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    tip[RELEASED:_AFTER_TIP] = row[RELEASED:_AFTER_TIP]
    change[RELEASED:_AFTER_TIP] = 0.0
    if what in (EXIT, PARTIAL):  # the error of the law was the tip's, and goes with it
        tip[LAW] = 1.0
        change[LAW : LAW_RATE + 1] = 0.0
        noise[LAW, LAW] = (LAW_ERROR * LEFT_ERROR * (force - mean[OFFSET] - np.dot(tip, mean))) ** 2
        noise[LAW_RATE, LAW_RATE] = noise[LAW, LAW] / LAW_MM**2
    if what == CONTACT:
        change[OWN_COULOMB : OWN_VISCOUS + 1] = 0.0
        noise[COULOMB, COULOMB] = (0.2 * (1.0 - deflection)) ** 2  # or it starts inside tissue
    elif what == PARTIAL:
        change[RELEASED], change[HELD] = tip, 0.5 * tip
        noise[HELD, HELD] = (0.25 * np.dot(tip, mean)) ** 2 + 1e-4
    else:
        change[OWN_COULOMB : OWN_VISCOUS + 1] = 0.0
        if was == LAYER:
            change[COULOMB, OWN_COULOMB], change[VISCOUS, OWN_VISCOUS] = length, length
        change[HELD if what == MEETING else RELEASED] = tip
    change[KEPT] = (KEPT_FRACTION if is_kept else 0.0) * tip
    noise[KEPT, KEPT] = ((KEPT_STD if is_kept else 0.0) * np.dot(tip, mean)) ** 2
    # A membrane met ends the layer's part of the shaft before its puncture is the rupture.
    if was == LAYER or (what == EXIT and not is_met):
        change[LEFT : EARLIER + 1] = 0.0
        change[EARLIER, LEFT] = 1.0
    if was == LAYER:
        change[LEFT, OWN_COULOMB], change[LEFT, OWN_VISCOUS] = passed * deflection, passed * speed
        noise[LEFT, LEFT] = (passed * mean[OWN_VISCOUS] * unseen) ** 2
    mean, spread = np.dot(change, mean), np.dot(np.dot(change, spread), change.T.copy()) + noise
    add_prior(mean, spread, speed, becomes, what == PARTIAL)
    return mean, spread


@compiled
def judge_fraction(
    mean: Vector, spread: Matrix, speed: float, is_due: bool
) -> tuple[bool, Vector, Matrix]:
    """Apply the prior of friction's fraction in the growth of the force, once that is known.

    Returns:
        Whether it has been applied, and the unknowns.
    """
    row = np.zeros(UNKNOWNS)
    row[STIFFNESS], row[OWN_COULOMB], row[OWN_VISCOUS] = 1.0, 1.0, speed
    slope, variance = np.dot(row, mean), np.dot(row, np.dot(spread, row))
    if variance > (0.2 * max(slope, 0.004)) ** 2 and not is_due:
        return False, mean.copy(), spread.copy()
    slope, speed = max(slope, 2e-3), max(speed, 0.1)
    fraction, std, coulomb = friction_fraction(speed)
    row[STIFFNESS], row[OWN_COULOMB] = -fraction, 1.0 - fraction
    row[OWN_VISCOUS] = (1.0 - fraction) * speed
    cross = np.dot(spread, row)
    gain = cross / (np.dot(row, cross) + (std * slope) ** 2)
    mean, spread = mean - gain * np.dot(row, mean), spread - np.outer(gain, cross)
    row[STIFFNESS], row[OWN_COULOMB], row[OWN_VISCOUS] = 0.0, 1.0 - coulomb, -coulomb * speed
    cross = np.dot(spread, row)
    std = coulomb * (1.0 - coulomb) * COULOMB_LOG_STD * fraction * slope
    gain = cross / (np.dot(row, cross) + std**2)
    return True, mean - gain * np.dot(row, mean), spread - np.outer(gain, cross)


@compiled
def hold_cutting(mean: Vector, spread: Matrix) -> tuple[float, Vector, Matrix]:
    """Take a negative cutting force for none: with its onset it would look like a slow release.

    Returns:
        What that adds to the logarithm of the weight, and the unknowns.
    """
    variance = max(spread[HELD, HELD], 0.0) + NO_CUTTING**2
    gain = spread[HELD] / variance
    surprise = mean[HELD] ** 2 / variance
    return -0.5 * surprise, mean - gain * mean[HELD], spread - np.outer(gain, spread[HELD])


@compiled
def weigh(
    means: Matrix,
    spreads: Spreads,
    facts: Matrix,
    log_weights: Vector,
    now: tuple[float, float, float, float],
) -> tuple[Vector, Matrix]:
    """Weigh down what no tissue does, at a depth, speed, length of block and noise of the force.

    Returns:
        Logarithms of weights that sum to one, and the facts, releases judged.
    """
    depth, speed, dt_s, noise = now
    weights, facts = log_weights.copy(), facts.copy()
    for k in range(len(means)):
        kind, travel = facts[k, KIND], depth - facts[k, TIP]
        own, mean = facts[k, OWN_FORCE], means[k]
        if own > 0.0 and depth > facts[k, RELEASE] + facts[k, LENGTH] + 0.1:
            is_partial = kind == LAYER and facts[k, IS_HELD] > 0.0
            fallen = mean[RELEASED] - mean[KEPT] - (mean[HELD] if is_partial else 0.0)
            if fallen < max(LEAST_DROP * own, 2.0 * noise):
                weights[k] -= 12.0
            facts[k, OWN_FORCE] = 0.0
        if kind != AIR and travel > 2.0:
            std = math.sqrt(max(spreads[k, STIFFNESS, STIFFNESS], 0.0))
            friction = mean[OWN_COULOMB] + mean[OWN_VISCOUS] * speed
            if mean[STIFFNESS] + 2.0 * std < 0.0 or friction < -0.003:
                weights[k] -= 0.1
        if kind == MEMBRANE and travel > PUSHED_MM:
            weights[k] -= 0.3 * min(dt_s * max(speed, 0.0) / 0.04, 2.0)
    weights -= weights.max()
    return weights - math.log(np.exp(weights).sum()), facts


@compiled
def shaft_mixture(
    means: Matrix, spreads: Spreads, facts: Matrix, weights: Vector, depth: float
) -> tuple[Vector, Matrix]:
    """Friction of the shaft at a depth, all hypotheses together.

    Returns:
        Mean and covariance of the offset, C, V, Coulomb and viscous friction of the whole shaft,
        c, b and the stiffness at the tip, shapes (8,) and (8, 8).
    """
    found, total, spread = np.zeros((len(means), 8)), np.zeros(8), np.zeros((8, 8))
    row = np.zeros((8, UNKNOWNS))
    for k in range(len(means)):
        is_met = facts[k, KIND] != AIR or facts[k, RUPTURES] > 0.0
        met, length = (1.0 if is_met else 0.0), max(depth - facts[k, ROOT], 0.0)
        row[0, OFFSET] = 1.0
        row[1, COULOMB] = row[2, VISCOUS] = row[3, COULOMB] = row[4, VISCOUS] = met
        row[3, OWN_COULOMB] = row[4, OWN_VISCOUS] = met * length
        row[5, OWN_COULOMB] = row[6, OWN_VISCOUS] = met
        row[7, STIFFNESS] = 1.0 if facts[k, KIND] != AIR else 0.0
        row[7, STIFFENING] = row[7, STIFFNESS] * 2.0 * max(depth - facts[k, TIP], 0.0)
        found[k] = np.dot(row, means[k])
        total += weights[k] * found[k]
        spread += weights[k] * np.dot(np.dot(row, spreads[k]), np.ascontiguousarray(row.T))
    for k in range(len(means)):
        off = found[k] - total
        spread += weights[k] * np.outer(off, off)
    return total, spread
