"""The axial force of a sample, split into tip force and shaft friction.

Between blocks each sample uses what the mixture knew at the last block, moved on to its
own depth, speed and presliding deflection. There are four situations: the tip has met
no tissue; it is drawn back in front of it; it is drawn back in its own channel; it
advances, and cuts. Lengths are in mm, speeds in mm/s, forces in N, where the name does
not say otherwise.
"""

import math
from typing import NamedTuple

from foundation.arrays import Matrix
from foundation.jit import compiled, compiled_inside
from identification.estimate import Outputs, Sample
from identification.mixture.block import MM_PER_M
from identification.mixture.needle_contact import (
    REST_SPEED_MM_S,
    NeedleContact,
    is_falling,
    update_contact,
)
from identification.mixture.needle_stop import (
    RELAXED_FRICTION,
    Friction,
    lost_speed,
    meet_stop,
    retain,
)
from identification.mixture.shaft_posterior import ShaftPosterior

UNSETTLED_FRACTION = 0.3
"""Standard deviation of the part of friction that a rest takes, and of friction while
presliding turns."""

TINY = 1e-12
"""What keeps a denominator above zero."""

START_M, THICKNESS_M, COULOMB_N, VISCOUS_N_PER_MM_S = range(4)
"""Columns of the layers traversed: see `split_force`."""

TIP_STD = 5
"""Place of the deviation of the tip's force among `Outputs`."""

PREDICTED = 8
"""Place of the force that was predicted."""


Forces = tuple[
    float,  # without the friction of the layers traversed
    float,  # standard deviation of that
    float,  # force at the tip
    float,  # standard deviation of the tip force
    float,  # friction of the shaft
    float,  # standard deviation of the friction
    float,  # axial force that all this predicts
]
"""A sample's force and its parts [N], in the order of `Outputs`."""


class SlidingShaft(NamedTuple):
    """How the shaft slides.

    Attributes:
        deflection: Presliding deflection, less what friction has relaxed at rest.
        uncertainty: Standard deviation of that, as a part of the friction.
        speed: Of the needle in the tissue [mm/s].
    """

    deflection: float
    uncertainty: float
    speed: float


@compiled
def friction_variance(friction: Friction, deflection: float, speed: float) -> float:
    """Return the variance of a friction at a presliding deflection and a speed."""
    variance = (
        deflection * deflection * friction.coulomb_variance
        + 2.0 * deflection * speed * friction.covariance
    )
    return variance + speed * speed * friction.viscous_variance


@compiled_inside
def net_force_std(
    posterior: ShaftPosterior,
    friction: Friction,
    sliding: SlidingShaft,
    variance: float,
) -> float:
    """Return the standard deviation of the force less the offset and a friction.

    Args:
        posterior: With the noise of the force, and the offset.
        friction: That is subtracted.
        sliding: How the shaft slides.
        variance: Of that friction, with all that adds to it.
    """
    cross_covariance = (
        sliding.deflection * friction.offset_coulomb
        + sliding.speed * friction.offset_viscous
    )
    noise = posterior.noise_variance + posterior.offset_variance
    return math.sqrt(max(noise + variance + 2.0 * cross_covariance, 0.0))


@compiled_inside
def noise_std(posterior: ShaftPosterior, contact: NeedleContact) -> float:
    """Return the standard deviation of the force less the offset."""
    noise = posterior.noise_variance + posterior.offset_variance
    return math.sqrt(noise + contact.motion_variance_N2)


@compiled_inside
def relax(contact: NeedleContact, speed: float) -> SlidingShaft:
    """Return how the shaft slides.

    After a rest, and while it turns, friction lies somewhere between none and all of
    it.
    """
    unsettled = max(1.0 - abs(contact.deflection), contact.relaxation)
    relaxed = 1.0 - RELAXED_FRICTION * contact.relaxation
    return SlidingShaft(
        contact.deflection * relaxed, UNSETTLED_FRACTION * unsettled, speed
    )


@compiled_inside
def measure_embedded(depth_m: float, layers: Matrix) -> tuple[float, float]:
    """Return fractions of the friction of the layers traversed still on the shaft.

    Returns:
        Of the Coulomb friction and of the viscous friction.
    """
    if len(layers) == 0:
        return 1.0, 1.0
    coulomb = TINY
    viscous = TINY
    all_coulomb = TINY
    all_viscous = TINY
    for k in range(len(layers)):
        embedded_m = max(depth_m - layers[k, START_M], 0.0)
        fraction = min(embedded_m / layers[k, THICKNESS_M], 1.0)
        coulomb += fraction * layers[k, COULOMB_N]
        viscous += fraction * layers[k, VISCOUS_N_PER_MM_S]
        all_coulomb += layers[k, COULOMB_N]
        all_viscous += layers[k, VISCOUS_N_PER_MM_S]
    return coulomb / all_coulomb, viscous / all_viscous


