"""The mixture: hypotheses of which ruptures there have been, weighed by their evidence.

Each component is one hypothesis: a Kalman filter on the twenty unknowns of the force,
with a weight. A block is a group of successive samples, usually 2 to 10 ms long, of
which the mixture sees the means (`Block`). `learner.Learner` calls 1 to 3,
`method.MixtureMethod` 4:

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

What the weights say of ruptures is left to `decisions`.

Lengths are in mm, speeds in mm/s, forces in N.
"""

import math
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar, cast

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
    COLOURED_NOISE_S,
    RandomMotion,
    breathing_step,
    heartbeat_step,
    smooth_walk_step,
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

MAX_BRANCH_MM = 1.0
"""Maximum travel for which one call of `branch` counts the probability of events."""

RUPTURES_PER_MM = 0.02
"""Prior rate of ruptures per travel: chosen, one in 50 mm."""

RELEASES_MM = np.array([0.15, 0.3, 0.5, 1.0, 1.5, 2.0])
"""Travel of a release, one hypothesis each: gels take 0.1 to 0.5 mm, real liver up to 2
mm."""

NO_RELEASES_MM = np.array([0.3])
"""Placeholder for an event without a release: one entry, so one child. Its value has no
effect."""

MIN_RELEASE_MM = 0.3
"""Minimum travel after a rupture before its hypothesis may have children: until then
the force does not show what the rupture was."""

FADING_PROBABILITY = 0.2
"""Where one layer ends at another: prior fraction of cases in which part of the tip
force is kept and fades."""

AIR_FRACTION = 0.25
"""Prior fraction of layer ends that lead into free air."""

GAP_OF_AIR_FRACTION = 0.1
"""Rate of contacts behind a layer that ended in air, as a fraction of the rate of the
first contact: gaps of air are rare."""

MIN_GAP_OF_AIR_MM = 3.0
"""Minimum travel in air before another layer may begin."""

CONTACT_LAYER_FRACTION = 0.7
"""Prior fraction of contacts that cut into a layer at once."""

CONTACT_MEMBRANE_FRACTION = 0.3
"""Prior fraction of contacts that push a membrane first."""

MIN_CONTACT_DEFLECTION = 0.3
"""Minimum presliding deflection of a needle that may meet tissue."""

MEMBRANES_PER_RUPTURE = 0.15
"""Prior number of membranes met under a layer, per rupture."""

MEMBRANE_STEP_MM = 0.25
"""Travel between hypotheses of a membrane met."""

MIN_LAYER_ABOVE_MEMBRANE_MM = 2.0
"""Minimum travel in a layer before a membrane may be met under it."""

MIN_BETWEEN_RUPTURES_MM = 1.2
"""Minimum travel between a rupture and the event before it: about a needle diameter."""

MAX_RECENT = 60
"""Maximum number of components kept with a recent event."""

MAX_RECENT_MEMBRANES = 8
"""Maximum number kept with a membrane just met."""

MAX_OLD = 16
"""Maximum number kept with older events."""

MAX_OLD_MEMBRANES = 6
"""Maximum number kept with older membranes."""

QUOTAS = (MAX_RECENT, MAX_RECENT_MEMBRANES, MAX_OLD, MAX_OLD_MEMBRANES)
"""Maximum number of components kept of each class. What an event was shows only some
tenths of a millimetre later; until then its class protects it."""

RECENT_MM = 0.4
"""Travel for which an event is recent."""

RECENT_MEMBRANE_MM = 1.5
"""Travel for which a membrane is just met."""

MAX_KEPT = sum(QUOTAS)
"""Maximum number of components kept by pruning."""

CAPACITY = MAX_KEPT + 120
"""Maximum number of components before pruning: room for children of two branchings."""

MIN_LOG_WEIGHT = -30.0
"""A component with a smaller logarithm of its weight is dropped."""

MAX_PARENT_LOG_WEIGHT_GAP = 25.0
"""A parent's log weight lies less than this below the largest."""

