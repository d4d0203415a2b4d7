"""Speed from depth, for recordings without it."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WINDOW_S = 0.05
_MOST_ROWS = 5000
_GAP_S = 0.25
"""What happened in a longer step says little about the rows beside it."""
_LITTLE_S = 1e-9


class DerivedSpeed:
    """Change of depth over time, centred over 50 ms; rows wait for the half window after them.

    Only rows whose stamps advance count: where several rows have one stamp, the first of them.
    The others get the speed of the row that advanced before them. However many rows come at a
    time, the numbers are the same, bit for bit.

    Args:
        step_s: Usual step of the stamps that advance [s], > 0; at most 100 kHz are smoothed so
            long.
    """

    def __init__(self, step_s: float) -> None:
        self._width = min(max(round(_WINDOW_S / step_s), 1), _MOST_ROWS)
        self._depth_m = np.empty(0)
        self._is_padded = False
        # Steps of time and changes of depth up to rows that advance.
        self._steps = np.empty((2, 0))
        # Of every row that waits, which one advanced last, counted from the first unknown speed.
        self._owners = np.empty(0, dtype=np.int64)
        self._advanced = 0
        self._speed_m_s = 0.0

    def update(self, dt_s: Array, depth_m: Array) -> Array:
        """Take further rows.

        Args:
            dt_s: Time since the latest row that advanced [s], shape (n,), n > 0; not positive for
                rows that do not advance. That of the very first row is not read.
            depth_m: Depth [m], shape (n,).

        Returns:
            Speeds [m/s] of the rows that need wait no longer, beginning with the first that has
            not been returned, shape (m,).
        """
        advances = dt_s > 0.0
        is_first = not self._depth_m.size
        advances[0] |= is_first
        self._owners = np.concatenate((self._owners, self._advanced - 1 + np.cumsum(advances)))
        self._advanced += int(np.count_nonzero(advances))
        depths = np.concatenate((self._depth_m, depth_m[advances]))
        steps = np.stack((dt_s[advances][1:] if is_first else dt_s[advances], np.diff(depths)))
        self._depth_m = depths[-1:]
        if steps.size and not self._is_padded:
            # The first row has no step before it: it takes the second's, as do those before it.
            self._is_padded = True
            steps = np.hstack((np.repeat(steps[:, :1], self._width // 2 + 1, axis=1), steps))
        self._steps = np.hstack((self._steps, steps))
        return self._known(self._means())

    def finish(self) -> Array:
        """Return the speeds of the rows that still waited [m/s], shape (m,)."""
        if not self._is_padded:
            return np.zeros(len(self._owners))
        after = self._width - 1 - self._width // 2
        last = np.repeat(self._steps[:, -1:], after, axis=1)
        self._steps = np.hstack((self._steps, last))
        return self._known(self._means())

    def _known(self, means: Array) -> Array:
        """Speeds of the rows whose last advancing row is among those of the means, or before."""
        speeds = np.concatenate(([self._speed_m_s], means))
        is_known = self._owners < len(means)
        known = speeds[self._owners[is_known] + 1]
        self._owners = self._owners[~is_known] - len(means)
        self._advanced -= len(means)
        self._speed_m_s = float(speeds[-1])
        return known

    def _means(self) -> Array:
        """Known changes of depth over their time, in every whole window."""
        rows = self._steps.shape[1] - self._width + 1
        if rows <= 0:
            return np.empty(0)
        dt_s, change_m = self._steps
        weights = np.where(np.isfinite(change_m), np.where(dt_s > _GAP_S, _LITTLE_S, dt_s), 0.0)
        changes = np.where(weights > 0.0, change_m * (weights / dt_s), 0.0)
        total, time_s = np.zeros(rows), np.zeros(rows)
        # In this order for every row, so that rounding does not depend on how rows came.
        for k in range(self._width):
            total += changes[k : k + rows]
            time_s += weights[k : k + rows]
        self._steps = self._steps[:, rows:]
        return np.divide(total, time_s, out=np.full(rows, np.nan), where=time_s > 0.0)
