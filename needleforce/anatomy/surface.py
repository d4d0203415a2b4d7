"""Watertight surfaces of segmented structures.

Marching cubes on the padded mask, Taubin's smoothing, a simplification that keeps manifolds, then
vertices moved along their normals until the volume is that of the voxels again.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.errors import StructureError
from needleforce.anatomy.volume import Array, Labels, Structure

SMOOTHING = {"lamb": 0.5, "nu": 0.53, "iterations": 20}
"""Taubin (1995): shrinks and grows in turn, so that little volume is lost."""
VOLUME_ROUNDS = 4
SIMPLIFIED_VOXELS = 0.05
"""A simplified surface may lie so far from the full one, in voxels."""
MOST_VOXELS = 3_000_000
"""A larger structure is averaged over blocks of voxels first."""


class Surface(NamedTuple):
    """A closed surface, seen from outside anticlockwise."""

    structure: Structure
    vertices_m: Array  # shape (v, 3), LPS
    triangles: NDArray[np.int64]  # indices of vertices, shape (t, 3)

    @property
    def mesh(self) -> Any:
        """As a `trimesh.Trimesh`."""
        import trimesh

        return trimesh.Trimesh(self.vertices_m, self.triangles, process=False)

    @property
    def volume_m3(self) -> float:
        """Enclosed volume."""
        return enclosed_volume(self.vertices_m, self.triangles)

    @property
    def is_watertight(self) -> bool:
        """Whether every edge has two triangles, in opposite directions."""
        mesh = self.mesh
        return bool(mesh.is_watertight and mesh.is_winding_consistent)


def surface_of(labels: Labels, name: str, *, simplify: bool = True) -> Surface:
    """The surface of one structure.

    Args:
        labels: The segmentation.
        name: Of the structure.
        simplify: Leave out triangles that a smooth surface does not need.

    Raises:
        StructureError: There is no such structure, or it has no voxels.
    """
    from scipy.ndimage import find_objects

    structure = labels.named(name)
    boxes = find_objects(labels.numbers == structure.number, max_label=1)
    if not boxes or boxes[0] is None:
        raise StructureError(f"structure {name!r} has no voxels")
    return _surface(labels, structure, boxes[0], simplify=simplify)


def surfaces(labels: Labels, *, least_voxels: int = 1, progress: Any = None) -> list[Surface]:
    """The surfaces of all structures with so many voxels at least.

    Args:
        labels: The segmentation.
        least_voxels: Smaller structures are left out.
        progress: Called with the fraction done.
    """
    from scipy.ndimage import find_objects

    found, boxes = [], find_objects(labels.numbers)
    for done, (number, structure) in enumerate(labels.structures.items()):
        box = boxes[number - 1] if number <= len(boxes) else None
        if box is not None and np.count_nonzero(labels.numbers[box] == number) >= least_voxels:
            found.append(_surface(labels, structure, box, simplify=True))
        if progress is not None:
            progress((done + 1) / len(labels.structures))
    return found


def _surface(
    labels: Labels, structure: Structure, box: tuple[slice, ...], *, simplify: bool
) -> Surface:
    import trimesh
    from skimage.measure import marching_cubes

    mask = labels.numbers[box] == structure.number
    volume_m3 = np.count_nonzero(mask) * labels.grid.voxel_m3
    # Organs may be cut by the volume's border: without a margin the surface would be open there.
    padded, step = _averaged(np.pad(mask, 2))
    vertices, triangles, _, _ = marching_cubes(padded, 0.5, allow_degenerate=False)
    if labels.grid.axes_m.shape and np.linalg.det(labels.grid.axes_m) < 0.0:
        triangles = triangles[:, ::-1]  # a grid of the left hand turns every triangle over
    start = np.array([part.start - 2 for part in box])
    index = start + 0.5 * (step - 1) + step * vertices
    points_m = labels.grid.to_world(index)
    # In millimetres: libraries have tolerances of their own.
    mesh = trimesh.Trimesh(1e3 * points_m, triangles, process=False)
    if mesh.volume < 0.0:
        mesh.invert()
    trimesh.smoothing.filter_taubin(mesh, **SMOOTHING)
    points_m, triangles = 1e-3 * np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if simplify:
        tolerance_m = SIMPLIFIED_VOXELS * step * float(labels.grid.spacing_m.min())
        points_m, triangles = _simplified(points_m, triangles, tolerance_m)
    return Surface(structure, _with_volume(points_m, triangles, volume_m3), triangles)


def _averaged(mask: NDArray[np.bool_]) -> tuple[NDArray[np.float32], int]:
    """The mask as a field from 0 to 1, averaged over blocks where it is large, and their size."""
    step = 1
    while mask.size / step**3 > MOST_VOXELS:
        step += 1
    field = mask.astype(np.float32)
    if step == 1:
        return field, 1
    field = np.pad(field, [(0, -size % step) for size in field.shape])
    blocks = [part for size in field.shape for part in (size // step, step)]
    return np.pad(field.reshape(blocks).mean(axis=(1, 3, 5))[...], 0), step


def _simplified(
    points_m: Array, triangles: NDArray[np.int64], tolerance_m: float
) -> tuple[Array, NDArray[np.int64]]:
    """Fewer triangles within a tolerance; as they are where they are no manifold."""
    import manifold3d

    body = manifold3d.Manifold(
        manifold3d.Mesh(
            vert_properties=(1e3 * points_m).astype(np.float32),
            tri_verts=triangles.astype(np.uint32),
        )
    )
    if body.status() != manifold3d.Error.NoError or body.is_empty():
        return points_m, triangles
    found = body.simplify(1e3 * tolerance_m).to_mesh()
    if not len(found.tri_verts):
        return points_m, triangles
    return 1e-3 * found.vert_properties[:, :3].astype(float), found.tri_verts.astype(np.int64)


def _with_volume(points_m: Array, triangles: NDArray[np.int64], volume_m3: float) -> Array:
    """Vertices moved along their normals until the surface encloses a volume."""
    for _ in range(VOLUME_ROUNDS):
        normals, area = _area_vectors(points_m, triangles)
        missing = volume_m3 - enclosed_volume(points_m, triangles)
        points_m = points_m + missing / area * normals
    return points_m


def _area_vectors(points_m: Array, triangles: NDArray[np.int64]) -> tuple[Array, float]:
    """Unit normals of the vertices, shape (v, 3), and the area by which moving them adds volume."""
    a, b, c = (points_m[triangles[:, k]] for k in range(3))
    crossed = np.cross(b - a, c - a)
    normals = np.zeros_like(points_m)
    for k in range(3):
        np.add.at(normals, triangles[:, k], crossed / 6.0)
    sizes = np.linalg.norm(normals, axis=1)
    return normals / np.maximum(sizes, 1e-30)[:, None], float(sizes.sum())


def enclosed_volume(points_m: Array, triangles: NDArray[np.int64]) -> float:
    """Volume [m^3] that a closed surface encloses, by the divergence theorem."""
    middle = points_m.mean(axis=0)
    a, b, c = (points_m[triangles[:, k]] - middle for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0
