"""Volumes and segmentations: DICOM series, NIfTI, NRRD, 3D Slicer's .seg.nrrd.

Inside, everything is in metres and LPS (x to the patient's left, y to the back, z to the head), as
DICOM has it; SimpleITK converts what is stored in RAS. Arrays are indexed [i, j, k], i along the
first axis of the grid, whatever the order in the file.
"""

import colorsys
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.anatomy.errors import StructureError, VolumeError

Array = NDArray[np.float64]

MM = 1e-3
UNLABELLED = "unlabelled"
"""Name of voxels with the number 0: tissue between the segmented structures, and air."""
OBSTACLES = re.compile(
    r"bone|vertebra|rib|sacrum|hip|femur|humerus|scapula|clavicula|sternum|skull|cartilage|pelvis"
)
"""A needle does not go through a structure with such a name."""
_SLICE_TOLERANCE = 0.02
"""Relative difference of slice distances that is still one series."""
_SAME_MM = 1e-3


@dataclass(frozen=True, eq=False)
class Grid:
    """Where the voxels lie.

    Attributes:
        origin_m: Centre of voxel (0, 0, 0), shape (3,).
        axes_m: Steps from voxel to voxel, one column per index, shape (3, 3).
        shape: Voxels along each index.
    """

    origin_m: Array
    axes_m: Array
    shape: tuple[int, int, int]

    def to_world(self, index: ArrayLike) -> Array:
        """Points [m] of indices, shape (..., 3), which need not be whole."""
        return self.origin_m + np.asarray(index, dtype=float) @ self.axes_m.T

    def to_index(self, points_m: ArrayLike) -> Array:
        """Indices of points [m], shape (..., 3)."""
        return (np.asarray(points_m, dtype=float) - self.origin_m) @ np.linalg.inv(self.axes_m).T

    @property
    def spacing_m(self) -> Array:
        """Size of a voxel along each index, shape (3,)."""
        return np.linalg.norm(self.axes_m, axis=0)

    @property
    def voxel_m3(self) -> float:
        """Volume of a voxel."""
        return abs(float(np.linalg.det(self.axes_m)))


@dataclass(frozen=True, eq=False)
class Image:
    """A CT or another scan: its grid and values, shape as the grid's."""

    grid: Grid
    values: NDArray[Any]


@dataclass(frozen=True)
class Structure:
    """One segmented structure."""

    number: int  # of its voxels
    name: str
    color: tuple[float, float, float]  # red, green, blue, 0 to 1

    @property
    def is_obstacle(self) -> bool:
        """Whether a needle cannot go through: bone or cartilage, by its name."""
        return OBSTACLES.search(self.name.lower()) is not None


