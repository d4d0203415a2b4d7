"""Motion of the tissue by itself: heartbeat and breathing, found in the force.

`motion_fit` has the force that it is found by; here is when it is looked for, taken for
known, and given up. A search first tries breaths of several frequencies, sizes and
phases, then a heartbeat beside the best of them, then a heartbeat alone; the clearest
wins. A unit of this work is done per block of samples.
"""

from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from identification.mixture.block import Block
from identification.mixture.motion_fit import (
    BREATHS_HZ,
    CLEARLY_LOWER,
    FAIR_ERROR,
    GOOD_ERROR,
    MAX_BREATHING_HZ,
    WINDOW_MEANS,
    WINDOW_STEP_S,
    Fit,
    Window,
    displacement,
    turned,
)

NEWEST_LEFT_OUT = 7
"""Newest means that are left out: a release may have begun there."""

MIN_WINDOW_MEANS = NEWEST_LEFT_OUT + 50
"""Least number of means of a window that is fitted: of 2.5 s."""

FIT_UNITS = 7
"""Units of a fit: its begin, and Gauss-Newton steps."""

NO_SEARCH = -1
"""Unit outside a search."""


class TissueMotion(NamedTuple):
    """What is known of the tissue's motion; immutable.

    Attributes:
        window: Means of time, depth, speed and force, in two layers, shape (n, 4).
        sums: Integrals of 1, time, depth, speed and force over the mean being filled.
        until_s: End of the layer before.
        from_s: Begin of the last layer; what lies between is not used.
        fit: The motion in use, if it has beats.
        since_s: In use since then.
        bad_steps: Steps in a row at which it was no good fit.
        next_s: When it is looked at again.
        unit: The next one of a search, `NO_SEARCH` outside one.
        tried: Being fitted.
        best: The best clear fit of the search so far.
        best_start: The best of breaths with a heartbeat, with which it goes on.
        likely: A fit that is good, but not clear yet.
        likely_steps: Steps in a row at which it was good.
    """

    window: Array = np.zeros((0, 4))
    sums: tuple[float, ...] = (0.0,) * 5
    until_s: float = 0.0
    from_s: float = 0.0
    fit: Fit = Fit()
    since_s: float = 0.0
    bad_steps: int = 0
    next_s: float = 0.0
    unit: int = NO_SEARCH
    tried: Fit = Fit()
    best: Fit = Fit()
    best_start: Fit = Fit()
    likely: Fit = Fit()
    likely_steps: int = 0

    @property
    def is_known(self) -> bool:
        """Whether a motion is in use."""
        return len(self.fit.beats) > 0

    @property
    def amplitude_mm(self) -> float:
        """Largest amplitude of a beat of the motion in use; 0 if none is known."""
        sizes_mm = np.hypot(self.fit.beats[:, 1], self.fit.beats[:, 2])
        return float(sizes_mm.max(initial=0.0))

    def motion_at(self, time_s: float) -> tuple[float, float]:
        """Return place [mm] and speed [mm/s] of the tissue at a time."""
        if not self.is_known:
            return 0.0, 0.0
        times_s = np.array([time_s - self.fit.at_s])
        places, speeds = displacement(self.fit.beats, times_s)
        place_mm = float(places[0])
        # A motion just found comes in over one second.
        progress = min(max(time_s - self.since_s, 0.0), 1.0)
        faded_in = progress * progress * (3.0 - 2.0 * progress)
        rate = 6.0 * progress * (1.0 - progress)
        return faded_in * place_mm, faded_in * float(speeds[0]) + rate * place_mm

    def unexplained_N2(self, *, is_breathing: bool) -> float:
        """Return the variance that breathing, or the heartbeat, leaves unexplained."""
        is_such = (self.fit.beats[:, 0] < MAX_BREATHING_HZ) == is_breathing
        return (2.0 * self.fit.rms_N) ** 2 * float(is_such.any())

    def doubt(self, time_s: float) -> float:
        """Return the part by which a motion just found is not believed, 0 to 1."""
        # The mixture has learnt without it: it takes two seconds.
        return 1.0 - min(max((time_s - self.since_s) / 2.0, 0.0), 1.0)

    def restarted(self, time_s: float) -> "TissueMotion":
        """Return the motion after a rupture: a new layer begins, the motion goes on.

        Of the layers before the last one stays that was long enough to show a motion.
        """
        begun = TissueMotion(
            self.window,
            until_s=self.until_s,
            from_s=time_s + 0.25,  # the end of the release
            since_s=self.since_s,
        )
        window = self.window[self.window[:, 0] >= self.from_s]
        if len(window) < MIN_WINDOW_MEANS:
            return begun
        until_s = float(window[-NEWEST_LEFT_OUT, 0])
        return begun._replace(window=window, until_s=until_s, fit=self.fit)

    def with_block(self, block: Block, *, is_met: bool) -> "TissueMotion":
        """Return the motion with a block, which lies in the tissue's frame.

        Nothing is kept before tissue has been met.
        """
        if not is_met:
            return self if len(self.window) == 0 else TissueMotion()
        place_mm, tissue_mm_s = self.motion_at(block.time_s)
        depth_mm = block.depth_mm + place_mm
        speed_mm_s = block.speed_mm_s + tissue_mm_s
        values = (1.0, block.time_s, depth_mm, speed_mm_s, block.force_N)
        sums = tuple(
            total + block.duration_s * value
            for total, value in zip(self.sums, values, strict=True)
        )
        if sums[0] < WINDOW_STEP_S * (1.0 - 1e-9):
            return self._replace(sums=sums)
        means = np.array(sums[1:]) / sums[0]
        window = np.vstack((self.window[-WINDOW_MEANS + 1 :], means))
        return self._replace(window=window, sums=(0.0,) * 5)

    def is_due(self, time_s: float) -> bool:
        """Return whether there is work to do, and the window is long enough for it."""
        is_time = self.unit != NO_SEARCH or time_s >= self.next_s
        return is_time and len(self.window) >= MIN_WINDOW_MEANS

    def worked(self, time_s: float) -> "TissueMotion":
        """Return the motion after one unit of the work that is due."""
        window = Window(self.window[:-NEWEST_LEFT_OUT], self.until_s, self.from_s)
        if len(self.likely.beats) > 0 and time_s >= self.next_s:
            return self._follow_likely(window, time_s)
        if self.unit != NO_SEARCH:
            return self._search(window, time_s)
        if self.is_known:
            return self._adapt(window, time_s)
        # Less than a tenth of the law's error is not worth a search.
        is_moving = window.error_at_rest > max(CLEARLY_LOWER, 0.1 * window.count)
        unit = 0 if is_moving else NO_SEARCH
        return self._replace(next_s=time_s + 0.25, unit=unit)

    def _adapt(self, window: Window, time_s: float) -> "TissueMotion":
        """Return the motion after a step of the one in use."""
        fit = window.stepped(turned(self.fit, time_s), is_prior=True)
        is_good = fit.error < min(GOOD_ERROR * window.count, window.error_at_rest)
        bad_steps = 0 if is_good else self.bad_steps + 1
        is_lost = bad_steps >= 8
        if bad_steps > 0 and not is_lost:
            # It may be a rupture: noise does not grow yet.
            fit = fit._replace(rms_N=min(fit.rms_N, self.fit.rms_N))
        return self._replace(
            fit=fit,
            bad_steps=bad_steps,
            next_s=time_s + 0.2,
            unit=0 if is_lost else NO_SEARCH,
        )

    def _follow_likely(self, window: Window, time_s: float) -> "TissueMotion":
        """Return the motion after a step of a likely one, until that is clear.

        The search goes on beside it.
        """
        fit = window.stepped(turned(self.likely, time_s))
        # Without the heart, which a course of the needle does not have, the error is
        # far larger: by 8 to 280 times were seen.
        without_heartbeat = window.solve(fit.beats[:1], fit.at_s).error
        max_error = min(0.12 * window.count, 0.25 * without_heartbeat)
        likely_steps = self.likely_steps + 1 if fit.error < max_error else 0
        if likely_steps > 0 and window.is_clear(fit, is_proven=likely_steps >= 5):
            return self._use(fit, time_s)
        is_fair = fit.error < FAIR_ERROR * window.count
        return self._replace(
            likely=fit if is_fair else Fit(),
            likely_steps=likely_steps,
            unit=max(self.unit, 0),
            next_s=time_s + 0.2,
        )

    def _use(self, fit: Fit, time_s: float) -> "TissueMotion":
        """Return the motion with a fit in use from now on."""
        return self._replace(
            fit=fit,
            since_s=time_s,
            likely=Fit(),
            likely_steps=0,
            bad_steps=0,
            unit=NO_SEARCH,
        )

    def _search(self, window: Window, time_s: float) -> "TissueMotion":
        """Return the motion after the next unit of the search.

        First the heartbeat alone is fitted, then breaths of several frequencies with a
        heartbeat, then the best of these goes on, at last without its heartbeat.
        """
        part, step = divmod(self.unit, FIT_UNITS)
        last_part = len(BREATHS_HZ) + 2
        if part > last_part:
            return self._choose(window, time_s)
        tried = self._fit(window, part, step, time_s)
        state = self._replace(unit=self.unit + 1, tried=tried)
        if self.unit == 0:
            return state._replace(best=Fit(), best_start=Fit())
        if step < FIT_UNITS - 1:
            return state
        if 0 < part < last_part - 1:
            is_best = tried.error < self.best_start.error
            return state._replace(best_start=tried) if is_best else state
        # A second beat must halve the error.
        more_beats = len(tried.beats) - max(len(self.best.beats), 1)
        is_better = tried.error * 2.0**more_beats < self.best.error
        if is_better and window.is_clear(tried):
            return state._replace(best=tried)
        is_open = part == last_part - 1 and not (self.is_known or len(self.best.beats))
        is_good = tried.error < min(FAIR_ERROR * window.count, self.likely.error)
        return state._replace(likely=tried) if is_open and is_good else state

    def _fit(self, window: Window, part: int, step: int, time_s: float) -> Fit:
        """Return the fit after a step of a part of the search."""
        tried = self.tried
        if part == len(BREATHS_HZ) + 1 and step == 0:
            return turned(self.best_start, time_s)
        if part == len(BREATHS_HZ) + 2 and step == 0:
            return tried._replace(beats=tried.beats[:1], error=1e30)
        if part <= len(BREATHS_HZ) and step == 0:
            breath_hz = BREATHS_HZ[max(part - 1, 0) : part]
            return window.first_frequencies(breath_hz, time_s)
        if part <= len(BREATHS_HZ) and step == 1:
            return window.first_sizes(tried)
        if 0 < part <= len(BREATHS_HZ) and step == 2:
            return window.turned_fit(tried)
        return window.stepped(tried)

    def _choose(self, window: Window, time_s: float) -> "TissueMotion":
        """Return the motion after a search: its best fit in use, if it found one."""
        best = self.best
        state = self._replace(unit=NO_SEARCH, bad_steps=0)
        if not self.is_known and len(best.beats) > 0:
            return self._use(best, time_s)
        if not self.is_known:
            return state._replace(next_s=time_s + 0.5)
        if best.error < 0.5 * self.fit.error:
            return state._replace(fit=best)
        # The force may have changed within the window, or the motion have ended: it
        # begins anew. Before it is full a breath may be missing, which wants all of it.
        is_off = len(self.window) == WINDOW_MEANS and self.fit.error > window.count
        if is_off or self.fit.error > window.error_at_rest:
            newer = self.window[len(self.window) // 2 :]
            return TissueMotion(newer, until_s=self.until_s, from_s=self.from_s)
        return state
