"""Scans and segmentations from files: where each voxel lies and which structure it belongs to.

SimpleITK reads every format and gives physical places in LPS millimetres; arrays of two files may
be stored in different orders and still agree, so only places are ever compared. Inside it is LPS
and metres, and arrays are (i, j, k) along the axes of their `Grid`.
"""

import gzip
import json
import locale
import os
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from needleforce.anatomy.errors import Array, VolumeError
from needleforce.anatomy.path_layers import layers_on_path
from needleforce.anatomy.surface import Surface, surface_of

SIZES_M = (0.005, 5.0)
"""Least and most diagonal of a volume: beyond them its unit is not the millimetre."""
BODY_HU, FAT_HU = -300.0, -30.0
"""Between air and fat, and between fat and lean tissue, in Hounsfield units."""
OBSTACLES = "bone rib ribs costal cartilage cartilages vertebra vertebrae sacrum hip femur sternum"
OBSTACLES += " scapula clavicula clavicle humerus pelvis skull"
"""Words in the names of structures that stop a needle."""
NIFTI_SPACING: dict[bytes, dict[str, Any]] = {
    b"\x5c\1\0\0": {"dtype": "<f4", "offset": 80},
    b"\0\0\1\x5c": {"dtype": ">f4", "offset": 80},
    b"\x1c\2\0\0": {"dtype": "<f8", "offset": 104},
    b"\0\0\2\x1c": {"dtype": ">f8", "offset": 104},
}
"""By a NIfTI file's first bytes: type and place of its spacing, in versions 1 and 2."""
NRRD_SPACES = "left-posterior-superior right-anterior-superior left-anterior-superior lps ras las"
_COLOURS = {
    OBSTACLES: (241, 214, 145),
    "liver": (221, 130, 101),
    "spleen": (157, 108, 162),
    "kidney adrenal": (185, 102, 83),
    "gallbladder": (139, 150, 98),
    "stomach": (216, 132, 105),
    "pancreas": (249, 180, 111),
    "lung": (197, 165, 145),
    "aorta artery": (216, 101, 79),
    "vein vena cava vessel": (0, 151, 206),
    "bowel duodenum colon bladder": (205, 167, 142),
    "gluteus iliopsoas autochthon muscle lean": (192, 104, 88),
    "fat": (230, 220, 70),
    "body skin": (177, 122, 101),
    "lesion tumor tumour mass": (144, 238, 144),
}
"""By words in names; red, green, blue of 3D Slicer's table of generic anatomy."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Where voxels lie: point = origin + axes @ index; whole indices are voxel centres."""

    shape: tuple[int, ...]  # voxels along each of three axes
    origin_m: Array  # (3,) centre of voxel 0, 0, 0 in LPS
    axes_m: Array  # (3, 3) columns: step from a voxel to the next along each axis

    @property
    def spacing_m(self) -> Array:
        """Distance between voxels along each axis, (3,)."""
        return np.linalg.norm(self.axes_m, axis=0)

    @property
    def voxel_m3(self) -> float:
        """Volume of a voxel."""
        return abs(float(np.linalg.det(self.axes_m)))

    def points_m(self, indices: ArrayLike) -> Array:
        """Points (..., 3) in LPS of indices (..., 3), which may lie between voxels."""
        return self.origin_m + np.asarray(indices, float) @ self.axes_m.T

    def indices(self, points_m: ArrayLike) -> Array:
        """Indices (..., 3), with fractions, of points (..., 3) in LPS."""
        return (np.asarray(points_m, float) - self.origin_m) @ np.linalg.inv(self.axes_m).T

    def corners_m(self, box: Sequence[slice] = ()) -> Array:
        """Centres of the eight voxels in the corners, of the grid or of a box in it, (8, 3)."""
        whole = [slice(0, size) for size in self.shape]
        return self.points_m(list(product(*((part.start, part.stop - 1) for part in box or whole))))


@dataclass(frozen=True, eq=False)
class Volume:
    """A scan: one number per voxel, of a CT in Hounsfield units."""

    values: NDArray[Any]  # (i, j, k)
    grid: Grid


