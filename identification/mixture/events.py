"""Events: contact, end of a layer, a membrane met under a layer.

Each is a linear map of the unknowns, with noise for what the event leaves open:

    x' = transition x + noise

The unknowns change, but at the event itself the mean force that they predict does not.

After a rupture part of the tip force may remain: it outlasts the release and then fades
with travel (`FADING`). What pushes at the tip when a membrane is met under a layer
stays there until the membrane ruptures (`HELD`).

A rupture is *reported* once the caller has been told of it by an alarm, and until that
alarm is retracted. A hypothesis may count one rupture more than were reported.

When an event may begin a hypothesis, and which are dropped, is left to `mixture`.

Lengths are in mm, speeds in mm/s, forces in N.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from foundation.arrays import (
    Vector,
    WrittenMatrix,
    WrittenVector,
)
from foundation.jit import compiled_inside
from foundation.linear_algebra import dot, multiply_vector
from identification.mixture.block import Block
from identification.mixture.force_model import (
    CUTTING_ON_SHAFT,
    CUTTING_ON_SHAFT_STD,
    FADING,
    FRICTION_BEFORE,
    FRICTION_LAST,
    HELD,
    LAYER,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    MEMBRANE,
    MODEL_ERROR,
    MODEL_ERROR_FRACTION,
    MODEL_ERROR_MM,
    MODEL_ERROR_SLOPE,
    NO_RELEASE_MM,
    OFFSET,
    RELEASE_STRETCH,
    RELEASED,
    STIFFENING,
    STIFFNESS,
    TIP_BEGIN,
    TIP_END,
    TRAVERSED_COULOMB,
    TRAVERSED_ERROR_FRACTION,
    TRAVERSED_VISCOUS,
    UNKNOWNS,
    Assumptions,
    regressor,
    undecided_cutting,
)
from identification.mixture.kalman import map_rows
from identification.mixture.priors import (
    MIN_SPEED_MM_S,
    add_friction_prior,
    add_membrane_prior,
    add_stiffness_prior,
)

CONTACT = 0
"""The tip meets tissue: a layer, or a membrane."""

LAYER_END = 1
"""The tip ruptures the end of a layer, or punctures a membrane, and enters a layer or
air."""

MEMBRANE_MET = 2
"""The tip meets a membrane under the layer that it is in."""


class Event(NamedTuple):
    """What may have happened in a block.

    Attributes:
        kind: `CONTACT`, `LAYER_END` or `MEMBRANE_MET`.
        next_medium: What the tip is in afterwards: `AIR`, `LAYER` or `MEMBRANE`.
        keeps_force: Whether part of the tip force is kept: it outlasts the release and
            then fades.
        release_lengths_mm: Travels that the release may take, a hypothesis each.
        probability: Prior probability of each of these hypotheses.
    """

    kind: int
    next_medium: float
    keeps_force: bool
    release_lengths_mm: Vector
    probability: float


@dataclass(slots=True)
class History:
    """Record of a hypothesis's past, for reports and alarms.

    The regressor does not depend on it, as it does on `Assumptions`. All are floats, so
    that a record of them is a row of numbers. The section is the one whose friction is
    `FRICTION_LAST`.

    Attributes:
        rupture_s: Time of the last rupture.
        rupture_mm: Its depth.
        rupture_speed_mm_s: Its speed.
        rupture_force_N: Force before it.
        section_start_mm: Depth at which the section begins.
        section_end_mm: Depth at which it ends.
        section_friction_N: Its friction, as it was when the section ended.
        stiffness_N_per_mm: Of the layer before the last event.
        stiffness_variance: Variance of the stiffness.
        coulomb_N_per_mm: Coulomb friction per length in that layer.
        coulomb_variance: Variance of the Coulomb friction.
        viscous_Ns_per_mm2: Viscous friction per length in that layer.
        viscous_variance: Variance of the viscous friction.
        contact_mm: Depth of the first contact.
        min_force_N: Minimum force since the last rupture.
        recent_log: Logarithm of the likelihood of the last blocks beyond what the
            tempered weight counts.
    """

    rupture_s: float = 0.0
    rupture_mm: float = 0.0
    rupture_speed_mm_s: float = 0.0
    rupture_force_N: float = 0.0
    section_start_mm: float = 0.0
    section_end_mm: float = 0.0
    section_friction_N: float = 0.0
    stiffness_N_per_mm: float = 0.0
    stiffness_variance: float = 0.0
    coulomb_N_per_mm: float = 0.0
    coulomb_variance: float = 0.0
    viscous_Ns_per_mm2: float = 0.0
    viscous_variance: float = 0.0
    contact_mm: float = 0.0
    min_force_N: float = 0.0
    recent_log: float = 0.0


class LinearMap(NamedTuple):
    """How an event changes the unknowns: x' = transition x + noise.

    Attributes:
        transition: Shape (20, 20).
        variance: Of the noise, shape (20,).
        transfer_std: Standard deviation of the force that passes from the tip to the
            shaft: positive for the unknowns that gain it, negative for those that
            lose it, shape (20,). It is one error, so the unknowns are correlated.
    """

    transition: WrittenMatrix
    variance: WrittenVector
    transfer_std: WrittenVector


class Gaussian(NamedTuple):
    """Mean and covariance of the unknowns.

    Attributes:
        mean: Shape (20,).
        covariance: Shape (20, 20).
    """

    mean: WrittenVector
    covariance: WrittenMatrix


@compiled_inside
def take_tip_force(
    step: LinearMap, unknown: int, tip_row: Vector, fraction: float
) -> None:
    """Let an unknown take a fraction of the tip force at the event."""
    step.transition[unknown] = fraction * tip_row
    step.transfer_std[unknown] -= fraction * step.transfer_std[TRAVERSED_COULOMB]


@compiled_inside
def leave_undecided_cutting_on_shaft(
    step: LinearMap,
    mean: Vector,
    tip_row: WrittenVector,
    assumption: Assumptions,
    block: Block,
) -> None:
    """Leave the friction in the undecided cutting force on the shaft.

    What the release then takes shows how large it was: the error of what stays on the
    shaft is opposite to that of the tip force. Like `release_model_error`, this call
    writes `tip_row` and comes before all that uses it.
    """
    undecided, _ = undecided_cutting(assumption, block.depth_mm)
    on_shaft = CUTTING_ON_SHAFT * undecided
    tip_row[HELD] -= on_shaft
    step.transition[TRAVERSED_COULOMB, HELD] = on_shaft
    transfer_std = CUTTING_ON_SHAFT_STD * undecided * abs(mean[HELD])
    step.transfer_std[TRAVERSED_COULOMB] = transfer_std


@compiled_inside
def begin_contact(step: LinearMap, block: Block) -> None:
    """Begin a layer without friction; the shaft may have some from before."""
    step.transition[LAYER_COULOMB : LAYER_VISCOUS + 1] = 0.0
    unsettled = 0.0 if block.is_swing else 1.0 - block.deflection
    # The recording may begin inside tissue, with friction already there.
    initial_std = 0.2 * unsettled  # N
    step.variance[TRAVERSED_COULOMB] = initial_std**2


@compiled_inside
def release_model_error(
    step: LinearMap, mean: Vector, tip_row: WrittenVector, block: Block
) -> None:
    """Add the model's error to the tip force, and start a new error at zero.

    The error belonged to the tip force and is released with it. This call also writes
    `tip_row`, which then includes the error, and sets the variance of `RELEASE_STRETCH`
    from the tip force without it. So `map_event` calls it before `tip_row` is used.
    """
    tip_force = dot(tip_row, mean)
    # Prior standard deviation of the logarithm of a release's length, about the length
    # that a hypothesis assumes: 0.12
    step.variance[RELEASE_STRETCH] = (0.12 * tip_force) ** 2
    tip_row[MODEL_ERROR] = 1.0
    step.transition[MODEL_ERROR : MODEL_ERROR_SLOPE + 1] = 0.0
    shaft_friction = block.force_before_N - mean[OFFSET] - dot(tip_row, mean)
    error_std = MODEL_ERROR_FRACTION * TRAVERSED_ERROR_FRACTION * shaft_friction
    # Where the force falls, the hysteresis of torque sensors turns round: part of the
    # force's slow error is another one, until the joints have moved on.
    hysteresis_std = 0.25 * block.force_std_N  # chosen
    step.variance[MODEL_ERROR] = error_std**2 + hysteresis_std**2
    step.variance[MODEL_ERROR_SLOPE] = step.variance[MODEL_ERROR] / MODEL_ERROR_MM**2


@compiled_inside
def leave_friction_on_shaft(
    step: LinearMap, assumption: Assumptions, block: Block
) -> None:
    """Add the layer's friction to that of the layers traversed; the next has none."""
    step.transition[LAYER_COULOMB : LAYER_VISCOUS + 1] = 0.0
    if assumption.medium == LAYER:
        length = max(block.depth_mm - assumption.layer_start_mm, 0.0)
        step.transition[TRAVERSED_COULOMB, LAYER_COULOMB] = length
        step.transition[TRAVERSED_VISCOUS, LAYER_VISCOUS] = length