TIP_STATES = 6
"""States of the tip: three media, each with force held or without."""

INITIAL_OFFSET_STD_N = 5.0
"""Standard deviation of the force in free air before the first sample."""

OFFSET_WALK_N2_PER_S = 1e-6
"""Random walk of the sensor's zero, as a variance per time."""

RELEASE_SHAPE_ERROR = 0.08
"""Relative error of a release's shape."""

RELEASE_SHAPE_MM = 0.02
"""Correlation length of that error."""

ONSET_ERROR = 0.1
"""Relative error of the cutting force's onset."""

LIKELIHOOD_EXPONENT = 0.5
"""Exponent of the likelihood: errors of the model are alike from one block to the
next."""

STUDENT_FREEDOM = 8.0
"""Degrees of freedom of Student's t: a single outlier proves little."""

ZERO_FORCE_STD_N = 0.02
"""Standard deviation with which a negative cutting force or friction is set to 0."""

ZERO_STIFFNESS_STD_N_PER_MM = 0.002
"""Standard deviation with which a negative stiffness is set to 0."""

FRACTION_TRAVEL_MM = 1.0
"""Minimum travel since the last event before `use_friction_fraction` is tried: it then
applies the prior once the growth of the force is known."""

MAX_FRACTION_TRAVEL_MM = 10.0
"""Travel from which on it applies the prior in any case."""

RELEASE_CHECK_MM = 0.1
"""Travel behind a release at which its size is checked."""

MIN_RELEASED_FRACTION = 0.12
"""Minimum fraction that a rupture releases, of the force of tip and layer before it."""

MIN_RELEASED_SIGMAS = 2.0
"""Minimum force that a rupture releases, in standard deviations of a block's force."""

SMALL_RELEASE_PENALTY = 12.0
"""Reduction of the log weight where less was released, or where a rupture is doubted:
then it was no rupture."""

SIGN_TRAVEL_MM = 2.0
"""Travel since the last event beyond which the signs of stiffness and friction are
checked."""

MIN_FRICTION_N_PER_MM = -0.003
"""Minimum friction per length of shaft: slightly negative, since noise may make it
so."""

SIGN_PENALTY = 0.1
"""Reduction of the log weight per block with negative stiffness or friction."""

MAX_PUSHED_MM = 12.0
"""Maximum travel that a membrane is pushed in without a penalty: it should have
ruptured before."""

PUSHED_PENALTY = 0.3
"""Reduction of the log weight per `PUSHED_STEP_MM` of travel beyond that."""

PUSHED_STEP_MM = 0.04
"""Travel that this penalty refers to."""

MAX_PUSHED_STEPS = 2.0
"""Maximum number of such steps that count in one block."""

SYMMETRY_TOLERANCE = 1e-3
"""Maximum difference of a restored covariance from its transpose, relative to the
standard deviations."""

Record = TypeVar("Record")

Rows = NDArray[np.int64]
"""Row numbers of components, shape (m,)."""


def _probabilities(log_weights: Array) -> Array:
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


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
        return _probabilities(self.log_weights)

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """The five arrays; the records are arrays too."""
        return cast(Any, self)[:]

    def first(self, size: int) -> "Mixture":
        """Return the first components, in the same memory."""
        return Mixture(
            means=self.means[:size],
            covariances=self.covariances[:size],
            log_weights=self.log_weights[:size],
            assumptions=self.assumptions[:size],
            history=self.history[:size],
        )

    @property
    def state(self) -> "MixtureState":
        """The same as plain arrays, in memory of their own."""
        return MixtureState(
            self.means.copy(),
            self.covariances.copy(),
            self.log_weights.copy(),
            numbers_of(self.assumptions),
            numbers_of(self.history),
        )


def numbers_of(records: list[Any]) -> Array:
    """Return the fields of n records of numbers as an array of its own, (n, m)."""
    return np.array(records).view(np.float64).reshape(len(records), -1)


