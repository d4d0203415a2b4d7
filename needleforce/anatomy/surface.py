"""Closed surfaces of labelled structures.

Marching cubes on the binary mask, Taubin's smoothing, simplification that keeps the
surface closed, and a step along the normals that gives back the volume of the voxels.
All but the last line works in voxels, so that unequal spacings are smoothed alike.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import chain, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import KDTree

from foundation.arrays import Array

if TYPE_CHECKING:
    from trimesh import Trimesh

SHRINKING = 0.5
"""Factor of the steps that smooth (Taubin 1995, doi 10.1145/218380.218473)."""

INFLATION = 0.53
"""Factor of the steps between them that undo the shrinking; from the same paper."""

SMOOTHING_STEPS = 80
"""Steps of both kinds: fewer leave the stairs of the voxels."""

TOLERANCE_VOXELS = 0.1
"""Simplification moves the surface at most so far: a triangle stays where fewer
would show."""

VOLUME_ROUNDS = 50
"""At most; an organ needs two or three, a single voxel more."""

VOLUME_TOLERANCE = 1e-7
"""Relative error of the volume that is left."""

MIN_SMOOTHED_VOLUME = 0.5
"""If less of the volume is left, smoothing has folded a structure of a few voxels."""

PIECES = 20_000
"""The nearest triangle is found by pieces with edges as long as those of so many
squares on the surface."""

FINEST = 250.0
"""No piece has shorter edges than this part of the surface's extent."""

SUBDIVISIONS = 30
"""Of a triangle, at most."""

_MM_PER_M = 1e3


class _Middles(NamedTuple):
    """Middles of the triangles that have an area.

    Attributes:
        tree: Of the middles.
        triangles: Index of the triangle of each.
    """

    tree: KDTree
    triangles: NDArray[np.intp]


class _Faces(NamedTuple):
    """The triangles of a surface.

    Attributes:
        corners_mm: Shape (m, 3, 3).
        normals: Shape (m, 3).
        areas_m2: Shape (m,).
    """

    corners_mm: Array
    normals: Array
    areas_m2: Array


