"""Numbers that a compiled function reads at every sample and that seldom change."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from speedup import COMPILER


def packed(numbers: Sequence[float]) -> Any:
    """In the form that is read fastest: an array by compiled code, a tuple by plain Python.

    Args:
        numbers: Any number of them; whoever reads them names their places.
    """
    if not COMPILER:
        return tuple(map(float, numbers))
    array = np.array(numbers, dtype=np.float64)
    array.setflags(write=False)
    return array
