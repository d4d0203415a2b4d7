"""How far an estimate runs behind the truth."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

Array = NDArray[np.float64]

EARLIEST_S, LATEST_S = -0.1, 0.6
"""Delays that are looked for; the paper's own lag is 0.2 s."""
COARSE_S = 0.01


def force_lag_s(t_s: Array, estimate: Array, truth: Array) -> float:
    """Delay of the estimate: the shift of the truth that leaves the least squared difference.

    A constant difference between the two is not counted.

    Args:
        t_s: Time, shape (n,), increasing.
        estimate: Shape (n,).
        truth: Shape (n,).

    Returns:
        The delay [s], positive when the estimate is late; nan where the truth does not change, or
        for less than a second of data.
    """
    inner = (t_s >= t_s[0] + LATEST_S) & (t_s <= t_s[-1] + EARLIEST_S) if len(t_s) else t_s > 0
    if np.count_nonzero(inner) < 2 or np.ptp(truth) == 0.0:
        return float("nan")
    seen, when = estimate[inner], t_s[inner]

    def left(delay_s: float) -> float:
        return float(np.var(seen - np.interp(when - delay_s, t_s, truth)))

    coarse = np.arange(EARLIEST_S, LATEST_S + COARSE_S / 2, COARSE_S)
    best = float(coarse[np.argmin([left(delay) for delay in coarse])])
    around = (max(best - COARSE_S, EARLIEST_S), min(best + COARSE_S, LATEST_S))
    found = minimize_scalar(left, bounds=around, method="bounded", options={"xatol": 1e-5})
    return float(found.x)
