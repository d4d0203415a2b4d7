"""Motion of the tissue by itself, heartbeat and breathing, found in the force, and then
used.

`motion_fit` has the law of the force that it is found by, here is when it is looked
for, taken for known, and given up. A unit of this work is done per block of samples.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from identification.multilayer import motion_fit as windows
from identification.multilayer.mixture import Place
from identification.multilayer.motion_fit import Fit, Window, displacement, turned

_LEAST_S = 2.5
_MARGIN = 7
"""Least length of a window, and newest means left out: a release may have begun
there."""
_SETTLE_S = 0.25  # after an alarm, until its release is over
_LOST = 1.0
_PATIENCE = 8
"""Mean square of the errors of a fit to give up, and so many steps in a row that are
not good."""
_FINE = 0.12
_WITHOUT_HEART = 0.25
_PROVEN = 5
"""Of a likely motion: most mean square of its errors, the same as part of that without
its heartbeat (seen: 1/8 to 1/280), and how many steps in a row both must hold."""
_CHECK_S = 0.25
_ADAPT_S = 0.2
_WAIT_S = 0.5
"""Between two looks whether the tissue moves, two steps of a known motion, and two
searches."""
# Gauss-Newton steps of a fit, and of each start of one with two beats
_STEPS = 8
_STEPS_EACH = 7
# Breaths that those begin with
_SLOW = np.linspace(0.15, 0.45, 7)
_SIZES = (0.7, 1.4)
_SCANNED = len(windows.BREATH) + 2 * len(
    windows.HEART
)  # units of a search before the first fit
_BOTH = 2 * _STEPS - 1 + len(_SLOW) * (1 + _STEPS_EACH)
_DONE = _STEPS - 1, _BOTH, _BOTH + _STEPS
"""Units after those at which a fit is done: the heart alone, both, the breath alone."""
_UNITS = _SCANNED + _DONE[-1] + 2
_FADE_S = 1.0
_BELIEF_S = 2.0
"""Over which a motion just found comes in, and is believed: the bank has learned
without it."""
_EMPTY = (0.0,) * 5
_IDLE: dict[str, Any] = {
    "unit": -1,
    "bad": 0,
    "tried": Fit(),
    "best": Fit(),
    "first": Fit(),
}


class TissueMotion(NamedTuple):
    """What is known of the motion; immutable.

    Attributes:
        window: Means of time, depth, speed and force, in two layers.
        until_s: The layer before ended.
        from_s: Its last layer begins, what lies between is not used.
        fit: The motion in use, if it has beats.
        since_s: In use since then.
        bad: Steps in a row at which it was no good fit.
        next_s: When it is looked at again.
        unit: The next one of a search, -1 outside one.
        found: Of breath, heart, one beside the other: error, frequencies.
        tried: Being fitted in a search.
        best: So far in that search.
        first: The best of its starts with two beats.
        likely: A good one found by the last search that was not clear yet.
        held: Steps in a row at which that explained the force.
    """

    window: Array = np.zeros((0, 4))
    filling: tuple[float, ...] = (
        _EMPTY  # length of the mean being filled, integrals of those
    )
    until_s: float = 0.0
    from_s: float = 0.0
    fit: Fit = Fit()
    since_s: float = 0.0
    bad: int = 0
    next_s: float = 0.0
    unit: int = -1
    found: Array = np.zeros((3, 3))
    tried: Fit = Fit()
    best: Fit = Fit()
    first: Fit = Fit()
    likely: Fit = Fit()
    held: int = 0

    @property
    def damage(self) -> str:
        """What is wrong with a restored one, if anything."""
        return (
            ""
            if self.unit in range(-1, _UNITS)
            else f"there is no unit {self.unit!r:.80}"
        )

    @property
    def is_known(self) -> bool:
        """Whether a motion is in use."""
        return len(self.fit.beats) > 0

    def at(self, time_s: float) -> tuple[float, float]:
        """Place and speed of the tissue [mm, mm/s]."""
        at_s = np.array([time_s - self.fit.at_s])
        place, speed = (float(each[0]) for each in displacement(self.fit.beats, at_s))
        part = min(max((time_s - self.since_s) / _FADE_S, 0.0), 1.0)
        kept = part * part * (3.0 - 2.0 * part)
        rate = 6.0 * part * (1.0 - part) / _FADE_S
        return kept * place, kept * speed + rate * place

    def limits(self, time_s: float) -> tuple[float, float, float]:
        """Variance of the force that heartbeat and breathing leave unexplained.

        The third is the part by which the motion just found is believed.
        """
        slow = self.fit.beats[:, 0] < windows.SLOWEST_HEART
        left = (2.0 * self.fit.rms_N) ** 2
        part = min(max((time_s - self.since_s) / _BELIEF_S, 0.0), 1.0)
        return left * float((~slow).any()), left * float(slow.any()), part

    def restarted(self, time_s: float) -> "TissueMotion":
        """After a rupture: a new layer begins, the motion goes on.

        Of the layers before stays the last one that was long enough to say something.
        """
        window = self.window
        until_s = self.until_s
        fit = Fit()
        is_last = window[:, 0] >= self.from_s
        if is_last.sum() >= _MARGIN + _LEAST_S / windows.STEP_S:
            window = window[is_last]
            fit = self.fit
            until_s = float(window[-_MARGIN, 0])
        from_s = time_s + _SETTLE_S
        since_s = self.since_s
        return TissueMotion(
            window, until_s=until_s, from_s=from_s, fit=fit, since_s=since_s
        )

    def with_block(self, block: Place, *, is_met: bool) -> "TissueMotion":
        """Use means of a block of samples, in the tissue's frame, once tissue has
        been met.
        """
        if not is_met:
            return self if len(self.window) == 0 else TissueMotion()
        place, speed = self.at(block.time_s) if self.is_known else (0.0, 0.0)
        means = (
            1.0,
            block.time_s,
            block.depth + place,
            block.speed + speed,
            block.force,
        )
        sums = zip(self.filling, means, strict=True)
        filling = tuple(total + block.dt_s * mean for total, mean in sums)
        if filling[0] < windows.STEP_S * (1.0 - 1e-9):
            return self._replace(filling=filling)
        window = np.vstack(
            (self.window[-windows.SIZE + 1 :], np.array(filling[1:]) / filling[0])
        )
        return self._replace(window=window, filling=_EMPTY)

    def is_due(self, time_s: float) -> bool:
        """Whether there is work to do: the window is long enough to be fitted."""
        is_long = len(self.window) >= _MARGIN + _LEAST_S / windows.STEP_S
        return is_long and (self.unit >= 0 or time_s >= self.next_s)

    def worked(self, time_s: float) -> "TissueMotion":
        """Do one unit of what is due."""
        window = Window(self.window[:-_MARGIN], self.until_s, self.from_s)
        if len(self.likely.beats) > 0 and time_s >= self.next_s:
            return self._followed(window, time_s)
        if self.unit >= 0:
            return self._searched(window, time_s)
        if not self.is_known:
            due = 0 if window.still > max(windows.CLEAR, 0.1 * window.count) else -1
            return self._replace(next_s=time_s + _CHECK_S, unit=due)
        fit = window.stepped(turned(self.fit, time_s), is_prior=True)
        is_good = fit.error < min(windows.GOOD * window.count, window.still)
        bad = 0 if is_good else self.bad + 1
        unit = 0 if bad >= _PATIENCE else -1
        if 0 < bad < _PATIENCE:  # it may be a rupture: noise does not grow yet
            fit = fit._replace(rms_N=min(fit.rms_N, self.fit.rms_N))
        return self._replace(fit=fit, bad=bad, next_s=time_s + _ADAPT_S, unit=unit)

    def _followed(self, window: Window, time_s: float) -> "TissueMotion":
        """A step of a motion that is likely, until it is clear; the search goes on
        beside it.
        """
        fit = window.stepped(turned(self.likely, time_s))
        # Without the heart, which a course of the needle does not have, the error is
        # far larger.
        least = _WITHOUT_HEART * window.solved(fit.beats[:1], fit.at_s)[2]
        held = self.held + 1 if fit.error < min(_FINE * window.count, least) else 0
        if held > 0 and window.is_clear(fit, is_proven=held >= _PROVEN):
            return self._known(fit, time_s)
        likely = fit if fit.error < windows.FAIR * window.count else Fit()
        unit = max(self.unit, 0)
        return self._replace(
            likely=likely, held=held, unit=unit, next_s=time_s + _ADAPT_S
        )

    def _known(self, fit: Fit, time_s: float) -> "TissueMotion":
        return self._replace(fit=fit, since_s=time_s, likely=Fit(), held=0, **_IDLE)

    def _searched(self, window: Window, time_s: float) -> "TissueMotion":
        """The next unit of a search: the frequencies one by one, then the fits, then
        a choice.
        """
        if self.unit < _SCANNED:
            return self._scanned(window)
        unit = self.unit - _SCANNED
        if unit == _DONE[-1] + 1:
            return self._chosen(window, time_s)
        first = self.first
        start, step = divmod(unit - _STEPS, 1 + _STEPS_EACH)
        if 0 <= start < len(_SLOW):
            tried = self._started(window, start, step, time_s)
            if step == _STEPS_EACH and tried.error < first.error:
                first = tried
        elif unit == 0:  # the heart alone
            tried = window.first_fit(self.found[1, 1:2], time_s)
        elif unit == _BOTH + 1:  # the breath alone
            tried = self.tried._replace(beats=self.tried.beats[:1], error=math.inf)
        else:  # of both the best start goes on
            tried = window.stepped(first if unit == _BOTH + 1 - _STEPS else self.tried)
        state = self._kept(window, tried) if unit in _DONE else self
        return state._replace(tried=tried, first=first, unit=self.unit + 1)

    def _started(self, window: Window, start: int, step: int, time_s: float) -> Fit:
        """One of the starts of a fit with two beats after a step more."""
        if step == 0:
            return window.first_fit(np.array([_SLOW[start], self.found[2, 2]]), time_s)
        if step <= len(_SIZES):
            return window.turned_fit(self.tried, _SIZES[step - 1])
        return window.stepped(self.tried)

    def _scanned(self, window: Window) -> "TissueMotion":
        """Scan the next frequency: of breaths, of hearts, of hearts beside the best
        breath.
        """
        n = len(windows.BREATH)
        m = len(windows.HEART)
        unit = self.unit
        row = 0 if unit < n else 1 if unit < n + m else 2
        scanned = windows.HEART[(unit - n) % m] if row else windows.BREATH[unit]
        hz = [[], [], [self.found[0, 1]]][row] + [scanned]
        # With waves that grow many a slow one fits as well: what matters is where to
        # begin.
        error = window.waves(np.array(hz))[1]
        found = self.found.copy()
        if unit in (0, n, n + m) or error < found[row, 0]:
            found[row] = error, hz[0], hz[-1]
        return self._replace(found=found, unit=unit + 1, best=Fit(), first=Fit())

    def _kept(self, window: Window, tried: Fit) -> "TissueMotion":
        """Keep the fit if it is clear and better; of two beats the second must halve
        the error.

        Two beats that are not clear yet are likely if they explain the force.
        """
        count = len(self.best.beats)
        most = self.best.error * 2.0 ** (count - len(tried.beats) if count else 0)
        if tried.error < most and window.is_clear(tried):
            return self._replace(best=tried)
        is_likely = not (self.is_known or count) and len(tried.beats) == 2
        is_likely &= tried.error < min(windows.FAIR * window.count, self.likely.error)
        return self._replace(likely=tried) if is_likely else self

    def _chosen(self, window: Window, time_s: float) -> "TissueMotion":
        state = self._replace(**_IDLE)
        best = self.best
        if self.is_known:
            if best.error < 0.5 * self.fit.error:
                return state._replace(fit=best)
            # The law may have changed within the window, or the motion have ended: it
            # begins anew. Before it is full a breath may be missing, which wants all of
            # it.
            most = (
                _LOST * window.count if len(self.window) == windows.SIZE else math.inf
            )
            is_lost = self.fit.error > min(most, window.still)
            newer = self.window[len(self.window) // 2 :]
            new = TissueMotion(newer, until_s=self.until_s, from_s=self.from_s)
            return new if is_lost else state
        if len(best.beats) == 0:
            return state._replace(next_s=time_s + _WAIT_S)
        return self._known(best, time_s)