def records_of(kind: type[Record], numbers: Array) -> list[Record]:
    """Return n records with the fields that an array holds, shape (n, m)."""
    records = record_array(kind, len(numbers))
    names = [field.name for field in fields(cast(Any, kind))]
    for name, column in zip(names, numbers.T, strict=True):
        read_column(records, name)[:] = column
    return records


def empty_mixture(size: int) -> Mixture:
    """Return room for so many components."""
    return Mixture(
        means=np.zeros((size, UNKNOWNS)),
        covariances=np.zeros((size, UNKNOWNS, UNKNOWNS)),
        log_weights=np.zeros(size),
        assumptions=record_array(Assumptions, size),
        history=record_array(History, size),
    )


class MixtureState(NamedTuple):
    """A mixture of n components as plain arrays, for snapshots.

    Attributes:
        means: Of the unknowns, shape (n, 20).
        covariances: Theirs, shape (n, 20, 20).
        log_weights: Logarithm of each one's probability, shape (n,).
        assumptions: Fields of `Assumptions`, shape (n, 10).
        history: Fields of `History`, shape (n, 16).
    """

    means: Array
    covariances: Array
    log_weights: Array
    assumptions: Array
    history: Array

    GROWING = ("means", "covariances", "log_weights", "assumptions", "history")

    @property
    def mixture(self) -> Mixture:
        """The mixture, in memory of its own."""
        return Mixture(
            np.array(self.means),
            np.array(self.covariances),
            np.array(self.log_weights),
            records_of(Assumptions, self.assumptions),
            records_of(History, self.history),
        )

    def find_damage(self) -> str:
        """Return what is wrong with the arrays, if anything.

        It is asked before compiled code reads them.
        """
        n = len(self.log_weights)
        expected = [
            (n, UNKNOWNS),
            (n, UNKNOWNS, UNKNOWNS),
            (n,),
            (n, len(fields(Assumptions))),
            (n, len(fields(History))),
        ]
        shapes = [np.shape(array) for array in self]
        if not 1 <= n <= CAPACITY or shapes != expected:
            return f"its arrays have shapes {shapes}"
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", self.covariances), 1e-300))
        scaled = self.covariances / (scale[:, :, None] * scale[:, None, :])
        transposed = scaled.transpose(0, 2, 1)
        if not np.allclose(scaled, transposed, rtol=0.0, atol=SYMMETRY_TOLERANCE):
            return "its covariances are not symmetric"
        assumptions = Assumptions(*self.assumptions.T)
        is_medium = np.isin(assumptions.medium, (AIR, LAYER, MEMBRANE))
        has_length = np.asarray(assumptions.release_length_mm) > 0.0
        is_possible = is_medium & has_length
        return "" if is_possible.all() else "its assumptions are impossible"


def first_mixture() -> Mixture:
    """Return one component: the tip is in free air, the offset unknown."""
    covariances = np.zeros((1, UNKNOWNS, UNKNOWNS))
    covariances[0, OFFSET, OFFSET] = INITIAL_OFFSET_STD_N**2
    assumptions = record_array(Assumptions, 1)
    read_column(assumptions, "release_start_mm")[:] = NO_RELEASE_MM
    read_column(assumptions, "release_length_mm")[:] = 1.0
    return Mixture(
        means=np.zeros((1, UNKNOWNS)),
        covariances=covariances,
        log_weights=np.zeros(1),
        assumptions=assumptions,
        history=record_array(History, 1),
    )


