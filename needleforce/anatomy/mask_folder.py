"""A folder with a mask for every structure, as TotalSegmentator writes by default."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.errors import (
    EXPORT_LABELS,
    LABELS_OF_SCAN,
    VolumeError,
)
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.structures import Structure
from needleforce.anatomy.volume import Grid, Volume

ENDINGS = (".nii.gz", ".nii", ".nrrd")
"""Of files with masks."""


MAX_NAMES = 255
"""As many masks as fit into one byte with 0 for none; more take two."""


def find_masks(folder: Path) -> list[Path]:
    """Return the masks in a folder, by their names; none where it is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(
        path
        for path in folder.iterdir()
        if path.name.endswith(ENDINGS) and not path.name.startswith(".")
    )


def join_masks(masks: Sequence[Path], read: Callable[[Path], Volume]) -> Labels:
    """Return the structures of masks; a structure is named as its file.

    Masks that overlap come into volumes of their own.

    Args:
        masks: The files.
        read: Reads one.

    Raises:
        VolumeError: A file is no mask, or has another grid than the first.
    """
    first = read(masks[0])
    kind = np.uint8 if len(masks) <= MAX_NAMES else np.uint16
    volumes: list[NDArray[Any]] = []
    structures: list[Structure] = []
    for value, path in enumerate(masks, 1):
        scan = first if value == 1 else read(path)
        mask = _as_mask(scan, first.grid, path)
        place = first_free(volumes, mask)
        if place == len(volumes):
            volumes.append(np.zeros(first.grid.shape, kind))
        volumes[place][mask] = value
        structures.append(Structure.named(_name_of(path), value, place))
    return Labels.of(volumes, first.grid, structures)


def _as_mask(scan: Volume, grid: Grid, path: Path) -> NDArray[np.bool_]:
    """Return the voxels of a mask; refuse what is none, or lies elsewhere."""
    max_difference_voxels = 0.01  # grids that differ by more are not the same
    mask = scan.values != 0
    if np.any(scan.values[mask] != scan.values.max()) or scan.values.min() < 0:
        raise VolumeError(
            f"{path} holds {scan.values.min():g} to {scan.values.max():g}: expected a "
            "mask of two values, as every file in a folder of masks",
            EXPORT_LABELS,
        )
    is_same = scan.grid.shape == grid.shape
    if is_same:
        shift = np.abs(
            grid.indices(scan.grid.corners_m()) - grid.indices(grid.corners_m())
        )
        is_same = bool(shift.max() <= max_difference_voxels)
    if not is_same:
        raise VolumeError(
            f"{path} lies on another grid than the other masks of its folder",
            LABELS_OF_SCAN,
        )
    return mask


def first_free(volumes: Sequence[NDArray[Any]], mask: NDArray[np.bool_]) -> int:
    """Return the number of the first volume that a mask does not overlap."""
    for place, volume in enumerate(volumes):
        if not volume[mask].any():
            return place
    return len(volumes)


def _name_of(path: Path) -> str:
    """Return the name of a mask's structure."""
    for ending in ENDINGS:
        if path.name.endswith(ending):
            return path.name.removesuffix(ending)
    return path.stem