@dataclass(frozen=True)
class Structure:
    """One labelled structure of a segmentation."""

    name: str
    value: int  # of its voxels
    colour: tuple[float, ...]  # red, green, blue from 0 to 1
    is_obstacle: bool = False  # bone or cartilage
    volume: int = 0  # in which label volume it lies: segments that overlap need several
    voxels: int = 0
    box: tuple[slice, ...] = ()  # around its voxels

    @classmethod
    def named(cls, name: str, value: int, volume: int = 0) -> "Structure":
        """Return a structure whose colour, and whether it stops a needle, its name implies."""
        words = set(name.lower().replace("-", "_").replace(" ", "_").split("_"))
        fitting = [colour for key, colour in _COLOURS.items() if words & set(key.split())]
        shade = (0.618 * value) % 1.0  # golden ratio: no two numbers close by look alike
        colour = fitting[0] if fitting else (90 + 150 * shade, 200 - 60 * shade, 240 - 150 * shade)
        stops = bool(words & set(OBSTACLES.split()))
        return cls(name, value, tuple(part / 255.0 for part in colour), stops, volume)


@dataclass(frozen=True, eq=False)
class Labels:
    """A segmentation: label volumes on one grid, and what their values mean."""

    volumes: Sequence[NDArray[np.integer]]  # each (i, j, k); 0 is no structure
    grid: Grid
    structures: tuple[Structure, ...]  # those with voxels

    @classmethod
    def of(
        cls, volumes: Sequence[NDArray[Any]], grid: Grid, structures: Iterable[Structure]
    ) -> "Labels":
        """Count the voxels of each structure; those without any are left out.

        Raises:
            VolumeError: No structure has a voxel, or two have the same name.
        """
        boxes = [dict(enumerate(ndimage.find_objects(volume), 1)) for volume in volumes]
        found: dict[str, Structure] = {}
        for item in structures:
            if item.name in found:
                raise VolumeError(f"two structures are named {item.name!r}: rename one")
            if (box := boxes[item.volume].get(item.value)) is not None:
                voxels = np.count_nonzero(volumes[item.volume][box] == item.value)
                found[item.name] = replace(item, voxels=int(voxels), box=box)
        if not found:
            raise VolumeError("no voxel is labelled: expected at least one structure")
        return cls(volumes, grid, tuple(found.values()))

    def __getitem__(self, name: str) -> Structure:
        named = {item.name: item for item in self.structures}
        if name not in named:
            there = ", ".join(named)
            raise VolumeError(f"no structure with voxels is named {name!r}; there are {there}")
        return named[name]

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Which voxels belong to a structure, (i, j, k) in the structure's box."""
        structure = self[name]
        return self.volumes[structure.volume][structure.box] == structure.value

    def centroid_m(self, name: str) -> Array:
        """Mean place of a structure's voxels in LPS, (3,)."""
        start = [part.start for part in self[name].box]
        return self.grid.points_m(np.argwhere(self.mask(name)).mean(axis=0) + start)

    def with_body(self, scan: Volume, *, fat: bool = False) -> "Labels":
        """Add ``body``: all that is not air around the patient, found in the CT.

        With ``fat`` it comes as two structures, ``lean`` and ``fat``.

        Raises:
            VolumeError: Labels that lie elsewhere than the scan, only air, or no air around.
        """
        _require_agreement(self, scan)
        parts, count = ndimage.label(scan.values > BODY_HU)
        inside = (parts == np.bincount(parts[parts > 0], minlength=1).argmax()) & (parts > 0)
        inner = inside[1:-1, 1:-1, 1:-1]
        if not count or inside.sum() - inner.sum() == inside.size - inner.size:
            raise VolumeError(
                f"no body in a scan of {scan.values.min():g} to {scan.values.max():g}: expected a "
                f"CT in Hounsfield units with air, below {BODY_HU:g}, around the patient"
            )
        head = int(np.abs(scan.grid.axes_m[2]).argmax())  # lungs are open at the top of a scan
        for section in np.moveaxis(inside, head, 0):
            section[:] = ndimage.binary_fill_holes(section)
        kinds = inside.astype(np.uint8)
        if fat:  # among the neighbours, not in every voxel: scans are noisy
            kinds += inside & (ndimage.median_filter(scan.values, 3) < FAT_HU)
        # Each of our voxels takes the scan's nearest: grids may be flipped, cropped or finer.
        first = scan.grid.indices(self.grid.origin_m).tolist()
        steps = np.linalg.solve(scan.grid.axes_m, self.grid.axes_m)
        body = ndimage.affine_transform(
            kinds, steps, first, self.grid.shape, order=0, mode="nearest"
        )
        names = ("lean", "fat") if fat else ("body",)
        extra = [Structure.named(name, k, len(self.volumes)) for k, name in enumerate(names, 1)]
        return Labels.of([*self.volumes, body], self.grid, (*self.structures, *extra))

    def surfaces(
        self, names: Iterable[str] | None = None, progress: Callable[[float], None] | None = None
    ) -> dict[str, Surface]:
        """Closed surfaces by name (`surface.surface_of`); ``progress`` gets the fraction done."""
        wanted = [item.name for item in self.structures] if names is None else list(names)
        found = {}
        for name in wanted:
            found[name] = surface_of(self, name)
            if progress is not None:
                progress(len(found) / len(wanted))
        return found

    layers_along = layers_on_path  # it takes the labels first


