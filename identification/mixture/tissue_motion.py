"""Motion of the tissue by itself: heartbeat and breathing, found in the force.

`motion_fit` has the force that it is found by, `motion_search` the search; here is when
it is looked for, taken for known, and given up. A unit of this work is done per block
of samples.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from identification.mixture.block import Block
from identification.mixture.motion_fit import (
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
from identification.mixture.motion_search import SEARCH, MotionSearch, Work

MIN_WINDOW_S = 2.5
"""Least length of a window."""

NEWEST_LEFT_OUT = 7
"""Newest means that are left out: a release may have begun there."""

MIN_WINDOW_MEANS = NEWEST_LEFT_OUT + MIN_WINDOW_S / WINDOW_STEP_S
"""Least number of means of a window that is fitted."""

RELEASE_S = 0.25
"""Time after an alarm until its release is over."""

LOST_ERROR = 1.0
"""Mean square of the errors of a fit that is given up."""

MAX_BAD_STEPS = 8
"""Steps in a row that are not good, after which a search begins."""

LIKELY_ERROR = 0.12
"""Mean square of the errors of a likely motion, at most."""

LIKELY_WITHOUT_HEARTBEAT = 0.25
"""The same, as a part of that without its heartbeat: seen were 1/8 to 1/280."""

MIN_PROVEN_STEPS = 5
"""Steps in a row at which both must hold before a likely motion counts as proven."""

CHECK_S = 0.25
"""Time between two checks whether the tissue moves."""

ADAPT_S = 0.2
"""Time between two steps of a known motion."""

WAIT_S = 0.5
"""Time between two searches."""

FADE_S = 1.0
"""Time over which a motion just found comes in."""

BELIEF_S = 2.0
"""Time over which it is believed: the mixture has learnt without it."""

MOVING_ERROR_FRACTION = 0.1
"""Mean square of the errors of tissue at rest, from which on a search is worth it."""

BETTER_FRACTION = 0.5
"""Part of the error of the motion in use that a new one must leave at most."""

UNEXPLAINED_FACTOR = 2.0
"""Force that a known motion leaves unexplained, in deviations of its fit's errors."""


class BlockSums(NamedTuple):
    """The mean being filled.

    Attributes:
        duration_s: Its length so far.
        time: Integral of the time [s²].
        depth: Integral of the depth [mm s].
        speed: Integral of the speed [mm].
        force: Integral of the force [N s].
    """

    duration_s: float = 0.0
    time: float = 0.0
    depth: float = 0.0
    speed: float = 0.0
    force: float = 0.0


class Motion(NamedTuple):
    """Where the tissue is.

    Attributes:
        place_mm: Along the needle.
        speed_mm_s: Its rate.
    """

    place_mm: float
    speed_mm_s: float


class MotionLimits(NamedTuple):
    """What a known motion leaves of the force.

    Attributes:
        heartbeat_variance: Variance that the heartbeat leaves unexplained [N²].
        breathing_variance: The same of breathing.
        confidence: Part by which a motion just found is believed, 0 to 1.
    """

    heartbeat_variance: float
    breathing_variance: float
    confidence: float