class _Pieces(NamedTuple):
    """Small pieces of the triangles.

    Attributes:
        tree: Of their middles.
        triangles: Index of the triangle of each.
        size_m: The most that a point of a piece lies from its middle.
    """

    tree: KDTree
    triangles: NDArray[np.intp]
    size_m: float


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
    def _middles(self) -> _Middles:
        triangles = np.flatnonzero(self.mesh.face_normals.any(axis=1))
        return _Middles(KDTree(self.mesh.triangles_center[triangles]), triangles)

    @cached_property
    def _faces(self) -> _Faces:
        """The triangles; the mesh would be checked for changes at each use."""
        return _Faces(
            corners_mm=_MM_PER_M * self.mesh.triangles,
            normals=np.array(self.mesh.face_normals),
            areas_m2=np.array(self.mesh.area_faces),
        )

    @cached_property
    def _pieces(self) -> _Pieces:
        from trimesh.remesh import subdivide_to_size

        edge_m = max(np.sqrt(self.mesh.area / PIECES), self.mesh.scale / FINEST)
        triangles = self._middles.triangles
        corners_m, faces, *origins = subdivide_to_size(
            self.vertices_m,
            self.triangles[triangles],
            edge_m,
            max_iter=SUBDIVISIONS,
            return_index=True,
        )
        pieces_m = corners_m[faces]
        middles_m = pieces_m.mean(axis=1)
        size_m = float(np.linalg.norm(pieces_m - middles_m[:, None], axis=-1).max())
        return _Pieces(KDTree(middles_m), triangles[origins[0]], size_m)

    def nearest(self, points_m: Array) -> tuple[Array, Array]:
        """Return the nearest positions on the surface, and the normals there.

        A position on any triangle, such as that of the piece with the nearest middle,
        bounds the distance of the nearest one; the middle of the nearest one's piece
        lies no further than that and the size of a piece.

        Args:
            points_m: Shape (n, 3), as both results.
        """
        pieces = self._pieces
        every_point = np.arange(len(points_m))
        first_piece = pieces.tree.query(points_m)[1]
        positions_m = self._nearest_on(pieces.triangles[first_piece], points_m)
        reach_m = np.linalg.norm(positions_m - points_m, axis=1) + pieces.size_m
        near = pieces.tree.query_ball_point(points_m, reach_m * (1.0 + 1e-9))
        rows = np.repeat(every_point, [len(indices) for indices in near])
        near_pieces = np.fromiter(chain.from_iterable(near), np.intp, len(rows))
        pairs = np.unique(rows * len(self.triangles) + pieces.triangles[near_pieces])
        rows, triangles = np.divmod(pairs, len(self.triangles))
        positions_m = self._nearest_on(triangles, points_m[rows])
        distance_m = np.linalg.norm(positions_m - points_m[rows], axis=1)
        order = np.lexsort((distance_m, rows))
        best = order[np.searchsorted(rows, every_point)]
        return positions_m[best], self._faces.normals[triangles[best]]

    def _nearest_on(self, triangles: NDArray[np.intp], points_m: Array) -> Array:
        """Return the nearest positions to points (n, 3), on one triangle each.

        In millimetres: the tolerances of `trimesh` are absolute, and in metres as large
        as a small triangle.
        """
        from trimesh.triangles import closest_point

        corners_mm = self._faces.corners_mm[triangles]
        return 1e-3 * closest_point(corners_mm, _MM_PER_M * points_m)

    def mean_normals(self, positions_m: Array, normals: Array, reach_m: float) -> Array:
        """Return means of the normals around positions on the surface, shape (n, 3).

        They are of length 1 where it is flat. The other side of a thin part does not
        count.

        Args:
            positions_m: Shape (n, 3).
            normals: There, shape (n, 3).
            reach_m: Radius around each position.
        """
        middles = self._middles
        faces = self._faces
        means = normals.copy()
        near_each = middles.tree.query_ball_point(positions_m, reach_m)
        for k, near in enumerate(near_each):
            triangles = middles.triangles[near]
            near_normals = faces.normals[triangles]
            areas_m2 = faces.areas_m2[triangles]
            areas_m2 = areas_m2 * (near_normals @ normals[k] > 0.0)
            if areas_m2.any():
                means[k] = areas_m2 @ near_normals / areas_m2.sum()
        return means


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

    padded = np.pad(mask, 1)
    vertices, triangles, _, _ = marching_cubes(padded, 0.5, gradient_direction="ascent")
    mesh = _smooth_and_simplify(vertices, triangles)
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
    if joined.prod() == 1:
        return mask
    sizes = np.array(mask.shape)
    padded: NDArray[np.bool_] = np.zeros(sizes + -sizes % joined, bool)
    padded[tuple(map(slice, mask.shape))] = mask
    counts = np.zeros(-(-sizes // joined), np.int32)
    for corner in product(*map(range, joined.tolist())):
        every = [
            slice(start, None, step) for start, step in zip(corner, joined, strict=True)
        ]
        counts += padded[tuple(every)]
    half = np.ceil(0.5 * joined.prod())
    return counts >= min(half, counts.max())


def _smooth_and_simplify(vertices: Array, triangles: NDArray[np.integer]) -> "Trimesh":
    """Return the surface of cubes without their stairs and with fewer triangles.

    A structure of a few voxels, which smoothing would fold, stays as it is.
    """
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
    filter_taubin(mesh, SHRINKING, INFLATION, SMOOTHING_STEPS, neighbours)
    if mesh.volume <= MIN_SMOOTHED_VOLUME * volume_of_cubes:
        return Trimesh(vertices, triangles, process=False)
    fine = manifold3d.Mesh(
        mesh.vertices.astype(np.float32), triangles.astype(np.uint32)
    )
    simple = manifold3d.Manifold(fine).simplify(TOLERANCE_VOXELS).to_mesh()
    return Trimesh(simple.vert_properties[:, :3], simple.tri_verts, process=False)


def _restore_volume(mesh: "Trimesh", voxels: int) -> None:
    """Move the vertices along their normals until the volume is that of the voxels."""
    for _ in range(VOLUME_ROUNDS):
        missing = voxels - mesh.volume
        if abs(missing) < VOLUME_TOLERANCE * voxels:
            break
        mesh.vertices = mesh.vertices + missing / mesh.area * mesh.vertex_normals