class ProcessNoise(NamedTuple):
    """What may change over a block, beside events.

    Attributes:
        duration_s: Length of the block.
        fresh_travel_mm: Its travel beyond the deepest point so far.
        held_variance: Variance that the cutting force gains [N²].
        coloured_variance: Stationary variance of the coloured noise [N²].
        heartbeat_variance: Of the force by the heartbeat [N²].
        breathing_variance: Of the force by breathing [N²].
        model_error_variance: Of the force model's error [N²].
    """

    duration_s: float
    fresh_travel_mm: float
    held_variance: float
    coloured_variance: float
    heartbeat_variance: float
    breathing_variance: float
    model_error_variance: float


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
    a = step.transition.value_by_value
    b = step.transition.value_by_rate
    c = step.transition.rate_by_value
    d = step.transition.rate_by_rate
    second = first + 1
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
    covariance[first, first] += step.value_variance
    covariance[first, second] += step.covariance
    covariance[second, first] += step.covariance
    covariance[second, second] += step.rate_variance


@compiled
def predict(mixture: Mixture, size: int, noise: ProcessNoise) -> None:
    """Move the unknowns of the first `size` components on by a block."""
    duration_s = noise.duration_s
    decay = math.exp(-duration_s / COLOURED_NOISE_S)
    coloured_variance = (1.0 - decay**2) * noise.coloured_variance
    heartbeat = heartbeat_step(duration_s, noise.heartbeat_variance)
    breathing = breathing_step(duration_s, noise.breathing_variance)
    model_error = smooth_walk_step(
        noise.fresh_travel_mm, MODEL_ERROR_MM, noise.model_error_variance
    )
    for k in range(size):
        mean = mixture.means[k]
        covariance = mixture.covariances[k]
        mean[COLOURED_NOISE] *= decay
        for j in range(UNKNOWNS):
            covariance[j, COLOURED_NOISE] *= decay
        for j in range(UNKNOWNS):
            covariance[COLOURED_NOISE, j] *= decay
        covariance[OFFSET, OFFSET] += OFFSET_WALK_N2_PER_S * duration_s
        if mixture.assumptions[k].medium != AIR:
            covariance[HELD, HELD] += noise.held_variance
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
    variance += (ONSET_ERROR * mean[HELD] * before_onset) ** 2
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
    # Degrees of freedom of Student's t for the last blocks: nearly normal
    recent_freedom = 30.0
    # So long a block counts as one of the last: a rupture's fall and the sensor's lag
    recent_s = 0.1
    largest = -math.inf
    for k in range(size):
        largest = max(largest, mixture.log_weights[k])
    total_weight = 0.0
    mean_innovation = 0.0
    mean_square = 0.0
    travel = abs(block.speed_mm_s) * block.duration_s
    errors = RELEASE_SHAPE_MM / max(travel, 0.1 * RELEASE_SHAPE_MM)
    shape_error = RELEASE_SHAPE_ERROR * math.sqrt(max(errors, 1.0))
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
        tempered = LIKELIHOOD_EXPONENT * log_likelihood
        mixture.log_weights[k] += tempered
        in_full = -0.5 * (
            math.log(total_variance)
            + (recent_freedom + 1.0) * math.log1p(surprise / recent_freedom)
        )
        history.recent_log *= math.exp(-block.duration_s / recent_s)
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
    cross_covariance = np.zeros(UNKNOWNS)
    for i in range(UNKNOWNS):
        cross_covariance[i] = covariance[i, index]
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
    log_weight += set_to_zero(mean, covariance, STIFFNESS, ZERO_STIFFNESS_STD_N_PER_MM)
    if assumption.medium == LAYER:
        # With its onset a negative cutting force would look like a slow release.
        log_weight += set_to_zero(mean, covariance, HELD, ZERO_FORCE_STD_N)
    return log_weight


@compiled_inside
def is_release_over(assumption: Assumptions, block: Block) -> bool:
    """Return whether a release that has not been checked yet is over."""
    end_mm = assumption.release_start_mm + assumption.release_length_mm
    is_over = block.depth_mm > end_mm + RELEASE_CHECK_MM
    return assumption.unchecked_force_N > 0.0 and is_over


@compiled_inside
def is_release_too_small(mean: Vector, assumption: Assumptions, block: Block) -> bool:
    """Return whether a release that is over released less than a rupture does."""
    if not is_release_over(assumption, block):
        return False
    released = mean[RELEASED] - mean[FADING]
    fraction = MIN_RELEASED_FRACTION * assumption.unchecked_force_N
    return released < max(fraction, MIN_RELEASED_SIGMAS * block.noise_std_N)