def read_volume(path: Path | str) -> Volume:
    """Read a scan: a folder with one DICOM series, a NIfTI file or an NRRD file.

    Raises:
        VolumeError: Not readable, damaged, not three-dimensional, not in millimetres, or without a
            word on how it lies; of DICOM: no series or several, slices that are missing, doubled,
            of different sizes or sheared.
    """
    arrays, grid, _ = _read(Path(path))
    if len(arrays) != 1:
        raise VolumeError(f"{path} has several numbers per voxel: expected a scan")
    return Volume(arrays[0], grid)


def read_labels(
    path: Path | str,
    names: Mapping[Any, str] | Path | str | None = None,
    scan: Volume | None = None,
) -> Labels:
    """Read a segmentation: 3D Slicer's ``.seg.nrrd``, or NIfTI or NRRD with one label per voxel.

    Args:
        path: The file, or a folder with a DICOM series.
        names: Of label values, or a JSON file with them (``{"5": "liver"}``), by default
            ``labels.json`` beside the file; labels without a name are called ``label_5``. Segments
            of a ``.seg.nrrd`` bring names and colours.
        scan: The CT to which the labels belong: places must agree.

    Raises:
        VolumeError: As `read_volume`; values that are no labels, no voxel labelled, or labels that
            lie elsewhere than the scan.
    """
    arrays, grid, header = _read(Path(path))
    beside = Path(path).with_name("labels.json")
    names = beside if names is None and beside.exists() else names
    volumes = []
    for values in arrays:
        whole = values if np.issubdtype(values.dtype, np.integer) else values.astype(np.int32)
        if whole.min() < 0 or whole.max() > np.iinfo(np.uint16).max or np.any(whole != values):
            raise VolumeError(f"{path} holds {values.min():g} to {values.max():g}: expected labels")
        volumes.append(whole.astype(np.uint8 if whole.max() < 256 else np.uint16, copy=False))
    try:
        segments = _segments(header, len(volumes)) or _plain_structures(volumes, names)
        labels = Labels.of(volumes, grid, segments)
        loose = sum(map(np.count_nonzero, volumes)) - sum(one.voxels for one in labels.structures)
        if loose:
            raise VolumeError(f"{loose} voxels have labels of no segment: its header is damaged")
    except VolumeError as error:
        raise VolumeError(f"{path}: {error}") from None
    if scan is not None:
        _require_agreement(labels, scan)
    return labels


def _plain_structures(
    volumes: Sequence[NDArray[Any]], names: Mapping[Any, str] | Path | str | None
) -> list[Structure]:
    try:
        read = json.loads(Path(names).read_bytes()) if isinstance(names, Path | str) else names
        given = {int(value): name for value, name in (read or {}).items()}
    except (OSError, ValueError, AttributeError) as error:
        raise VolumeError(f"cannot read names from {names}: {error}") from error
    if not all(isinstance(name, str) for name in given.values()):
        raise VolumeError(f"names {given}: expected a text for each label")
    if len(volumes) > 1:
        raise VolumeError("several labels per voxel and no segments: expected a .seg.nrrd file")
    most = int(volumes[0].max())
    return [Structure.named(given.get(k, f"label_{k}"), k) for k in range(1, most + 1)]


def _segments(header: Mapping[str, str], layers: int) -> list[Structure]:
    """Return the segments that 3D Slicer described in the file's header, none in other files."""
    found: dict[tuple[int, int], Structure] = {}
    count = len({key.split("_")[0] for key in header if re.match(r"Segment\d+_", key)})
    for k in range(count):
        fields = {key.removeprefix(f"Segment{k}_"): text for key, text in header.items()}
        if "ID" not in fields:
            raise VolumeError(f"Segment{k}_ID is not in its header: expected {count} from 0 on")
        name = fields.get("Name", fields["ID"])
        try:
            volume, value = int(fields.get("Layer", 0)), int(fields.get("LabelValue", k + 1))
            colour = tuple(float(part) for part in fields.get("Color", "").split())
            if len(colour) not in (0, 3) or not all(0.0 <= part <= 1.0 for part in colour):
                raise ValueError(f"colour {colour}: expected three from 0 to 1")
        except ValueError as error:
            raise VolumeError(f"segment {name}: {error}; expected numbers in its header") from error
        if not 0 <= volume < layers:
            raise VolumeError(f"segment {name} lies in layer {volume}; the file has {layers}")
        if (volume, value) in found:
            raise VolumeError(f"segment {name} has the label {value} of another: give it its own")
        made = Structure.named(name, value, volume)
        found[volume, value] = replace(made, colour=colour or made.colour)
    return list(found.values())


