"""What every sample asks of the switching filter: shaft friction out of the force.

All else is done once per block of samples, see `switching_identifier`.
"""

import math
from typing import NamedTuple

from identification.estimate import Outputs
from needleforce.jit import compiled

_MM = 1e3
_BLOCK_S, _BLOCK_MM, _LEAST_S = 0.01, 0.06, 0.002
"""A block ends after a travel well below any release, or after a time; both are enough to average
the noise of single samples."""
_PRESLIDING_MM = 0.3
"""Travel over which friction turns after a reversal: gel clings for a fifth, soft tissue for half a
millimetre."""
_DEADBAND, _LEAST_DEADBAND_M = 3.0, 2e-5
"""Standard deviations of the depth, and least travel, within which the needle may not have moved:
an arm's joints have play, and a filtered depth swings past a sudden stop."""
_REST_SPEED, _REST_S = 0.1, 8.5
"""Slower than this [mm/s] the needle rests; real liver loses its force in that time."""
_RELAXED, _UNKNOWN = 0.6, 0.3
"""Part of the friction lost in a long rest, as of the whole force in real liver (19 holds of 60 s);
and standard deviation of that part, and of friction while presliding turns."""
_UNLOADED_M = 1e-3
"""A tip drawn back by a needle diameter touches nothing."""
_IDENTIFIED = 0.25
"""A value is identified if its standard deviation is no more of it."""
_TINY = 1e-12


Motion = tuple[float, float, float, float]
"""Depth [m], speed [m/s], and the standard deviations of their noise."""


class SwitchingMemory(NamedTuple):
    """What every sample changes. Compiled code takes and returns the fields as a plain tuple."""

    due: float = 0.0  # 1 if the next sample finds work to do even if it fills no block
    filled_s: float = 0.0  # length of the block being filled; integrals over it follow
    depth_sum: float = 0.0  # of the depth [m s]
    speed_sum: float = 0.0  # of the speed [m]
    deflection_sum: float = 0.0  # of the presliding deflection [s]
    force_sum: float = 0.0  # of the force [N s]
    deflection: float = 0.0  # presliding, -1 to 1
    follower_m: float = 0.0  # depth less the jitter of its measurement
    rest: float = 0.0  # how far friction may have let go at rest, 0 to 1
    deepest_m: float = -math.inf  # deepest point so far; minus infinity before the first sample
    depth_std_m: float = 0.0  # noise of the last depth
    speed_std_m_s: float = 0.0  # noise of the last speed


Memory = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float
]  # fmt: skip
"""Fields of `SwitchingMemory`, plain."""


class Answer(NamedTuple):
    """What the bank knows of the shaft at one depth, all hypotheses together; N, mm, mm/s.

    C and V are Coulomb and viscous friction of the layers left, A and B those of the whole shaft.
    """

    in_contact: bool = False
    layer: int = 0  # the one the tip is in, from 1; 0 before contact
    contact_m: float = 0.0  # depth at which the first layer was met
    depth: float = 0.0  # that the answer is of
    noise: float = 0.0  # variance of a sample's force
    offset: float = 0.0  # force in free air
    left_coulomb: float = 0.0  # C
    left_viscous: float = 0.0  # V
    coulomb: float = 0.0  # A
    viscous: float = 0.0  # B
    own_coulomb: float = 0.0  # growth of A with depth
    own_viscous: float = 0.0  # growth of B with depth
    stiffness: float = 0.0  # of the tip's force with depth
    tip: float = 0.0  # force at the tip
    var_offset: float = 0.0
    cov_offset_left_coulomb: float = 0.0
    cov_offset_left_viscous: float = 0.0
    var_left_coulomb: float = 0.0
    cov_left: float = 0.0
    var_left_viscous: float = 0.0
    cov_offset_coulomb: float = 0.0
    cov_offset_viscous: float = 0.0
    var_coulomb: float = 0.0
    cov_both: float = 0.0
    var_viscous: float = 0.0
    var_own_coulomb: float = 0.0
    cov_own: float = 0.0
    var_own_viscous: float = 0.0
    stiffness_variance: float = 0.0
    # Speed for the cumulative friction: that of the last rupture; 0 before the first, to take the
    # present one
    cumulative_speed: float = 0.0


