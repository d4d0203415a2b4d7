"""Closed surfaces of labelled structures.

Marching cubes on the binary mask, Taubin's smoothing, simplification that keeps the
surface closed, and a step along the normals that gives back the volume of the voxels.
All but the last line works in voxels, so that unequal spacings are smoothed alike.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import KDTree

from foundation.arrays import Array

if TYPE_CHECKING:
    from igl import AABB
    from trimesh import Trimesh


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface of one structure, triangles seen counter-clockwise from outside.

    What `trimesh` says of it: ``mesh.volume`` [m^3], ``mesh.is_volume`` for closed and
    consistent.

    Attributes:
        name: Of the structure.
        vertices_m: (n, 3), LPS.
        triangles: (m, 3) indices of vertices.
        colour: Red, green, blue from 0 to 1.
    """

    name: str
    vertices_m: Array
    triangles: NDArray[np.integer]
    colour: tuple[float, ...] = (0.7, 0.7, 0.7)

    @cached_property
    def mesh(self) -> "Trimesh":
        """The same for `trimesh`."""
        from trimesh import Trimesh

        return Trimesh(self.vertices_m, self.triangles, process=False)

    @cached_property
    def _with_area(self) -> NDArray[np.integer]:
        """The triangles that have an area: only these have a normal."""
        return self.triangles[self.mesh.face_normals.any(axis=1)].astype(np.int64)

    @cached_property
    def _area_normals_m2(self) -> Array:
        """Of these triangles, each as long as its area."""
        corners_m = self.vertices_m[self._with_area]
        edges_m = corners_m[:, 1:] - corners_m[:, :1]
        return 0.5 * np.cross(edges_m[:, 0], edges_m[:, 1])

    @cached_property
    def _boxes(self) -> "AABB":
        from igl import AABB

        boxes = AABB()
        boxes.init(self.vertices_m, self._with_area)
        return boxes

    @cached_property
    def _middles(self) -> KDTree:
        return KDTree(self.vertices_m[self._with_area].mean(axis=1))

    def nearest(self, points_m: Array) -> tuple[Array, Array]:
        """Return the nearest positions on the surface, (n, 3), and the normals there.

        Args:
            points_m: Shape (n, 3).
        """
        _, nearest, positions = self._boxes.squared_distance(
            self.vertices_m, self._with_area, np.ascontiguousarray(points_m)
        )
        positions_m = np.asarray(positions, dtype=np.float64)
        normals = self._area_normals_m2[np.asarray(nearest)]
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return positions_m, normals

    def mean_normals(self, positions_m: Array, normals: Array, reach_m: float) -> Array:
        """Return means of the normals around positions on the surface, shape (n, 3).

        Each triangle counts by its area if its middle lies within reach and it looks to
        the same side, so the other side of a thin part does not; where none does, the
        normal itself is returned. They are of length 1 where the surface is flat.

        Args:
            positions_m: Shape (n, 3).
            normals: There, shape (n, 3).
            reach_m: Radius around each position.
        """
        near = self._middles.query_ball_point(positions_m, reach_m)
        row = np.repeat(np.arange(len(near)), [len(numbers) for numbers in near])
        areas_m2 = self._area_normals_m2[np.concatenate(near).astype(np.intp)]
        counts = np.vecdot(areas_m2, normals[row]) > 0.0
        sums = np.zeros((len(near), 4))
        sizes = np.linalg.norm(areas_m2, axis=1, keepdims=True)
        np.add.at(sums, row[counts], np.hstack([areas_m2, sizes])[counts])
        is_found = sums[:, 3:] > 0.0
        return np.where(
            is_found, sums[:, :3] / np.where(is_found, sums[:, 3:], 1.0), normals
        )