@contextmanager
def kept_locale() -> Iterator[None]:
    """Put the locale back: the DICOM library sets C, and Python's text files would be ASCII."""
    before = locale.setlocale(locale.LC_CTYPE)
    try:
        yield
    finally:
        locale.setlocale(locale.LC_CTYPE, before)


def _read(path: Path) -> tuple[list[NDArray[Any]], Grid, dict[str, str]]:
    """Return one array (i, j, k) per component, their grid, and the file's header."""
    import SimpleITK

    SimpleITK.ProcessObject.GlobalWarningDisplayOff()  # what it warns of is refused here
    try:
        with kept_locale():
            image = _read_series(path) if path.is_dir() else SimpleITK.ReadImage(str(path))
    except RuntimeError as error:
        why = "no such file" if not path.exists() else str(error).strip().splitlines()[-1]
        raise VolumeError(
            f"cannot read {path}: {why}; expected DICOM, .nii, .nii.gz, .nrrd or .seg.nrrd"
        ) from error
    if image.GetDimension() != 3 or min(image.GetSize()) < 2:
        raise VolumeError(f"{path} has {image.GetSize()} voxels: expected three dimensions")
    axes = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
    grid = Grid(image.GetSize(), 1e-3 * np.array(image.GetOrigin()), 1e-3 * axes)
    diagonal = float(np.linalg.norm(np.ptp(grid.corners_m(), axis=0)))
    if not SIZES_M[0] < diagonal < SIZES_M[1]:
        raise VolumeError(f"{path} measures {diagonal:.3g} m: expected a file in millimetres")
    values = SimpleITK.GetArrayFromImage(image).T  # it gives (k, j, i), or (k, j, i, component)
    header = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys()}
    if header.get("nifti_type") == "1":
        _require_sound_nifti(path, header, image.GetSpacing())
    elif path.suffix in (".nrrd", ".nhdr"):
        _require_placed_nrrd(path)
    return [values] if values.ndim == 3 else list(values), grid, header


def _require_sound_nifti(
    path: Path, header: Mapping[str, str], spacing_mm: Sequence[float]
) -> None:
    """Refuse a file that is cut short or damaged, or does not say how it lies, or says two things.

    SimpleITK fills what is missing with zeros, and takes spacing and directions from two places.
    """
    sizes = [int(header[f"dim[{k}]"]) for k in range(1, int(header["dim[0]"]) + 1)]
    needed = float(header["vox_offset"]) + np.prod(sizes) * int(header["bitpix"]) / 8
    try:
        with path.open("rb") as plain:
            file = gzip.GzipFile(fileobj=plain) if plain.peek(2)[:2] == b"\x1f\x8b" else plain
            start, found = file.read(128), file.seek(0, os.SEEK_END)
        if found < needed:
            raise EOFError(f"{found} bytes of {needed:.0f}")
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise VolumeError(f"{path} ends early or is damaged: {error}; copy it again") from error
    has_matrix = header["sform_code"] != "0"
    if not has_matrix and header["qform_code"] == "0":
        raise VolumeError(
            f"{path} does not say how it lies (neither qform nor sform): left and right are "
            "unknown; export it again"
        )
    stated = np.frombuffer(start, count=3, **NIFTI_SPACING[start[:4]])
    rows = [[float(part) for part in header[f"srow_{axis}"].split()[:3]] for axis in "xyz"]
    lengths = np.linalg.norm(rows, axis=0) if has_matrix else spacing_mm
    if not np.allclose([stated, lengths], spacing_mm, rtol=0.01, atol=0.0):
        raise VolumeError(
            f"{path}: its header states a spacing of {stated.tolist()} mm (pixdim), and its matrix "
            f"(sform) one of {np.round(lengths, 4).tolist()}: expected the same; export it again"
        )