@dataclass(frozen=True, eq=False)
class Labels:
    """A segmentation: every voxel belongs to one structure, or with number 0 to none.

    Attributes:
        grid: Where the voxels lie.
        numbers: Of the structures, shape as the grid's.
        structures: By number.
    """

    grid: Grid
    numbers: NDArray[Any]
    structures: Mapping[int, Structure]

    def __post_init__(self) -> None:
        """Raise `VolumeError` if the numbers have another shape than the grid."""
        if self.numbers.shape != self.grid.shape:
            raise VolumeError(f"numbers {self.numbers.shape}, grid {self.grid.shape}: expected one")

    def named(self, name: str) -> Structure:
        """The structure of that name; `StructureError` if there is none."""
        for structure in self.structures.values():
            if structure.name == name:
                return structure
        known = ", ".join(structure.name for structure in self.structures.values())
        raise StructureError(f"no structure {name!r}; there are: {known}")

    def name_of(self, number: int) -> str:
        """Name of the structure with that number."""
        found = self.structures.get(number)
        return UNLABELLED if found is None else found.name

    def is_obstacle(self, number: int) -> bool:
        """Whether a needle cannot go through that structure."""
        found = self.structures.get(number)
        return found is not None and found.is_obstacle

    def centroid_m(self, name: str) -> Array:
        """Centre of a structure's voxels, shape (3,); `StructureError` if it is empty."""
        return self.grid.to_world(self._voxels(name).mean(axis=0))

    def volume_m3(self, name: str) -> float:
        """Volume of a structure's voxels."""
        return len(self._voxels(name)) * self.grid.voxel_m3

    def _voxels(self, name: str) -> NDArray[np.int64]:
        found = np.argwhere(self.numbers == self.named(name).number)
        if not len(found):
            raise StructureError(f"structure {name!r} has no voxels")
        return found

    def require_same_space(self, image: Image) -> None:
        """Raise `VolumeError` unless the labelled voxels lie inside an image's grid.

        A segmentation may be cropped or finer, but one whose origin, axes or units are not those of
        the scan puts organs where they are not.
        """
        filled = np.argwhere(self.numbers != 0)
        ends = np.array([filled.min(axis=0), filled.max(axis=0)])
        corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)
        index = image.grid.to_index(self.grid.to_world(corners))
        beyond = np.maximum(-0.5 - index, index - (np.array(image.grid.shape) - 0.5)).max()
        if beyond > 1.0:
            raise VolumeError(
                f"labelled voxels lie {beyond:.1f} voxels outside the scan: the segmentation is of "
                "another scan, or lost its origin; export it again with its own geometry"
            )
        if self.numbers.shape == image.values.shape and not np.allclose(
            self.grid.axes_m, image.grid.axes_m, atol=_SAME_MM * MM
        ):
            raise VolumeError(
                "segmentation and scan have the same size but different axes or spacing: "
                f"{self.grid.axes_m.tolist()} and {image.grid.axes_m.tolist()} m"
            )


def read_image(path: str | Path) -> Image:
    """Read a scan: a file (NIfTI, NRRD, MetaImage), or a folder with one DICOM series.

    Raises:
        VolumeError: It cannot be read, several series lie in the folder, or slices are missing.
    """
    found = _read(Path(path))
    if found.GetNumberOfComponentsPerPixel() != 1:
        raise VolumeError(f"{path} has several values per voxel; expected a scan with one")
    return Image(*_arrays(found))


def read_labels(path: str | Path, names: Mapping[int, str] | str | Path | None = None) -> Labels:
    """Read a segmentation.

    Args:
        path: A file of whole numbers. Slicer's .seg.nrrd brings names and colours along.
        names: Names by number, or a JSON file of them; None: `labels.json` beside the file, where
            there is one. What has no name is called by its number.

    Raises:
        VolumeError: It cannot be read, holds no whole numbers, is empty, or names no voxels.
    """
    place = Path(path)
    found = _read(place)
    grid, numbers = _arrays(found)
    meta = {key: found.GetMetaData(key) for key in found.GetMetaDataKeys()}
    if any(re.match(r"Segment\d+_LabelValue", key) for key in meta):
        numbers, structures = _slicer_segments(numbers, meta)
    else:
        if numbers.ndim != 3:
            raise VolumeError(f"{place} has several values per voxel, and is no .seg.nrrd")
        numbers = _whole_numbers(numbers, place)
        known = _names(place, names)
        present = [int(number) for number in np.unique(numbers) if number != 0]
        structures = {n: Structure(n, known.get(n, f"label {n}"), _color(n)) for n in present}
    if not structures or not numbers.any():
        raise VolumeError(f"{place} is empty: every voxel is 0; is it the segmentation?")
    return Labels(grid, numbers, structures)


def _read(path: Path) -> Any:
    import SimpleITK as sitk

    if not path.exists():
        raise VolumeError(f"{path} does not exist; expected a file, or a folder of DICOM slices")
    try:
        if path.is_dir():
            return _read_series(path, sitk)
        return sitk.ReadImage(str(path))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise VolumeError(f"{path} is no volume that can be read: {reason}") from error


