"""What the mixture knows of the shaft at the depth of a block, all components together.

Its mean is the mean of the components; where they differ its variance is larger than
that of each. Lengths are in mm, speeds in mm/s, forces in N.
"""

from dataclasses import dataclass, field

import numpy as np

from foundation.arrays import Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import dot, index_of_largest
from identification.mixture.block import MM_PER_M, Block
from identification.mixture.events import Gaussian
from identification.mixture.evidence import Evidence
from identification.mixture.force_model import (
    AIR,
    CUTTING_ON_SHAFT,
    CUTTING_ON_SHAFT_STD,
    FRICTION_LAST,
    HELD,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    MEMBRANE,
    OFFSET,
    STIFFENING,
    STIFFNESS,
    TIP_BEGIN,
    TIP_END,
    TRAVERSED_COULOMB,
    TRAVERSED_VISCOUS,
    UNKNOWNS,
    Assumptions,
    regressor,
    undecided_cutting,
)
from identification.mixture.mixture import Mixture
from identification.mixture.needle_contact import REST_SPEED_MM_S
from identification.mixture.needle_stop import (
    SLIDING_DEFLECTION,
    Friction,
    NeedleStop,
    learn_from_rest,
    remember_motion,
)

(
    AT_OFFSET,
    AT_TRAVERSED_COULOMB,
    AT_TRAVERSED_VISCOUS,
    AT_SHAFT_COULOMB,
    AT_SHAFT_VISCOUS,
    AT_LAYER_COULOMB,
    AT_LAYER_VISCOUS,
    AT_STIFFNESS,
) = range(8)
"""Indices of the quantities that are summarised."""

QUANTITIES = 8
"""Number of these quantities."""


@dataclass(slots=True)
class ShaftPosterior:
    """What the mixture knows of the shaft at one depth.

    Attributes:
        in_contact: Whether tissue has been met.
        layer: Number of the layer that the tip is in, from 1; 0 before the contact.
        contact_depth_m: Depth at which the first was met.
        depth_mm: Depth that all this is of.
        noise_variance: Of a block's force [N²].
        tip_force: At that depth [N].
        rupture_speed_mm_s: Speed of the last rupture, 0 before the first.
        model_error_variance: Of the force model [N²].
        offset: Force in free air [N].
        offset_variance: Variance of the offset.
        stiffness: Of the tip's force [N/mm].
        stiffness_variance: Variance of the stiffness.
        traversed: Friction of the layers traversed.
        shaft: Friction of the whole shaft.
        layer_friction: Friction per length of shaft in the layer [1/mm].
        stop: The motion before a stop, and what stops have shown.
    """

    in_contact: bool = False
    layer: int = 0
    contact_depth_m: float = 0.0
    depth_mm: float = 0.0
    noise_variance: float = 0.0
    tip_force: float = 0.0
    rupture_speed_mm_s: float = 0.0
    model_error_variance: float = 0.0
    offset: float = 0.0
    offset_variance: float = 0.0
    stiffness: float = 0.0
    stiffness_variance: float = 0.0
    traversed: Friction = field(default_factory=Friction)
    shaft: Friction = field(default_factory=Friction)
    layer_friction: Friction = field(default_factory=Friction)
    stop: NeedleStop = field(default_factory=NeedleStop)


@compiled_inside
def traversed_rows(rows: WrittenMatrix, assumption: Assumptions, reported: int) -> None:
    """Map a component's unknowns to the friction of the layers reported.

    A component that knows of a rupture, or of a membrane under the layer, before it is
    reported has the friction of its last section among that of the layers traversed:
    for whoever reads the force that layer still goes on. Before the first rupture no
    layer is traversed.
    """
    if reported == 0:
        return
    rows[AT_TRAVERSED_COULOMB, TRAVERSED_COULOMB] = 1.0
    rows[AT_TRAVERSED_VISCOUS, TRAVERSED_VISCOUS] = 1.0
    has_met_membrane = assumption.medium == MEMBRANE and assumption.holds_force > 0.0
    if assumption.ruptures > reported or has_met_membrane:
        rows[AT_TRAVERSED_COULOMB, FRICTION_LAST] = -1.0


@compiled_inside
def shaft_rows(assumption: Assumptions, depth_mm: float, met: float) -> WrittenMatrix:
    """Return the map of a component's unknowns to the quantities, shape (8, 20).

    Those of the layers traversed are left to `traversed_rows`. `met` is 1 where it has
    met tissue, else 0.
    """
    rows = np.zeros((QUANTITIES, UNKNOWNS))
    length = max(depth_mm - assumption.layer_start_mm, 0.0)
    rows[AT_OFFSET, OFFSET] = 1.0
    rows[AT_SHAFT_COULOMB, TRAVERSED_COULOMB] = met
    rows[AT_SHAFT_VISCOUS, TRAVERSED_VISCOUS] = met
    rows[AT_SHAFT_COULOMB, LAYER_COULOMB] = met * length
    rows[AT_SHAFT_VISCOUS, LAYER_VISCOUS] = met * length
    rows[AT_LAYER_COULOMB, LAYER_COULOMB] = met
    rows[AT_LAYER_VISCOUS, LAYER_VISCOUS] = met
    undecided, growth = undecided_cutting(assumption, depth_mm)
    growth *= met * CUTTING_ON_SHAFT
    rows[AT_SHAFT_COULOMB, HELD] = met * CUTTING_ON_SHAFT * undecided
    rows[AT_LAYER_COULOMB, HELD] = growth
    if assumption.medium != AIR:
        rows[AT_STIFFNESS, STIFFNESS] = 1.0
        travel = max(depth_mm - assumption.tip_start_mm, 0.0)
        rows[AT_STIFFNESS, STIFFENING] = 2.0 * travel
        rows[AT_STIFFNESS, HELD] = -growth
    return rows


