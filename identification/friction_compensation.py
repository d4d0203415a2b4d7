"""What every sample asks of this toolkit's own identification; the rest is done once per block."""

import math
from typing import Any, NamedTuple

from needleforce.jit import Vector, compiled

(
    SMOOTHING_S,
    PLAY_M,
    PRESLIDING_M,
    BLOCK_S,
    ONSET_M,
    REST_SPEED,
    IDENTIFIED_SHARE,
    IS_DUE,
    IN_CONTACT,
    LAYER,
    OFFSET_N,
    START_M,
    TIP_M,
    COULOMB,
    VISCOUS,
    STIFFNESS,
    STIFFNESS_STD,
    OWN_COULOMB,
    OWN_VISCOUS,
    VAR_OWN_COULOMB,
    VAR_OWN_BOTH,
    VAR_OWN_VISCOUS,
    SHAFT_STD_N,
    EARLIER_COULOMB,
    EARLIER_VISCOUS,
    VAR_COULOMB,
    VAR_BOTH,
    VAR_VISCOUS,
    CUMULATIVE_SPEED,
    TRAVERSED,
) = range(30)
"""Places of the numbers that `multilayer_coefficients`; four per traversed layer at the end."""
PER_LAYER = 4
_MM = 1e3
_TINY = 1e-12


class MultilayerUpdate(NamedTuple):
    """What every sample changes. Compiled code takes and gives the fields as a plain tuple.

    Attributes:
        filled_s: Length of the block being filled.
        depth_sum: Integral of the depth over it.
        speed_sum: Integral of the speed over it.
        force_sum: Integral of the force over it.
        bristle: Presliding deflection.
        follower_m: Depth less the jitter of its measurement.
        speed_m_s: Speed without the noise of its measurement.
        deepest_m: Deepest point so far; minus infinity before the first sample.
    """

    filled_s: float = 0.0
    depth_sum: float = 0.0
    speed_sum: float = 0.0
    force_sum: float = 0.0
    bristle: float = 0.0
    follower_m: float = 0.0
    speed_m_s: float = 0.0
    deepest_m: float = -math.inf

    @property
    def plain(self) -> tuple[Any, ...]:
        """As `multilayer_update` takes it."""
        return tuple(self)

    @staticmethod
    def of(plain: tuple[Any, ...]) -> "MultilayerUpdate":
        """From what `multilayer_update` gave."""
        return MultilayerUpdate(*plain)


Fields = tuple[float, float, float, float, float, float, float, float]
"""Of `MultilayerUpdate`, plain."""
Figures = tuple[Any, ...]
"""The fields of an `Estimate` from ``in_contact`` up to the events."""


@compiled
def follow_depth(follower_m: float, depth_m: float, deadband_m: float) -> float:
    """Depth without the jitter of the measurement: it moves only when more than `deadband_m` off.

    The play of a loose coupling: noise smaller than the play causes no reversal, a true reversal
    is followed after twice the play.
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

    Args:
        bristle: Deflection before, -1 to 1.
        travel_m: Signed travel; none leaves the deflection, so friction holds at rest.
        presliding_m: Travel over which 63 % of a reversal is done.
    """
    if travel_m == 0.0:
        return bristle
    target = math.copysign(1.0, travel_m)
    return target + (bristle - target) * math.exp(-abs(travel_m) / presliding_m)


@compiled
def _embedded_shares(depth_m: float, numbers: Vector) -> tuple[float, float]:
    """Share of the cumulative Coulomb and viscous friction still on the shaft."""
    if depth_m >= numbers[START_M] or len(numbers) == TRAVERSED:
        return 1.0, 1.0
    coulomb = viscous = all_coulomb = all_viscous = _TINY
    for k in range(TRAVERSED, len(numbers), PER_LAYER):
        share = min(max(depth_m - numbers[k], 0.0) / numbers[k + 1], 1.0)
        coulomb += share * numbers[k + 2]
        viscous += share * numbers[k + 3]
        all_coulomb += numbers[k + 2]
        all_viscous += numbers[k + 3]
    return coulomb / all_coulomb, viscous / all_viscous


