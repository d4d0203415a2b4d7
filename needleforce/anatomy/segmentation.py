"""The part of labels that the search for paths reads."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.structures import Structure
from needleforce.anatomy.volume import Grid


class Segmentation(Protocol):
    """What has voxels: see `Labels`."""

    @property
    def volumes(self) -> Sequence[NDArray[np.integer]]:
        """Label volumes, each (i, j, k)."""
        ...

    @property
    def grid(self) -> Grid:
        """Where the voxels lie."""
        ...

    @property
    def structures(self) -> tuple[Structure, ...]:
        """Structures with voxels."""
        ...
