"""Presliding: how friction builds up after a reversal (Dahl 1968, shape exponent 1)."""

import math


def bristle_step(bristle: float, travel_m: float, presliding_m: float) -> float:
    """Advance the deflection of the tissue clinging to the shaft by one step of travel.

    Exact solution of dw/dx = (sign(dx) - w) / presliding: two half steps equal one, and the
    deflection never leaves [-1, 1]. Coulomb friction is its limit for a short `presliding_m`.

    Args:
        bristle: Deflection before, -1 to 1.
        travel_m: Signed travel; none leaves the deflection, so friction holds at rest.
        presliding_m: Travel over which 63 % of a reversal is done.
    """
    if travel_m == 0.0:
        return bristle
    target = math.copysign(1.0, travel_m)
    return target + (bristle - target) * math.exp(-abs(travel_m) / presliding_m)


def follow_depth(follower_m: float, depth_m: float, play_m: float) -> float:
    """Depth without the jitter of its measurement: it moves only when more than `play_m` behind.

    The play of a loose coupling: noise smaller than the play causes no reversal, a true reversal
    is followed after twice the play.
    """
    if follower_m < depth_m - play_m:
        return depth_m - play_m
    return min(follower_m, depth_m + play_m)