@compiled
def shaft_friction(
    depth_m: float, force_N: float, tick: Fields, numbers: Vector
) -> tuple[float, float]:
    """Friction of the needle's shaft in tissue, positive when it resists insertion.

    On the way out the embedded length shrinks layer by layer, and a tip drawn back by more than
    a needle diameter touches nothing: all force is friction then.

    Args:
        depth_m: Of the sample [m].
        force_N: Its force less the free-air offset [N].
        tick: After the sample.
        numbers: See `multilayer_update`.

    Returns:
        Friction of the layers traversed and identified, without which the enhanced force goes; and
        that of the current layer, and of one just left that is not identified yet [N].
    """
    _, _, _, _, bristle, _, speed, deepest_m = tick
    speed = _MM * speed
    coulomb_share, viscous_share = _embedded_shares(depth_m, numbers)
    earlier = (
        bristle * coulomb_share * numbers[EARLIER_COULOMB]
        + speed * viscous_share * numbers[EARLIER_VISCOUS]
    )
    if depth_m < deepest_m - numbers[ONSET_M]:
        return earlier, force_N - earlier
    total = bristle * coulomb_share * numbers[COULOMB] + speed * viscous_share * numbers[VISCOUS]
    depth = _MM * max(depth_m - numbers[START_M], 0.0)
    own = depth * (bristle * numbers[OWN_COULOMB] + speed * numbers[OWN_VISCOUS])
    return earlier, total - earlier + own


@compiled
def _per_speed(
    speed: float, friction: tuple[float, float], spread: tuple[float, float, float]
) -> tuple[float, float]:
    """Coulomb and viscous friction as one damping at a speed, and its standard deviation."""
    coulomb, viscous = friction
    var_coulomb, both, var_viscous = spread
    variance = var_coulomb / (speed * speed) + 2.0 * both / speed + var_viscous
    return coulomb / speed + viscous, math.sqrt(max(variance, 0.0))


@compiled
def multilayer_outputs(
    depth_m: float, speed_m_s: float, force_N: float, tick: Fields, numbers: Vector
) -> Figures:
    """Enhanced force, tip force and their companions, for one sample; see `multilayer_update`."""
    in_contact = numbers[IN_CONTACT] != 0.0
    force_N -= numbers[OFFSET_N]
    earlier_N = own_N = 0.0
    if in_contact:
        earlier_N, own_N = shaft_friction(depth_m, force_N, tick, numbers)
    speed = _MM * max(abs(speed_m_s), numbers[REST_SPEED])
    b, b_std = _per_speed(
        speed,
        (numbers[OWN_COULOMB], numbers[OWN_VISCOUS]),
        (numbers[VAR_OWN_COULOMB], numbers[VAR_OWN_BOTH], numbers[VAR_OWN_VISCOUS]),
    )
    if numbers[CUMULATIVE_SPEED] != 0.0:
        speed = numbers[CUMULATIVE_SPEED]
    d, d_std = _per_speed(
        speed,
        (numbers[EARLIER_COULOMB], numbers[EARLIER_VISCOUS]),
        (numbers[VAR_COULOMB], numbers[VAR_BOTH], numbers[VAR_VISCOUS]),
    )
    k, k_std, b, b_std = numbers[STIFFNESS], numbers[STIFFNESS_STD], 1e6 * b, 1e6 * b_std
    share = numbers[IDENTIFIED_SHARE]
    return (
        in_contact,
        int(numbers[LAYER]),
        force_N - earlier_N,
        force_N - earlier_N - own_N,
        earlier_N + own_N,
        numbers[SHAFT_STD_N],
        earlier_N + own_N + k * max(depth_m - numbers[TIP_M], 0.0),
        k,
        k_std,
        in_contact and k_std <= share * abs(k),
        b,
        b_std,
        in_contact and b_std <= share * abs(b),
        _MM * d,
        _MM * d_std,
    )


@compiled
def multilayer_update(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    dt_s: float,
    tick: Fields,
    numbers: Vector,
) -> tuple[bool, Fields, Figures]:
    """Absorb one sample.

    Args:
        depth_m: Travel of the tip along the insertion axis [m].
        speed_m_s: Rate of depth [m/s].
        force_N: Axial force [N].
        dt_s: Time since the sample before [s].
        tick: The fields of `MultilayerUpdate`.
        numbers: All else that counts, see `multilayer_coefficients`.

    Returns:
        Whether that was all: no block is full, nothing else is due; the new fields, and what to
        tell, see `multilayer_outputs`.
    """
    filled, depth_sum, speed_sum, force_sum, bristle, last, smooth, deepest = tick
    keep = 0.0
    if deepest == -math.inf:
        last = depth_m
    else:
        keep = math.exp(-dt_s / numbers[SMOOTHING_S])
    follower = follow_depth(last, depth_m, numbers[PLAY_M])
    new = (
        filled + dt_s,
        depth_sum + dt_s * depth_m,
        speed_sum + dt_s * speed_m_s,
        force_sum + dt_s * force_N,
        bristle_step(bristle, follower - last, numbers[PRESLIDING_M]),
        follower,
        keep * smooth + (1.0 - keep) * speed_m_s,
        max(deepest, depth_m),
    )
    is_calm = new[0] < numbers[BLOCK_S] and numbers[IS_DUE] == 0.0
    return is_calm, new, multilayer_outputs(depth_m, speed_m_s, force_N, new, numbers)
