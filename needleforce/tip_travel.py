"""Travel of the needle's tip from joint positions and velocities."""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector, WrittenVector
from foundation.jit import compiled_inside
from foundation.linear_algebra import multiply

Needle = tuple[Vector, Matrix, Matrix, Vector, Vector]
"""Type of `residual.ToolKinematics.needle`: a plain tuple, for Python passes one to
compiled code ten times as fast as a named tuple."""


class TravelZero(NamedTuple):
    """Point and direction from which depth is counted, in base axes.

    Attributes:
        start_in_base_m: Position of the tip at depth zero, shape (3,).
        axis_in_base: Direction of the needle there, length one, shape (3,).
    """

    start_in_base_m: Array
    axis_in_base: Array


class TipTravel(NamedTuple):
    """Depth and speed of the tip, and the same delayed by as much as the force.

    A needle that a hand drives changes its speed within the observer's lag: the force
    of a moment ago, beside the present speed, would look like friction that comes and
    goes.

    Attributes:
        depth_m: Travel since the zero, positive inwards, along the needle's direction
            at the zero.
        speed_m_s: Speed along the needle's present direction.
        delayed_depth_m: Depth behind a first-order low-pass with the lag of the force.
        delayed_speed_m_s: Speed behind the same low-pass.
    """

    depth_m: float = 0.0
    speed_m_s: float = 0.0
    delayed_depth_m: float = 0.0
    delayed_speed_m_s: float = 0.0

    def advanced(
        self,
        depth_m: float,
        speed_m_s: float,
        dt_s: float,
        *,
        speed_lag_s: float,
        force_lag_s: float,
    ) -> "TipTravel":
        """Return the travel a time step later.

        With the lag T each low-pass follows x by y += (1 - exp(-dt / T)) (x - y).

        Args:
            depth_m: Measured depth [m].
            speed_m_s: Measured speed [m/s].
            dt_s: Time since the step before [s].
            speed_lag_s: Time constant of the low-pass of the speed [s]; 0 for none.
            force_lag_s: Lag of the force [s], by which both are delayed; 0 for none.
        """
        if speed_lag_s > 0.0:
            passed = -math.expm1(-dt_s / speed_lag_s)
            speed_m_s = self.speed_m_s + passed * (speed_m_s - self.speed_m_s)
        if force_lag_s <= 0.0:
            return TipTravel(depth_m, speed_m_s, depth_m, speed_m_s)
        remaining = math.exp(-dt_s / force_lag_s)
        late_depth_m = depth_m + remaining * (self.delayed_depth_m - depth_m)
        late_speed_m_s = speed_m_s + remaining * (self.delayed_speed_m_s - speed_m_s)
        return TipTravel(depth_m, speed_m_s, late_depth_m, late_speed_m_s)


class TipPlace(NamedTuple):
    """Position of the tip and direction of the needle, in base axes.

    Attributes:
        position_m: Position of the tip, shape (3,).
        direction: Direction of the needle, shape (3,).
    """

    position_m: WrittenVector
    direction: WrittenVector


@compiled_inside
def place_tip(needle: Needle) -> TipPlace:
    """Return where the tip is and where the needle points to."""
    place, axes, _, tip, direction = needle
    position = place.copy()
    along = np.zeros(3)
    for i in range(3):
        for k in range(3):
            position[i] += tip[k] * axes[k, i]
            along[i] += direction[k] * axes[k, i]
    return TipPlace(position, along)


@compiled_inside
def tip_speed(tip: TipPlace, needle: Needle, dq: Vector) -> float:
    """Return the speed of the tip along the needle [m/s].

    With linear and angular velocity v and w of the link that carries the needle, taken
    at the base's origin, the tip at r has the speed v . d + w . (r x d) along the
    needle's direction d.

    Args:
        tip: Where it is.
        needle: `residual.ToolKinematics.needle`.
        dq: Joint velocities [rad/s], shape (n,).
    """
    twist = multiply(dq.reshape(1, len(dq)), needle[2])[0]
    x, y, z = tip.position_m
    a, b, c = tip.direction
    speed = a * twist[0] + b * twist[1] + c * twist[2]
    speed += (
        (y * c - z * b) * twist[3]
        + (z * a - x * c) * twist[4]
        + (x * b - y * a) * twist[5]
    )
    return speed
