"""Insertions into real human liver.

de Jong, Dankelman, van den Dobbelsteen, "Dataset on needle insertions in ex vivo human livers",
Data in Brief 2017, doi 10.1016/j.dib.2017.01.018.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.errors import DataError
from benchmarks.recorded.array_files import read_arrays
from benchmarks.recorded.pullout import mean_at_depth

Array = NDArray[np.float64]

FOLDER = "liver_dejong2017"
NUMBERS = (0, 2, 4, 6, 8, 10, 12, 16, 18, 20, 22, 24, 26, 28, 30, 32, 34, 36, 38)
"""Of the insertions, as in the file."""
NOISE_N = 7e-3
"""Of the recorded force, above 20 Hz, as the recordings' description says."""
REST_s = 0.9
"""The needle rests at least this long at the start of each recording."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiverInsertion:
    """One recording, as a rule from the end of the rest at its start.

    Attributes:
        t_s: Time since its first sample, shape (n,).
        depth_m: Depth, shape (n,).
        force_N: Axial force, as a rule less its mean at rest, shape (n,).
    """

    t_s: Array
    depth_m: Array
    force_N: Array

    def force_at_N(self, part: slice, depth_mm: float) -> float:
        """Mean force near a depth [mm] in a part of the recording; nan if the needle was not there.

        Negative on the way out, where friction holds the needle back.
        """
        return mean_at_depth(self.depth_m[part], self.force_N[part], 1e-3 * depth_mm)


def read_liver(data: Path, index: int, *, as_recorded: bool = False) -> LiverInsertion:
    """Read one insertion.

    Args:
        data: Folder of recordings.
        index: Into `NUMBERS`.
        as_recorded: Whether to keep the rest at the start, and the force as it was read.

    Raises:
        DataError: There is no such insertion, or the file is missing or broken.
    """
    if not 0 <= index < len(NUMBERS):
        raise DataError(f"there are {len(NUMBERS)} liver insertions, no number {index}")
    number = f"{NUMBERS[index]:02d}"
    names = ("sample_rate_Hz", f"depth_m_{number}", f"force_N_{number}")
    rate, depth, force = read_arrays(data / FOLDER / "insertions.npz", names)
    rest = int(REST_s * float(rate))
    start, offset = (0, 0.0) if as_recorded else (rest, float(force[:rest].mean()))
    return LiverInsertion(
        t_s=np.arange(len(depth) - start) / float(rate),
        depth_m=depth[start:],
        force_N=force[start:] - offset,
    )
