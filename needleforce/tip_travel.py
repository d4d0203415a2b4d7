"""Travel of the needle's tip from joint positions and velocities, also as late as the force."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.jit import Matrix, Vector, compiled


class TravelZero(NamedTuple):
    """Where depth is counted from."""

    start_in_base_m: NDArray[np.float64]  # the tip's place, shape (3,)
    axis_in_base: NDArray[np.float64]  # the needle's direction, shape (3,)


@compiled
def tip_motion(
    axis: Vector, pose: Matrix, axial_jacobian: Vector, dq: Vector
) -> tuple[float, float]:
    """Place of the tip along an axis in base axes [m], and its speed along the needle [m/s]."""
    along_m = axis[0] * pose[0, 3] + axis[1] * pose[1, 3] + axis[2] * pose[2, 3]
    return float(along_m), float(axial_jacobian.dot(dq))


@compiled
def travel_step(
    tip: tuple[Vector, Matrix, Vector, Vector],
    start_m: float,
    last: tuple[float, float, float, float],
    dt_s: float,
    lags_s: tuple[float, float],
) -> tuple[float, float, float, float]:
    """Depth [m] and speed [m/s] of the tip, and the same as late as the force.

    Depth grows inwards along the needle's direction at the zero; speed is along its present one.

    A needle that a hand drives changes its speed within the observer's lag: the force of a moment
    ago, beside the speed of now, would look like friction that comes and goes.

    Args:
        tip: What `tip_motion` takes.
        start_m: Place at depth zero.
        last: What the step before returned.
        dt_s: Time since then.
        lags_s: Of the speed's own low-pass, 0 for none, and of the force.
    """
    along, speed = tip_motion(*tip)
    depth, (speed_lag_s, force_lag_s) = along - start_m, lags_s
    _, last_speed, late_depth, late_speed = last
    if speed_lag_s > 0.0:
        speed = last_speed - math.expm1(-dt_s / speed_lag_s) * (speed - last_speed)
    if force_lag_s <= 0.0:
        return depth, speed, depth, speed
    kept = math.exp(-dt_s / force_lag_s)
    return depth, speed, depth + kept * (late_depth - depth), speed + kept * (late_speed - speed)