@compiled_inside
def truncate_at_zero(tip_force: float, variance: float) -> tuple[float, float]:
    """Cut a tip force off at zero, since no tissue pulls the tip.

    Args:
        tip_force: Mean of the tip force [N].
        variance: Of the force model's error, which the components do not know of.

    Returns:
        Mean of the tip force, and the variance that this knowledge removes.
    """
    std = math.sqrt(max(variance, TINY))
    ratio = max(tip_force / std, -30.0)  # the normal distribution's tail ends there
    hazard = (
        math.sqrt(2.0 / math.pi)
        * math.exp(-0.5 * ratio * ratio)
        / math.erfc(-math.sqrt(0.5) * ratio)
    )
    return std * (ratio + hazard), variance * hazard * (hazard + ratio)


@compiled_inside
def split_in_air(
    posterior: ShaftPosterior, contact: NeedleContact, force: float, tip_force: float
) -> Forces:
    """Split a force where no tissue is met: all of it is at the tip.

    Args:
        posterior: What the mixture knows.
        contact: Of needle and tissue.
        force: Axial force [N].
        tip_force: Tip force that is predicted [N].
    """
    net = force - posterior.offset
    std = noise_std(posterior, contact)
    return net, std, net, std, 0.0, 0.0, posterior.offset + tip_force


@compiled_inside
def traversed_friction(posterior: ShaftPosterior, sliding: SlidingShaft) -> float:
    """Return the friction of the layers traversed [N]."""
    coulomb = sliding.deflection * posterior.traversed.coulomb
    return coulomb + sliding.speed * posterior.traversed.viscous


@compiled_inside
def traversed_std(
    posterior: ShaftPosterior, contact: NeedleContact, sliding: SlidingShaft
) -> float:
    """Return the standard deviation of the force less that friction [N]."""
    friction = posterior.traversed
    variance = friction_variance(friction, sliding.deflection, sliding.speed)
    variance += (sliding.uncertainty * friction.coulomb) ** 2
    variance += contact.motion_variance_N2
    return net_force_std(posterior, friction, sliding, variance)


@compiled_inside
def split_in_channel(
    posterior: ShaftPosterior,
    contact: NeedleContact,
    sliding: SlidingShaft,
    layers: Matrix,
    depth_m: float,
    force: float,
    travel: float,
) -> Forces:
    """Split a force in the needle's own channel, where the tip touches nothing.

    Args:
        posterior: What the mixture knows.
        contact: Of needle and tissue.
        sliding: How the shaft slides.
        layers: Those traversed, see `split_force`.
        depth_m: Of the tip in the tissue.
        force: Axial force [N].
        travel: Since the depth of the posterior [mm].
    """
    net = force - posterior.offset
    traversed = posterior.traversed
    shaft = posterior.shaft
    layer = posterior.layer_friction
    embedded_coulomb, embedded_viscous = measure_embedded(depth_m, layers)
    embedded_sliding = SlidingShaft(
        sliding.deflection * embedded_coulomb,
        sliding.uncertainty,
        sliding.speed * embedded_viscous,
    )
    friction = traversed_friction(posterior, embedded_sliding)
    enhanced_std = traversed_std(posterior, contact, embedded_sliding)
    layer_coulomb = shaft.coulomb - traversed.coulomb + layer.coulomb * travel
    layer_viscous = shaft.viscous - traversed.viscous + layer.viscous * travel
    in_layer = sliding.deflection * max(layer_coulomb, 0.0)
    in_layer += sliding.speed * max(layer_viscous, 0.0)
    std = noise_std(posterior, contact)
    predicted = posterior.offset + friction + in_layer
    return net - friction, enhanced_std, 0.0, std, net, std, predicted


@compiled_inside
def sliding_friction(
    posterior: ShaftPosterior, sliding: SlidingShaft, travel: float
) -> tuple[float, float]:
    """Return mean [N] and variance of the shaft's friction by the force law.

    Args:
        posterior: What the mixture knows.
        sliding: How the shaft slides.
        travel: Since the depth of the posterior [mm].
    """
    shaft = posterior.shaft
    layer = posterior.layer_friction
    friction = sliding.deflection * (shaft.coulomb + layer.coulomb * travel)
    friction += sliding.speed * (shaft.viscous + layer.viscous * travel)
    variance = friction_variance(shaft, sliding.deflection, sliding.speed)
    variance += (sliding.uncertainty * shaft.coulomb) ** 2
    return friction, variance


