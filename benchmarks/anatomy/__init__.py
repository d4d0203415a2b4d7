"""The patient's anatomy against analytic shapes and a real CT.

Parts: `path`, `registration`, `patient`.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array

CT_FOLDER = "torso_ct_totalsegmentator"
"""Of the recordings."""


def rms(values: ArrayLike) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def draw_on(
    mesh: Any, weights: Array, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw points on the triangles of a mesh, shape (count, 3), and their normals.

    Args:
        mesh: Of `trimesh`.
        weights: Chance of each triangle, of any sum.
        count: How many.
        rng: Source of the draws.
    """
    chosen = rng.choice(len(weights), count, p=weights / weights.sum())
    corners = rng.dirichlet([1, 1, 1], count)
    points = np.einsum("nk,nkj->nj", corners, mesh.triangles[chosen])
    return points, mesh.face_normals[chosen]