@compiled_inside
def predict_tip_force(mixture: Mixture, component: int, block: Block) -> float:
    """Return the tip force of a component [N]."""
    assumption = mixture.assumptions[component]
    mean = mixture.means[component]
    row = regressor(assumption, block)
    row[HELD] -= CUTTING_ON_SHAFT * undecided_cutting(assumption, block.depth_mm)[0]
    tip_force = 0.0
    for i in range(TIP_BEGIN, TIP_END):
        tip_force += row[i] * mean[i]
    return tip_force


@compiled_inside
def leave_out_unlikely(
    trusted: Vector, weights: Vector
) -> tuple[WrittenVector, WrittenVector]:
    """Return weights for means and for spreads without the least likely components.

    They are normalised; what they are for, see `mix_components`.
    """
    min_weight = 1e-3
    means = np.where(trusted > min_weight * trusted.sum(), trusted, 0.0)
    spreads = np.where((weights > min_weight) | (means > 0.0), weights, 0.0)
    return means / means.sum(), spreads / spreads.sum()


@compiled_inside
def add_covariance(
    covariance: WrittenMatrix, weight: float, rows: Matrix, of_unknowns: Matrix
) -> None:
    """Add ``weight * rows @ of_unknowns @ rows.T``, for rows with many zeros.

    Args:
        covariance: Of the quantities, which is changed, shape (8, 8).
        weight: Of the component.
        rows: See `shaft_rows`, shape (8, 20).
        of_unknowns: Covariance of the component's unknowns, shape (20, 20).
    """
    for b in range(QUANTITIES):
        for j in range(UNKNOWNS):
            if rows[b, j] == 0.0:
                continue
            factor = weight * rows[b, j]
            for a in range(QUANTITIES):
                product = 0.0
                for i in range(UNKNOWNS):
                    product += rows[a, i] * of_unknowns[j, i]
                covariance[a, b] += factor * product


@compiled_inside
def add_spread(
    covariance: WrittenMatrix, weights: Vector, values: Matrix, mean: Vector
) -> None:
    """Add the spread of the components' values about their mean.

    Args:
        covariance: Of the quantities, which is changed, shape (8, 8).
        weights: Of the components, shape (n,).
        values: What each component says, shape (n, 8).
        mean: Of the mixture, shape (8,).
    """
    for k in range(len(weights)):
        for a in range(QUANTITIES):
            deviation = weights[k] * (values[k, a] - mean[a])
            for b in range(QUANTITIES):
                covariance[a, b] += deviation * (values[k, b] - mean[b])
    for a in range(QUANTITIES):
        covariance[a, a] = max(covariance[a, a], 0.0)


@compiled_inside
def mix_components(
    posterior: ShaftPosterior,
    evidence: Evidence,
    trusted: Vector,
    block: Block,
    reported: int,
) -> Gaussian:
    """Mix what the components say of the shaft, the least likely left out.

    Args:
        posterior: Of which the contact and the tip force are set.
        evidence: The mixture of n components, weights for the covariance.
        trusted: Weights for the means, around which that is, shape (n,).
        block: Place of the tip.
        reported: Ruptures reported so far.

    Returns:
        Mean and covariance of the quantities `AT_OFFSET` to `AT_STIFFNESS`, shapes (8,)
        and (8, 8).
    """
    mixture = evidence.mixture
    mean_weights, spread_weights = leave_out_unlikely(trusted, evidence.weights)
    values = np.zeros((len(trusted), QUANTITIES))
    mean = np.zeros(QUANTITIES)
    covariance = np.zeros((QUANTITIES, QUANTITIES))
    met_probability = 0.0
    contact_mm = 0.0
    for k in range(len(trusted)):
        if spread_weights[k] == 0.0:
            continue
        assumption = mixture.assumptions[k]
        has_met = assumption.medium != AIR or assumption.ruptures > 0.0
        rows = shaft_rows(assumption, block.depth_mm, 1.0 if has_met else 0.0)
        if has_met:
            if met_probability == 0.0:
                contact_mm = mixture.history[k].contact_mm
            met_probability += mean_weights[k]
            traversed_rows(rows, assumption, reported)
        for a in range(QUANTITIES):
            values[k, a] = dot(rows[a], mixture.means[k])
            mean[a] += mean_weights[k] * values[k, a]
        add_covariance(covariance, spread_weights[k], rows, mixture.covariances[k])
        # Of the friction in the undecided cutting force
        undecided, _ = undecided_cutting(assumption, block.depth_mm)
        std = CUTTING_ON_SHAFT_STD * undecided * mixture.means[k, HELD]
        covariance[AT_SHAFT_COULOMB, AT_SHAFT_COULOMB] += spread_weights[k] * std**2
    add_spread(covariance, spread_weights, values, mean)
    # The needle counts as in contact where a contact is likelier than none.
    posterior.in_contact = met_probability > 0.5
    posterior.contact_depth_m = contact_mm / MM_PER_M if posterior.in_contact else 0.0
    # Friction is known no better than the force model is, whose error the tissue's
    # texture shows.
    posterior.model_error_variance = met_probability * block.model_error_N**2
    likeliest = index_of_largest(mean_weights)
    posterior.tip_force = predict_tip_force(mixture, likeliest, block)
    return Gaussian(mean, covariance)