@compiled_inside
def stopped_friction(
    posterior: ShaftPosterior,
    contact: NeedleContact,
    sliding: SlidingShaft,
    net: float,
    travel: float,
) -> tuple[float, float]:
    """Return mean [N] and variance of friction where the shaft stops or rests.

    Args:
        posterior: What the mixture knows, with the motion before the stop.
        contact: Of needle and tissue.
        sliding: How the shaft slides.
        net: Axial force less the offset [N].
        travel: Since the depth of the posterior [mm].
    """
    stop = posterior.stop
    before = retain(stop, lost_speed(stop, sliding.speed), contact.relaxation)
    turned = 1.0 - abs(contact.deflection)
    travelled = posterior.depth_mm + travel - stop.depth_mm
    unexplained = turned * stop.force
    cut = posterior.stiffness * travelled
    force_variance = 2.0 * posterior.noise_variance + contact.motion_variance_N2
    force_variance += unexplained**2 + cut**2
    (at_rest, variance_at_rest), _ = meet_stop(stop, before, net, force_variance)
    friction = contact.deflection * at_rest
    variance = (contact.deflection**2) * variance_at_rest
    variance += (UNSETTLED_FRACTION * turned * stop.friction) ** 2
    backwards = min(sliding.speed, 0.0) * posterior.shaft.viscous
    return friction + backwards, variance


@compiled_inside
def split_at_front(
    posterior: ShaftPosterior,
    contact: NeedleContact,
    sliding: SlidingShaft,
    force: float,
    travel: float,
) -> Forces:
    """Split a force where the tip cuts: what friction does not explain acts at it.

    Args:
        posterior: What the mixture knows.
        contact: Of needle and tissue.
        sliding: How the shaft slides.
        force: Axial force [N].
        travel: Since the depth of the posterior [mm].
    """
    net = force - posterior.offset
    shaft = posterior.shaft
    motion_variance = contact.motion_variance_N2
    tip_prediction = posterior.tip_force + posterior.stiffness * travel

    friction, variance = sliding_friction(posterior, sliding, travel)
    if lost_speed(posterior.stop, sliding.speed) > 0.0:
        friction, variance = stopped_friction(posterior, contact, sliding, net, travel)

    # A force counts less, the more uncertain motion makes it, beside what is not known
    # of friction.
    known_variance = posterior.noise_variance + max(variance, 0.0)
    weight = 1.0 - motion_variance / (known_variance + motion_variance + TINY)
    weighted = weight * net + (1.0 - weight) * (friction + tip_prediction)

    # At rest the force may relax faster than this friction says.
    excess = max(friction - net, 0.0)
    error_variance = (
        sliding.deflection * sliding.deflection * posterior.model_error_variance
    )
    # A stop may have shown the friction better than the model's error is.
    error_variance = min(error_variance, max(variance, 0.0))
    tip_force, removed_variance = truncate_at_zero(weighted - friction, error_variance)
    variance += weight * motion_variance + excess**2 - removed_variance
    return (
        net - traversed_friction(posterior, sliding),
        traversed_std(posterior, contact, sliding),
        tip_force,
        net_force_std(posterior, shaft, sliding, variance),
        weighted - tip_force,
        math.sqrt(max(variance, 0.0)),
        posterior.offset + friction + tip_prediction,
    )


@compiled_inside
def split_force(
    posterior: ShaftPosterior,
    contact: NeedleContact,
    layers: Matrix,
    depth_m: float,
    speed: float,
    force: float,
) -> Forces:
    """Split the axial force into tip force and shaft friction, by where the tip is.

    Args:
        posterior: What the mixture knew at the last block.
        contact: Of needle and tissue at this sample.
        layers: Those traversed, shape (n, 4): where they begin [m], their thickness
            [m], Coulomb [N] and viscous friction [N/(mm/s)] of their whole length.
        depth_m: Of the tip in the tissue.
        speed: Of the tip in the tissue [mm/s].
        force: Axial force [N].
    """
    travel = MM_PER_M * depth_m - posterior.depth_mm
    if not posterior.in_contact:
        tip_force = posterior.tip_force + posterior.stiffness * travel
        return split_in_air(posterior, contact, force, tip_force)
    if depth_m < posterior.contact_depth_m:
        return split_in_air(posterior, contact, force, 0.0)
    sliding = relax(contact, speed)
    # A tip drawn back by a millimetre, about its diameter, touches nothing.
    if depth_m < contact.deepest_m - 1e-3:
        return split_in_channel(
            posterior, contact, sliding, layers, depth_m, force, travel
        )
    return split_at_front(posterior, contact, sliding, force, travel)