class TissueMotion(NamedTuple):
    """What is known of the tissue's motion; immutable.

    Attributes:
        window: Means of time, depth, speed and force, in two layers, shape (n, 4).
        sums: The mean being filled.
        until_s: End of the layer before.
        from_s: Begin of the last layer; what lies between is not used.
        fit: The motion in use, if it has beats.
        since_s: In use since then.
        bad_steps: Steps in a row at which it was no good fit.
        next_s: When it is looked at again.
        search: For a motion.
        likely: A good one found by the last search that was not clear yet.
        likely_steps: Steps in a row at which that explained the force.
    """

    window: Array = np.zeros((0, 4))
    sums: BlockSums = BlockSums()
    until_s: float = 0.0
    from_s: float = 0.0
    fit: Fit = Fit()
    since_s: float = 0.0
    bad_steps: int = 0
    next_s: float = 0.0
    search: MotionSearch = MotionSearch()
    likely: Fit = Fit()
    likely_steps: int = 0

    GROWING = ("window",)

    @property
    def is_known(self) -> bool:
        """Whether a motion is in use."""
        return len(self.fit.beats) > 0

    @property
    def amplitude_mm(self) -> float:
        """Largest amplitude of a beat of the motion in use; 0 if none is known."""
        if not self.is_known:
            return 0.0
        return float(np.hypot(self.fit.beats[:, 1], self.fit.beats[:, 2]).max())

    def motion_at(self, time_s: float) -> Motion:
        """Return place and speed of the tissue at a time."""
        times_s = np.array([time_s - self.fit.at_s])
        places, speeds = displacement(self.fit.beats, times_s)
        place_mm = float(places[0])
        speed_mm_s = float(speeds[0])
        progress = min(max((time_s - self.since_s) / FADE_S, 0.0), 1.0)
        faded_in = progress * progress * (3.0 - 2.0 * progress)
        rate = 6.0 * progress * (1.0 - progress) / FADE_S
        return Motion(faded_in * place_mm, faded_in * speed_mm_s + rate * place_mm)

    def limits(self, time_s: float) -> MotionLimits:
        """Return what the motion leaves of the force at a time."""
        is_breathing = self.fit.beats[:, 0] < MAX_BREATHING_HZ
        unexplained = (UNEXPLAINED_FACTOR * self.fit.rms_N) ** 2
        return MotionLimits(
            unexplained * float((~is_breathing).any()),
            unexplained * float(is_breathing.any()),
            min(max((time_s - self.since_s) / BELIEF_S, 0.0), 1.0),
        )

    def restarted(self, time_s: float) -> "TissueMotion":
        """Return the motion after a rupture: a new layer begins, the motion goes on.

        Of the layers before the last one stays that was long enough to show a motion.
        """
        window = self.window
        until_s = self.until_s
        fit = Fit()
        is_of_last_layer = window[:, 0] >= self.from_s
        if is_of_last_layer.sum() >= MIN_WINDOW_MEANS:
            window = window[is_of_last_layer]
            fit = self.fit
            until_s = float(window[-NEWEST_LEFT_OUT, 0])
        return TissueMotion(
            window=window,
            until_s=until_s,
            from_s=time_s + RELEASE_S,
            fit=fit,
            since_s=self.since_s,
        )

    def with_block(self, block: Block, *, is_met: bool) -> "TissueMotion":
        """Return the motion with a block, which lies in the tissue's frame.

        Nothing is kept before tissue has been met.
        """
        if not is_met:
            return self if len(self.window) == 0 else TissueMotion()
        motion = self.motion_at(block.time_s) if self.is_known else Motion(0.0, 0.0)
        duration_s = block.duration_s
        depth_mm = block.depth_mm + motion.place_mm
        speed_mm_s = block.speed_mm_s + motion.speed_mm_s
        sums = BlockSums(
            self.sums.duration_s + duration_s,
            self.sums.time + duration_s * block.time_s,
            self.sums.depth + duration_s * depth_mm,
            self.sums.speed + duration_s * speed_mm_s,
            self.sums.force + duration_s * block.force_N,
        )
        if sums.duration_s < WINDOW_STEP_S * (1.0 - 1e-9):
            return self._replace(sums=sums)
        means = np.array(sums[1:]) / sums.duration_s
        window = np.vstack((self.window[-WINDOW_MEANS + 1 :], means))
        return self._replace(window=window, sums=BlockSums())

    def is_due(self, time_s: float) -> bool:
        """Return whether there is work to do, and the window is long enough for it."""
        is_long = len(self.window) >= MIN_WINDOW_MEANS
        return is_long and (self.search.is_running or time_s >= self.next_s)

    def worked(self, time_s: float) -> "TissueMotion":
        """Return the motion after one unit of the work that is due."""
        window = Window(self.window[:-NEWEST_LEFT_OUT], self.until_s, self.from_s)
        if len(self.likely.beats) > 0 and time_s >= self.next_s:
            return self._follow_likely(window, time_s)
        if self.search.is_running:
            return self._search(window, time_s)
        if self.is_known:
            return self._adapt(window, time_s)
        error = window.error_at_rest
        is_moving = error > max(CLEARLY_LOWER, MOVING_ERROR_FRACTION * window.count)
        search = MotionSearch(unit=0) if is_moving else MotionSearch()
        return self._replace(next_s=time_s + CHECK_S, search=search)

    def _adapt(self, window: Window, time_s: float) -> "TissueMotion":
        """Return the motion after a step of the one in use."""
        fit = window.stepped(turned(self.fit, time_s), is_prior=True)
        max_error = min(GOOD_ERROR * window.count, window.error_at_rest)
        bad_steps = 0 if fit.error < max_error else self.bad_steps + 1
        is_lost = bad_steps >= MAX_BAD_STEPS
        if 0 < bad_steps < MAX_BAD_STEPS:
            # It may be a rupture: noise does not grow yet.
            fit = fit._replace(rms_N=min(fit.rms_N, self.fit.rms_N))
        return self._replace(
            fit=fit,
            bad_steps=bad_steps,
            next_s=time_s + ADAPT_S,
            search=MotionSearch(unit=0) if is_lost else MotionSearch(),
        )

    def _follow_likely(self, window: Window, time_s: float) -> "TissueMotion":
        """Return the motion after a step of a likely one, until that is clear.

        The search goes on beside it.
        """
        fit = window.stepped(turned(self.likely, time_s))
        # Without the heart, which a course of the needle does not have, the error is
        # far larger.
        without_heartbeat = window.solve(fit.beats[:1], fit.at_s).error
        max_error = min(
            LIKELY_ERROR * window.count, LIKELY_WITHOUT_HEARTBEAT * without_heartbeat
        )
        likely_steps = self.likely_steps + 1 if fit.error < max_error else 0
        is_proven = likely_steps >= MIN_PROVEN_STEPS
        if likely_steps > 0 and window.is_clear(fit, is_proven=is_proven):
            return self._use(fit, time_s)
        is_fair = fit.error < FAIR_ERROR * window.count
        search = self.search if self.search.is_running else MotionSearch(unit=0)
        return self._replace(
            likely=fit if is_fair else Fit(),
            likely_steps=likely_steps,
            search=search,
            next_s=time_s + ADAPT_S,
        )

    def _use(self, fit: Fit, time_s: float) -> "TissueMotion":
        """Return the motion with a fit in use from now on."""
        return self._replace(
            fit=fit,
            since_s=time_s,
            likely=Fit(),
            likely_steps=0,
            bad_steps=0,
            search=MotionSearch(),
        )

    def _search(self, window: Window, time_s: float) -> "TissueMotion":
        """Return the motion after the next unit of the search."""
        unit = SEARCH[self.search.unit]
        if unit.work is Work.CHOOSE:
            return self._choose(window, time_s)
        state = self._replace(search=self.search.advanced(window, time_s))
        return state._keep_if_better(window) if unit.ends_fit else state

    def _keep_if_better(self, window: Window) -> "TissueMotion":
        """Return the motion with the fit just tried kept if it is clear and better.

        Of two beats the second must halve the error. Two beats that are not clear yet
        are likely if they explain the force.
        """
        tried = self.search.tried
        best = self.search.best
        more_beats = len(best.beats) - len(tried.beats) if len(best.beats) else 0
        if tried.error < best.error * 2.0**more_beats and window.is_clear(tried):
            return self._replace(search=self.search._replace(best=tried))
        if self.is_known or len(best.beats) > 0 or len(tried.beats) != 2:
            return self
        max_error = min(FAIR_ERROR * window.count, self.likely.error)
        return self._replace(likely=tried) if tried.error < max_error else self

    def _choose(self, window: Window, time_s: float) -> "TissueMotion":
        """Return the motion after a search: its best fit in use, if it found one."""
        best = self.search.best
        state = self._replace(search=MotionSearch(), bad_steps=0)
        if not self.is_known:
            if len(best.beats) > 0:
                return self._use(best, time_s)
            return state._replace(next_s=time_s + WAIT_S)
        if best.error < BETTER_FRACTION * self.fit.error:
            return state._replace(fit=best)
        # The force may have changed within the window, or the motion have ended: it
        # begins anew. Before it is full a breath may be missing, which wants all of it.
        is_full = len(self.window) == WINDOW_MEANS
        max_error = LOST_ERROR * window.count if is_full else math.inf
        if self.fit.error > min(max_error, window.error_at_rest):
            newer = self.window[len(self.window) // 2 :]
            return TissueMotion(newer, until_s=self.until_s, from_s=self.from_s)
        return state
