"""The mixture: hypotheses of which ruptures there have been, weighed by their evidence.

Each component is one hypothesis: a Kalman filter on the twenty unknowns of the force,
with a weight. A block is a group of successive samples, usually 2 to 10 ms long, of
which the mixture sees the means (`Block`). `learner.Learner` calls all four:

1. `predict`, for every block: the unknowns go on by the block's time and travel.
2. `correct` and `penalise_implausible`, unless the needle is in tissue and does not
   advance, the force is pulled, or the block is a gap in the samples: components learn
   from the force.
3. `MixtureMemory.branch`, some samples later, where the needle advances fast enough
   and `MIN_BRANCH_MM` beyond the last call; for a gap twice. It picks parents, the
   likeliest component in each state of the tip, and gives each parent children: one
   for each event that may have happened and each length of its release.
4. `MixtureMemory.prune`, after each corrected block: it drops components that the force
   speaks against, and the least likely of each class. A class is new or old events,
   with or without a membrane: each has its own quota, since what an event was may show
   only at the next one.

What the weights say of ruptures is left to `evidence`.

Lengths are in mm, speeds in mm/s, forces in N.
"""

import math
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import (
    Array,
    Vector,
    WrittenBlocks,
    WrittenMatrix,
    WrittenVector,
)
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import dot, sort_descending
from foundation.records import read_column, record_array
from identification.mixture.block import Block
from identification.mixture.disturbances import (
    BREATHING_DAMPING,
    BREATHING_HZ,
    COLOURED_NOISE_S,
    HEARTBEAT_DAMPING,
    HEARTBEAT_HZ,
    RandomMotion,
    driven,
    oscillation,
    smooth_walk,
)
from identification.mixture.events import (
    CONTACT,
    LAYER_END,
    MEMBRANE_MET,
    Event,
    Gaussian,
    History,
    apply_event,
    record_contact,
    record_membrane,
    record_rupture,
    record_section,
    update_assumption,
)
from identification.mixture.force_model import (
    AIR,
    BREATHING,
    COLOURED_NOISE,
    CUTTING_ONSET_MM,
    FADING,
    FRICTION_LAST,
    HEARTBEAT,
    HELD,
    LAYER,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    MEMBRANE,
    MODEL_ERROR,
    MODEL_ERROR_MM,
    NO_RELEASE_MM,
    OFFSET,
    RELEASE_STRETCH,
    RELEASED,
    STIFFNESS,
    TIP_BEGIN,
    TRAVERSED_COULOMB,
    UNKNOWNS,
    Assumptions,
    regressor,
)
from identification.mixture.kalman import times, update
from identification.mixture.priors import use_friction_fraction

MIN_BRANCH_MM = 0.02
"""Minimum travel between two calls of `branch`."""

RUPTURES_PER_MM = 0.02
"""Prior rate of ruptures per travel: chosen, one in 50 mm."""

RELEASES_MM = np.array([0.15, 0.3, 0.5, 1.0, 1.5, 2.0])
"""Travel of a release, one hypothesis each: gels take 0.1 to 0.5 mm, real liver up to 2
mm."""

NO_RELEASES_MM = np.array([0.3])
"""Placeholder for an event without a release: one entry, so one child. Its value has no
effect."""

MEMBRANE_STEP_MM = 0.25
"""Travel between hypotheses of a membrane met."""

MIN_BETWEEN_RUPTURES_MM = 1.2
"""Minimum travel between a rupture and the event before it: about a needle diameter."""

QUOTAS = (60, 8, 16, 6)
"""Maximum number of components kept of each class: with a recent event, with a membrane
just met, with older events, with older membranes. What an event was shows only some
tenths of a millimetre later; until then its class protects it."""

MAX_KEPT = sum(QUOTAS)
"""Maximum number of components kept by pruning."""

CAPACITY = MAX_KEPT + 120
"""Maximum number of components before pruning: room for children of two branchings."""

STUDENT_FREEDOM = 8.0
"""Degrees of freedom of Student's t: a single outlier proves little."""

ZERO_FORCE_STD_N = 0.02
"""Standard deviation with which a negative cutting force or friction is set to 0."""

SMALL_RELEASE_PENALTY = 12.0
"""Reduction of the log weight where less was released, or where a rupture is doubted:
then it was no rupture."""

Rows = NDArray[np.int64]
"""Row numbers of components, shape (m,)."""


