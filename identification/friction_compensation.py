"""What every sample asks of the multi-layer method: shaft friction out of the force.

All else is done once per block of samples, see `multilayer_identifier`.
"""

import math
from typing import NamedTuple

from identification.estimate import Outputs
from needleforce.jit import compiled

_MM = 1e3
_TINY = 1e-12
_JITTER = 3.0
"""Standard deviations of the depth within which it plays."""


class MultilayerMemory(NamedTuple):
    """What every sample changes. Compiled code takes and returns the fields as a plain tuple."""

    filled_s: float = 0.0  # Length of the block being filled
    depth_sum: float = 0.0  # Integral of the depth over it
    speed_sum: float = 0.0  # Integral of the speed over it
    force_sum: float = 0.0  # Integral of the force over it
    bristle: float = 0.0  # Presliding deflection
    follower_m: float = 0.0  # Depth less the jitter of its measurement
    speed_m_s: float = 0.0  # Speed without the noise of its measurement
    deepest_m: float = -math.inf  # Deepest point so far; minus infinity before the first sample


Memory = tuple[float, float, float, float, float, float, float, float]
"""Fields of `MultilayerMemory`, plain."""


class MultilayerCoefficients(NamedTuple):
    """What `update_multilayer` reads; changes with the fit, a rupture or the layers only.

    Unknowns of a layer as in `layer_model`, in N and mm.
    """

    smoothing_s: float  # Setting ``speed_smoothing_s``
    deadband_m: float  # Jitter of the depth that is no travel
    presliding_m: float  # Setting
    block_s: float  # Length from which on a block is full
    onset_m: float  # Setting ``cutting_onset_m``
    rest_speed_m_s: float  # Setting
    identified_fraction: float  # A value is identified if its deviation is no more of it
    is_due: bool  # Whether the next sample finds work to do even if it fills no block
    in_contact: bool  # The first layer has been met
    layer: int  # Number of the layer the tip is in, 0 before contact
    offset_N: float  # Force in free air
    start_m: float  # Depth at which the layer begins
    tip_m: float  # Depth from which on it resists the tip
    coulomb: float  # C, Coulomb friction of the layers before
    viscous: float  # V, their viscous friction
    stiffness_N_per_m: float  # K of the layer
    stiffness_std_N_per_m: float  # Its standard deviation
    own_coulomb: float  # c of the layer
    own_viscous: float  # b of the layer
    var_own_coulomb: float  # Variance of c
    var_own_both: float  # Covariance of c and b
    var_own_viscous: float  # Variance of b
    shaft_std_N: float  # Standard deviation of the shaft friction
    earlier_coulomb: float  # C without what an open rupture has added
    earlier_viscous: float  # V without that
    var_coulomb: float  # Variance of C, as the next two without an open rupture
    var_both: float  # Covariance of C and V
    var_viscous: float  # Variance of V
    # Speed for the cumulative friction [mm/s]: that of the last rupture; 0 before the first, to
    # take the present one
    cumulative_speed: float


class LayerFriction(NamedTuple):
    """Friction of one layer traversed, as the needle is withdrawn through it."""

    start_m: float  # Depth at which it begins
    thickness_m: float
    coulomb_N: float  # c d
    viscous: float  # b d [N/(mm/s)]


Coefficients = tuple[MultilayerCoefficients, ...]
Traversed = tuple[LayerFriction, ...]


@compiled
def follow_depth(follower_m: float, depth_m: float, deadband_m: float) -> float:
    """Depth without the jitter of the measurement: it moves only when more than `deadband_m` off.

    The backlash of a loose coupling: noise smaller than it causes no reversal, a true reversal
    is followed after twice the deadband.
    """
    if follower_m < depth_m - deadband_m:
        return depth_m - deadband_m
    return min(follower_m, depth_m + deadband_m)


@compiled
def bristle_step(bristle: float, travel_m: float, presliding_m: float) -> float:
    """Advance the deflection of the tissue clinging to the shaft by one step of travel.

    Presliding (Dahl 1968, shape exponent 1), exact solution of dw/dx = (sign(dx) - w) / presliding:
    two half steps equal one, and the deflection never leaves [-1, 1]. Coulomb friction is its limit
    for a short `presliding_m`.
    """
    if travel_m == 0.0:
        return bristle
    target = math.copysign(1.0, travel_m)
    return target + (bristle - target) * math.exp(-abs(travel_m) / presliding_m)


@compiled
def embedded_fractions(depth_m: float, traversed: Traversed) -> tuple[float, float]:
    """Fraction of the cumulative Coulomb and viscous friction still on the shaft."""
    coulomb = viscous = all_coulomb = all_viscous = _TINY
    for k in range(len(traversed)):
        layer = traversed[k]
        fraction = min(max(depth_m - layer.start_m, 0.0) / layer.thickness_m, 1.0)
        coulomb += fraction * layer.coulomb_N
        viscous += fraction * layer.viscous
        all_coulomb += layer.coulomb_N
        all_viscous += layer.viscous
    return coulomb / all_coulomb, viscous / all_viscous


