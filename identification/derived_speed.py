"""Speed from depth, for recordings without it."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WINDOW_S = 0.05
_MOST_ROWS = 5000


class DerivedSpeed:
    """Difference quotient of depth, centred over 50 ms; rows wait for the half window after them.

    However many rows come at a time, the numbers are the same, bit for bit.

    Args:
        step_s: Usual time step of the recording [s], > 0; at most 100 kHz are smoothed so long.
    """

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self._width = min(max(round(_WINDOW_S / step_s), 1), _MOST_ROWS)
        self._last: tuple[Array, Array] | None = None
        self._rates = np.empty(0)

    def update(self, t_s: Array, depth_m: Array) -> Array:
        """Take further rows.

        Args:
            t_s: Time stamps [s], shape (n,), n > 0.
            depth_m: Depth [m], shape (n,).

        Returns:
            Speeds [m/s] of the rows that need wait no longer, beginning with the first that has
            not been returned, shape (m,).
        """
        is_first = self._last is None
        t_before, z_before = (t_s[:1], depth_m[:1]) if self._last is None else self._last
        self._last = t_s[-1:], depth_m[-1:]
        steps = np.diff(t_s, prepend=t_before)
        rates = np.diff(depth_m, prepend=z_before) / np.where(steps > 0.0, steps, self._step_s)
        if is_first:
            # The first row has no step before it: it takes the second's rate, as do those before.
            rates = rates[1:] if len(rates) > 1 else rates
            rates = np.concatenate((np.repeat(rates[:1], self._width // 2 + 1), rates))[
                : len(t_s) + self._width // 2
            ]
        self._rates = np.concatenate((self._rates, rates))
        return self._means()

    def finish(self) -> Array:
        """Return the speeds of the rows that still waited [m/s], shape (m,)."""
        if not self._rates.size:
            return self._rates
        after = self._width - 1 - self._width // 2
        self._rates = np.concatenate((self._rates, np.repeat(self._rates[-1:], after)))
        return self._means()

    def _means(self) -> Array:
        """Mean of the known rates in every whole window."""
        rows = len(self._rates) - self._width + 1
        if rows <= 0:
            return np.empty(0)
        is_known = np.isfinite(self._rates)
        rates = np.where(is_known, self._rates, 0.0)
        total, known = np.zeros(rows), np.zeros(rows)
        # In this order for every row, so that rounding does not depend on how rows came.
        for k in range(self._width):
            total += rates[k : k + rows]
            known += is_known[k : k + rows]
        self._rates = self._rates[rows:]
        return np.where(known > 0.0, total / np.maximum(known, 1.0), np.nan)