class LeftLayer(NamedTuple):
    """Friction of one layer left, as the needle is withdrawn through it."""

    start_m: float  # depth at which it begins
    thickness_m: float
    coulomb_N: float  # Coulomb friction of its whole length
    viscous: float  # viscous friction of its whole length [N/(mm/s)]


@compiled
def _embedded(depth_m: float, layers: tuple[LeftLayer, ...]) -> tuple[float, float]:
    """Fraction of the Coulomb and the viscous friction of the layers left still on the shaft."""
    coulomb = viscous = all_coulomb = all_viscous = _TINY
    for k in range(len(layers)):
        layer = layers[k]
        fraction = min(max(depth_m - layer.start_m, 0.0) / layer.thickness_m, 1.0)
        coulomb += fraction * layer.coulomb_N
        viscous += fraction * layer.viscous
        all_coulomb += layer.coulomb_N
        all_viscous += layer.viscous
    return coulomb / all_coulomb, viscous / all_viscous


@compiled
def _per_speed(
    speed: float, coulomb: float, viscous: float, spread: tuple[float, float, float]
) -> tuple[float, float]:
    """Coulomb and viscous friction as one damping at a speed, and its standard deviation."""
    var_coulomb, both, var_viscous = spread
    variance = var_coulomb / (speed * speed) + 2.0 * both / speed + var_viscous
    return coulomb / speed + viscous, math.sqrt(max(variance, 0.0))


@compiled
def _forces(
    motion: Motion,
    force: float,
    memory: Memory,
    answers: tuple[Answer, ...],
    layers: tuple[LeftLayer, ...],
) -> tuple[float, float, float, float, float, float]:
    """Enhanced force, tip force and shaft friction, each with its standard deviation [N]."""
    a = answers[0]
    depth_m, speed = motion[0], _MM * motion[1]
    w, rest, deepest_m = memory[6], memory[8], memory[9]
    force -= a.offset
    std = math.sqrt(a.noise + a.var_offset)
    if not a.in_contact or depth_m < a.contact_m:
        return force, std, force, std, 0.0, 0.0
    coulomb_share = viscous_share = 1.0
    if depth_m < deepest_m - _UNLOADED_M and len(layers) > 0:
        coulomb_share, viscous_share = _embedded(depth_m, layers)
    # Friction after a rest, and while it turns, lies somewhere between none and all of it.
    loose = _UNKNOWN * max(1.0 - abs(w), rest)
    w *= 1.0 - _RELAXED * rest
    p, q = w * coulomb_share, speed * viscous_share
    left = p * a.left_coulomb + q * a.left_viscous
    var_left = p * p * a.var_left_coulomb + 2.0 * p * q * a.cov_left + q * q * a.var_left_viscous
    var_left += (loose * a.left_coulomb) ** 2
    both = p * a.cov_offset_left_coulomb + q * a.cov_offset_left_viscous
    left_std = math.sqrt(max(a.noise + a.var_offset + var_left + 2.0 * both, 0.0))
    if depth_m < deepest_m - _UNLOADED_M:
        return force - left, left_std, 0.0, std, force, std
    further = _MM * depth_m - a.depth
    friction = w * (a.coulomb + a.own_coulomb * further)
    friction += speed * (a.viscous + a.own_viscous * further)
    variance = w * w * a.var_coulomb + 2.0 * w * speed * a.cov_both
    variance += speed * speed * a.var_viscous + (loose * a.coulomb) ** 2
    both = w * a.cov_offset_coulomb + speed * a.cov_offset_viscous
    tip_std = math.sqrt(max(a.noise + a.var_offset + variance + 2.0 * both, 0.0))
    friction_std = math.sqrt(max(variance, 0.0))
    return force - left, left_std, force - friction, tip_std, friction, friction_std