def _read_series(folder: Path, sitk: Any) -> Any:
    reader = sitk.ImageSeriesReader()
    series = reader.GetGDCMSeriesIDs(str(folder))
    if len(series) != 1:
        what = f"holds {len(series)} DICOM series" if series else "holds no DICOM series"
        raise VolumeError(f"{folder} {what}; expected one: put each series into its own folder")
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder), series[0]))
    reader.MetaDataDictionaryArrayUpdateOn()
    image = reader.Execute()
    slices = range(image.GetSize()[2])
    places = [_numbers(reader, k, "0020|0032") for k in slices]
    tilts = [_numbers(reader, k, "0020|0037") for k in slices]
    if np.ptp(tilts, axis=0).max() > 1e-4:
        raise VolumeError(f"{folder}: slices are tilted against each other; expected one series")
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    usual = float(np.median(steps)) if len(steps) else 1.0
    odd = np.flatnonzero(np.abs(steps - usual) > _SLICE_TOLERANCE * usual)
    if len(odd):
        raise VolumeError(
            f"{folder}: slices are {usual:.4g} mm apart, but {steps[odd[0]]:.4g} mm after slice "
            f"{odd[0] + 1}: slices are missing or double; export the series again"
        )
    return image


def _numbers(reader: Any, slice_number: int, tag: str) -> list[float]:
    return [float(value) for value in reader.GetMetaData(slice_number, tag).split("\\")]


def _arrays(image: Any) -> tuple[Grid, NDArray[Any]]:
    """Grid and values, [i, j, k] or with several values per voxel [i, j, k, component]."""
    import SimpleITK as sitk

    if image.GetDimension() != 3:
        raise VolumeError(f"expected a volume, got {image.GetDimension()} dimensions")
    direction = np.array(image.GetDirection()).reshape(3, 3)
    axes_m = MM * direction * np.array(image.GetSpacing())
    if abs(np.linalg.det(axes_m)) < 1e-15:
        raise VolumeError(f"spacing {image.GetSpacing()} mm and axes span no volume")
    values = sitk.GetArrayFromImage(image)
    values = values.transpose(2, 1, 0, *range(3, values.ndim))
    return Grid(MM * np.array(image.GetOrigin()), axes_m, values.shape[:3]), values


def _whole_numbers(values: NDArray[Any], path: Path) -> NDArray[Any]:
    if np.issubdtype(values.dtype, np.integer):
        return values
    whole = np.rint(values)
    if not (np.isfinite(values).all() and np.array_equal(whole, values)):
        raise VolumeError(f"{path} holds fractions: expected the whole numbers of a segmentation")
    return whole.astype(np.int32)


def _names(path: Path, names: Mapping[int, str] | str | Path | None) -> dict[int, str]:
    if isinstance(names, Mapping):
        return {int(number): str(name) for number, name in names.items()}
    place = path.with_name("labels.json") if names is None else Path(names)
    if names is None and not place.exists():
        return {}
    try:
        table = json.loads(place.read_text(encoding="utf-8"))
        return {int(number): str(name) for number, name in table.items()}
    except (OSError, ValueError, AttributeError) as error:
        raise VolumeError(
            f'{place}: {error}; expected a JSON object such as {{"1": "liver"}}'
        ) from error


def _slicer_segments(
    values: NDArray[Any], meta: Mapping[str, str]
) -> tuple[NDArray[Any], dict[int, Structure]]:
    """Segments of a .seg.nrrd, renumbered from 1; of those that overlap the later lies on top."""
    layers = values if values.ndim == 4 else values[..., None]
    numbers = np.zeros(layers.shape[:3], dtype=np.uint16)
    structures: dict[int, Structure] = {}
    segments = sorted(int(m[1]) for key in meta if (m := re.match(r"Segment(\d+)_LabelValue", key)))
    for number, segment in enumerate(segments, start=1):
        field = f"Segment{segment}_"
        layer = layers[..., int(meta.get(field + "Layer", 0))]
        inside = layer == int(meta[field + "LabelValue"])
        if not inside.any():
            continue
        numbers[inside] = number
        parts = [float(part) for part in meta.get(field + "Color", "").split()]
        red, green, blue = parts if len(parts) == 3 else _color(number)
        name = meta.get(field + "Name", f"label {number}")
        structures[number] = Structure(number, name, (red, green, blue))
    return numbers, structures


def _color(number: int) -> tuple[float, float, float]:
    """A colour that differs from those of the neighbouring numbers."""
    return colorsys.hsv_to_rgb((0.618034 * number) % 1.0, 0.55, 0.85)
