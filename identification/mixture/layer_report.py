"""Ruptures and layers traversed, as the mixture reports them."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from foundation.records import read_column, read_element
from identification.estimate import LayerEstimate, Rupture, Sample
from identification.mixture.block import MM_PER_M, Block
from identification.mixture.events import History
from identification.mixture.evidence import Evidence
from identification.mixture.force_model import (
    AIR,
    FRICTION_BEFORE,
    FRICTION_LAST,
    MEMBRANE,
    RELEASED,
)
from identification.mixture.force_split import is_identified
from identification.mixture.mixture import MIN_BRANCH_MM

MIN_SPEED_M_S = 1e-6
"""Speed at a rupture, at least."""


def contact_std_mm(evidence: Evidence, block: Block) -> float:
    """Return the standard deviation of the depth at which tissue was met [mm].

    To be asked before the first rupture: all that outlives it may say the same depth.

    Args:
        evidence: Of the mixture.
        block: The last one.
    """
    is_in_air = read_column(evidence.mixture.assumptions, "medium") == AIR
    weights = np.where(is_in_air, 0.0, evidence.weights)
    if not weights.any():
        return 0.0
    contacts_mm = read_column(evidence.mixture.history, "contact_mm")
    return _std_of_event(weights, contacts_mm, block.speed_mm_s, block)


def _std_of_event(
    weights: Array, depths_mm: Array, speed_mm_s: float, block: Block
) -> float:
    """Return the standard deviation of the depth of the likeliest component's event.

    An event may begin anywhere in a block, but a component dates it to its beginning.
    """
    likeliest_mm = depths_mm[np.argmax(weights)]
    spread_mm2 = float(weights @ (depths_mm - likeliest_mm) ** 2) / float(weights.sum())
    step_mm = max(speed_mm_s * block.duration_s, MIN_BRANCH_MM)
    return math.sqrt(spread_mm2 + step_mm**2 + block.depth_std_mm**2)


def report_rupture(
    evidence: Evidence,
    component: int,
    layer: int,
    probability: float,
    alarm: Sample,
    contact_std_mm: float,
) -> Rupture:
    """Return the last rupture of a component.

    Args:
        evidence: Of the mixture.
        component: Its row.
        layer: Number of the layer that ends.
        probability: Of the rupture.
        alarm: The sample that raises it.
        contact_std_mm: Standard deviation of the depth of first contact.
    """
    history = read_element(History, evidence.mixture.history, component)
    since_s = max(alarm.clock_s - history.rupture_s, 0.0)
    return Rupture(
        layer=layer,
        alarm_s=alarm.time_s,
        alarm_depth_m=alarm.depth_m,
        time_s=alarm.time_s - since_s,
        depth_m=history.rupture_mm / MM_PER_M,
        force_N=history.rupture_force_N,
        speed_m_s=history.rupture_speed_mm_s / MM_PER_M,
        probability=min(probability, 1.0),
        contact_depth_m=history.contact_mm / MM_PER_M,
        contact_depth_std_m=contact_std_mm / MM_PER_M,
    )


def _has_met_membrane(evidence: Evidence) -> NDArray[np.bool_]:
    """Return which components push a membrane that they met under a layer, (n,)."""
    assumptions = evidence.mixture.assumptions
    is_membrane = read_column(assumptions, "medium") == MEMBRANE
    return is_membrane & (read_column(assumptions, "holds_force") > 0.0)


def friction_of_layer(
    evidence: Evidence, ruptures: int, variance_N2: float, *, is_last: bool
) -> tuple[float, float] | None:
    """Return mean and deviation of the friction of a layer traversed [N].

    None where other components are likelier than those that know of the last rupture as
    the last.

    Args:
        evidence: Of the mixture.
        ruptures: Number of ruptures reported.
        variance_N2: Of the force's slow error, which is in the friction.
        is_last: Whether it is the layer that the last rupture ended, or the one before.
    """
    weights = evidence.weights_of(ruptures)
    # Where a membrane was met, another friction record has begun.
    has_met_membrane = _has_met_membrane(evidence)
    if not is_last:
        weights[has_met_membrane] = 0.0
    is_before = has_met_membrane | (not is_last)
    unknowns = np.where(is_before, FRICTION_BEFORE, FRICTION_LAST)
    total = float(weights.sum())
    if total < 0.3:
        return None
    mixture = evidence.mixture
    components = np.arange(len(weights))
    fractions = weights / total
    frictions_N = mixture.means[components, unknowns]
    variances_N2 = mixture.covariances[components, unknowns, unknowns]
    mean_N = float(fractions @ frictions_N)
    spread_N2 = np.maximum(variances_N2, 0.0) + (frictions_N - mean_N) ** 2
    return mean_N, math.sqrt(float(fractions @ spread_N2) + variance_N2)


def report_layer(
    evidence: Evidence,
    rupture: Rupture,
    ruptures: int,
    variance_N2: float,
    block: Block,
) -> LayerEstimate | None:
    """Return the layer, or the part of one, that the last rupture ended.

    None where no component knows of it, or its friction.

    Args:
        evidence: Of the mixture.
        rupture: The last one.
        ruptures: Number of ruptures reported.
        variance_N2: Of the force's slow error, which is in the friction.
        block: The last one.
    """
    friction = friction_of_layer(evidence, ruptures, variance_N2, is_last=True)
    weights = evidence.weights_of(ruptures)
    weights[_has_met_membrane(evidence)] = 0.0
    if friction is None or not weights.any():
        return None
    component = int(np.argmax(weights))
    mixture = evidence.mixture
    history = read_element(History, evidence.mixture.history, component)
    thickness_mm = max(history.rupture_mm - history.section_start_mm, 1e-3)
    end_std_mm = _std_of_event(
        weights,
        read_column(mixture.history, "rupture_mm"),
        history.rupture_speed_mm_s,
        block,
    )
    stiffness = MM_PER_M * max(history.stiffness_N_per_mm, 0.0)
    stiffness_std = MM_PER_M * _std(history.stiffness_variance)
    coulomb = MM_PER_M * max(history.coulomb_N_per_mm, 0.0)
    coulomb_std = MM_PER_M * _std(history.coulomb_variance)
    viscous = MM_PER_M * MM_PER_M * max(history.viscous_Ns_per_mm2, 0.0)
    viscous_std = MM_PER_M * MM_PER_M * _std(history.viscous_variance)
    layer = LayerEstimate(
        layer=rupture.layer,
        is_final=False,
        start_depth_m=history.section_start_mm / MM_PER_M,
        thickness_m=thickness_mm / MM_PER_M,
        end_depth_std_m=end_std_mm / MM_PER_M,
        rupture=rupture,
        force_drop_N=float(mixture.means[component, RELEASED]),
        force_drop_std_N=_std(
            float(mixture.covariances[component, RELEASED, RELEASED])
        ),
        stiffness_N_per_m=stiffness,
        stiffness_std_N_per_m=stiffness_std,
        stiffness_identified=is_identified(stiffness, stiffness_std),
        friction_N=max(history.section_friction_N, 0.0),
        friction_Ns_per_m2=0.0,
        friction_identified=False,
        coulomb_N_per_m=coulomb,
        coulomb_std_N_per_m=coulomb_std,
        coulomb_identified=is_identified(coulomb, coulomb_std),
        viscous_Ns_per_m2=viscous,
        viscous_std_Ns_per_m2=viscous_std,
        viscous_identified=is_identified(viscous, viscous_std),
    )
    return with_friction(layer, *friction)


def _std(variance: float) -> float:
    return math.sqrt(max(variance, 0.0))


def with_doubt(layer: LayerEstimate, std_N: float) -> LayerEstimate:
    """Return a layer that is not final, its force in doubt by so much at least."""
    thickness_m = layer.thickness_m
    speed_m_s = max(layer.rupture.speed_m_s, MIN_SPEED_M_S)
    per_length = std_N / thickness_m
    viscous = per_length / speed_m_s
    return replace(
        layer,
        is_final=False,
        rupture=replace(layer.rupture, is_final=False),
        force_drop_std_N=max(layer.force_drop_std_N or 0.0, std_N),
        stiffness_std_N_per_m=max(layer.stiffness_std_N_per_m or 0.0, per_length),
        stiffness_identified=False,
        friction_std_N=max(layer.friction_std_N or 0.0, std_N),
        friction_std_Ns_per_m2=max(layer.friction_std_Ns_per_m2 or 0.0, viscous),
        friction_identified=False,
        coulomb_std_N_per_m=max(layer.coulomb_std_N_per_m or 0.0, per_length),
        coulomb_identified=False,
        viscous_std_Ns_per_m2=max(layer.viscous_std_Ns_per_m2 or 0.0, viscous),
        viscous_identified=False,
    )


def with_friction(layer: LayerEstimate, mean_N: float, std_N: float) -> LayerEstimate:
    """Return a layer with its friction known better.

    Its Coulomb and viscous parts keep their ratio.
    """
    force_N = max(mean_N, 0.0)
    scale = force_N / layer.friction_N if layer.friction_N > 0.0 else 1.0
    speed_m_s = max(layer.rupture.speed_m_s, MIN_SPEED_M_S)
    per_length_and_speed = 1.0 / (layer.thickness_m * speed_m_s)
    return replace(
        layer,
        friction_N=force_N,
        friction_std_N=std_N,
        friction_Ns_per_m2=per_length_and_speed * force_N,
        friction_std_Ns_per_m2=per_length_and_speed * std_N,
        friction_identified=is_identified(force_N, std_N),
        coulomb_N_per_m=scale * (layer.coulomb_N_per_m or 0.0),
        viscous_Ns_per_m2=scale * (layer.viscous_Ns_per_m2 or 0.0),
    )
