"""Where the links of an arm are, for bags that show it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class LinkTransforms(NamedTuple):
    """Poses of k links in the axes of one frame.

    Attributes:
        parent: The frame.
        children: Names of the links, shape (k,).
        translation_m: Origins of the links, shape (k, 3).
        rotation_xyzw: Unit quaternions, shape (k, 4).
    """

    parent: str
    children: tuple[str, ...]
    translation_m: np.ndarray
    rotation_xyzw: np.ndarray


LinkPoses = Callable[[np.ndarray], LinkTransforms]
"""Returns where the links are for joint positions, shape (n,) [rad or m]."""
