"""Segmentations, and what is asked of them: surfaces, layers, clearances, the body."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from needleforce.anatomy.clearance import Clearance, VoxelBoxes
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.label_checks import check_against_scan
from needleforce.anatomy.path_layers import TISSUES, Layer, find_layers
from needleforce.anatomy.structures import Segmentation, Structure
from needleforce.anatomy.surface import Surface, closed_surface, join_voxels
from needleforce.anatomy.volume import Grid, Volume

BODY_HU = -300.0
"""Between air and fat, in Hounsfield units."""

FAT_HU = -30.0
"""Between fat and lean tissue, in Hounsfield units."""

LEAN = 1
"""Value of lean tissue, and of the whole body where fat is not separated."""

FAT = 2
"""Value of fat."""


def find_body(
    scan: Volume, *, fat: bool, progress: Callable[[float], None]
) -> NDArray[np.uint8]:
    """Return which voxels of a CT belong to the largest body, its holes filled.

    Args:
        scan: The CT.
        fat: Tell fat from lean tissue.
        progress: Called with the fraction done.

    Returns:
        0 outside of the body, `LEAN` in it, `FAT` where it is separated, (i, j, k).

    Raises:
        VolumeError: There is only air, or no air around.
    """
    import SimpleITK

    body = _largest_part(scan.values > BODY_HU)
    progress(0.5)
    air_around = np.count_nonzero(~body) - np.count_nonzero(~body[1:-1, 1:-1, 1:-1])
    if not body.any() or not air_around:
        raise VolumeError(
            f"no body in a scan of {scan.values.min():g} to {scan.values.max():g}: "
            f"expected a CT in Hounsfield units with air, below {BODY_HU:g}, around "
            "the patient (no MR, and air at -1000)"
        )
    body = _without_couch(body, scan.grid)
    # Lungs are open at the top of a scan, so holes are filled section by section.
    head_axis = int(np.abs(scan.grid.axes_m[2]).argmax())
    for section in np.moveaxis(body, head_axis, 0):
        image = SimpleITK.GetImageFromArray(section.astype(np.uint8))
        filled = SimpleITK.BinaryFillhole(image, foregroundValue=1)
        section[:] = SimpleITK.GetArrayViewFromImage(filled)
    kinds = body.astype(np.uint8)  # true is `LEAN`
    if fat:
        # Scans are noisy: the median of a voxel and the 26 around it decides.
        median = SimpleITK.Median(SimpleITK.GetImageFromArray(scan.values), [1, 1, 1])
        kinds[body & (SimpleITK.GetArrayViewFromImage(median) < FAT_HU)] = FAT
    progress(1.0)
    return kinds


def _largest_part(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which voxels belong to the largest part of a mask."""
    import SimpleITK

    image = SimpleITK.GetImageFromArray(mask.astype(np.uint8))
    parts = SimpleITK.RelabelComponent(SimpleITK.ConnectedComponent(image))
    return np.asarray(SimpleITK.GetArrayViewFromImage(parts) == 1)