class Mixture(NamedTuple):
    """n components, once pruned the likeliest first; never more than `CAPACITY`.

    Attributes:
        means: Of the unknowns, shape (n, 20).
        covariances: Theirs, shape (n, 20, 20).
        log_weights: Logarithm of each one's probability, shape (n,).
        assumptions: What each one assumes, records, shape (n,).
        history: Record of each one's past, records, shape (n,).
    """

    means: WrittenMatrix
    covariances: WrittenBlocks
    log_weights: WrittenVector
    assumptions: list[Assumptions]
    history: list[History]

    @property
    def size(self) -> int:
        """Number of components."""
        return len(self.log_weights)

    @property
    def weights(self) -> Array:
        """Probabilities, shape (n,)."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        return weights / weights.sum()

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """The five arrays; the records are arrays too."""
        return cast(Any, self)[:]

    @property
    def state(self) -> tuple[Array, ...]:
        """Copies of the five arrays, of records the rows of their numbers, (n, m)."""
        return tuple(
            array.copy().view(np.float64).reshape(len(array), -1)
            if array.dtype.names
            else array.copy()
            for array in self.arrays
        )


def empty_mixture(size: int) -> Mixture:
    """Return room for so many components."""
    return Mixture(
        means=np.zeros((size, UNKNOWNS)),
        covariances=np.zeros((size, UNKNOWNS, UNKNOWNS)),
        log_weights=np.zeros(size),
        assumptions=record_array(Assumptions, size),
        history=record_array(History, size),
    )


def first_mixture() -> Mixture:
    """Return one component: the tip is in free air, the offset unknown."""
    mixture = empty_mixture(1)
    mixture.covariances[0, OFFSET, OFFSET] = 5.0**2  # N²
    read_column(mixture.assumptions, "release_start_mm")[:] = NO_RELEASE_MM
    read_column(mixture.assumptions, "release_length_mm")[:] = 1.0
    return mixture


@compiled
def move(
    mean: WrittenVector, covariance: WrittenMatrix, first: int, step: RandomMotion
) -> None:
    """Move two neighbouring unknowns on, a value and its rate.

    Args:
        mean: Of all unknowns, shape (20,).
        covariance: Theirs, shape (20, 20).
        first: Index of the value; that of the rate follows it.
        step: How both go on.
    """
    second = first + 1
    a = step.transition[0, 0]
    b = step.transition[0, 1]
    c = step.transition[1, 0]
    d = step.transition[1, 1]
    value = mean[first]
    rate = mean[second]
    mean[first] = a * value + b * rate
    mean[second] = c * value + d * rate
    for j in range(UNKNOWNS):
        value = covariance[first, j]
        rate = covariance[second, j]
        covariance[first, j] = a * value + b * rate
        covariance[second, j] = c * value + d * rate
    for j in range(UNKNOWNS):
        value = covariance[j, first]
        rate = covariance[j, second]
        covariance[j, first] = a * value + b * rate
        covariance[j, second] = c * value + d * rate
    covariance[first : first + 2, first : first + 2] += step.noise


@compiled
def predict(
    mixture: Mixture,
    size: int,
    duration_s: float,
    fresh_travel_mm: float,
    held_variance: float,
    coloured_variance: float,
    heartbeat_variance: float,
    breathing_variance: float,
    model_error_variance: float,
) -> None:
    """Move the unknowns of the first `size` components on by a block.

    Args:
        mixture: Whose components are changed.
        size: How many there are.
        duration_s: Length of the block.
        fresh_travel_mm: Its travel beyond the deepest point so far.
        held_variance: Variance that the cutting force gains [N²].
        coloured_variance: Stationary variance of the coloured noise [N²].
        heartbeat_variance: Of the force by the heartbeat [N²].
        breathing_variance: Of the force by breathing [N²].
        model_error_variance: Of the force model's error [N²].
    """
    zero_walk_N2 = 1e-6 * duration_s  # random walk of the sensor's zero
    decay = math.exp(-duration_s / COLOURED_NOISE_S)
    coloured_variance *= 1.0 - decay**2
    heartbeat = driven(
        oscillation(duration_s, HEARTBEAT_HZ, HEARTBEAT_DAMPING),
        2.0 * math.pi * HEARTBEAT_HZ,
        heartbeat_variance,
    )
    breathing = driven(
        oscillation(duration_s, BREATHING_HZ, BREATHING_DAMPING),
        2.0 * math.pi * BREATHING_HZ,
        breathing_variance,
    )
    model_error = driven(
        smooth_walk(fresh_travel_mm, MODEL_ERROR_MM),
        1.0 / MODEL_ERROR_MM,
        model_error_variance,
    )
    for k in range(size):
        mean = mixture.means[k]
        covariance = mixture.covariances[k]
        mean[COLOURED_NOISE] *= decay
        for j in range(UNKNOWNS):
            covariance[j, COLOURED_NOISE] *= decay
        for j in range(UNKNOWNS):
            covariance[COLOURED_NOISE, j] *= decay
        covariance[OFFSET, OFFSET] += zero_walk_N2
        if mixture.assumptions[k].medium != AIR:
            covariance[HELD, HELD] += held_variance
        covariance[COLOURED_NOISE, COLOURED_NOISE] += coloured_variance
        move(mean, covariance, HEARTBEAT, heartbeat)
        move(mean, covariance, BREATHING, breathing)
        move(mean, covariance, MODEL_ERROR, model_error)


@compiled
def force_variance(
    mean: Vector,
    row: Vector,
    assumption: Assumptions,
    block: Block,
    variance: float,
    shape_error: float,
) -> float:
    """Return the variance of a block's force, errors of its shape included.

    Args:
        mean: Of the unknowns, shape (20,).
        row: Regressor of the block, shape (20,).
        assumption: What the component assumes.
        block: Where the needle is.
        variance: Without errors of a release's and an onset's shape.
        shape_error: Relative error of a release's shape, over the block.
    """
    travel = max(block.depth_mm - assumption.tip_start_mm, 0.0)
    before_onset = max(1.0 - travel / CUTTING_ONSET_MM, 0.0)
    release_slope = 2.0 * mean[RELEASED] / assumption.release_length_mm
    variance += (shape_error * mean[RELEASED]) ** 2 * 2.0 * row[RELEASE_STRETCH]
    onset_error = 0.1 * mean[HELD] * before_onset  # of the cutting force's onset
    variance += onset_error**2
    variance += (release_slope * block.depth_std_mm) ** 2 * row[RELEASED]
    return variance


@compiled
def correct(
    mixture: Mixture, size: int, block: Block, variance: float
) -> tuple[float, float]:
    """Update the first `size` components, and their weights, with a block's force.

    The weight follows Student's t, so that one outlier proves little, and a component
    that is surprised learns less.

    Args:
        mixture: Whose components are changed.
        size: How many there are.
        block: Its force and place.
        variance: Of the block's force, that of the model's shape not included [N²].

    Returns:
        By what the force differs from the mixture's prediction, 0 without components,
        and the variance that was predicted of it [N, N²].
    """
    recent_freedom = 30.0  # of Student's t for the last blocks: nearly normal
    largest = -math.inf
    for k in range(size):
        largest = max(largest, mixture.log_weights[k])
    total_weight = 0.0
    mean_innovation = 0.0
    mean_square = 0.0
    travel = abs(block.speed_mm_s) * block.duration_s
    # Relative error of a release's shape is 0.08, and correlated over 0.02 mm.
    shape_error = 0.08 * math.sqrt(max(0.02 / max(travel, 0.1 * 0.02), 1.0))
    for k in range(size):
        mean = mixture.means[k]
        covariance = mixture.covariances[k]
        assumption = mixture.assumptions[k]
        history = mixture.history[k]
        history.min_force_N = min(history.min_force_N, block.force_N)
        row = regressor(assumption, block)
        noise = force_variance(mean, row, assumption, block, variance, shape_error)
        cross_covariance = times(covariance, row)
        total_variance = max(dot(row, cross_covariance), 0.0) + noise
        innovation = block.force_N - dot(row, mean)
        weight = math.exp(mixture.log_weights[k] - largest)
        total_weight += weight
        mean_innovation += weight * innovation
        mean_square += weight * (innovation * innovation + total_variance)
        surprise = innovation * innovation / total_variance
        log_likelihood = -0.5 * (
            math.log(total_variance)
            + (STUDENT_FREEDOM + 1.0) * math.log1p(surprise / STUDENT_FREEDOM)
        )
        tempered = 0.5 * log_likelihood  # errors are alike from one block to the next
        mixture.log_weights[k] += tempered
        in_full = -0.5 * (
            math.log(total_variance)
            + (recent_freedom + 1.0) * math.log1p(surprise / recent_freedom)
        )
        # A block is one of the last for 0.1 s: a rupture's fall and the sensor's lag.
        history.recent_log *= math.exp(-block.duration_s / 0.1)
        history.recent_log += in_full - tempered
        widening = (STUDENT_FREEDOM + surprise) / (STUDENT_FREEDOM + 1.0)
        total_variance *= max(widening, 1.0)
        update(mean, covariance, cross_covariance, innovation, total_variance)
    if total_weight == 0.0:
        return 0.0, 0.0
    mean_innovation /= total_weight
    return mean_innovation, mean_square / total_weight - mean_innovation**2


@compiled_inside
def set_to_zero(
    mean: WrittenVector, covariance: WrittenMatrix, index: int, zero_std: float
) -> float:
    """Set an unknown to zero where it is negative beyond its deviation.

    Returns:
        Change of the logarithm of the weight.
    """
    value = mean[index]
    variance = max(covariance[index, index], 0.0)
    if value >= -zero_std - math.sqrt(variance):
        return 0.0
    total_variance = variance + zero_std**2
    cross_covariance = covariance[:, index].copy()
    update(mean, covariance, cross_covariance, -value, total_variance)
    return -0.5 * value**2 / total_variance


@compiled_inside
def constrain_sign(
    mean: WrittenVector, covariance: WrittenMatrix, assumption: Assumptions
) -> float:
    """Set to zero what is negative but cannot be.

    Returns:
        Change of the logarithm of the weight.
    """
    log_weight = set_to_zero(mean, covariance, TRAVERSED_COULOMB, ZERO_FORCE_STD_N)
    log_weight += set_to_zero(mean, covariance, STIFFNESS, 0.002)  # N/mm
    if assumption.medium == LAYER:
        # With its onset a negative cutting force would look like a slow release.
        log_weight += set_to_zero(mean, covariance, HELD, ZERO_FORCE_STD_N)
    return log_weight


@compiled_inside
def penalise_release(mean: Vector, assumption: Assumptions, block: Block) -> float:
    """Return what the logarithm of the weight loses by a release that is too small.

    It is checked once, 0.1 mm behind its end.
    """
    end_mm = assumption.release_start_mm + assumption.release_length_mm
    force = assumption.unchecked_force_N
    if force <= 0.0 or block.depth_mm <= end_mm + 0.1:
        return 0.0
    assumption.unchecked_force_N = 0.0
    released = mean[RELEASED] - mean[FADING]
    # A rupture releases at least this fraction of the force of tip and layer before it,
    # and so many standard deviations of a block's force.
    least = max(0.12 * force, 2.0 * block.noise_std_N)
    return SMALL_RELEASE_PENALTY if released < least else 0.0


@compiled_inside
def has_negative_stiffness_or_friction(
    mean: Vector, covariance: WrittenMatrix, assumption: Assumptions, block: Block
) -> bool:
    """Return whether the stiffness or the layer's friction is negative beyond noise.

    It is asked 2 mm behind the last event.
    """
    travel = block.depth_mm - assumption.tip_start_mm
    if assumption.medium == AIR or travel <= 2.0:
        return False
    std = math.sqrt(max(covariance[STIFFNESS, STIFFNESS], 0.0))
    friction = mean[LAYER_COULOMB] + mean[LAYER_VISCOUS] * block.speed_mm_s
    return mean[STIFFNESS] + 2.0 * std < 0.0 or friction < -0.003


@compiled
def penalise_implausible(
    mixture: Mixture, size: int, block: Block, is_advancing: bool
) -> None:
    """Constrain the first `size` components, and lower weights of what no tissue does.

    Args:
        mixture: Whose components are changed.
        size: How many there are.
        block: The block that they have just learnt from.
        is_advancing: Whether the needle cuts further.
    """
    for k in range(size):
        mean = mixture.means[k]
        covariance = mixture.covariances[k]
        assumption = mixture.assumptions[k]
        travel = block.depth_mm - assumption.tip_start_mm
        prior_speed = assumption.prior_speed_mm_s
        # From 1 mm behind the last event on the prior of friction's fraction is tried,
        # once the growth of the force is known; from 10 mm on it applies anyway.
        if is_advancing and prior_speed > 0.0 and travel > 1.0:
            is_late = travel >= 10.0
            speed = block.speed_mm_s
            if use_friction_fraction(mean, covariance, speed, prior_speed, is_late):
                assumption.prior_speed_mm_s = 0.0
        log_weight = constrain_sign(mean, covariance, assumption)
        log_weight = mixture.log_weights[k] + log_weight
        log_weight -= penalise_release(mean, assumption, block)
        if has_negative_stiffness_or_friction(mean, covariance, assumption, block):
            log_weight -= 0.1
        if assumption.medium == MEMBRANE and travel > 12.0:  # it should have ruptured
            pushed_mm = block.duration_s * max(block.speed_mm_s, 0.0)
            log_weight -= 0.3 * min(pushed_mm / 0.04, 2.0)  # per 0.04 mm
        mixture.log_weights[k] = log_weight


@compiled_inside
def record_event(
    mixture: Mixture, row: int, parent: int, event: Event, block: Block, reported: int
) -> None:
    """Write a child's assumptions, and its history except for the friction record.

    Args:
        mixture: With room for the child.
        row: Of the child.
        parent: Row of its parent.
        event: What happens.
        block: Where.
        reported: Ruptures reported so far.
    """
    mixture.assumptions[row] = mixture.assumptions[parent]
    mixture.history[row] = mixture.history[parent]
    assumption = mixture.assumptions[parent]
    child = mixture.assumptions[row]
    history = mixture.history[row]
    update_assumption(child, assumption, event, block, reported)
    if event.kind == LAYER_END:
        regressors = regressor(assumption, block)
        force = 0.0
        for i in range(TIP_BEGIN, LAYER_VISCOUS + 1):  # tip and layer
            force += regressors[i] * mixture.means[parent, i]
        child.unchecked_force_N = force
        record_rupture(history, block)
    if event.kind == CONTACT:
        record_contact(history, block.depth_mm, assumption.ruptures == 0.0)


@compiled_inside
def record_end(
    history: History,
    assumption: Assumptions,
    before: Gaussian,
    after: Gaussian,
    start_mm: float,
    block: Block,
    reported: int,
) -> None:
    """Record what an event ends: a section of a layer, or a membrane met in air.

    Args:
        history: Of the child.
        assumption: What its parent assumes.
        before: Unknowns before the event.
        after: Unknowns after it.
        start_mm: Depth at which the section begins that entered since the last event.
        block: Where the event is.
        reported: Ruptures reported so far.
    """
    if assumption.medium == LAYER:
        if assumption.ruptures > reported:
            start_mm = history.section_start_mm
        friction = after.mean[FRICTION_LAST]
        record_section(history, before, start_mm, block.depth_mm, friction)
    elif assumption.medium == MEMBRANE and assumption.holds_force == 0.0:
        record_membrane(history, before, block.depth_mm - assumption.tip_start_mm)


@compiled_inside
def add_children(
    mixture: Mixture,
    parent: int,
    size: int,
    event: Event,
    block: Block,
    reported: int,
    tissue_speed_std: float,
) -> int:
    """Write what a component becomes by an event, once for each release length.

    Args:
        mixture: With room for the children, from row `size` on.
        parent: Row of the component.
        size: Number of components before.
        event: What happens.
        block: Where and how.
        reported: Ruptures reported so far.
        tissue_speed_std: Standard deviation of the tissue's own speed [mm/s].

    Returns:
        Number of components now.
    """
    old = Gaussian(mixture.means[parent], mixture.covariances[parent])
    assumption = mixture.assumptions[parent]
    start_mm = block.depth_mm
    if assumption.medium == LAYER:
        section_end_mm = mixture.history[parent].section_end_mm
        start_mm = max(assumption.layer_start_mm, section_end_mm)
    new_length = block.depth_mm - start_mm
    new = apply_event(
        old, assumption, event, block, new_length, reported, tissue_speed_std
    )
    # The first child is written whole, the others are copies with other lengths.
    record_event(mixture, size, parent, event, block, reported)
    record_end(mixture.history[size], assumption, old, new, start_mm, block, reported)
    log_weight = mixture.log_weights[parent] + math.log(event.probability)
    for i in range(len(event.release_lengths_mm)):
        row = size + i
        if i > 0:
            mixture.assumptions[row] = mixture.assumptions[size]
            mixture.history[row] = mixture.history[size]
        mixture.assumptions[row].release_length_mm = event.release_lengths_mm[i]
        for j in range(UNKNOWNS):
            mixture.means[row, j] = new.mean[j]
            for k in range(UNKNOWNS):
                mixture.covariances[row, j, k] = new.covariance[j, k]
        mixture.log_weights[row] = log_weight
    return size + len(event.release_lengths_mm)


@compiled_inside
def add_contacts(
    mixture: Mixture,
    parent: int,
    size: int,
    block: Block,
    probability: float,
    reported: int,
    tissue_speed_std: float,
) -> int:
    """Write what a component in free air may have become; see `branch_parents`."""
    assumption = mixture.assumptions[parent]
    if block.deflection < 0.3 and not block.is_swing:  # it hardly slides inwards
        return size
    if assumption.ruptures > 0.0:
        # Gaps of air are rare, and none is thin.
        probability *= 0.1
        if block.depth_mm < assumption.release_start_mm + 3.0:
            return size
    # Prior: 70 % of contacts cut into a layer at once, others push a membrane first.
    event = Event(CONTACT, LAYER, False, NO_RELEASES_MM, 0.7 * probability)
    size = add_children(mixture, parent, size, event, block, reported, tissue_speed_std)
    event = Event(CONTACT, MEMBRANE, False, NO_RELEASES_MM, 0.3 * probability)
    return add_children(mixture, parent, size, event, block, reported, tissue_speed_std)


@compiled_inside
def add_ends(
    mixture: Mixture,
    parent: int,
    size: int,
    block: Block,
    probability: float,
    reported: int,
    tissue_speed_std: float,
) -> int:
    """Write what a component in tissue may have become; see `branch_parents`."""
    air_fraction = 0.25  # prior, of layer ends that lead into free air
    # Prior, of ends at another layer at which part of the tip force is kept and fades
    fading_fraction = 0.2
    end = probability / len(RELEASES_MM)
    further = end * (1.0 - air_fraction)
    if mixture.assumptions[parent].medium != LAYER:
        event = Event(LAYER_END, LAYER, False, RELEASES_MM, further)
        return add_children(
            mixture, parent, size, event, block, reported, tissue_speed_std
        )
    whole = further * (1.0 - fading_fraction)
    event = Event(LAYER_END, LAYER, False, RELEASES_MM, whole)
    size = add_children(mixture, parent, size, event, block, reported, tissue_speed_std)
    event = Event(LAYER_END, LAYER, True, RELEASES_MM, further * fading_fraction)
    size = add_children(mixture, parent, size, event, block, reported, tissue_speed_std)
    event = Event(LAYER_END, AIR, False, RELEASES_MM, end * air_fraction)
    return add_children(mixture, parent, size, event, block, reported, tissue_speed_std)


@compiled
def branch_parents(
    mixture: Mixture,
    size: int,
    block: Block,
    probability: float,
    is_membrane_due: bool,
    reported: int,
    tissue_speed_std: float,
) -> int:
    """Write what the likeliest component of each tip state may have become.

    Args:
        mixture: With room for the children, from row `size` on.
        size: Number of components before.
        block: Where and how.
        probability: Prior probability of a rupture over the travel.
        is_membrane_due: Whether a membrane may have been met.
        reported: Ruptures reported so far.
        tissue_speed_std: Standard deviation of the tissue's own speed [mm/s].

    Returns:
        Number of components now.
    """
    for parent in choose_parents(mixture, size, block.depth_mm):
        assumption = mixture.assumptions[parent]
        medium = assumption.medium
        if medium == AIR:
            size = add_contacts(
                mixture, parent, size, block, probability, reported, tissue_speed_std
            )
        elif block.depth_mm > assumption.tip_start_mm + MIN_BETWEEN_RUPTURES_MM:
            size = add_ends(
                mixture, parent, size, block, probability, reported, tissue_speed_std
            )
            is_deep = block.depth_mm > assumption.layer_start_mm + 2.0
            is_known = assumption.prior_speed_mm_s == 0.0
            if medium == LAYER and is_membrane_due and is_deep and is_known:
                # Prior: 0.15 membranes are met under a layer per rupture.
                rate = 0.15 * MEMBRANE_STEP_MM * RUPTURES_PER_MM
                event = Event(MEMBRANE_MET, MEMBRANE, False, NO_RELEASES_MM, rate)
                size = add_children(
                    mixture, parent, size, event, block, reported, tissue_speed_std
                )
    return size


@compiled_inside
def choose_parents(mixture: Mixture, size: int, depth_mm: float) -> Rows:
    """Return the likeliest component's row for each tip state, the likeliest first.

    Only of the first `size` components.

    Components whose last release is not over are left out: until 0.3 mm after it the
    force does not show what the rupture was.
    """
    states = 6  # of the tip: three media, each with force held or without
    best = np.full(states, -1)
    best_log_weights = np.full(states, -math.inf)
    min_log_weight = mixture.log_weights[:size].max() - 25.0
    count = 0
    for k in range(size):
        assumption = mixture.assumptions[k]
        release_mm = max(assumption.release_length_mm, 0.3)
        is_over = depth_mm > assumption.release_start_mm + release_mm
        log_weight = mixture.log_weights[k]
        state = int(2.0 * assumption.medium + assumption.holds_force)
        if is_over and log_weight > max(min_log_weight, best_log_weights[state]):
            count += best[state] < 0
            best[state] = k
            best_log_weights[state] = log_weight
    return best[sort_descending(best_log_weights)[:count]]


@compiled
def rank(mixture: Mixture, depth_mm: float) -> tuple[Rows, Array]:
    """Return rows and log weights of components to keep, the likeliest first, (m,).

    Each class has its quota. The weights are normalised.
    """
    order = sort_descending(mixture.log_weights)
    max_log_weight = mixture.log_weights[order[0]]
    total = 0.0
    for log_weight in mixture.log_weights:
        total += math.exp(log_weight - max_log_weight)
    log_total = max_log_weight + math.log(total)
    rows = np.zeros(MAX_KEPT, dtype=np.int64)
    log_weights = np.zeros(MAX_KEPT)
    places = np.array(QUOTAS)
    size = 0
    for k in order:
        log_weight = mixture.log_weights[k] - log_total
        if log_weight <= -30.0:
            break
        assumption = mixture.assumptions[k]
        is_membrane = assumption.medium == MEMBRANE
        new_mm = 1.5 if is_membrane else 0.4
        is_old = depth_mm - assumption.tip_start_mm >= new_mm
        class_index = 2 * is_old + 1 * is_membrane  # in the order of QUOTAS
        if places[class_index] > 0:
            places[class_index] -= 1
            rows[size] = k
            log_weights[size] = log_weight
            size += 1
    return rows[:size], log_weights[:size]


class MixtureMemory:
    """Memory of a mixture that changes in place.

    Pruning copies what it keeps into a second one.

    Attributes:
        store: Room for components.
        size: How many there are.
    """

    def __init__(self, state: tuple[Array, ...]) -> None:
        self.store = empty_mixture(CAPACITY)
        self._other = empty_mixture(CAPACITY)
        self.size = len(state[0])
        for room, numbers in zip(self.store.arrays, state, strict=True):
            kept = room[: self.size]
            kept[:] = numbers.view(room.dtype).reshape(kept.shape)

    @property
    def mixture(self) -> Mixture:
        """The components as they are now, not to be kept."""
        first: list[Any] = [array[: self.size] for array in self.store.arrays]
        return Mixture(*first)

    def branch(
        self, block: Block, before_mm: float, tissue_speed_std: float, reported: int
    ) -> None:
        """Add components of what may have happened since the last call.

        Args:
            block: Where and how.
            before_mm: Depth at the last call.
            tissue_speed_std: Standard deviation of the tissue's own speed [mm/s].
            reported: Ruptures reported so far.
        """
        # One call counts the probability of events over 1 mm at most.
        begin_mm = max(before_mm, block.depth_mm - 1.0)
        travel_mm = max(block.depth_mm - begin_mm, MIN_BRANCH_MM)
        # In each step of travel one membrane may be met.
        step = int(block.depth_mm / MEMBRANE_STEP_MM)
        is_membrane_due = step != int(before_mm / MEMBRANE_STEP_MM)
        self.size = branch_parents(
            self.store,
            self.size,
            block,
            RUPTURES_PER_MM * travel_mm,
            is_membrane_due,
            reported,
            tissue_speed_std,
        )

    def prune(self, depth_mm: float) -> None:
        """Keep the likeliest components of each class, best first."""
        mixture = self.mixture
        rows, log_weights = rank(mixture, depth_mm)
        self.size = len(rows)
        for source, target in zip(mixture.arrays, self._other.arrays, strict=True):
            source.take(rows, axis=0, out=target[: self.size], mode="clip")
        self._other.log_weights[: self.size] = log_weights
        self.store, self._other = self._other, self.store
