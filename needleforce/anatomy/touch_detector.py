"""When a needle's tip rests in contact.

The force of a model has an offset that changes with the posture, so a contact is a rise
of the force over what was felt while the tip last moved.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array

DWELL_s = 1.0
"""So long the tip rests."""

AWAY_m = 4e-3
"""After a touch it must have moved so far before the next; and only what was felt so
far away counts as the force of the free needle."""

FREE_s = 0.5
"""Time over which the force of the free needle is averaged."""

SLOT_s = 0.02
"""Samples are averaged over so long: one is as good as fifty."""


class _Slot(NamedTuple):
    """A moment.

    Attributes:
        time_s: Its end.
        tip_m: Mean place of the tip, (3,).
        force_N: Mean force, (3,).
    """

    time_s: float
    tip_m: Array
    force_N: Array


class TipTouch(NamedTuple):
    """A place that was touched.

    Attributes:
        place_m: Of the tip in the robot's base, (3,).
        force_N: By which the force rose there.
    """

    place_m: Array
    force_N: float


class TouchDetector:
    """Finds touches in the places and forces of a needle's tip.

    Args:
        contact_N: Least rise of the force in contact.
    """

    def __init__(self, contact_N: float) -> None:
        self._contact_N = contact_N
        self._sums = np.zeros(6)
        self._count = 0
        self._time_s = 0.0
        self._slot_end_s = SLOT_s
        self._recent: deque[_Slot] = deque()
        self._older: deque[_Slot] = deque(maxlen=int(60.0 / SLOT_s))
        self._last_m: Array | None = None

    def update(self, dt_s: float, tip_m: Array, force_N: Array) -> TipTouch | None:
        """Take a sample; return the touch that it completes, if it does.

        Args:
            dt_s: Time since the last one.
            tip_m: Place of the tip in the base, (3,).
            force_N: Force on it in any fixed axes, (3,).
        """
        self._time_s += dt_s
        self._sums += np.concatenate([tip_m, force_N])
        self._count += 1
        if self._time_s < self._slot_end_s:
            return None
        mean = self._sums / self._count
        self._sums[:] = 0.0
        self._count = 0
        self._slot_end_s = self._time_s + SLOT_s
        self._recent.append(_Slot(self._time_s, mean[:3], mean[3:]))
        while self._recent[0].time_s < self._time_s - DWELL_s:
            self._older.append(self._recent.popleft())
        return self._find_touch()

    def take_now(self) -> TipTouch | None:
        """Return where the tip is now, as a touch; None before the first moment."""
        if not self._recent:
            return None
        self._last_m = self._recent[-1].tip_m
        return TipTouch(self._last_m, 0.0)

    def _find_touch(self) -> TipTouch | None:
        """Return the touch of the latest second, if it was one."""
        span_s = self._recent[-1].time_s - self._recent[0].time_s
        if span_s < DWELL_s - 2.0 * SLOT_s:
            return None
        tips_m = np.array([slot.tip_m for slot in self._recent])
        place_m = tips_m.mean(axis=0)
        # It rests while it stays in a ball of this radius: a hand trembles by less.
        still_m = 0.7e-3
        if np.linalg.norm(tips_m - place_m, axis=1).max() > still_m:
            return None
        if self._is_at_last_touch(place_m):
            return None
        free_N = self._free_force_N(place_m)
        if free_N is None:
            return None
        force_N = np.mean([slot.force_N for slot in self._recent], axis=0)
        rise_N = float(np.linalg.norm(force_N - free_N))
        if rise_N < self._contact_N:
            return None
        self._last_m = place_m
        return TipTouch(place_m, rise_N)

    def _is_at_last_touch(self, place_m: Array) -> bool:
        """Return whether the tip has not left the place of the last touch."""
        if self._last_m is None:
            return False
        return bool(np.linalg.norm(place_m - self._last_m) < AWAY_m)

    def _free_force_N(self, place_m: Array) -> Array | None:
        """Return the force that was felt when the tip was last away from a place."""
        away: list[Array] = []
        for slot in reversed(self._older):
            if np.linalg.norm(slot.tip_m - place_m) >= AWAY_m:
                away.append(slot.force_N)
            elif away:
                break
            if len(away) * SLOT_s >= FREE_s:
                break
        return np.mean(away, axis=0) if away else None
