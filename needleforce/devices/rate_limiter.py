"""The velocities that a joint may be given in the coming cycle: one rule for all.

The controller solves its tasks within them, and the guard before every arm cuts to them
what it is asked for.
"""

import numpy as np

from foundation.arrays import Matrix, Vector, WrittenMatrix
from foundation.jit import compiled


@compiled
def write_velocity_bounds(
    limits: Matrix,
    q_rad: Vector,
    last_rad_s: Vector,
    last_rad_s2: Vector,
    cycle_s: float,
    slack_rad_s: float,
    bounds: WrittenMatrix,
) -> None:
    """Write the bounds l <= dq <= u of the coming cycle.

        u = min(v, sqrt((b t)^2 + 2 b (q_max - q)) - b t),    t = (a + b) / j + 2 T
        clipped to  dq_last + T clip(a_last -+ j T, -a, a)

    and l alike. The root is the fastest speed from which the joint, braking at b after
    the time t that it takes to turn to it, stops before q_max: u^2 / 2b + u t =
    q_max - q. From anywhere in the box the next cycle has such a speed within reach
    again. Where noise or a push has moved the arm too close, or nobody knows where it
    is, the clip lets it brake as hard as it may; l <= u. With a <= j T an acceleration
    ends within a cycle: whatever velocity is wanted is met without overshoot.

    Args:
        limits: q_min, q_max, v, a, j and b, shape (6, n). One array passes into
            compiled code in 0.4 us less than five.
        q_rad: q, shape (n,); nan where it is not known.
        last_rad_s: dq_last, the velocity commanded last, shape (n,).
        last_rad_s2: a_last, its change since the one before, over T, shape (n,).
        cycle_s: T, over which a change of the velocity counts.
        slack_rad_s: By so much the bounds stay inside what accelerations allow.
        bounds: l and u, shape (2, n).
    """
    acceleration_rad_s2 = limits[3]
    brake_rad_s2 = limits[5]
    change_rad_s2 = limits[4] * cycle_s
    start_rad_s2 = np.minimum(
        np.maximum(last_rad_s2, -acceleration_rad_s2), acceleration_rad_s2
    )
    lowest_rad_s2 = np.maximum(start_rad_s2 - change_rad_s2, -acceleration_rad_s2)
    highest_rad_s2 = np.minimum(start_rad_s2 + change_rad_s2, acceleration_rad_s2)
    lowest_rad_s = last_rad_s + cycle_s * lowest_rad_s2 + slack_rad_s
    highest_rad_s = last_rad_s + cycle_s * highest_rad_s2 - slack_rad_s
    turn_s = (acceleration_rad_s2 + brake_rad_s2) / limits[4] + 2.0 * cycle_s
    lost_rad_s = brake_rad_s2 * turn_s
    room_below = np.fmax(q_rad - limits[0], 0.0)
    room_above = np.fmax(limits[1] - q_rad, 0.0)
    lower = lost_rad_s - np.sqrt(lost_rad_s**2 + 2.0 * brake_rad_s2 * room_below)
    upper = np.sqrt(lost_rad_s**2 + 2.0 * brake_rad_s2 * room_above) - lost_rad_s
    lower = np.maximum(lower, -limits[2])
    upper = np.minimum(upper, limits[2])
    bounds[0] = np.minimum(np.maximum(lower, lowest_rad_s), highest_rad_s)
    bounds[1] = np.minimum(np.maximum(upper, lowest_rad_s), highest_rad_s)