def _without_couch(body: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
    """Return the body without the couch, where that touches the back.

    A couch is alike in all sections, wide, and lies behind what else is.
    """
    least_common = 0.95  # of the sections have something there
    min_width_m = 0.2
    head_axis, left_axis = (int(np.abs(grid.axes_m[k]).argmax()) for k in (2, 0))
    back_axis = 3 - head_axis - left_axis
    backwards = -1 if grid.axes_m[1, back_axis] < 0.0 else 1
    # A view of the same voxels, left to right, front to back, along the body.
    ordered = body.transpose(left_axis, back_axis, head_axis)[:, ::backwards]
    labelled: Any = ndimage.label(ordered.mean(axis=2) > least_common)
    parts, count = labelled
    boxes = ndimage.find_objects(parts)
    sizes = np.bincount(parts.ravel())
    trunk_stop = boxes[sizes[1:].argmax()][1].stop if count else 0
    couches = [
        number
        for number, box in enumerate(boxes, 1)
        if (box[0].stop - box[0].start) * grid.spacing_m[left_axis] > min_width_m
        and box[1].stop > trunk_stop
    ]
    if not couches:
        return body
    # Its edges, whose voxels are half air, go with it; so does its filling.
    edged = ndimage.binary_dilation(np.isin(parts, couches))
    ordered[np.asarray(ndimage.binary_fill_holes(edged), bool)] = False
    return _largest_part(body)


def resample_nearest(
    values: NDArray[np.uint8], source: Grid, target: Grid
) -> NDArray[np.uint8]:
    """Return values on another grid, which may be flipped, cropped or finer.

    Args:
        values: On the source grid, (i, j, k).
        source: Their grid.
        target: The other grid; outside of the source the result is 0.
    """
    import SimpleITK

    # From indices of the target to those of the source.
    turn = np.linalg.inv(source.axes_m) @ target.axes_m
    shift = source.indices(target.origin_m)
    taken = SimpleITK.Resample(
        SimpleITK.GetImageFromArray(values.T),
        [int(size) for size in target.shape],
        SimpleITK.AffineTransform(turn.ravel().tolist(), shift.tolist()),
        SimpleITK.sitkNearestNeighbor,
    )
    return np.ascontiguousarray(SimpleITK.GetArrayViewFromImage(taken).T)


SHOWN_VOXEL_m = 3e-3
"""Voxels of surfaces that are looked at: finer ones add triangles that nobody sees."""

DENSE = "dense_as_bone"
"""Name of what is as dense as bone in the CT and not labelled."""


class Labels(Segmentation):
    """A segmentation; see `Segmentation` for what it holds."""

    def with_body(
        self,
        scan: Volume,
        *,
        fat: bool = False,
        progress: Callable[[float], None] = lambda fraction: None,
    ) -> "Labels":
        """Add ``body``: all that is not air around the patient, found in the CT.

        Args:
            scan: The CT.
            fat: Add two structures in place of it, ``lean`` and ``fat``.
            progress: Called with the fraction done.

        Raises:
            VolumeError: Labels that lie elsewhere than the scan shows what they name,
                only air, or no air around.
        """
        checked = self.checked_against(scan)
        kinds = find_body(scan, fat=fat, progress=progress)
        values = resample_nearest(kinds, scan.grid, self.grid)
        return checked._with_volume(values, ("lean", "fat") if fat else ("body",))

    def _with_volume(self, values: NDArray[Any], names: Sequence[str]) -> "Labels":
        """Return labels with one more volume, and structures of values from 1."""
        number = len(self.volumes)
        added = [Structure.named(name, k, number) for k, name in enumerate(names, 1)]
        structures = [*self.structures, *added]
        labels = Labels.of([*self.volumes, values], self.grid, structures)
        return replace(labels, unchecked=self.unchecked)

    def with_dense(self, scan: Volume) -> "Labels":
        """Add `DENSE`, an obstacle: what is dense as bone in the CT and not labelled.

        What ``lean``, ``fat`` or ``body`` covers counts as not labelled. Pieces smaller
        than 10 mm³, which stop no needle, are left out.

        Args:
            scan: The CT, in HU.
        """
        import SimpleITK

        min_dense_m3 = 10e-9  # smaller pieces are calcifications, or noise
        # Soft tissue, with contrast medium too, seldom exceeds it; bone and metal do.
        dense_HU = 200.0
        dense = resample_nearest(
            (scan.values > dense_HU).astype(np.uint8), scan.grid, self.grid
        )
        for item in self.structures:
            if item.name not in TISSUES:
                dense[item.box][self.mask(item.name)] = 0
        pieces = SimpleITK.ConnectedComponent(SimpleITK.GetImageFromArray(dense), True)
        min_voxels = int(np.ceil(min_dense_m3 / self.grid.voxel_m3))
        large = SimpleITK.RelabelComponent(pieces, min_voxels)
        values = (SimpleITK.GetArrayViewFromImage(large) > 0).astype(np.uint8)
        return self._with_volume(values, (DENSE,)) if values.any() else self

    def checked_against(self, scan: Volume) -> "Labels":
        """Return the same labels, checked against their scan.

        Raises:
            VolumeError: The labels do not lie where the scan shows what they name.
        """
        return replace(self, unchecked=check_against_scan(self, scan))

    def surfaces(
        self,
        names: Iterable[str] | None = None,
        progress: Callable[[float], None] = lambda fraction: None,
        *,
        voxel_m: float = 0.0,
    ) -> dict[str, Surface]:
        """Return closed surfaces by name; see `closed_surface`.

        Args:
            names: Of the structures; None for all.
            progress: Called with the fraction done.
            voxel_m: Voxels are joined as long as they do not become larger than this,
                for surfaces that are only looked at (`SHOWN_VOXEL_m`).

        Raises:
            VolumeError: No structure with voxels has one of the names.
        """
        rounding = 1e-6  # fraction of a voxel by which it may be larger
        chosen = [item.name for item in self.structures] if names is None else [*names]
        voxels = voxel_m / self.grid.spacing_m + rounding
        joined = np.maximum(voxels, 1.0).astype(int)
        surfaces: dict[str, Surface] = {}
        for name in chosen:
            surfaces[name] = closed_surface(
                name,
                join_voxels(self.mask(name), joined),
                self.grid.points_m(self.corner(name) + 0.5 * (joined - 1)),
                self.grid.axes_m * joined,
                self[name].colour,
            )
            progress(len(surfaces) / len(chosen))
        return surfaces

    def skin(self) -> Surface:
        """Return the closed surface of all that is labelled; see `with_body`."""
        inside = [self.inside().astype(np.uint8)]
        return Labels.of(inside, self.grid, [Structure.named("skin", 1)]).surfaces()[
            "skin"
        ]

    def layers_along(self, entry_m: ArrayLike, target_m: ArrayLike) -> list[Layer]:
        """Return what a straight path crosses, in order, without gaps or overlaps.

        Where structures overlap the smaller one counts. Layers thinner than about 1.5
        voxels may be missed. The stated deviations contain what the voxels' size adds.

        Args:
            entry_m: First point, (3,) in LPS.
            target_m: Last point, inside the volume.

        Raises:
            VolumeError: A point is not finite, both are the same, the target lies
                outside, or the entry more than a metre.
        """
        return find_layers(self, entry_m, target_m)

    def clearances(
        self,
        entry_m: ArrayLike,
        target_m: ArrayLike,
        names: Iterable[str] | None = None,
    ) -> list[Clearance]:
        """Return how near a path comes to structures within 0.1 m, the nearest first.

        Every voxel counts as the box that it fills. `VoxelBoxes` judges many paths
        faster; `require_clear_path` refuses one that comes too near to an obstacle.

        Args:
            entry_m: First point, (3,) in LPS.
            target_m: Last point.
            names: Of the structures; None for obstacles and structures at risk.

        Raises:
            VolumeError: No structure with voxels has one of the names.
        """
        chosen = self.at_risk() if names is None else [self[name] for name in names]
        within_m = 0.1  # structures further away are not reported
        nearest = [
            VoxelBoxes(self, one).nearest(entry_m, target_m, within_m) for one in chosen
        ]
        found = [one for one in nearest if one is not None]
        return sorted(found, key=lambda one: (one.distance_m, one.depth_m))
