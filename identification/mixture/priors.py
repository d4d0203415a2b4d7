"""What is assumed of a layer or a membrane before its force is measured.

All these values are chosen; no measurement is known that gives them. Two of friction,
`FRICTION_FRACTION` and the deviation of the speed at which Coulomb and viscous friction
are equal, were compared with recordings in liver before they were kept, so results on
these recordings are no independent test.

The growth of the force is its change per mm of travel at one speed: stiffness plus
friction per length of shaft. Lengths are in mm, speeds in mm/s, forces in N.
"""

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

PART_STD_N_PER_MM = 0.7 * 0.04
"""Standard deviation of stiffness, and of friction: that of the growth is 0.04 N/mm, of
which two independent parts with equal deviations have 1/√2, rounded."""

FRICTION_FRACTION = 0.5
"""Prior mean of friction's fraction of the growth of the force: half, since it is not
known."""

FRICTION_FRACTION_STD = 0.2
"""Standard deviation of that fraction."""

COULOMB_SPEED_MM_S = 3.4
"""Speed at which Coulomb and viscous friction are equal: chosen, no measurement is
known. The simulated gels have 1.5, the liver 20."""

MIN_SPEED_MM_S = 0.1
"""Speed below which friction is taken to be as at this speed."""

MIN_VISCOUS_SPEED_MM_S = 0.5
"""Speed below which viscous friction per speed is taken to be as at this speed."""


@compiled
def friction_fraction(speed: float) -> tuple[float, float]:
    """Return mean and deviation of friction's fraction of the force's growth.

    `FRICTION_FRACTION` and its deviation hold at 3 mm/s. The faster the needle, the
    larger the fraction, since part of friction is viscous.
    """
    odds = FRICTION_FRACTION / (1.0 - FRICTION_FRACTION)
    odds *= (COULOMB_SPEED_MM_S + speed) / (COULOMB_SPEED_MM_S + 3.0)
    fraction = odds / (1.0 + odds)
    std = FRICTION_FRACTION_STD * fraction * (1.0 - fraction)
    return fraction, std / (FRICTION_FRACTION * (1.0 - FRICTION_FRACTION))


@compiled_inside
def coulomb_fraction(speed: float) -> float:
    """Return Coulomb's fraction of the friction at a speed."""
    return COULOMB_SPEED_MM_S / (COULOMB_SPEED_MM_S + speed)


@compiled_inside
def add_membrane_prior(mean: WrittenVector, covariance: WrittenMatrix) -> None:
    """Set the prior of a membrane's stiffness K, and of H: K grows by 2 H per mm."""
    mean[STIFFNESS] = 0.05  # N/mm
    mean[STIFFENING] = 0.01  # N/mm²
    covariance[STIFFNESS, STIFFNESS] = 0.1**2
    covariance[STIFFENING, STIFFENING] = 0.02**2


@compiled_inside
def add_stiffness_prior(
    mean: WrittenVector, covariance: WrittenMatrix, speed: float
) -> None:
    """Add the prior of a layer's stiffness, at a speed."""
    fraction, _ = friction_fraction(max(speed, MIN_SPEED_MM_S))
    mean[STIFFNESS] += (1.0 - fraction) * SLOPE_N_PER_MM
    covariance[STIFFNESS, STIFFNESS] += PART_STD_N_PER_MM**2
    covariance[STIFFENING, STIFFENING] += 1e-3**2  # H: K grows by 2 H per mm


@compiled_inside
def add_friction_prior(
    mean: WrittenVector, covariance: WrittenMatrix, speed: float
) -> None:
    """Add the prior of a layer's friction and cutting force, at a speed."""
    fraction, _ = friction_fraction(max(speed, MIN_SPEED_MM_S))
    coulomb = coulomb_fraction(max(speed, MIN_SPEED_MM_S))
    viscous = 1.0 - coulomb
    viscous_speed = max(speed, MIN_VISCOUS_SPEED_MM_S)
    std = PART_STD_N_PER_MM
    mean[LAYER_COULOMB] += fraction * coulomb * SLOPE_N_PER_MM
    covariance[LAYER_COULOMB, LAYER_COULOMB] += (std * coulomb) ** 2
    mean[LAYER_VISCOUS] += fraction * viscous * SLOPE_N_PER_MM / viscous_speed
    covariance[LAYER_VISCOUS, LAYER_VISCOUS] += (std * viscous / viscous_speed) ** 2
    mean[HELD] += 0.03  # N
    covariance[HELD, HELD] += 0.15**2
    # Stiff tissue is hard to cut: 2 N per N/mm.
    covariance[:, HELD] += 2.0 * covariance[:, STIFFNESS]
    covariance[HELD] += 2.0 * covariance[STIFFNESS]


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
    # The growth counts as known once its deviation is a fifth of it.
    known_std = 0.2 * max(slope, 0.004)
    if variance > known_std**2 and not is_due:
        return False
    slope = max(slope, 2e-3)  # N/mm
    speed = max(speed, MIN_SPEED_MM_S)
    fraction, std = friction_fraction(speed)
    # Friction is this fraction of the growth: (1 - fraction) friction = fraction K.
    row[STIFFNESS] = -fraction
    row[LAYER_COULOMB] = 1.0 - fraction
    row[LAYER_VISCOUS] = (1.0 - fraction) * speed
    update_to_zero(mean, covariance, row, (std * slope) ** 2)
    forget_first_fraction(mean, covariance, speed, prior_speed)
    # And Coulomb's part of the friction is as the speed says.
    coulomb = coulomb_fraction(speed)
    row[STIFFNESS] = 0.0
    row[LAYER_COULOMB] = 1.0 - coulomb
    row[LAYER_VISCOUS] = -coulomb * speed
    # The speed at which both are equal is known but for a factor of 4.
    std = coulomb * (1.0 - coulomb) * 1.4
    std = std * fraction * slope
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
    fraction, _ = friction_fraction(prior_speed)
    coulomb = coulomb_fraction(prior_speed)
    viscous_speed = max(prior_speed, MIN_VISCOUS_SPEED_MM_S)
    viscous = (1.0 - coulomb) * speed / viscous_speed
    part_variance = PART_STD_N_PER_MM**2  # a
    friction_variance = part_variance * (coulomb**2 + viscous**2)  # b
    stiffness = (1.0 - fraction) * SLOPE_N_PER_MM
    friction = fraction * (coulomb + viscous) * SLOPE_N_PER_MM
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
