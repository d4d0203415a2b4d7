"""Closed surfaces of labelled structures.

Marching cubes on the binary mask, Taubin's smoothing, simplification that keeps the surface closed,
and a step along the normals that gives back the volume of the voxels. All but the last line works
in voxels, so that unequal spacings are smoothed alike.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from needleforce.anatomy.errors import Array

if TYPE_CHECKING:
    from needleforce.anatomy.volume import Labels

SMOOTHING = 0.5, -0.53, 40  # Factors and pairs of steps (Taubin 1995, doi 10.1145/218380.218473)
TOLERANCE_VOXELS = 0.1
"""Simplification moves the surface at most so far: a triangle stays where fewer would show."""

VOLUME_ROUNDS = 50  # At most; an organ needs two or three, a single voxel more


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface of one structure, triangles seen counter-clockwise from outside."""

    name: str
    vertices_m: Array  # (n, 3), LPS
    triangles: NDArray[np.int32]  # (m, 3) indices of vertices
    colour: tuple[float, ...]  # red, green, blue from 0 to 1

    @property
    def volume_m3(self) -> float:
        """Volume inside."""
        return enclosed(self.vertices_m, self.triangles)

    @property
    def is_watertight(self) -> bool:
        """Whether every edge joins two triangles that run along it in opposite directions."""
        from trimesh import Trimesh

        mesh = Trimesh(self.vertices_m, self.triangles, process=False)
        return bool(mesh.is_watertight and mesh.is_winding_consistent)


def surface_of(labels: "Labels", name: str) -> Surface:
    """Return the closed surface of a structure, whose volume is that of its voxels.

    A structure that the volume cuts off is closed there. One in several parts stays so, but beside
    a larger part one of less than some 30 voxels shrinks or vanishes, its volume goes to the rest.

    Raises:
        VolumeError: No structure with voxels has that name.
    """
    import manifold3d
    from skimage.measure import marching_cubes

    structure, padded = labels[name], np.pad(labels.mask(name), 1)
    vertices, triangles, _, _ = marching_cubes(padded, 0.5, gradient_direction="ascent")
    smooth = _smoothed(vertices, triangles)
    if enclosed(smooth, triangles) > 0.5 * enclosed(vertices, triangles):
        mesh = manifold3d.Mesh(smooth, triangles.astype(np.uint32))
        simple = manifold3d.Manifold(mesh).simplify(TOLERANCE_VOXELS).to_mesh()
        vertices, triangles = simple.vert_properties[:, :3].astype(float), simple.tri_verts
    # Else smoothing has folded a structure of a few voxels: its cubes' surface stays as it is.
    vertices = _with_volume(vertices, triangles, float(structure.voxels))
    start = np.array([part.start for part in structure.box]) - 1.0
    points_m = labels.grid.points_m(vertices + start)
    if np.linalg.det(labels.grid.axes_m) < 0.0:  # a mirrored grid turns triangles inside out
        triangles = triangles[:, ::-1]
    return Surface(name, points_m, np.ascontiguousarray(triangles, np.int32), structure.colour)


def enclosed(vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> float:
    """Volume inside a closed surface, by the divergence theorem; negative if it is inside out."""
    a, b, c = (vertices[triangles[:, corner]].astype(float) for corner in range(3))
    return float(np.vecdot(np.cross(a, b), c).sum() / 6.0)


def _smoothed(
    vertices: NDArray[np.floating], triangles: NDArray[np.integer]
) -> NDArray[np.float32]:
    # Every edge is an edge of two triangles, once in each direction.
    edges = np.concatenate([triangles[:, (i, (i + 1) % 3)] for i in range(3)])
    weights = 1.0 / np.bincount(edges[:, 0], minlength=len(vertices)).astype(np.float32)
    size = len(vertices), len(vertices)
    mean = sparse.csr_array((weights[edges[:, 0]], (edges[:, 0], edges[:, 1])), shape=size)
    points = vertices.astype(np.float32)
    shrink, grow, pairs = SMOOTHING
    for factor in (shrink, grow) * pairs:
        points += factor * (mean @ points - points)
    return points


def _with_volume(vertices: Array, triangles: NDArray[np.integer], volume: float) -> Array:
    """Move vertices along the normals until the surface holds a volume."""
    # Which triangles meet in a vertex: a third of each one's area to each of its corners.
    rows, columns = triangles.ravel(), np.repeat(np.arange(len(triangles)), 3)
    corners = sparse.csr_array((np.full(len(rows), 1.0 / 6.0), (rows, columns)))
    for _ in range(VOLUME_ROUNDS):
        missing = volume - enclosed(vertices, triangles)
        if abs(missing) < 1e-7 * volume:
            break
        a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
        normals = corners @ np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        vertices = vertices + missing / lengths.sum() * normals / np.maximum(lengths, 1e-12)
    return vertices