@compiled
def switching_outputs(
    motion: Motion,
    force_N: float,
    memory: Memory,
    answers: tuple[Answer, ...],
    layers: tuple[LeftLayer, ...],
) -> Outputs:
    """Enhanced force, tip force and their companions, for one sample; see `update_switching`."""
    a = answers[0]
    enhanced, enhanced_std, tip, tip_std, friction, friction_std = _forces(
        motion, force_N, memory, answers, layers
    )
    predicted = a.offset + friction + a.tip + a.stiffness * (_MM * motion[0] - a.depth)
    speed = max(_MM * abs(motion[1]), _REST_SPEED)
    spread = (a.var_own_coulomb, a.cov_own, a.var_own_viscous)
    b, b_std = _per_speed(speed, a.own_coulomb, a.own_viscous, spread)
    if a.cumulative_speed != 0.0:
        speed = a.cumulative_speed
    spread = (a.var_left_coulomb, a.cov_left, a.var_left_viscous)
    d, d_std = _per_speed(speed, a.left_coulomb, a.left_viscous, spread)
    k, k_std = _MM * a.stiffness, _MM * math.sqrt(a.stiffness_variance)
    b, b_std = _MM * _MM * b, _MM * _MM * b_std
    return (
        a.in_contact,
        a.layer,
        enhanced,
        enhanced_std,
        tip,
        tip_std,
        friction,
        friction_std,
        predicted,
        k,
        k_std,
        a.in_contact and k_std <= _IDENTIFIED * abs(k),
        b,
        b_std,
        a.in_contact and b_std <= _IDENTIFIED * abs(b),
        _MM * d,
        _MM * d_std,
    )


@compiled
def is_full(memory: Memory) -> bool:
    """Whether the block being filled is."""
    filled, travel = memory[1], _MM * abs(memory[3])
    is_far = travel >= _BLOCK_MM and filled > _LEAST_S * (1.0 - 1e-6)
    return is_far or filled > _BLOCK_S * (1.0 - 1e-6)


@compiled
def update_switching(
    motion: Motion,
    force_N: float,
    dt_s: float,
    memory: Memory,
    answers: tuple[Answer, ...],
    layers: tuple[LeftLayer, ...],
) -> tuple[bool, Memory, Outputs]:
    """Use one sample.

    Returns:
        Whether that was all: no block is full, nothing else is due; the new memory, and what to
        report, see `switching_outputs`.
    """
    depth_m, speed_m_s, depth_std_m, speed_std_m_s = motion
    due, filled, depth_sum, speed_sum, deflection_sum, force_sum = memory[:6]
    w, last, rest, deepest, _, _ = memory[6:]
    if deepest == -math.inf:
        last = depth_m
    deadband = max(_DEADBAND * depth_std_m, _LEAST_DEADBAND_M)
    follower = depth_m - deadband if last < depth_m - deadband else min(last, depth_m + deadband)
    if follower != last:
        # Presliding (Dahl 1968, shape exponent 1), its exact solution: two half steps equal one.
        kept = math.exp(-_MM * abs(follower - last) / _PRESLIDING_MM)
        aim = math.copysign(1.0, follower - last)
        w, rest = aim + (w - aim) * kept, rest * kept
    if _MM * abs(speed_m_s) < _REST_SPEED:
        rest += (1.0 - rest) * -math.expm1(-dt_s / _REST_S)
    new = (
        due,
        filled + dt_s,
        depth_sum + dt_s * depth_m,
        speed_sum + dt_s * speed_m_s,
        deflection_sum + dt_s * w,
        force_sum + dt_s * force_N,
        w,
        follower,
        rest,
        max(deepest, depth_m),
        depth_std_m,
        speed_std_m_s,
    )
    is_all = due == 0.0 and not is_full(new)
    return is_all, new, switching_outputs(motion, force_N, new, answers, layers)