def closed_surface(
    name: str,
    mask: NDArray[np.bool_],
    corner_m: Array,
    axes_m: Array,
    colour: tuple[float, ...],
) -> Surface:
    """Return the closed surface of a mask, whose volume is that of its voxels.

    A structure that the volume cuts off is closed there. One in several parts stays so,
    but beside a larger part one of less than some 30 voxels shrinks or vanishes, its
    volume goes to the rest.

    Args:
        name: Of the structure.
        mask: Which voxels belong to it, (i, j, k).
        corner_m: Centre of voxel 0, 0, 0, shape (3,).
        axes_m: Steps to the next voxels, in columns, shape (3, 3).
        colour: Red, green, blue from 0 to 1.
    """
    from skimage.measure import marching_cubes

    cubes = marching_cubes(np.pad(mask, 1), 0.5, gradient_direction="ascent")
    mesh = _smooth_and_simplify(*cubes[:2])
    _restore_volume(mesh, int(np.count_nonzero(mask)))
    # A mirrored grid turns triangles inside out, and this turns them back.
    origin_m = (corner_m - axes_m.sum(axis=1))[:, None]
    mesh.apply_transform(np.block([[axes_m, origin_m], [np.zeros((1, 3)), 1.0]]))
    return Surface(name, np.array(mesh.vertices), mesh.faces.astype(np.int32), colour)


def join_voxels(
    mask: NDArray[np.bool_], joined: NDArray[np.integer]
) -> NDArray[np.bool_]:
    """Return a mask of larger voxels: those of which half belongs to the structure.

    Of a structure so thin that no voxel does, those remain that hold most of it.

    Args:
        mask: Which voxels belong to the structure, (i, j, k).
        joined: How many are joined along each axis, (3,).
    """
    from skimage.measure import block_reduce

    blocks: Any = tuple(joined.tolist())
    counts = block_reduce(mask, blocks, np.sum)
    return counts >= min(np.ceil(0.5 * joined.prod()), counts.max())


def _smooth_and_simplify(vertices: Array, triangles: NDArray[np.integer]) -> "Trimesh":
    """Return the surface of cubes without their stairs and with fewer triangles.

    A structure of a few voxels, which smoothing would fold, stays as it is.
    """
    # If less of the volume is left, smoothing has folded a structure of a few voxels.
    min_smoothed_volume = 0.5
    # Factor of the steps that smooth (Taubin 1995, doi 10.1145/218380.218473).
    shrinking = 0.5
    # Factor of the steps between them that undo the shrinking; from the same paper.
    inflation = 0.53
    smoothing_steps = 80  # steps of both kinds: fewer leave the stairs of the voxels
    # Simplification moves the surface at most so far: a triangle stays where fewer
    # would show.
    tolerance_voxels = 0.1
    import manifold3d
    from trimesh import Trimesh
    from trimesh.smoothing import filter_taubin

    mesh = Trimesh(vertices, triangles, process=False)
    volume_of_cubes = mesh.volume
    # Every edge of a closed surface is that of two triangles, once in each direction.
    edges = [triangles[:, (k, (k + 1) % 3)] for k in range(3)]
    start, end = np.concatenate(edges).T
    weights = 1.0 / np.bincount(start).astype(np.float32)[start]
    neighbours = sparse.csr_array((weights, (start, end)))
    filter_taubin(mesh, shrinking, inflation, smoothing_steps, neighbours)
    if mesh.volume <= min_smoothed_volume * volume_of_cubes:
        return Trimesh(vertices, triangles, process=False)
    fine = manifold3d.Mesh(
        mesh.vertices.astype(np.float32), triangles.astype(np.uint32)
    )
    simple = manifold3d.Manifold(fine).simplify(tolerance_voxels).to_mesh()
    return Trimesh(simple.vert_properties[:, :3], simple.tri_verts, process=False)


def _restore_volume(mesh: "Trimesh", voxels: int) -> None:
    """Move the vertices along their normals until the volume is that of the voxels."""
    volume_tolerance = 1e-7  # relative error of the volume that is left
    volume_rounds = 50  # at most; an organ needs two or three, a single voxel more
    for _ in range(volume_rounds):
        missing = voxels - mesh.volume
        if abs(missing) < volume_tolerance * voxels:
            break
        mesh.vertices = mesh.vertices + missing / mesh.area * mesh.vertex_normals