@compiled_inside
def find_layer(posterior: ShaftPosterior, layers: Matrix, depth_m: float) -> int:
    """Return the layer that the tip is in, 0 in free air in front of the first."""
    if depth_m < posterior.contact_depth_m:
        return 0
    number = posterior.layer
    for k in range(len(layers)):
        if depth_m < layers[k, START_M] + layers[k, THICKNESS_M]:
            number -= 1
    return number


@compiled_inside
def damping_at(friction: Friction, speed: float) -> tuple[float, float]:
    """Return Coulomb and viscous friction over a speed [N/(mm/s)], and its std."""
    value = friction.coulomb / speed + friction.viscous
    variance = friction_variance(friction, 1.0 / speed, 1.0)
    return value, math.sqrt(max(variance, 0.0))


@compiled
def is_identified(value: float, std: float) -> bool:
    """Return whether the data determine a value: within a quarter of it.

    A standard deviation of zero is that of a value which no data gave, as the friction
    of a membrane.
    """
    return 0.0 < std <= 0.25 * abs(value)


@compiled
def estimate_sample(
    posteriors: list[ShaftPosterior],
    contacts: list[NeedleContact],
    layers: Matrix,
    depth_m: float,
    speed_m_s: float,
    force: float,
) -> Outputs:
    """Return what to report of a sample, see `Outputs`.

    Args:
        posteriors: What the mixture knew at the last block, shape (1,).
        contacts: Contact of needle and tissue at this sample, shape (1,).
        layers: Those traversed, see `split_force`.
        depth_m: Of the tip in the tissue.
        speed_m_s: Of the tip in the tissue.
        force: Axial force [N].
    """
    posterior = posteriors[0]
    # So far in front of the first contact a needle is out of the tissue: the surface
    # was pushed in, and is known that well.
    surface_m = posterior.contact_depth_m - 2e-3
    in_contact = posterior.in_contact and depth_m > surface_m
    speed = MM_PER_M * speed_m_s
    forces = split_force(posterior, contacts[0], layers, depth_m, speed, force)
    speed = max(abs(speed), REST_SPEED_MM_S)
    damping, damping_std = damping_at(posterior.layer_friction, speed)
    friction = MM_PER_M * MM_PER_M * damping
    friction_std = MM_PER_M * MM_PER_M * damping_std
    if posterior.rupture_speed_mm_s != 0.0:
        speed = posterior.rupture_speed_mm_s
    cumulative, cumulative_std = damping_at(posterior.traversed, speed)
    stiffness = MM_PER_M * posterior.stiffness
    stiffness_std = MM_PER_M * math.sqrt(posterior.stiffness_variance)
    return (
        in_contact,
        find_layer(posterior, layers, depth_m),
        *forces,
        stiffness,
        stiffness_std,
        in_contact & is_identified(stiffness, stiffness_std),
        friction,
        friction_std,
        in_contact & is_identified(friction, friction_std),
        MM_PER_M * cumulative,
        MM_PER_M * cumulative_std,
    )


@compiled
def update_sample(
    posteriors: list[ShaftPosterior],
    contacts: list[NeedleContact],
    layers: Matrix,
    depth_m: float,
    speed_m_s: float,
    depth_std_m: float,
    speed_std_m_s: float,
    arm_m_s: float,
    force: float,
    force_std: float,
    raw_depth_m: float,
    raw_speed_m_s: float,
    dt_s: float,
) -> tuple[bool, Outputs]:
    """Use one sample; return whether the block is full, and what to report of it.

    The arguments are those of `estimate_sample`, fields of a `Sample`, and the speed of
    the arm, which tissue that moves does not have.
    """
    sample = Sample(
        0.0,
        dt_s,
        depth_m,
        speed_m_s,
        depth_std_m,
        speed_std_m_s,
        force,
        force_std,
        raw_depth_m,
        raw_speed_m_s,
        0.0,
    )
    is_full = update_contact(contacts[0], sample, arm_m_s)
    outputs = estimate_sample(posteriors, contacts, layers, depth_m, speed_m_s, force)
    predicted = outputs[PREDICTED]
    noise_variance = posteriors[0].noise_variance
    if force_std == 0.0:
        # A force with a slow error is a virtual sensor's. That needs 20 ms to say that
        # a joint torque has jumped, so an alarm must not be quicker.
        is_full |= is_falling(contacts[0], predicted - force, dt_s, noise_variance)
    return is_full, outputs