@compiled_inside
def keep_part_of_tip_force(step: LinearMap, mean: Vector, tip_row: Vector) -> None:
    """Let part of the tip force outlast the release, until it fades with travel.

    The fraction, 0.45 ± 0.15, is chosen, between the 30 and 60 % that ruptures in liver
    suggest.
    """
    take_tip_force(step, FADING, tip_row, 0.45)
    step.variance[FADING] = (0.15 * dot(tip_row, mean)) ** 2


@compiled_inside
def begins_friction_record(assumption: Assumptions, kind: int, reported: int) -> bool:
    """Return whether an event begins a new friction record, for the section it ends.

    True for each event in a layer: its end, a membrane met under it.
    True also for the puncture of a membrane that was met in air. The puncture of a
    membrane met under a layer begins none: that layer's section ended where the
    membrane was met. Nor does any event of a hypothesis with a rupture that is not
    reported yet: the section then goes on, and both count as one.
    """
    if assumption.ruptures > reported:
        return False
    was_met_in_air = kind == LAYER_END and assumption.holds_force == 0.0
    return assumption.medium == LAYER or was_met_in_air


@compiled_inside
def start_friction_record(step: LinearMap) -> None:
    """Move the last section's friction to the one before; the last starts at zero."""
    step.transition[FRICTION_LAST : FRICTION_BEFORE + 1] = 0.0
    step.transition[FRICTION_BEFORE, FRICTION_LAST] = 1.0