@compiled_inside
def has_negative_stiffness_or_friction(
    mean: Vector, covariance: WrittenMatrix, assumption: Assumptions, block: Block
) -> bool:
    """Return whether the stiffness or the layer's friction is negative beyond noise."""
    travel = block.depth_mm - assumption.tip_start_mm
    if assumption.medium == AIR or travel <= SIGN_TRAVEL_MM:
        return False
    std = math.sqrt(max(covariance[STIFFNESS, STIFFNESS], 0.0))
    friction = mean[LAYER_COULOMB] + mean[LAYER_VISCOUS] * block.speed_mm_s
    return mean[STIFFNESS] + 2.0 * std < 0.0 or friction < MIN_FRICTION_N_PER_MM


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
        is_fraction_due = assumption.prior_speed_mm_s > 0.0
        if is_advancing and is_fraction_due and travel > FRACTION_TRAVEL_MM:
            is_late = travel >= MAX_FRACTION_TRAVEL_MM
            speed = block.speed_mm_s
            prior_speed = assumption.prior_speed_mm_s
            if use_friction_fraction(mean, covariance, speed, prior_speed, is_late):
                assumption.prior_speed_mm_s = 0.0
        log_weight = constrain_sign(mean, covariance, assumption)
        log_weight = mixture.log_weights[k] + log_weight
        if is_release_too_small(mean, assumption, block):
            log_weight -= SMALL_RELEASE_PENALTY
        if is_release_over(assumption, block):
            assumption.unchecked_force_N = 0.0
        if has_negative_stiffness_or_friction(mean, covariance, assumption, block):
            log_weight -= SIGN_PENALTY
        if assumption.medium == MEMBRANE and travel > MAX_PUSHED_MM:
            pushed_mm = block.duration_s * max(block.speed_mm_s, 0.0)
            steps = min(pushed_mm / PUSHED_STEP_MM, MAX_PUSHED_STEPS)
            log_weight -= PUSHED_PENALTY * steps
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
    if block.deflection < MIN_CONTACT_DEFLECTION and not block.is_swing:
        return size
    if assumption.ruptures > 0.0:
        probability *= GAP_OF_AIR_FRACTION
        if block.depth_mm < assumption.release_start_mm + MIN_GAP_OF_AIR_MM:
            return size
    layer = CONTACT_LAYER_FRACTION * probability
    event = Event(CONTACT, LAYER, False, NO_RELEASES_MM, layer)
    size = add_children(mixture, parent, size, event, block, reported, tissue_speed_std)
    membrane = CONTACT_MEMBRANE_FRACTION * probability
    event = Event(CONTACT, MEMBRANE, False, NO_RELEASES_MM, membrane)
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
    end = probability / len(RELEASES_MM)
    further = end * (1.0 - AIR_FRACTION)
    if mixture.assumptions[parent].medium != LAYER:
        event = Event(LAYER_END, LAYER, False, RELEASES_MM, further)
        return add_children(
            mixture, parent, size, event, block, reported, tissue_speed_std
        )
    fading = further * FADING_PROBABILITY
    whole = further * (1.0 - FADING_PROBABILITY)
    event = Event(LAYER_END, LAYER, False, RELEASES_MM, whole)
    size = add_children(mixture, parent, size, event, block, reported, tissue_speed_std)
    event = Event(LAYER_END, LAYER, True, RELEASES_MM, fading)
    size = add_children(mixture, parent, size, event, block, reported, tissue_speed_std)
    event = Event(LAYER_END, AIR, False, RELEASES_MM, end * AIR_FRACTION)
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
            start_mm = assumption.layer_start_mm + MIN_LAYER_ABOVE_MEMBRANE_MM
            is_deep = block.depth_mm > start_mm
            is_known = assumption.prior_speed_mm_s == 0.0
            if medium == LAYER and is_membrane_due and is_deep and is_known:
                rate = MEMBRANES_PER_RUPTURE * MEMBRANE_STEP_MM * RUPTURES_PER_MM
                event = Event(MEMBRANE_MET, MEMBRANE, False, NO_RELEASES_MM, rate)
                size = add_children(
                    mixture, parent, size, event, block, reported, tissue_speed_std
                )
    return size


