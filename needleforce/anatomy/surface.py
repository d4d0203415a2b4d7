"""Closed surfaces of labelled structures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface of one structure, triangles seen counter-clockwise from outside."""

    name: str
    vertices_m: NDArray[np.float64]  # (n, 3), LPS
    triangles: NDArray[np.int32]  # (m, 3) indices of vertices
    colour: tuple[float, float, float]  # red, green, blue from 0 to 1

    @property
    def volume_m3(self) -> float:
        """Volume inside, by the divergence theorem."""
        a, b, c = (self.vertices_m[self.triangles[:, corner]] for corner in range(3))
        return float(np.vecdot(np.cross(a, b), c).sum() / 6.0)