@compiled_inside
def add_to_friction_record(
    step: LinearMap, mean: Vector, block: Block, length: float, tissue_speed_std: float
) -> None:
    """Add the friction of a length of shaft in the layer to the last section's.

    With it goes what `leave_undecided_cutting_on_shaft` left on the shaft.
    """
    step.transition[FRICTION_LAST, HELD] = step.transition[TRAVERSED_COULOMB, HELD]
    step.transfer_std[FRICTION_LAST] = step.transfer_std[TRAVERSED_COULOMB]
    step.transition[FRICTION_LAST, LAYER_COULOMB] = length * block.deflection
    step.transition[FRICTION_LAST, LAYER_VISCOUS] = length * block.speed_mm_s
    unseen_friction = length * mean[LAYER_VISCOUS] * tissue_speed_std
    step.variance[FRICTION_LAST] = unseen_friction**2


@compiled_inside
def map_event(
    mean: Vector, assumption: Assumptions, event: Event, block: Block
) -> LinearMap:
    """Return how an event maps the unknowns, the friction record not included.

    The mean force that they predict at the event stays the same.
    """
    step = LinearMap(np.eye(UNKNOWNS), np.zeros(UNKNOWNS), np.zeros(UNKNOWNS))
    tip_row = regressor(assumption, block)  # the tip force is tip_row @ mean
    tip_row[:TIP_BEGIN] = 0.0
    tip_row[TIP_END:] = 0.0
    step.transition[TIP_BEGIN:TIP_END] = 0.0
    if event.kind == CONTACT:
        begin_contact(step, block)
    elif event.kind == LAYER_END:
        # These change tip_row, so they come before all that use it; below likewise.
        leave_undecided_cutting_on_shaft(step, mean, tip_row, assumption, block)
        release_model_error(step, mean, tip_row, block)
        leave_friction_on_shaft(step, assumption, block)
        take_tip_force(step, RELEASED, tip_row, 1.0)
    elif event.kind == MEMBRANE_MET:
        leave_undecided_cutting_on_shaft(step, mean, tip_row, assumption, block)
        leave_friction_on_shaft(step, assumption, block)
        take_tip_force(step, HELD, tip_row, 1.0)
    if event.keeps_force:
        keep_part_of_tip_force(step, mean, tip_row)
    return step


@compiled_inside
def add_prior(gaussian: Gaussian, event: Event, speed: float) -> None:
    """Add the prior of what the tip is in after an event."""
    if event.next_medium == MEMBRANE:
        add_membrane_prior(gaussian.mean, gaussian.covariance)
    elif event.next_medium == LAYER:
        add_stiffness_prior(gaussian.mean, gaussian.covariance, speed)
        add_friction_prior(gaussian.mean, gaussian.covariance, speed)


@compiled_inside
def apply_event(
    gaussian: Gaussian,
    assumption: Assumptions,
    event: Event,
    block: Block,
    new_length: float,
    reported: int,
    tissue_speed_std: float,
) -> Gaussian:
    """Return the unknowns after an event.

    Args:
        gaussian: Unknowns of the hypothesis before the event.
        assumption: What it assumes.
        event: What happens.
        block: Where and how it happens.
        new_length: Shaft that entered the layer since the last event [mm].
        reported: Number of ruptures reported so far.
        tissue_speed_std: Standard deviation of the tissue's own speed [mm/s].
    """
    mean = gaussian.mean
    step = map_event(mean, assumption, event, block)
    if begins_friction_record(assumption, event.kind, reported):
        start_friction_record(step)
    if assumption.medium == LAYER:
        add_to_friction_record(step, mean, block, new_length, tissue_speed_std)
    mean_after = multiply_vector(step.transition, mean)
    # map_rows returns the transpose, (T P).T; applied twice that is T P T.T.
    covariance = map_rows(step.transition, gaussian.covariance)
    covariance = map_rows(step.transition, covariance)
    covariance += np.diag(step.variance)
    covariance += np.outer(step.transfer_std, step.transfer_std)
    after = Gaussian(mean_after, covariance)
    add_prior(after, event, block.speed_mm_s)
    return after


