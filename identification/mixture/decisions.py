"""How likely more or fewer ruptures are than reported; whether braking explains a fall.

What follows from it, an alarm or its retraction, is left to `reporter`.

Lengths are in mm, speeds in mm/s, forces in N.
"""

from typing import NamedTuple

from foundation.arrays import Vector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import index_of_largest
from foundation.records import read_element
from identification.mixture.block import Block
from identification.mixture.events import History
from identification.mixture.evidence import Evidence
from identification.mixture.force_model import (
    FADING,
    OFFSET,
    RELEASED,
    Assumptions,
)
from identification.mixture.mixture import Mixture
from identification.mixture.tissue_motion import TissueMotion

VISIBLE_FRACTION = 0.3
"""Fraction of the released force that counts as a rupture by which the force must have
fallen: else it only grows slower."""

LATE_ALARM_S = 0.5
"""If an alarm comes later than this, the force must still be lower."""


class RuptureCount(NamedTuple):
    """What the components say about the number of ruptures.

    Attributes:
        more: Probability of more ruptures than reported and a clear fall of the force.
        fewer: Probability of fewer than reported.
        likeliest_with_more: The likeliest component with more, -1 without any.
        likeliest: Number of ruptures of the likeliest component of all.
    """

    more: float
    fewer: float
    likeliest_with_more: int
    likeliest: int


@compiled_inside
def released_force(mean: Vector, assumption: Assumptions, history: History) -> float:
    """Return the force that the last rupture of a component has released."""
    released = mean[RELEASED] - mean[FADING]
    # At most all of the force has fallen.
    return min(released, history.rupture_force_N - mean[OFFSET])


@compiled_inside
def is_undone(history: History, block: Block) -> bool:
    """Return whether the force is higher again, long after the rupture.

    A late component with a rupture is then rather a change of the tissue.
    """
    is_late = block.time_s - history.rupture_s > LATE_ALARM_S
    return is_late and history.rupture_force_N <= block.force_N


@compiled
def compare_counts(
    evidence: Evidence, reported: int, block: Block, clear_fall: float
) -> RuptureCount:
    """Compare the number of ruptures reported with those of the components.

    Args:
        evidence: Of n components.
        reported: Ruptures reported so far.
        block: The last one.
        clear_fall: Released force that counts as a rupture.
    """
    mixture = evidence.mixture
    more = 0.0
    fewer = 0.0
    likeliest = -1
    for k in range(len(evidence.weights)):
        weight = evidence.weights[k]
        if evidence.ruptures[k] < reported:
            fewer += weight
        elif evidence.ruptures[k] > reported:
            history = mixture.history[k]
            released = released_force(mixture.means[k], mixture.assumptions[k], history)
            if released > clear_fall and not is_undone(history, block):
                more += weight
                if likeliest < 0 or weight > evidence.weights[likeliest]:
                    likeliest = k
    if likeliest >= 0:
        history = mixture.history[likeliest]
        fallen = history.rupture_force_N - history.min_force_N
        if fallen <= VISIBLE_FRACTION * clear_fall:
            more = 0.0
    ruptures = int(evidence.ruptures[index_of_largest(evidence.weights)])
    return RuptureCount(more, fewer, likeliest, ruptures)


def count_ruptures(evidence: Evidence, reported: int, block: Block) -> RuptureCount:
    """Return what the components say about the number of ruptures reported."""
    # Released force for an alarm, in standard deviations of a block's force
    clear_fall_sigmas = 3.0
    # Released force for an alarm: two thirds of the least rupture seen in real liver
    min_clear_fall_N = 0.1
    clear_fall_N = max(clear_fall_sigmas * block.noise_std_N, min_clear_fall_N)
    return compare_counts(evidence, reported, block, clear_fall_N)


def may_be_braking(
    mixture: Mixture, component: int, block: Block, time_s: float, tissue: TissueMotion
) -> bool:
    """Return whether a needle that slows down could explain the fall of the force.

    Friction falls with the speed at once, but the speed is known late. So a relatively
    small fall waits until the speed would show braking, and counts only if it exceeds
    what that explains.

    Args:
        mixture: As it is now.
        component: The one that says that there was a rupture.
        block: The last one.
        time_s: Now, since the reset.
        tissue: Its own motion.
    """
    # Fall, as a fraction of the force, that no robot makes by braking before its speed
    # is known
    early_fall_fraction = 0.12
    # The same per time since it began
    fall_rate_per_s = 1.5
    # A fall of more than this fraction of the force is large
    large_fall_fraction = 0.3
    # Fraction of the speed lost, below which it is noise of the filtered speed
    min_speed_loss = 0.02
    # Relative fall that braking explains, per fraction of the speed lost: more than 1,
    # since the speed is late and travel shows its mean
    fall_per_speed_loss = 3.0
    # The same of a large fall
    large_fall_per_speed_loss = 2.0
    history = read_element(History, mixture.history, component)
    force_N = abs(history.rupture_force_N - float(mixture.means[component, OFFSET]))
    fall_N = history.rupture_force_N - block.force_N
    since_s = time_s - history.rupture_s
    quick_fall = max(early_fall_fraction, fall_rate_per_s * since_s)
    if since_s < block.speed_lag_s and fall_N < quick_fall * force_N:
        return True
    loss = _speed_loss(history, block, tissue)
    is_large = fall_N > large_fall_fraction * force_N
    explained = large_fall_per_speed_loss if is_large else fall_per_speed_loss
    return loss > min_speed_loss and fall_N < explained * loss * force_N


def _speed_loss(history: History, block: Block, tissue: TissueMotion) -> float:
    """Return the fraction of the needle's own speed lost since a rupture."""
    # So long after a rupture the travel since then shows the speed better, less noisy
    recent_rupture_s = 0.5
    # Speed that a loss refers to, at least
    min_speed_mm_s = 1e-3
    speed = block.speed_mm_s
    speed_before = history.rupture_speed_mm_s
    travel_mm = block.unfiltered_depth_mm - history.rupture_mm
    if tissue.is_known:  # only the needle's own speed is known late
        start = tissue.motion_at(history.rupture_s)
        end = tissue.motion_at(block.time_s)
        speed = speed + end.speed_mm_s
        speed_before = speed_before + start.speed_mm_s
        travel_mm = travel_mm + end.place_mm - start.place_mm
    travelled_s = block.time_s - history.rupture_s
    if 0.0 < travelled_s < recent_rupture_s:
        # A filtered depth is as late as its speed, an unfiltered one is not.
        speed = min(speed, travel_mm / travelled_s)
    return 1.0 - speed / max(speed_before, min_speed_mm_s)