@compiled_inside
def trust_components(evidence: Evidence, block: Block, reported: int) -> WrittenVector:
    """Return weights for the means: of the components that ruptures reported support.

    A rupture that is not reported and may be a needle that slowed down does not count:
    a hand that feels the tip's force vanish for it pushes.
    """
    trusted = np.zeros(len(evidence.weights))
    # Where the needle is slower, friction's dependence on the speed may look like a
    # fall of the force.
    steady_speed = 0.9 * block.usual_speed_mm_s
    for k in range(len(trusted)):
        rupture_speed = evidence.mixture.history[k].rupture_speed_mm_s
        is_slow = min(rupture_speed, block.speed_mm_s) < steady_speed
        if evidence.ruptures[k] <= reported or not is_slow:
            trusted[k] = evidence.weights[k]
    return trusted


@compiled_inside
def set_friction(friction: Friction, shaft: Gaussian, first: int) -> None:
    """Set a friction to the quantities `first` (Coulomb) and the next (viscous)."""
    second = first + 1
    friction.coulomb = shaft.mean[first]
    friction.viscous = shaft.mean[second]
    friction.coulomb_variance = shaft.covariance[first, first]
    friction.covariance = shaft.covariance[first, second]
    friction.viscous_variance = shaft.covariance[second, second]
    friction.offset_coulomb = shaft.covariance[AT_OFFSET, first]
    friction.offset_viscous = shaft.covariance[AT_OFFSET, second]


@compiled_inside
def update_stop(posterior: ShaftPosterior, block: Block) -> None:
    """Remember a needle that advances, and learn from one that rests."""
    stop = posterior.stop
    if not posterior.in_contact or block.deflection < SLIDING_DEFLECTION:
        return
    net_force = block.force_N - posterior.offset
    speed = block.speed_mm_s
    if speed > REST_SPEED_MM_S:
        remember_motion(stop, posterior.shaft, speed, block.depth_mm, net_force)
        return
    variance = 2.0 * posterior.noise_variance + block.motion_variance_N2
    learn_from_rest(stop, block.duration_s, net_force, variance)


@compiled
def update_posterior(
    posteriors: list[ShaftPosterior],
    evidence: Evidence,
    block: Block,
    reported: int,
    traversed: int,
    rupture_speed: float,
) -> None:
    """Set the posterior to what the mixture knows at a block's place.

    Args:
        posteriors: The one that is set, shape (1,).
        evidence: The mixture, after the ruptures reported.
        block: Where the tip is.
        reported: Ruptures reported so far.
        traversed: Layers traversed so far.
        rupture_speed: Speed of the last rupture, 0 before the first [mm/s].
    """
    posterior = posteriors[0]
    trusted = trust_components(evidence, block, reported)
    if trusted.sum() <= 1e-6:  # too little for a mean to rest on
        trusted = evidence.weights
    shaft = mix_components(posterior, evidence, trusted, block, reported)
    posterior.layer = traversed + 1 if posterior.in_contact else 0
    posterior.depth_mm = block.depth_mm
    posterior.noise_variance = block.noise_std_N**2
    posterior.rupture_speed_mm_s = rupture_speed
    posterior.offset = shaft.mean[AT_OFFSET]
    posterior.offset_variance = shaft.covariance[AT_OFFSET, AT_OFFSET]
    posterior.stiffness = shaft.mean[AT_STIFFNESS]
    posterior.stiffness_variance = shaft.covariance[AT_STIFFNESS, AT_STIFFNESS]
    set_friction(posterior.traversed, shaft, AT_TRAVERSED_COULOMB)
    set_friction(posterior.shaft, shaft, AT_SHAFT_COULOMB)
    set_friction(posterior.layer_friction, shaft, AT_LAYER_COULOMB)
    if reported > 0:  # before, none of the force is subtracted
        posterior.traversed.coulomb_variance += posterior.model_error_variance
    posterior.shaft.coulomb_variance += posterior.model_error_variance
    update_stop(posterior, block)