@compiled
def shaft_friction(
    depth_m: float, force_N: float, memory: Memory, coefficients: Coefficients, traversed: Traversed
) -> tuple[float, float]:
    """Friction of the needle's shaft in tissue, positive when it resists insertion.

    During withdrawal the embedded length shrinks layer by layer, and a tip drawn back by more than
    a needle diameter touches nothing: all force is friction then.

    Returns:
        Friction of the layers traversed and identified, which the enhanced force is without; and
        that of the current layer, and of one just ruptured that is not identified yet [N].
    """
    c = coefficients[0]
    _, _, _, _, bristle, _, speed, deepest_m = memory
    speed = _MM * speed
    coulomb_fraction = viscous_fraction = 1.0
    if depth_m < c.start_m and len(traversed) > 0:
        coulomb_fraction, viscous_fraction = embedded_fractions(depth_m, traversed)
    earlier = (
        bristle * coulomb_fraction * c.earlier_coulomb
        + speed * viscous_fraction * c.earlier_viscous
    )
    if depth_m < deepest_m - c.onset_m:
        return earlier, force_N - earlier
    total = bristle * coulomb_fraction * c.coulomb + speed * viscous_fraction * c.viscous
    depth = _MM * max(depth_m - c.start_m, 0.0)
    own = depth * (bristle * c.own_coulomb + speed * c.own_viscous)
    return earlier, total - earlier + own


@compiled
def _per_speed(
    speed: float, coulomb: float, viscous: float, spread: tuple[float, float, float]
) -> tuple[float, float]:
    """Coulomb and viscous friction as one damping at a speed, and its standard deviation."""
    var_coulomb, both, var_viscous = spread
    variance = var_coulomb / (speed * speed) + 2.0 * both / speed + var_viscous
    return coulomb / speed + viscous, math.sqrt(max(variance, 0.0))


@compiled
def multilayer_outputs(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    memory: Memory,
    coefficients: Coefficients,
    traversed: Traversed,
) -> Outputs:
    """Enhanced force, tip force and their companions, for one sample; see `update_multilayer`."""
    c = coefficients[0]
    force_N -= c.offset_N
    earlier_N = own_N = 0.0
    if c.in_contact:
        earlier_N, own_N = shaft_friction(depth_m, force_N, memory, coefficients, traversed)
    speed = _MM * max(abs(speed_m_s), c.rest_speed_m_s)
    spread = (c.var_own_coulomb, c.var_own_both, c.var_own_viscous)
    b, b_std = _per_speed(speed, c.own_coulomb, c.own_viscous, spread)
    if c.cumulative_speed != 0.0:
        speed = c.cumulative_speed
    spread = (c.var_coulomb, c.var_both, c.var_viscous)
    d, d_std = _per_speed(speed, c.earlier_coulomb, c.earlier_viscous, spread)
    k, k_std, b, b_std = c.stiffness_N_per_m, c.stiffness_std_N_per_m, 1e6 * b, 1e6 * b_std
    return (
        c.in_contact,
        c.layer,
        force_N - earlier_N,
        d_std * _MM * abs(speed_m_s),
        force_N - earlier_N - own_N,
        c.shaft_std_N,
        earlier_N + own_N,
        c.shaft_std_N,
        earlier_N + own_N + k * max(depth_m - c.tip_m, 0.0),
        k,
        k_std,
        c.in_contact and k_std <= c.identified_fraction * abs(k),
        b,
        b_std,
        c.in_contact and b_std <= c.identified_fraction * abs(b),
        _MM * d,
        _MM * d_std,
    )


@compiled
def update_multilayer(
    depth_m: float,
    speed_m_s: float,
    jitter_m: float,
    force_N: float,
    dt_s: float,
    memory: Memory,
    coefficients: Coefficients,
    traversed: Traversed,
) -> tuple[bool, Memory, Outputs]:
    """Use one sample.

    Returns:
        Whether that was all: no block is full, nothing else is due; the new memory, and what to
        report, see `multilayer_outputs`.
    """
    c = coefficients[0]
    filled, depth_sum, speed_sum, force_sum, bristle, last, smooth, deepest = memory
    keep = 0.0
    if deepest == -math.inf:
        last = depth_m
    else:
        keep = math.exp(-dt_s / c.smoothing_s)
    follower = follow_depth(last, depth_m, max(c.deadband_m, _JITTER * jitter_m))
    new = (
        filled + dt_s,
        depth_sum + dt_s * depth_m,
        speed_sum + dt_s * speed_m_s,
        force_sum + dt_s * force_N,
        bristle_step(bristle, follower - last, c.presliding_m),
        follower,
        keep * smooth + (1.0 - keep) * speed_m_s,
        max(deepest, depth_m),
    )
    is_all = new[0] < c.block_s and not c.is_due
    outputs = multilayer_outputs(depth_m, speed_m_s, force_N, new, coefficients, traversed)
    return is_all, new, outputs
