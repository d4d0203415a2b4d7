"""When a needle's tip rests in contact.

The force of a model has an offset that changes with the posture, so a contact is a rise
of the force over what was felt while the tip last moved.
"""

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
        self._samples: list[Array] = []  # of this moment: tip, force
        self._time_s = 0.0
        # Ends of moments, mean places of the tip and mean forces, the latest first.
        self._slots: Array = np.zeros((0, 7))
        self._last_m = np.full(3, np.inf)

    def update(self, dt_s: float, tip_m: Array, force_N: Array) -> TipTouch | None:
        """Take a sample; return the touch that it completes, if it does.

        Args:
            dt_s: Time since the last one.
            tip_m: Place of the tip in the base, (3,).
            force_N: Force on it in any fixed axes, (3,).
        """
        kept_s = 60.0  # a touch needs what was felt before it, up to so long ago
        self._time_s += dt_s
        self._samples.append(np.concatenate([tip_m, force_N]))
        if self._time_s < self._slots[:, 0].max(initial=0.0) + SLOT_s:
            return None
        slot = np.append(self._time_s, np.mean(self._samples, axis=0))
        self._slots = np.vstack([slot, self._slots])[: round(kept_s / SLOT_s)]
        self._samples.clear()
        return self._find_touch()

    def take_now(self) -> TipTouch | None:
        """Return where the tip is now, as a touch; None before the first moment."""
        if not len(self._slots):
            return None
        self._last_m = self._slots[0, 1:4]
        return TipTouch(self._last_m, 0.0)

    def _find_touch(self) -> TipTouch | None:
        """Return the touch of the latest second, if it was one."""
        still_m = 0.7e-3  # in a ball of this radius it rests: a hand trembles by less
        is_recent = self._slots[:, 0] >= self._time_s - DWELL_s
        recent = self._slots[is_recent]
        older = self._slots[~is_recent]
        place_m = recent[:, 1:4].mean(axis=0)
        radius_m = np.linalg.norm(recent[:, 1:4] - place_m, axis=1).max()
        is_new = np.linalg.norm(place_m - self._last_m) >= AWAY_m
        is_away = np.linalg.norm(older[:, 1:4] - place_m, axis=1) >= AWAY_m
        if radius_m > still_m or not is_new or not is_away.any():
            return None
        # What was felt when the tip was last away from that place.
        first = int(is_away.argmax())
        stays = np.append(is_away[first:], False)
        last = first + min(int(stays.argmin()), round(FREE_s / SLOT_s))
        rise_N = recent[:, 4:].mean(axis=0) - older[first:last, 4:].mean(axis=0)
        force_N = float(np.linalg.norm(rise_N))
        if force_N < self._contact_N:
            return None
        self._last_m = place_m
        return TipTouch(place_m, force_N)
