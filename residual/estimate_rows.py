"""Estimates of many samples as columns: an object for each would take too long."""

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from residual.estimate import Assessment, Status, WrenchEstimate

AXIAL = 0
"""Column of `EstimateRows.numbers`: the axial force [N]."""

AXIAL_STD = 1
"""Column of its standard deviation [N]."""

LATERAL = 2
"""Column of the force across the needle [N]."""

LATERAL_STD = 3
"""Column of its standard deviation [N]."""

STD_OF_BIAS = 4
"""Column of `AXIAL_STD` without the error of the torques' scale [N]."""

UNSMOOTHED = 5
"""Column of the axial force before it is smoothed [N]."""

WRENCH = 6
"""First of the 3 or 6 columns of force and torque [N, Nm]; the variances of the
components that the mode estimates follow."""


class RowNote(NamedTuple):
    """What consecutive estimates say of themselves.

    Attributes:
        first_row: The first of them.
        assessment: What they say.
        question: `VirtualForceSensor.question` then.
    """

    first_row: int
    assessment: Assessment
    question: str


class EstimateRows:
    """Estimates of m samples.

    Args:
        count: m.
        size: Number of components of force and torque: 3 or 6.
        unknowns: Number of components that the mode estimates.

    Attributes:
        numbers: See `AXIAL` and the others, shape (m, 6 + size + unknowns).
        elapsed_s: Time since the last sample that was used, 0 for a rejected one, shape
            (m,).
        notes: What the estimates say of themselves, in order of rows.
    """

    def __init__(self, count: int, size: int, unknowns: int) -> None:
        self.numbers = np.zeros((count, WRENCH + size + unknowns))
        self.elapsed_s = np.zeros(count)
        self.notes: list[RowNote] = []
        self._size = size

    def put(
        self,
        row: int,
        estimate: WrenchEstimate,
        std_of_bias_N: float,
        elapsed_s: float,
        question: str,
    ) -> None:
        """Set one row.

        Args:
            row: Its number.
            estimate: Its estimate.
            std_of_bias_N: `VirtualForceSensor.std_of_bias_N` of it.
            elapsed_s: Time since the last sample that was used.
            question: See `RowNote`.
        """
        numbers = self.numbers[row]
        numbers[AXIAL] = estimate.axial
        numbers[AXIAL_STD] = estimate.axial_std
        numbers[LATERAL] = estimate.lateral
        numbers[LATERAL_STD] = estimate.lateral_std
        numbers[STD_OF_BIAS] = std_of_bias_N
        numbers[UNSMOOTHED] = estimate.axial_unsmoothed
        numbers[WRENCH : WRENCH + 3] = estimate.force
        if self._size > 3:
            numbers[WRENCH + 3 : WRENCH + 6] = estimate.torque
        numbers[WRENCH + self._size :] = estimate.covariance.diagonal()
        if estimate.status is not Status.REJECTED:
            self.elapsed_s[row] = elapsed_s
        self.note(row, estimate.assessment, question)

    def note(self, first_row: int, assessment: Assessment, question: str) -> None:
        """Set what a row and those after it say of themselves, see `RowNote`."""
        self.notes.append(RowNote(first_row, assessment, question))

    def statuses(self, codes: dict[Status, int]) -> NDArray[np.int64]:
        """Return a code for the status of every row, shape (m,)."""
        return self._spread([codes[note.assessment.status] for note in self.notes])

    @property
    def warnings(self) -> NDArray[np.int64]:
        """`WrenchEstimate.warnings` of every row, shape (m,)."""
        return self._spread([int(note.assessment.warnings) for note in self.notes])

    @property
    def model_mismatch(self) -> Array:
        """`WrenchEstimate.model_mismatch` of every row, shape (m,)."""
        return self._spread([note.assessment.model_mismatch for note in self.notes])

    def _spread(self, values: Sequence[float]) -> NDArray:
        """Return the value of its note for every row, shape (m,)."""
        firsts = [note.first_row for note in self.notes]
        counts = np.diff([*firsts, len(self.numbers)])
        return np.repeat(np.array(values), counts)

    def first(self, count: int) -> "EstimateRows":
        """Return the first so many rows."""
        rows = copy(self)
        rows.numbers = self.numbers[:count]
        rows.elapsed_s = self.elapsed_s[:count]
        return rows

    @property
    def wrench(self) -> Array:
        """Force and torque, shape (m, 3 or 6)."""
        return self.numbers[:, WRENCH : WRENCH + self._size]

    @property
    def variances(self) -> Array:
        """Variances of the components that the mode estimates, shape (m, k)."""
        return self.numbers[:, WRENCH + self._size :]
