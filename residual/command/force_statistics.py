"""What the summary tells about the estimates of a log of any length."""

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from residual.command.force_rows import ForceRows
from residual.command.thinned_median import ThinnedMedian
from residual.wrench_estimate import Caution, Status


class ForceStatistics:
    """Counts rows and remembers ranges; memory stays bounded."""

    def __init__(self) -> None:
        self.rows = 0
        self.first_s, self.last_s = math.inf, -math.inf
        self._steps = ThinnedMedian()
        self.cautions: Counter[Caution] = Counter()
        """Rows with each caution."""
        self._of_status = {status: StatusStatistics() for status in Status}

    def add(self, rows: ForceRows) -> None:
        """Take further rows."""
        latest_s = np.maximum.accumulate(np.concatenate(([self.last_s], rows.t_s)))
        steps = np.diff(latest_s)
        self._steps.add(steps[(steps > 0.0) & np.isfinite(steps)])
        self.rows += len(rows.t_s)
        self.first_s = min(self.first_s, float(rows.t_s.min()))
        self.last_s = float(latest_s[-1])
        for caution in Caution:
            self.cautions[caution] += int(np.count_nonzero(rows.cautions & caution))
        for status in Status:
            chosen = rows.has_status(status)
            if chosen.any():
                self._of_status[status].add(rows.axial_N[chosen], rows.axial_std_N[chosen])

    def __getitem__(self, status: Status) -> "StatusStatistics":
        """Return what is known about the rows of one status."""
        return self._of_status[status]

    @property
    def step_s(self) -> float:
        """Median time step [s] of rows that advance."""
        return self._steps.value


class StatusStatistics:
    """Number, range and typical standard deviation of rows."""

    def __init__(self) -> None:
        self.count = 0
        self.least_N, self.largest_N = math.inf, -math.inf
        self._std = ThinnedMedian()

    def add(self, axial_N: NDArray[np.float64], axial_std_N: NDArray[np.float64]) -> None:
        """Take the rows' axial forces and their standard deviations [N]."""
        self.count += len(axial_N)
        self.least_N = min(self.least_N, float(axial_N.min()))
        self.largest_N = max(self.largest_N, float(axial_N.max()))
        self._std.add(axial_std_N)

    @property
    def std_N(self) -> float:
        """Median standard deviation [N]."""
        return self._std.value
