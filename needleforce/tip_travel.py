"""Travel of the needle's tip from joint positions and velocities, also as late as
the force.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.jit import Matrix, Vector, compiled, dot

Array = NDArray[np.float64]
Needle = tuple[
    Vector, Matrix, Matrix, Vector, Vector
]  # `residual.ToolKinematics.needle`


class TravelZero(NamedTuple):
    """Where depth is counted from.

    Attributes:
        start_in_base_m: The tip's place, shape (3,).
        axis_in_base: The needle's direction, shape (3,).
    """

    start_in_base_m: Array
    axis_in_base: Array


@compiled
def tip_motion(axis: Vector, needle: Needle, dq: Vector) -> tuple[float, float]:
    """Place of the tip along an axis in base axes [m], and its speed along the needle
    [m/s].

    The axis has length one, shape (3,); joint velocities are in rad/s, shape (n,). With
    linear and angular velocity v and w of the link that carries the needle, at the
    base's origin, the tip at r has the speed v . d + w . (r x d) along the needle's
    direction d.
    """
    place, axes, jacobian, tip, direction = needle
    at = place + tip[0] * axes[0] + tip[1] * axes[1] + tip[2] * axes[2]
    along = direction[0] * axes[0] + direction[1] * axes[1] + direction[2] * axes[2]
    twist = dq.dot(jacobian)
    x, y, z = at
    a, b, c = along
    speed = a * twist[0] + b * twist[1] + c * twist[2]
    speed += (
        (y * c - z * b) * twist[3]
        + (z * a - x * c) * twist[4]
        + (x * b - y * a) * twist[5]
    )
    return float(dot(axis, at)), float(speed)


@compiled
def travel_step(
    tip: tuple[Vector, Needle, Vector],
    start_m: float,
    last: tuple[float, float, float, float],
    dt_s: float,
    lags_s: tuple[float, float],
) -> tuple[float, float, float, float]:
    """Depth [m] and speed [m/s] of the tip, and the same as late as the force.

    Depth grows inwards along the needle's direction at the zero; speed is along its
    present one.

    A needle that a hand drives changes its speed within the observer's lag: the force
    of a moment ago, beside the speed of now, would look like friction that comes and
    goes.

    Args:
        tip: What `tip_motion` takes.
        start_m: Place at depth zero.
        last: What the step before returned.
        dt_s: Time since then.
        lags_s: Of the speed's own low-pass, 0 for none, and of the force.
    """
    along, speed = tip_motion(*tip)
    depth = along - start_m
    speed_lag_s, force_lag_s = lags_s
    _, last_speed, late_depth, late_speed = last
    if speed_lag_s > 0.0:
        speed = last_speed - math.expm1(-dt_s / speed_lag_s) * (speed - last_speed)
    if force_lag_s <= 0.0:
        return depth, speed, depth, speed
    kept = math.exp(-dt_s / force_lag_s)
    return (
        depth,
        speed,
        depth + kept * (late_depth - depth),
        speed + kept * (late_speed - speed),
    )