@compiled_inside
def choose_parents(mixture: Mixture, size: int, depth_mm: float) -> Rows:
    """Return the likeliest component's row for each tip state, the likeliest first.

    Of the first `size` components.

    Components whose last release is not over are left out: until then the force does
    not show what the rupture was.
    """
    best = np.full(TIP_STATES, -1)
    max_log_weight = mixture.log_weights[0]
    for k in range(size):
        max_log_weight = max(max_log_weight, mixture.log_weights[k])
    min_log_weight = max_log_weight - MAX_PARENT_LOG_WEIGHT_GAP
    for k in range(size):
        assumption = mixture.assumptions[k]
        release_mm = max(assumption.release_length_mm, MIN_RELEASE_MM)
        is_over = depth_mm > assumption.release_start_mm + release_mm
        log_weight = mixture.log_weights[k]
        if is_over and log_weight > min_log_weight:
            state = int(2.0 * assumption.medium + assumption.holds_force)
            if best[state] < 0 or log_weight > mixture.log_weights[best[state]]:
                best[state] = k
    best_log_weights = np.full(TIP_STATES, -math.inf)
    count = 0
    for state in range(TIP_STATES):
        if best[state] >= 0:
            best_log_weights[state] = mixture.log_weights[best[state]]
            count += 1
    order = sort_descending(best_log_weights)
    rows = np.zeros(count, dtype=np.int64)
    for k in range(count):
        rows[k] = best[order[k]]
    return rows


class Ranking(NamedTuple):
    """The components to keep.

    Attributes:
        rows: Their rows, the likeliest first, shape (m,).
        log_weights: Logarithms of their probabilities, normalised, shape (m,).
    """

    rows: Rows
    log_weights: Array


@compiled
def rank(mixture: Mixture, depth_mm: float) -> tuple[Rows, Array]:
    """Return the fields of a `Ranking`, within the quota of each class."""
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
        if log_weight <= MIN_LOG_WEIGHT:
            break
        assumption = mixture.assumptions[k]
        is_membrane = assumption.medium == MEMBRANE
        recent_mm = RECENT_MEMBRANE_MM if is_membrane else RECENT_MM
        is_old = depth_mm - assumption.tip_start_mm >= recent_mm
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
    """

    def __init__(self, mixture: Mixture) -> None:
        self.store = empty_mixture(CAPACITY)
        self._other = empty_mixture(CAPACITY)
        self.size = mixture.size
        for room, array in zip(self.store.arrays, mixture.arrays, strict=True):
            room[: self.size] = array

    @property
    def mixture(self) -> Mixture:
        """The components as they are now, not to be kept."""
        return self.store.first(self.size)

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
        begin_mm = max(before_mm, block.depth_mm - MAX_BRANCH_MM)
        travel_mm = max(block.depth_mm - begin_mm, MIN_BRANCH_MM)
        is_membrane_due = _membrane_step(block.depth_mm) != _membrane_step(before_mm)
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
        ranking = Ranking(*rank(mixture, depth_mm))
        size = len(ranking.rows)
        arrays = zip(mixture.arrays, self._other.arrays, strict=True)
        for source, target in arrays:
            source.take(ranking.rows, axis=0, out=target[:size], mode="clip")
        self._other.log_weights[:size] = ranking.log_weights
        self.store, self._other = self._other, self.store
        self.size = size


def _membrane_step(depth_mm: float) -> int:
    """Return the number of the step of travel in which one membrane may be met."""
    return int(depth_mm / MEMBRANE_STEP_MM)
