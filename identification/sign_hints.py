"""Tells what a recording with a flipped sign or a wrong unit looks like."""

import numpy as np
from numpy.typing import NDArray

_LEAST_TRAVEL_M = 1e-3
_LARGEST_DEPTH_M = 1.0
_LEAST_FORCE_N = 0.02

Array = NDArray[np.float64]


class SignWatch:
    """Looks at a recording, of which any number of rows may come at a time."""

    def __init__(self) -> None:
        self._last_m = np.empty(0)
        self._deepest_m, self._least_m = -np.inf, np.inf
        self._start_m: float | None = None
        self._pushed_Nm = self._fresh_m = self._agreement = 0.0
        self._least_N, self._largest_N = np.inf, -np.inf

    def update(self, depth_m: Array, speed_m_s: Array | None, force_N: Array) -> None:
        """Take further rows.

        Args:
            depth_m: Tip depth, shape (n,); may hold gaps.
            speed_m_s: Recorded speed, shape (n,), or None.
            force_N: Axial force, shape (n,).
        """
        before = self._last_m if self._last_m.size else depth_m[:1]
        change = np.diff(depth_m, prepend=before)
        self._last_m = depth_m[-1:]
        good = np.isfinite(change) & np.isfinite(force_N)
        change, force = np.where(good, change, 0.0), np.where(good, force_N, 0.0)
        known = depth_m[np.isfinite(depth_m)]
        if known.size:
            self._start_m = float(known[0]) if self._start_m is None else self._start_m
            self._least_m = min(self._least_m, float(known.min()))
        depth = np.where(np.isfinite(depth_m), depth_m, -np.inf)
        deepest = np.maximum.accumulate(np.concatenate(([self._deepest_m], depth)))
        fresh = change * ((change > 0.0) & (depth >= deepest[1:]))
        self._deepest_m = float(deepest[-1])
        self._pushed_Nm += float((force * fresh).sum())
        self._fresh_m += float(fresh.sum())
        self._least_N = min(self._least_N, float(force.min()))
        self._largest_N = max(self._largest_N, float(force.max()))
        if speed_m_s is not None:
            self._agreement += float(np.nansum(change * speed_m_s))

    def hints(self) -> tuple[str, ...]:
        """One sentence per suspicion; none for a recording that looks right."""
        hints = []
        start = self._start_m
        span = 0.0 if start is None else self._deepest_m - self._least_m
        if span > _LARGEST_DEPTH_M:
            hints.append(f"depth spans {span:.3g} m; is it in millimetres?")
        if start is None or span < _LEAST_TRAVEL_M:
            return (
                *hints,
                f"depth moves by {span * 1e3:.3g} mm only; there is nothing to identify",
            )
        if self._fresh_m > 0.0 and self._pushed_Nm / self._fresh_m < -_LEAST_FORCE_N:
            hints.append(
                "the force is negative while the needle goes in; it must be positive when tissue "
                "pushes back: flip its sign"
            )
        if start - self._least_m > 0.7 * span and self._largest_N > self._least_N:
            hints.append(
                "depth falls before it rises; it must grow into the tissue: flip its sign?"
            )
        if self._agreement < 0.0:
            hints.append("speed has the sign opposite to the change of depth: flip one of them")
        return tuple(hints)


def sign_hints(depth_m: Array, speed_m_s: Array | None, force_N: Array) -> tuple[str, ...]:
    """Look at a whole recording for signs of a wrong sign.

    Args:
        depth_m: Tip depth, shape (n,); may hold gaps.
        speed_m_s: Recorded speed, shape (n,), or None.
        force_N: Axial force, shape (n,).

    Returns:
        One sentence per suspicion; none for a recording that looks right.
    """
    watch = SignWatch()
    watch.update(depth_m, speed_m_s, force_N)
    return watch.hints()
