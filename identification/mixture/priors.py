"""What is assumed of a layer or a membrane before its force is measured.

All these values are chosen; no measurement is known that gives them. Two of friction,
`FRICTION_FRACTION` and `COULOMB_SPEED_LOG_STD`, were compared with recordings in
liver before they were kept, so results on these recordings are no independent test.

The growth of the force is its change per mm of travel at one speed: stiffness plus
friction per length of shaft. Lengths are in mm, speeds in mm/s, forces in N.
"""

from typing import NamedTuple

import numpy as np

from foundation.arrays import WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import dot
from identification.mixture.force_model import (
    HELD,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    STIFFENING,
    STIFFNESS,
    UNKNOWNS,
)
from identification.mixture.kalman import times, update, update_to_zero

SLOPE_N_PER_MM = 0.03
"""Prior mean of the growth of the force in a layer, stiffness and friction together."""

SLOPE_STD_N_PER_MM = 0.04
"""Standard deviation of that growth."""

PART_STD_FRACTION = 0.7
"""Standard deviation of stiffness, and of friction, as a fraction of
`SLOPE_STD_N_PER_MM`: 1/√2, rounded, as for two independent parts with equal
deviations."""

STIFFENING_STD_N_PER_MM2 = 1e-3
"""Standard deviation of H in a layer, about zero. The stiffness grows by 2 H per mm."""

CUTTING_N = 0.03
"""Prior mean of the cutting force."""

CUTTING_STD_N = 0.15
"""Standard deviation of the cutting force."""

CUTTING_PER_STIFFNESS_MM = 2.0
"""Change of the cutting force per change of the stiffness: stiff tissue is hard to
cut."""

MEMBRANE_STIFFNESS_N_PER_MM = 0.05
"""Prior mean of a membrane's stiffness."""

MEMBRANE_STIFFNESS_STD_N_PER_MM = 0.1
"""Standard deviation of a membrane's stiffness."""

MEMBRANE_STIFFENING_N_PER_MM2 = 0.01
"""Prior mean of a membrane's H. Its stiffness grows by 2 H per mm."""

MEMBRANE_STIFFENING_STD_N_PER_MM2 = 0.02
"""Standard deviation of a membrane's H."""

FRICTION_FRACTION = 0.5
"""Prior mean of friction's fraction of the growth of the force: half, since it is not
known."""

FRICTION_FRACTION_STD = 0.2
"""Standard deviation of that fraction."""

FRICTION_FRACTION_SPEED_MM_S = 3.0
"""Speed at which this mean and deviation hold."""

COULOMB_SPEED_MM_S = 3.4
"""Speed at which Coulomb and viscous friction are equal: chosen, no measurement is
known. The simulated gels have 1.5, the liver 20."""

COULOMB_SPEED_LOG_STD = 1.4
"""Standard deviation of the logarithm of that speed: a factor of 4."""

MIN_SPEED_MM_S = 0.1
"""Speed below which friction is taken to be as at this speed."""

MIN_VISCOUS_SPEED_MM_S = 0.5
"""Speed below which viscous friction per speed is taken to be as at this speed."""

MIN_SLOPE_N_PER_MM = 2e-3
"""Minimum growth of the force in `use_friction_fraction`: where the estimate is
smaller, the deviations are computed from this value."""

KNOWN_SLOPE_FRACTION = 0.2
"""The growth of the force counts as known once its standard deviation is at most this
fraction of it."""

MIN_KNOWN_SLOPE_N_PER_MM = 0.004
"""Minimum growth of the force in that test: where the estimate is smaller, this value
takes its place."""


class FrictionFraction(NamedTuple):
    """Friction's fraction of the force's growth in a layer, at one speed.

    Attributes:
        fraction: Its prior mean, 0 to 1.
        std: Its prior standard deviation.
        coulomb: Coulomb's fraction of that friction.
    """

    fraction: float
    std: float
    coulomb: float


@compiled
def friction_fraction(speed: float) -> FrictionFraction:
    """Return the prior of friction's fraction of the force's growth at a speed.

    The faster the needle, the larger the fraction, since part of friction is viscous.
    """
    odds = FRICTION_FRACTION / (1.0 - FRICTION_FRACTION)
    odds *= (COULOMB_SPEED_MM_S + speed) / (
        COULOMB_SPEED_MM_S + FRICTION_FRACTION_SPEED_MM_S
    )
    fraction = odds / (1.0 + odds)
    std = FRICTION_FRACTION_STD * fraction * (1.0 - fraction)
    std /= FRICTION_FRACTION * (1.0 - FRICTION_FRACTION)
    return FrictionFraction(
        fraction, std, COULOMB_SPEED_MM_S / (COULOMB_SPEED_MM_S + speed)
    )


@compiled_inside
def add_membrane_prior(mean: WrittenVector, covariance: WrittenMatrix) -> None:
    """Set the prior of a membrane's stiffness."""
    mean[STIFFNESS] = MEMBRANE_STIFFNESS_N_PER_MM
    mean[STIFFENING] = MEMBRANE_STIFFENING_N_PER_MM2
    covariance[STIFFNESS, STIFFNESS] = MEMBRANE_STIFFNESS_STD_N_PER_MM**2
    covariance[STIFFENING, STIFFENING] = MEMBRANE_STIFFENING_STD_N_PER_MM2**2


@compiled_inside
def add_stiffness_prior(
    mean: WrittenVector, covariance: WrittenMatrix, speed: float
) -> None:
    """Add the prior of a layer's stiffness, at a speed."""
    friction = friction_fraction(max(speed, MIN_SPEED_MM_S))
    std = PART_STD_FRACTION * SLOPE_STD_N_PER_MM
    mean[STIFFNESS] += (1.0 - friction.fraction) * SLOPE_N_PER_MM
    covariance[STIFFNESS, STIFFNESS] += std**2
    covariance[STIFFENING, STIFFENING] += STIFFENING_STD_N_PER_MM2**2


