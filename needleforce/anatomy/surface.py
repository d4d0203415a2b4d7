"""Closed surfaces of labelled structures.

Marching cubes on the binary mask, Taubin's smoothing, simplification that keeps the
surface closed, and a step along the normals that gives back the volume of the voxels.
All but the last line works in voxels, so that unequal spacings are smoothed alike.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import KDTree

from needleforce.anatomy.errors import Array

if TYPE_CHECKING:
    from trimesh import Trimesh

SMOOTHING = 0.5, 0.53, 80  # Factors and steps (Taubin 1995, doi 10.1145/218380.218473)
TOLERANCE_VOXELS = 0.1
"""Simplification moves the surface at most so far: a triangle stays where fewer
would show."""
VOLUME_ROUNDS = 50  # At most; an organ needs two or three, a single voxel more
PIECES = 20_000
FINEST = 250.0
"""The nearest triangle is found by pieces with edges as long as those of so many
squares on the surface, but no shorter than this part of its extent."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface of one structure, triangles seen counter-clockwise from outside.

    What `trimesh` says of it: ``mesh.volume`` [m^3], ``mesh.is_volume`` for closed and
    consistent.

    Attributes:
        vertices_m: (n, 3), LPS.
        triangles: (m, 3) indices of vertices.
        colour: red, green, blue from 0 to 1.
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
    def _middles(self) -> tuple[KDTree, NDArray[np.intp]]:
        """Middles of the triangles that have an area, and which ones those are."""
        kept = np.flatnonzero(self.mesh.face_normals.any(axis=1))
        return KDTree(self.mesh.triangles_center[kept]), kept

    @cached_property
    def _faces(self) -> tuple[Array, Array, Array]:
        """Corners [mm], normals and areas of the triangles; the mesh would be
        checked each time.
        """
        mesh = self.mesh
        return (
            1e3 * mesh.triangles,
            np.array(mesh.face_normals),
            np.array(mesh.area_faces),
        )

    @cached_property
    def _pieces(self) -> tuple[KDTree, NDArray[np.intp], float]:
        """Middles of small pieces of those triangles, which these are, and the pieces'
        size.

        The size is the most that a point of a piece lies from its middle.
        """
        from trimesh.remesh import subdivide_to_size

        _, kept = self._middles
        edge_m = max(np.sqrt(self.mesh.area / PIECES), self.mesh.scale / FINEST)
        corners_m, faces, *of = subdivide_to_size(
            self.vertices_m,
            self.triangles[kept],
            edge_m,
            max_iter=30,
            return_index=True,
        )
        pieces_m = corners_m[faces]
        middles_m = pieces_m.mean(axis=1)
        size_m = float(np.linalg.norm(pieces_m - middles_m[:, None], axis=-1).max())
        return KDTree(middles_m), kept[of[0]], size_m

    def nearest(self, points_m: Array) -> tuple[Array, Array]:
        """Nearest places on the surface, and the normals there, of points (n, 3)."""
        tree, of, size_m = self._pieces
        # The place lies no further than a place on any triangle, its piece's middle by
        # a size more.
        every = np.arange(len(points_m))
        first = tree.query(points_m)[1]
        places_m = self._places(of[first], points_m)
        reach_m = np.linalg.norm(places_m - points_m, axis=1) + size_m
        near = tree.query_ball_point(points_m, reach_m * (1.0 + 1e-9))
        rows = np.repeat(every, [len(one) for one in near])
        pairs = np.unique(
            rows * len(self.triangles) + of[np.concatenate(near).astype(int)]
        )
        rows, faces = np.divmod(pairs, len(self.triangles))
        places_m = self._places(faces, points_m[rows])
        apart_m = np.linalg.norm(places_m - points_m[rows], axis=1)
        order = np.lexsort((apart_m, rows))
        best = order[np.searchsorted(rows, every)]
        return places_m[best], self._faces[1][faces[best]]

    def _places(self, faces: NDArray[np.intp], points_m: Array) -> Array:
        """Nearest places of points (n, 3) on one triangle each."""
        from trimesh.triangles import closest_point

        # In millimetres: its tolerances are absolute, and in metres as large as a small
        # triangle.
        return 1e-3 * closest_point(self._faces[0][faces], 1e3 * points_m)

    def mean_normals(self, places_m: Array, normals: Array, reach_m: float) -> Array:
        """Means of the normals so far around places (n, 3) on it; as long as 1 where
        it is flat.
        """
        tree, kept = self._middles
        _, every, area = self._faces
        means = normals.copy()
        for k, near in enumerate(tree.query_ball_point(places_m, reach_m)):
            around = every[kept[near]]
            areas = area[kept[near]]
            areas = areas * (
                around @ normals[k] > 0.0
            )  # not the other side of a thin part
            if areas.any():
                means[k] = areas @ around / areas.sum()
        return means


def closed_surface(
    name: str,
    mask: NDArray[np.bool_],
    corner_m: Array,
    axes_m: Array,
    colour: tuple[float, ...],
) -> Surface:
    """Return the closed surface of a mask (i, j, k), whose volume is that of its
    voxels.

    Voxel 0, 0, 0 lies at the corner; the columns of the axes are the steps to the next
    ones.

    A structure that the volume cuts off is closed there. One in several parts stays so,
    but beside a larger part one of less than some 30 voxels shrinks or vanishes, its
    volume goes to the rest.
    """
    import manifold3d
    from skimage.measure import marching_cubes
    from trimesh import Trimesh
    from trimesh.smoothing import filter_taubin

    voxels = np.count_nonzero(mask)
    padded = np.pad(mask, 1)
    vertices, triangles, _, _ = marching_cubes(padded, 0.5, gradient_direction="ascent")
    mesh = Trimesh(vertices, triangles, process=False)
    of_cubes = mesh.volume
    # Every edge of a closed surface is that of two triangles, once in each direction.
    one, other = np.concatenate([triangles[:, (k, (k + 1) % 3)] for k in range(3)]).T
    weights = 1.0 / np.bincount(one).astype(np.float32)[one]
    filter_taubin(mesh, *SMOOTHING, sparse.csr_array((weights, (one, other))))
    if mesh.volume > 0.5 * of_cubes:
        rough = manifold3d.Mesh(
            mesh.vertices.astype(np.float32), triangles.astype(np.uint32)
        )
        simple = manifold3d.Manifold(rough).simplify(TOLERANCE_VOXELS).to_mesh()
        mesh = Trimesh(simple.vert_properties[:, :3], simple.tri_verts, process=False)
    else:  # smoothing has folded a structure of a few voxels: its cubes' surface stays as it is
        mesh.vertices = vertices
    for _ in range(VOLUME_ROUNDS):
        missing = voxels - mesh.volume
        if abs(missing) < 1e-7 * voxels:
            break
        mesh.vertices = mesh.vertices + missing / mesh.area * mesh.vertex_normals
    # A mirrored grid turns triangles inside out, and this turns them back.
    origin_m = (corner_m - axes_m.sum(axis=1))[:, None]
    mesh.apply_transform(np.block([[axes_m, origin_m], [np.zeros((1, 3)), 1.0]]))
    return Surface(name, np.array(mesh.vertices), mesh.faces.astype(np.int32), colour)
