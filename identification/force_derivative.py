"""Low-pass derivative of the force: the second criterion of Section III-B."""

import math


def derivative_step(
    derivative_N_per_s: float, change_N: float, dt_s: float, time_constant_s: float
) -> float:
    """Advance the first-order low-pass of df/dt; exact for a force linear over the step.

    Args:
        derivative_N_per_s: Filtered derivative so far.
        change_N: f_k - f_{k-1}.
        dt_s: Time between the two samples.
        time_constant_s: Of the low-pass.
    """
    keep = math.exp(-dt_s / time_constant_s)
    return keep * derivative_N_per_s + (1.0 - keep) * change_N / dt_s