@compiled_inside
def update_assumption(
    child: Assumptions, parent: Assumptions, event: Event, block: Block, reported: int
) -> None:
    """Change what a hypothesis assumes, by an event.

    Args:
        child: A copy of the parent's assumptions. All that the event changes is
            written, except the release's length.
        parent: Assumptions before the event.
        event: What happens.
        block: Where it happens.
        reported: Number of ruptures reported so far.
    """
    is_rupture = event.kind == LAYER_END
    is_puncture = is_rupture and parent.medium == MEMBRANE
    child.release_start_mm = NO_RELEASE_MM
    if is_rupture:
        child.ruptures = min(parent.ruptures, reported) + 1.0
        child.release_start_mm = block.depth_mm
    # The layer behind a membrane has rubbed since the membrane was met.
    child.layer_start_mm = parent.tip_start_mm if is_puncture else block.depth_mm
    child.prior_speed_mm_s = 0.0
    if event.next_medium == LAYER:
        child.prior_speed_mm_s = max(block.speed_mm_s, MIN_SPEED_MM_S)
    child.tip_start_mm = block.depth_mm
    child.medium = event.next_medium
    child.holds_force = 1.0 if event.kind == MEMBRANE_MET else 0.0
    child.is_punctured = 1.0 if is_puncture else 0.0


@compiled_inside
def record_rupture(history: History, block: Block) -> None:
    """Record a rupture at the beginning of a block.

    A release can be over within a block, so the force it fell from is that of the block
    before.
    """
    history.rupture_s = block.time_s - 0.5 * block.duration_s
    history.rupture_mm = block.depth_mm
    history.rupture_speed_mm_s = block.speed_mm_s
    history.rupture_force_N = block.force_before_N
    history.min_force_N = block.force_before_N


@compiled_inside
def record_section(
    history: History,
    before: Gaussian,
    start_mm: float,
    end_mm: float,
    friction: float,
) -> None:
    """Record the section of shaft that an event ends, and the layer's parameters.

    Args:
        history: Record that is changed.
        before: Unknowns before the event.
        start_mm: Depth at which the section begins.
        end_mm: Depth at which it ends.
        friction: Its friction [N].
    """
    history.section_start_mm = start_mm
    history.section_end_mm = end_mm
    history.section_friction_N = friction
    history.stiffness_N_per_mm = before.mean[STIFFNESS]
    history.stiffness_variance = before.covariance[STIFFNESS, STIFFNESS]
    history.coulomb_N_per_mm = before.mean[LAYER_COULOMB]
    history.coulomb_variance = before.covariance[LAYER_COULOMB, LAYER_COULOMB]
    history.viscous_Ns_per_mm2 = before.mean[LAYER_VISCOUS]
    history.viscous_variance = before.covariance[LAYER_VISCOUS, LAYER_VISCOUS]


@compiled_inside
def record_membrane(history: History, before: Gaussian, travel_mm: float) -> None:
    """Record the mean stiffness of a membrane that was met in air, K + H x.

    A membrane has no friction: what rubs is the layer behind it.

    Args:
        history: Record that is changed.
        before: Unknowns before the puncture.
        travel_mm: x, over which the membrane was pushed in.
    """
    mean = before.mean
    covariance = before.covariance
    variance = covariance[STIFFNESS, STIFFNESS]
    variance += 2.0 * travel_mm * covariance[STIFFNESS, STIFFENING]
    variance += travel_mm**2 * covariance[STIFFENING, STIFFENING]
    history.stiffness_N_per_mm = mean[STIFFNESS] + mean[STIFFENING] * travel_mm
    history.stiffness_variance = variance


@compiled_inside
def record_contact(history: History, depth_mm: float, is_first: bool) -> None:
    """Record that tissue begins here and that nothing is known of it yet."""
    history.section_start_mm = depth_mm
    history.section_end_mm = depth_mm
    history.section_friction_N = 0.0
    history.stiffness_N_per_mm = 0.0
    history.stiffness_variance = 0.0
    history.coulomb_N_per_mm = 0.0
    history.coulomb_variance = 0.0
    history.viscous_Ns_per_mm2 = 0.0
    history.viscous_variance = 0.0
    if is_first:
        history.contact_mm = depth_mm