@compiled_inside
def add_friction_prior(
    mean: WrittenVector, covariance: WrittenMatrix, speed: float
) -> None:
    """Add the prior of a layer's friction and cutting force, at a speed."""
    friction = friction_fraction(max(speed, MIN_SPEED_MM_S))
    coulomb = friction.coulomb
    viscous = 1.0 - coulomb
    viscous_speed = max(speed, MIN_VISCOUS_SPEED_MM_S)
    std = PART_STD_FRACTION * SLOPE_STD_N_PER_MM
    mean[LAYER_COULOMB] += friction.fraction * coulomb * SLOPE_N_PER_MM
    covariance[LAYER_COULOMB, LAYER_COULOMB] += (std * coulomb) ** 2
    mean[LAYER_VISCOUS] += friction.fraction * viscous * SLOPE_N_PER_MM / viscous_speed
    covariance[LAYER_VISCOUS, LAYER_VISCOUS] += (std * viscous / viscous_speed) ** 2
    mean[HELD] += CUTTING_N
    covariance[HELD, HELD] += CUTTING_STD_N**2
    for i in range(UNKNOWNS):
        covariance[i, HELD] += CUTTING_PER_STIFFNESS_MM * covariance[i, STIFFNESS]
    for i in range(UNKNOWNS):
        covariance[HELD, i] += CUTTING_PER_STIFFNESS_MM * covariance[STIFFNESS, i]


@compiled_inside
def use_friction_fraction(
    mean: WrittenVector,
    covariance: WrittenMatrix,
    speed: float,
    prior_speed: float,
    is_due: bool,
) -> bool:
    """Apply the prior of friction's fraction to the growth of the force, now known.

    The priors at the beginning of a layer contain the fraction already, but for an
    assumed growth, with deviations in N/mm: too sure where the force grows fast, since
    a needle that advances at constant speed does not tell stiffness from friction. Once
    the growth is known, that part of the first prior is taken out again, and the
    fraction applied with deviations in proportion to the growth.

    Args:
        mean: Of the unknowns, shape (20,).
        covariance: Theirs, shape (20, 20).
        speed: Of the needle.
        prior_speed: Speed at which the first prior was made.
        is_due: Whether to apply it even where the growth is not known well.

    Returns:
        Whether it was applied.
    """
    row = np.zeros(UNKNOWNS)
    row[STIFFNESS] = 1.0
    row[LAYER_COULOMB] = 1.0
    row[LAYER_VISCOUS] = speed
    slope = dot(row, mean)
    variance = dot(row, times(covariance, row))
    known_std = KNOWN_SLOPE_FRACTION * max(slope, MIN_KNOWN_SLOPE_N_PER_MM)
    if variance > known_std**2 and not is_due:
        return False
    slope = max(slope, MIN_SLOPE_N_PER_MM)
    speed = max(speed, MIN_SPEED_MM_S)
    friction = friction_fraction(speed)
    # Friction is this fraction of the growth: (1 - fraction) friction = fraction K.
    row[STIFFNESS] = -friction.fraction
    row[LAYER_COULOMB] = 1.0 - friction.fraction
    row[LAYER_VISCOUS] = (1.0 - friction.fraction) * speed
    update_to_zero(mean, covariance, row, (friction.std * slope) ** 2)
    forget_first_fraction(mean, covariance, speed, prior_speed)
    # And Coulomb's part of the friction is as the speed says.
    coulomb = friction.coulomb
    row[STIFFNESS] = 0.0
    row[LAYER_COULOMB] = 1.0 - coulomb
    row[LAYER_VISCOUS] = -coulomb * speed
    std = coulomb * (1.0 - coulomb) * COULOMB_SPEED_LOG_STD
    std = std * friction.fraction * slope
    update_to_zero(mean, covariance, row, std**2)
    return True


@compiled_inside
def forget_first_fraction(
    mean: WrittenVector, covariance: WrittenMatrix, speed: float, prior_speed: float
) -> None:
    """Divide out what a layer's first prior said of friction's share in the growth.

    Of stiffness K and friction F per length, independent in that prior with variances a
    and b, it is the factor of b K - a F, the combination that is independent of K + F.
    """
    first = friction_fraction(prior_speed)
    viscous_speed = max(prior_speed, MIN_VISCOUS_SPEED_MM_S)
    viscous = (1.0 - first.coulomb) * speed / viscous_speed
    part_variance = (PART_STD_FRACTION * SLOPE_STD_N_PER_MM) ** 2  # a
    friction_variance = part_variance * (first.coulomb**2 + viscous**2)  # b
    stiffness = (1.0 - first.fraction) * SLOPE_N_PER_MM
    friction = first.fraction * (first.coulomb + viscous) * SLOPE_N_PER_MM
    row = np.zeros(UNKNOWNS)
    row[STIFFNESS] = friction_variance
    row[LAYER_COULOMB] = -part_variance
    row[LAYER_VISCOUS] = -part_variance * speed
    prior_value = friction_variance * stiffness - part_variance * friction
    prior_variance = part_variance * friction_variance
    prior_variance *= part_variance + friction_variance
    cross_covariance = times(covariance, row)
    innovation = prior_value - dot(row, mean)
    # A measurement of negative variance: what it adds is taken away.
    total_variance = dot(row, cross_covariance) - prior_variance
    update(mean, covariance, cross_covariance, innovation, total_variance)
