"""One insertion into bovine liver, digitised from a figure.

Okamura, Simone, O'Leary, "Force modeling for needle insertion into soft tissue", IEEE TBME 2004,
doi 10.1109/TBME.2004.831542.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.errors import DataError

Array = NDArray[np.float64]

FOLDER = "bovine_liver_okamura2004"
FILE = "depth_force.csv"
SPEED_m_s = 3e-3
RATE_hz = 1000.0
CONTACT_m = 8e-3
"""About where the needle meets the liver."""
PEN_UP_m = 1e-3
"""Where the depth of one point is so much less than that of the one before, a new stroke begins."""
NOISE_N = 0.01
"""White noise put on it: a drawn line shows none, and every sensor has some. This is sigma_0, and
what the points of the later strokes scatter by in free air, between two dips there."""
RUPTURES_mm = (19.2, 29.9, 32.7, 36.7)
"""The capsule as annotated by the authors; the others read off the curve."""


class BovineInsertion(NamedTuple):
    """The insertion as a sensor would have sent it, n samples.

    Attributes:
        t_s: Time, shape (n,).
        depth_m: Depth, shape (n,).
        force_N: Axial force, shape (n,).
    """

    t_s: Array
    depth_m: Array
    force_N: Array


def read_bovine(data: Path, rng: np.random.Generator | None) -> BovineInsertion:
    """Turn the points of the figure into a signal.

    The curve was traced in one stroke of 232 points; those that follow it in the file go over parts
    of it again, less exactly, and would put a zigzag into it. The stroke's points are joined by
    straight lines; where it falls it goes straight down.

    Args:
        data: Folder of recordings.
        rng: Source of the noise; None for the line as it was drawn.

    Raises:
        DataError: The file is missing or broken.
    """
    path = data / FOLDER / FILE
    try:
        lines = path.read_text(encoding="utf-8").splitlines()[1:]
        table = np.array([line.split(",") for line in lines], dtype=np.float64)
    except (OSError, ValueError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    if table.ndim != 2 or table.shape[1] != 2 or not np.isfinite(table).all():
        raise DataError(f"{path} should have two columns, depth_m and force_N, and finite values")
    lifts = np.flatnonzero(np.diff(table[:, 0]) < -PEN_UP_m)
    stroke = table[: lifts[0] + 1] if len(lifts) else table
    depth, force = np.maximum.accumulate(stroke[:, 0]), stroke[:, 1]
    depth_m = np.arange(int(depth[-1] / SPEED_m_s * RATE_hz)) / RATE_hz * SPEED_m_s
    force_N = np.interp(depth_m, depth, force)
    if rng is not None:
        force_N += NOISE_N * rng.standard_normal(len(depth_m))
    return BovineInsertion(t_s=np.arange(len(depth_m)) / RATE_hz, depth_m=depth_m, force_N=force_N)
