"""The search for the tissue's motion, a unit of work per block of samples.

First the frequencies are scanned, then the heartbeat alone is fitted, then both
together from several breaths, then the breath alone. The clearest fit wins.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np

from identification.mixture.motion_fit import (
    BREATHS_HZ,
    HEARTBEATS_HZ,
    UNKNOWN_ERROR,
    Fit,
    Window,
)

FIT_STEPS = 7
"""Gauss-Newton steps of a fit."""

START_STEPS = 5
"""Gauss-Newton steps of each start of a fit with two beats."""

STARTS_HZ = np.linspace(0.15, 0.45, 7)
"""Breaths that those begin with."""

START_SIZES_MM = (0.7, 1.4)
"""Sizes of such a breath that are tried."""


class Work(Enum):
    """What a unit of a search does."""

    SCAN_BREATHING = "scan a breathing frequency"
    SCAN_HEARTBEAT = "scan a heartbeat frequency"
    SCAN_BESIDE_BREATHING = "scan a heartbeat frequency beside the best breath"
    START_HEARTBEAT = "begin a fit of the heartbeat alone"
    START_BOTH = "begin a fit of breath and heartbeat"
    TRY_SIZE = "try a size of the breath, at any phase"
    START_BEST = "go on with the best of these"
    START_BREATHING = "begin a fit of the breath alone"
    STEP = "do a Gauss-Newton step"
    CHOOSE = "choose the best fit"


class SearchUnit(NamedTuple):
    """One unit of a search.

    Attributes:
        work: What it does.
        number: Which frequency, start or size.
        ends_start: Whether it is the last one of a start with two beats.
        ends_fit: Whether it is the last one of a fit.
    """

    work: Work
    number: int = 0
    ends_start: bool = False
    ends_fit: bool = False


def _plan_search() -> tuple[SearchUnit, ...]:
    """Return all units of a search, in order."""
    step = SearchUnit(Work.STEP)
    fit = [*[step] * (FIT_STEPS - 1), SearchUnit(Work.STEP, ends_fit=True)]
    units = [SearchUnit(Work.SCAN_BREATHING, k) for k in range(len(BREATHS_HZ))]
    units += [SearchUnit(Work.SCAN_HEARTBEAT, k) for k in range(len(HEARTBEATS_HZ))]
    units += [
        SearchUnit(Work.SCAN_BESIDE_BREATHING, k) for k in range(len(HEARTBEATS_HZ))
    ]
    units += [SearchUnit(Work.START_HEARTBEAT), *fit]
    for start in range(len(STARTS_HZ)):
        units.append(SearchUnit(Work.START_BOTH, start))
        units += [SearchUnit(Work.TRY_SIZE, k) for k in range(len(START_SIZES_MM))]
        units += [step] * (START_STEPS - 1)
        units.append(SearchUnit(Work.STEP, ends_start=True))
    units += [SearchUnit(Work.START_BEST), *fit]
    units += [SearchUnit(Work.START_BREATHING), *fit]
    return (*units, SearchUnit(Work.CHOOSE))


SEARCH = _plan_search()
"""The units of a search."""

NO_SEARCH = -1
"""Unit outside a search."""


class Scan(NamedTuple):
    """The best frequency of a scan.

    Attributes:
        error: Mean square of what waves of that frequency leave of the force.
        frequency_hz: Of the waves.
    """

    error: float = UNKNOWN_ERROR
    frequency_hz: float = 0.0


class MotionSearch(NamedTuple):
    """State of a search; immutable.

    Attributes:
        unit: The next one, `NO_SEARCH` outside a search.
        breathing: The best breath.
        heartbeat: The best heartbeat.
        beside_breathing: The best heartbeat beside that breath.
        tried: Being fitted.
        best: The best clear fit so far.
        best_start: The best start with two beats.
    """

    unit: int = NO_SEARCH
    breathing: Scan = Scan()
    heartbeat: Scan = Scan()
    beside_breathing: Scan = Scan()
    tried: Fit = Fit()
    best: Fit = Fit()
    best_start: Fit = Fit()

    def find_damage(self) -> str:
        """Return what is wrong with a restored state, if anything."""
        is_unit = self.unit in range(NO_SEARCH, len(SEARCH))
        return "" if is_unit else f"there is no unit {self.unit!r:.80}"

    @property
    def is_running(self) -> bool:
        """Whether a search is going on."""
        return self.unit != NO_SEARCH

    def advanced(self, window: Window, time_s: float) -> "MotionSearch":
        """Return the search after its next unit, which is not the choice."""
        unit = SEARCH[self.unit]
        search = self._replace(unit=self.unit + 1)
        match unit.work:
            case Work.SCAN_BREATHING:
                scanned_hz = float(BREATHS_HZ[unit.number])
                scan = _scan(window, [scanned_hz], self.breathing, unit)
                return search._replace(breathing=scan)
            case Work.SCAN_HEARTBEAT:
                scanned_hz = float(HEARTBEATS_HZ[unit.number])
                scan = _scan(window, [scanned_hz], self.heartbeat, unit)
                return search._replace(heartbeat=scan)
            case Work.SCAN_BESIDE_BREATHING:
                scanned_hz = float(HEARTBEATS_HZ[unit.number])
                both_hz = [self.breathing.frequency_hz, scanned_hz]
                scan = _scan(window, both_hz, self.beside_breathing, unit)
                return search._replace(beside_breathing=scan)
        tried = self._fit(window, unit, time_s)
        if unit.ends_start and tried.error < self.best_start.error:
            return search._replace(tried=tried, best_start=tried)
        return search._replace(tried=tried)

    def _fit(self, window: Window, unit: SearchUnit, time_s: float) -> Fit:
        """Return the fit after a unit of work."""
        match unit.work:
            case Work.START_HEARTBEAT:
                hz = np.array([self.heartbeat.frequency_hz])
                return window.first_fit(hz, time_s)
            case Work.START_BOTH:
                breathing_hz = STARTS_HZ[unit.number]
                hz = np.array([breathing_hz, self.beside_breathing.frequency_hz])
                return window.first_fit(hz, time_s)
            case Work.TRY_SIZE:
                return window.turned_fit(self.tried, START_SIZES_MM[unit.number])
            case Work.START_BEST:
                return window.stepped(self.best_start)
            case Work.START_BREATHING:
                breath = self.tried.beats[:1]
                return self.tried._replace(beats=breath, error=UNKNOWN_ERROR)
            case _:
                return window.stepped(self.tried)


def _scan(window: Window, hz: list[float], best: Scan, unit: SearchUnit) -> Scan:
    """Return the better of the best frequency so far and the last one of `hz`."""
    # With waves that grow many a slow one fits as well: what matters is where to begin.
    error = window.fit_waves(np.array(hz)).error
    is_better = unit.number == 0 or error < best.error
    return Scan(error, hz[-1]) if is_better else best
