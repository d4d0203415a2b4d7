"""Contact of needle and tissue, sample by sample, and the block being filled.

Friction turns round over a travel (Dahl 1968) and relaxes at rest.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from foundation.arrays import Matrix
from foundation.jit import compiled, compiled_inside
from identification.estimate import Sample
from identification.mixture.block import MM_PER_M
from identification.mixture.needle_swing import NeedleSwing, update_swing

MAX_BLOCK_S = 0.01
"""A block ends after this time: enough to average the noise of single samples."""

MIN_BLOCK_S = 0.002
"""Time before a block ends by its travel."""

ROUNDING = 1e-6
"""Relative error that sums of time steps may have."""

REST_SPEED_MM_S = 0.1
"""Slower than this the needle rests."""

NOWHERE_M = -1e9
"""The deepest point before the first sample."""


@dataclass(slots=True)
class NeedleContact:
    """State of needle and tissue at a sample, and the block being filled.

    Attributes:
        deflection: Presliding deflection, -1 to 1.
        followed_m: Depth less the jitter of its measurement.
        relaxation: How far friction may have let go at rest, 0 to 1.
        deepest_m: Deepest point so far.
        depth_std_m: Noise of the last depth.
        speed_std_m_s: Noise of the last speed.
        lagged_speed_m_s: Speed of the arm, with a lag.
        inertia_variance_N2: Square of the force that accelerates the arm, at most.
        motion_variance_N2: Variance of the force by motion now.
        block_s: Length of the block being filled.
        depth_m_s: Integral of the depth over it.
        travel_m: Integral of the speed.
        deflection_s: Integral of the presliding deflection.
        force_N_s: Integral of the force.
        force_squared_N2_s: Integral of its square.
        unfiltered_depth_m_s: Integral of the unfiltered depth.
        motion_variance_N2_s: Integral of the variance of the force by motion.
        shortfall_N_s: Integral of the force that was predicted, less the force.
        early_blocks: Blocks in a row that ended early, see `is_falling`.
        swing: Of the needle.
    """

    deflection: float = 0.0
    followed_m: float = 0.0
    relaxation: float = 0.0
    deepest_m: float = NOWHERE_M
    depth_std_m: float = 0.0
    speed_std_m_s: float = 0.0
    lagged_speed_m_s: float = 0.0
    inertia_variance_N2: float = 0.0
    motion_variance_N2: float = 0.0
    block_s: float = 0.0
    depth_m_s: float = 0.0
    travel_m: float = 0.0
    deflection_s: float = 0.0
    force_N_s: float = 0.0
    force_squared_N2_s: float = 0.0
    unfiltered_depth_m_s: float = 0.0
    motion_variance_N2_s: float = 0.0
    shortfall_N_s: float = 0.0
    early_blocks: int = 0
    swing: NeedleSwing = field(default_factory=NeedleSwing)


@compiled_inside
def slide(deflection: float, travel_mm: float) -> tuple[float, float]:
    """Return the presliding deflection after a travel, and what remains of the old one.

    The exact solution of Dahl's law (1968, shape exponent 1): two half steps equal one.
    """
    # Friction turns over 0.3 mm after a reversal: gel clings for a fifth, soft tissue
    # for half a millimetre.
    remaining = math.exp(-abs(travel_mm) / 0.3)
    limit = math.copysign(1.0, travel_mm)
    return limit + (deflection - limit) * remaining, remaining


@compiled
def contact_along(depths_mm: Matrix) -> tuple[Matrix, Matrix]:
    """Return presliding deflection and remaining tip force along courses of depths.

    Args:
        depths_mm: A course is a row, shape (m, n).

    Returns:
        The deflections, and the part of the tip's force that remains, shapes (m, n).
    """
    deflection = np.ones_like(depths_mm)
    remaining = np.ones_like(depths_mm)
    for course in range(len(depths_mm)):
        depth = depths_mm[course]
        deepest = depth[0]
        for k in range(1, len(depth)):
            travel = depth[k] - depth[k - 1]
            deflection[course, k] = slide(deflection[course, k - 1], travel)[0]
            deepest = max(deepest, depth[k])
            unloaded = (deepest - depth[k]) / 0.5  # mm that the tip is drawn back
            remaining[course, k] = min(max(1.0 - unloaded, 0.0), 1.0)
    return deflection, remaining


@compiled_inside
def update_inertia(contact: NeedleContact, sample: Sample, arm_m_s: float) -> None:
    """Update how uncertain the force is by the arm's acceleration.

    Masses are known roughly, and inertia is taken out with another lag than the force
    has: so a virtual force is uncertain where the arm accelerates.
    """
    acceleration_s = 0.03  # over which the acceleration is measured
    dt_s = sample.dt_s
    change_m_s = arm_m_s - contact.lagged_speed_m_s
    contact.lagged_speed_m_s += change_m_s * dt_s / (acceleration_s + dt_s)
    change_m_s = abs(arm_m_s - contact.lagged_speed_m_s)
    change_m_s = max(change_m_s - 3.0 * sample.speed_std_m_s, 0.0)  # no jitter
    # The needle is taken to have at most a mass of 10 kg along it: an LWR has 3 to 4 kg
    # in the insertions, below 10 kg in nine of ten postures.
    variance_N2 = (10.0 * change_m_s / acceleration_s) ** 2
    remembered_N2 = contact.inertia_variance_N2 * math.exp(-dt_s / 0.2)
    contact.inertia_variance_N2 = max(variance_N2, remembered_N2)
    force_variance_N2 = sample.force_std_N * sample.force_std_N
    contact.motion_variance_N2 = min(force_variance_N2, contact.inertia_variance_N2)


@compiled_inside
def update_friction_state(contact: NeedleContact, sample: Sample) -> None:
    """Update presliding deflection and relaxation at rest."""
    # Within it the needle may not have moved: a filtered depth swings past a sudden
    # stop, and an arm's joints have play.
    deadband_m = max(3.0 * sample.depth_std_m, 2e-5)
    depth_m = sample.depth_m
    followed_m = depth_m if contact.deepest_m == NOWHERE_M else contact.followed_m
    if followed_m < depth_m - deadband_m:
        contact.followed_m = depth_m - deadband_m
    else:
        contact.followed_m = min(followed_m, depth_m + deadband_m)
    if contact.followed_m != followed_m:
        travel_mm = MM_PER_M * (contact.followed_m - followed_m)
        contact.deflection, remaining = slide(contact.deflection, travel_mm)
        contact.relaxation *= remaining
    if MM_PER_M * abs(sample.speed_m_s) < REST_SPEED_MM_S:
        # Real liver loses its force with this time constant.
        relaxing = -math.expm1(-sample.dt_s / 8.5)
        contact.relaxation += (1.0 - contact.relaxation) * relaxing


@compiled_inside
def fill_block(contact: NeedleContact, sample: Sample, is_end_of_swing: bool) -> bool:
    """Add a sample to the block, and return whether it is full.

    The contact is already that of this sample. Where the needle swings the block holds
    a whole swing.
    """
    dt_s = sample.dt_s
    contact.block_s += dt_s
    contact.depth_m_s += dt_s * sample.depth_m
    contact.travel_m += dt_s * sample.speed_m_s
    contact.deflection_s += dt_s * contact.deflection
    contact.force_N_s += dt_s * sample.force_N
    contact.force_squared_N2_s += dt_s * sample.force_N * sample.force_N
    contact.unfiltered_depth_m_s += dt_s * sample.raw_depth_m
    contact.motion_variance_N2_s += dt_s * contact.motion_variance_N2
    if contact.swing.is_swinging:
        # Two of the longest halves take 0.24 s.
        return is_end_of_swing or contact.block_s > 0.24
    if contact.block_s > MAX_BLOCK_S * (1.0 - ROUNDING):
        return True
    is_far = MM_PER_M * abs(contact.travel_m) >= 0.06  # well below any release
    return is_far and contact.block_s > MIN_BLOCK_S * (1.0 - ROUNDING)


@compiled_inside
def update_contact(contact: NeedleContact, sample: Sample, arm_m_s: float) -> bool:
    """Use one sample, and return whether the block being filled is full.

    Depths and speed of the sample are those in the tissue, which may move; the arm has
    a speed of its own.
    """
    update_inertia(contact, sample, arm_m_s)
    update_friction_state(contact, sample)
    contact.deepest_m = max(contact.deepest_m, sample.depth_m)
    contact.depth_std_m = sample.depth_std_m
    contact.speed_std_m_s = sample.speed_std_m_s
    is_end_of_swing = update_swing(contact.swing, sample.raw_speed_m_s, sample.dt_s)
    return fill_block(contact, sample, is_end_of_swing)


@compiled_inside
def is_falling(
    contact: NeedleContact, shortfall_N: float, dt_s: float, noise_variance_N2: float
) -> bool:
    """Return whether the force of the block falls clearly short of its prediction.

    A block then ends early, so that hypotheses are weighed at once: the first blocks of
    a rupture. A force that stays short, as one that no tissue exerts, ends none.

    Args:
        contact: With the block being filled.
        shortfall_N: Of this sample: force that was predicted, less the force.
        dt_s: Time since the sample before.
        noise_variance_N2: Of the mean force of a whole block.
    """
    contact.shortfall_N_s += dt_s * shortfall_N
    if contact.swing.is_swinging or contact.block_s < MIN_BLOCK_S * (1.0 - ROUNDING):
        return False
    # White noise: the shorter the mean, the larger.
    variance_N2_s2 = noise_variance_N2 * MAX_BLOCK_S * contact.block_s
    variance_N2_s2 += contact.motion_variance_N2_s * contact.block_s
    # By chance once in 30,000 blocks; after 20 ms an alarm is raised.
    if contact.shortfall_N_s > 4.0 * math.sqrt(variance_N2_s2):
        contact.early_blocks += 1
        return contact.early_blocks <= 10
    if contact.block_s > MAX_BLOCK_S * (1.0 - ROUNDING):
        contact.early_blocks = 0
    return False


@compiled
def begin_block(contacts: list[NeedleContact]) -> None:
    """Empty the block being filled."""
    contact = contacts[0]
    contact.block_s = 0.0
    contact.depth_m_s = 0.0
    contact.travel_m = 0.0
    contact.deflection_s = 0.0
    contact.force_N_s = 0.0
    contact.force_squared_N2_s = 0.0
    contact.unfiltered_depth_m_s = 0.0
    contact.motion_variance_N2_s = 0.0
    contact.shortfall_N_s = 0.0


@compiled
def shift_depth(contacts: list[NeedleContact], by_m: float) -> None:
    """Count depth from elsewhere."""
    contact = contacts[0]
    contact.followed_m += by_m
    contact.deepest_m += by_m
    contact.depth_m_s += by_m * contact.block_s
    contact.unfiltered_depth_m_s += by_m * contact.block_s
