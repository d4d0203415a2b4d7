"""Many numbers for a compiled function, in the form that it reads fastest."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from speedup import COMPILER


def packed(numbers: Sequence[float]) -> Any:
    """Numbers that seldom change: an array for compiled code, a tuple for plain Python.

    Args:
        numbers: Any number of them; whoever reads them names their places.
    """
    if not COMPILER:
        return tuple(map(float, numbers))
    array = np.array(numbers, dtype=np.float64)
    array.setflags(write=False)
    return array