def _require_placed_nrrd(path: Path) -> None:
    """Refuse a file that does not say in millimetres of the patient how it lies."""
    with path.open("rb") as file:
        start = re.split(r"\r?\n\r?\n", file.read(1 << 22).decode("latin-1"), maxsplit=1)[0]
    fields = {key.lower(): text for key, text in re.findall(r"(?m)^([^:\n]+): (.*?)\r?$", start)}
    space, units = fields.get("space", "none"), fields.get("space units", "")
    if space.lower() not in NRRD_SPACES.split():
        why = f"its space is {space!r}: expected left-posterior-superior, or RAS or LAS"
    elif "space directions" not in fields:
        why = "it has no `space directions`: spacing and orientation are unknown"
    elif set(units.replace('"', " ").split()) - {"mm", "millimeter", "millimetre"}:
        why = f"its space units are {units}: expected mm"
    else:
        return
    raise VolumeError(f"{path}: {why}; export it again")


def _read_series(folder: Path) -> Any:
    """Read a DICOM series after a look at where its slices lie."""
    import SimpleITK

    reader = SimpleITK.ImageSeriesReader()
    series = reader.GetGDCMSeriesIDs(str(folder))
    if len(series) != 1:
        raise VolumeError(
            f"{folder} holds {len(series)} DICOM series: expected one; put each into its own folder"
        )
    files = reader.GetGDCMSeriesFileNames(str(folder), series[0])
    headers = np.array([_slice_header(name) for name in files])
    if np.ptp(headers[:, 3:], axis=0).any():
        raise VolumeError(f"{folder}: slices differ in size, spacing or orientation: mixed series")
    axes = headers[0, 3:9].reshape(2, 3)
    steps = np.diff(headers[:, :3], axis=0) @ np.vstack((axes, np.cross(*axes))).T
    apart = np.abs(steps[:, 2])
    usual = float(np.median(apart)) if len(apart) else 0.0
    if usual < 1e-3:
        raise VolumeError(f"{folder}: one slice, or all at the same place: expected one scan")
    worst = int(np.abs(apart - usual).argmax())
    if abs(apart[worst] - usual) > 0.01 * usual:
        raise VolumeError(
            f"{folder}: slices are {usual:.3f} mm apart, but {apart[worst]:.3f} mm after "
            f"{Path(files[worst]).name}: a slice is missing or doubled"
        )
    aside = np.abs(steps[:, :2]).max(), np.abs(np.cumsum(steps[:, :2], axis=0)).max()
    if aside[0] > 0.01 * usual or aside[1] > 0.5 * headers[0, 9:11].min():
        raise VolumeError(f"{folder}: slices are sheared (gantry tilt): resample the scan")
    reader.SetFileNames(files)
    return reader.Execute()


def _slice_header(name: str) -> list[float]:
    """Position, orientation, spacing and size of a DICOM slice, 13 numbers."""
    import SimpleITK

    reader, found = SimpleITK.ImageFileReader(), []
    reader.SetFileName(name)
    reader.ReadImageInformation()
    for tag in ("0020|0032", "0020|0037", "0028|0030", "0028|0010", "0028|0011"):
        if not reader.HasMetaDataKey(tag):
            raise VolumeError(f"{name} has no DICOM tag {tag}: expected slices of one scan")
        found += [float(part) for part in reader.GetMetaData(tag).split("\\")]
    return found


def _require_agreement(labels: Labels, scan: Volume) -> None:
    """Refuse labels on a grid as large as the scan's elsewhere, or with voxels outside the scan."""
    last = np.array(scan.grid.shape) - 1.0
    corners = scan.grid.indices(labels.grid.corners_m())
    off = float(np.minimum(np.abs(corners), np.abs(corners - last)).max())
    extents = (np.sort(np.ptp(grid.corners_m(), axis=0)) for grid in (labels.grid, scan.grid))
    is_as_large = np.allclose(*extents, atol=0.1 * scan.grid.spacing_m.min())
    if (is_as_large or sorted(labels.grid.shape) == sorted(scan.grid.shape)) and off > 0.1:
        raise VolumeError(
            f"the labels' grid is as large as the scan's and lies {off:.1f} voxels beside it: "
            "origin, spacing or directions of one of the files are wrong"
        )
    for item in labels.structures:
        found = scan.grid.indices(labels.grid.corners_m(item.box))
        if (off := float(np.maximum(-found, found - last).max())) > 1.0:
            raise VolumeError(
                f"{item.name} lies {off:.0f} voxels outside the scan: the labels belong to another "
                "scan, or lost their origin when they were cropped"
            )
