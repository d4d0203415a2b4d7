"""How probable each component is, and what follows for the number of ruptures.

How likely more or fewer ruptures are than reported; whether braking explains a fall.
What follows from it, an alarm or its retraction, is left to `reporter`.

Lengths are in mm, speeds in mm/s, forces in N.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import WrittenVector
from foundation.jit import compiled
from foundation.linear_algebra import index_of_largest
from foundation.records import read_column, read_element
from identification.estimate import Rupture
from identification.mixture.block import MM_PER_M, Block
from identification.mixture.events import History
from identification.mixture.force_model import (
    FADING,
    LAYER_VISCOUS,
    OFFSET,
    RELEASED,
    TRAVERSED_VISCOUS,
)
from identification.mixture.mixture import MIN_BETWEEN_RUPTURES_MM, Mixture
from identification.mixture.tissue_motion import TissueMotion


class Evidence(NamedTuple):
    """The mixture, the probability of each component, and how many ruptures it counts.

    Attributes:
        mixture: Of n components.
        weights: Their probabilities, shape (n,).
        ruptures: Number of ruptures that each counts, shape (n,).
    """

    mixture: Mixture
    weights: WrittenVector
    ruptures: WrittenVector

    def weights_of(self, ruptures: int) -> WrittenVector:
        """Return the probabilities of components with so many ruptures, of others 0."""
        return np.where(self.ruptures == ruptures, self.weights, 0.0)


def weigh_evidence(mixture: Mixture, alarm: Rupture | None, reported: int) -> Evidence:
    """Return the evidence after the last of the alarms reported.

    A component whose last rupture lies clearly before the alarm's denies that one.

    Args:
        mixture: As it is now.
        alarm: The last one, None before the first.
        reported: Ruptures reported so far.
    """
    clearly_before_mm = -math.inf
    if alarm is not None:
        clearly_before_mm = MM_PER_M * alarm.depth_m - MIN_BETWEEN_RUPTURES_MM
    ruptures = read_column(mixture.assumptions, "ruptures")
    denies_alarm = read_column(mixture.history, "rupture_mm") < clearly_before_mm
    without_alarm = np.minimum(ruptures, reported - 1.0)
    counted = np.where(denies_alarm, without_alarm, ruptures)
    return Evidence(mixture, mixture.weights, counted)


def count_recent_in_full(evidence: Evidence, noise_fraction: float) -> Evidence:
    """Return the evidence with weights that count the last blocks' likelihood in full.

    A mixture's own weights temper it, for what is learnt over millimetres repeats the
    model's own errors. What is heard within a tenth of a second differs by noise, but
    for tissue that moves.

    Args:
        evidence: With the mixture's own weights.
        noise_fraction: Part of white noise in what changes the force, 0 to 1.
    """
    recent = read_column(evidence.mixture.history, "recent_log")
    logs = evidence.mixture.log_weights + noise_fraction * recent
    weights = np.exp(logs - logs.max())
    return evidence._replace(weights=weights / weights.sum())


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
            mean = mixture.means[k]
            # At most all of the force has fallen.
            most = history.rupture_force_N - mean[OFFSET]
            released = min(mean[RELEASED] - mean[FADING], most)
            # A late component with a rupture is rather a change of the tissue, unless
            # the force is still lower at the same speed.
            is_late = block.time_s - history.rupture_s > 0.5
            length_mm = max(block.depth_mm - mixture.assumptions[k].layer_start_mm, 0.0)
            damping = mean[TRAVERSED_VISCOUS] + mean[LAYER_VISCOUS] * length_mm
            by_speed_N = damping * (block.speed_mm_s - history.rupture_speed_mm_s)
            force_before_N = history.rupture_force_N + by_speed_N
            is_undone = is_late and force_before_N <= block.force_N
            if released > clear_fall and not is_undone:
                more += weight
                if likeliest < 0 or weight > evidence.weights[likeliest]:
                    likeliest = k
    if likeliest >= 0:
        history = mixture.history[likeliest]
        fallen = history.rupture_force_N - history.min_force_N
        if fallen <= 0.3 * clear_fall:  # the force only grows slower
            more = 0.0
    ruptures = int(evidence.ruptures[index_of_largest(evidence.weights)])
    return RuptureCount(more, fewer, likeliest, ruptures)


def count_ruptures(evidence: Evidence, reported: int, block: Block) -> RuptureCount:
    """Return what the components say about the number of ruptures reported."""
    # Released force for an alarm: two thirds of the least rupture seen in real liver
    return compare_counts(evidence, reported, block, max(3.0 * block.noise_std_N, 0.1))


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
    history = read_element(History, mixture.history, component)
    force_N = abs(history.rupture_force_N - float(mixture.means[component, OFFSET]))
    fall_N = history.rupture_force_N - block.force_N
    since_s = time_s - history.rupture_s
    # No robot makes so large a fall, or so quick a one, by braking before its speed is
    # known. Were all of the force viscous, 2.5/s would be rest within 0.4 s and 1.5/s
    # within 0.7 s; in between a quick stop has taken an eighth of the speed.
    quick_fall = max(min(2.5 * since_s, 0.12), 1.5 * since_s)
    if since_s < block.speed_lag_s and fall_N < quick_fall * force_N:
        return True
    # Only the needle's own speed is known late.
    start_mm, start_mm_s = tissue.motion_at(history.rupture_s)
    end_mm, end_mm_s = tissue.motion_at(block.time_s)
    speed = block.speed_mm_s + end_mm_s
    speed_before = history.rupture_speed_mm_s + start_mm_s
    travel_mm = block.unfiltered_depth_mm - history.rupture_mm + end_mm - start_mm
    travelled_s = block.time_s - history.rupture_s
    noise_mm_s = block.speed_std_mm_s
    if 0.0 < travelled_s < 0.5:
        # A filtered depth is as late as its speed, an unfiltered one is not.
        speed = min(speed, travel_mm / travelled_s)
        # A difference of two depths has 1.4 times the noise of one.
        noise_mm_s = max(noise_mm_s, 1.4 * block.depth_std_mm / travelled_s)
    loss = 1.0 - speed / max(speed_before, 1e-3)
    # Relative fall that braking explains, per fraction of the speed lost, less of a
    # large fall: more than 1, since the speed is late and travel shows its mean
    explained = 2.0 if fall_N > 0.3 * force_N else 3.0
    # A smaller loss is noise of the speed, two deviations, or of the force's model.
    least_loss = max(2.0 * noise_mm_s / max(speed_before, 1e-3), 0.02)
    return loss > least_loss and fall_N < explained * loss * force_N
