"""Scans and segmentations from files.

SimpleITK reads every format, in LPS millimetres. What it would take in spite of damage
or doubt is refused, see `file_checks` and `dicom_series`.
"""

import gzip
import locale
import math
import zlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.body_order import require_body_order
from needleforce.anatomy.dicom_kinds import find_label_objects, refuse_contours
from needleforce.anatomy.dicom_segmentation import read_dicom_segmentation
from needleforce.anatomy.dicom_series import read_series
from needleforce.anatomy.errors import (
    EXPORT_LABELS,
    EXPORT_VOLUME,
    ONE_SERIES,
    VolumeError,
)
from needleforce.anatomy.file_checks import require_placed_nrrd, require_whole_nifti
from needleforce.anatomy.label_names import read_header_names
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.mask_folder import find_masks, join_masks
from needleforce.anatomy.renaming import is_unnamed, rename
from needleforce.anatomy.slabs import are_whole, copy_in_order
from needleforce.anatomy.slicer_segments import read_segments
from needleforce.anatomy.structures import Structure
from needleforce.anatomy.volume import Grid, Volume

MAX_VOLUME_BYTES = 2 << 30
"""Memory that the voxels of a file may take by default: four times a CT of 512 x 512 x
1000; a small damaged file can ask for any."""


M_PER_MM = 1e-3


Names = Mapping[Any, str] | Path | str | None
"""Names of labels, by their values or by the names in the file; or a JSON file with
them."""


class _Image(NamedTuple):
    """What a file holds.

    Attributes:
        arrays: One (i, j, k) per component, in the memory of `owner`.
        grid: Where their voxels lie.
        header: Fields of the file's header.
        is_nifti: The file is NIfTI, and not one that another was copied from.
        owner: The image of SimpleITK.
    """

    arrays: list[NDArray[Any]]
    grid: Grid
    header: dict[str, str]
    is_nifti: bool
    owner: Any


def read_volume(path: Path | str, *, max_bytes: int = MAX_VOLUME_BYTES) -> Volume:
    """Read a scan: a folder with one DICOM series, a NIfTI file or an NRRD file.

    Args:
        path: The file or folder.
        max_bytes: The most memory that the voxels of a file may take.

    Raises:
        VolumeError: Not readable, too large, damaged, not three-dimensional, not in
            millimetres, or without a word on how it lies; of DICOM: no series or
            several, slices that are missing, doubled, of different sizes or sheared.
    """
    image = _read_image(Path(path), max_bytes)
    if len(image.arrays) != 1:
        raise VolumeError(f"{path} has several numbers per voxel: expected a scan")
    return Volume(_as_scan(image.arrays[0], path), image.grid)


def read_labels(
    path: Path | str,
    names: Names = None,
    scan: Volume | None = None,
    *,
    situs_inversus: bool = False,
    max_bytes: int = MAX_VOLUME_BYTES,
) -> Labels:
    """Read a segmentation: 3D Slicer's ``.seg.nrrd``, NIfTI, NRRD, DICOM SEG, masks.

    NIfTI and other NRRD files have one label per voxel. A folder has a mask for every
    structure, named as it, as TotalSegmentator writes them; or one DICOM SEG.

    Args:
        path: The file or folder.
        names: By label value, or by the name in the file, or a JSON file with them
            (``{"5": "liver", "Segment_2": "rib"}``). They replace those in the file:
            segments, and NIfTI of TotalSegmentator, bring names; other labels are
            called as in ``labels.json`` beside the file, or ``label_5``.
        scan: The CT to which the labels belong: places and Hounsfield units must
            agree.
        situs_inversus: Liver and spleen of this patient are exchanged.
        max_bytes: The most memory that the voxels of a file may take.

    Raises:
        VolumeError: As `read_volume`; values that are no labels, no voxel labelled,
            structures that lie the wrong way round, or elsewhere than the scan shows
            them.
    """
    place = Path(path)
    try:
        labels = _read_structures(place, max_bytes)
        _require_all_named(labels)
        beside = place.with_name("labels.json")
        if names is None and beside.exists() and is_unnamed(labels):
            names = beside
        if names is not None:
            labels = rename(labels, names)
        require_body_order(labels, situs_inversus=situs_inversus)
        return labels if scan is None else labels.checked_against(scan)
    except VolumeError as error:
        if str(path) in str(error):
            raise
        raise error.reworded(f"{path}: {error}") from None


def _read_structures(place: Path, max_bytes: int) -> Labels:
    """Read a segmentation from a file or a folder, with the names that it has."""
    masks = find_masks(place)
    if masks:
        return join_masks(masks, partial(read_volume, max_bytes=max_bytes))
    segmentations, contours = find_label_objects(place)
    if contours:
        refuse_contours(contours[0])
    if len(segmentations) > 1:
        raise VolumeError(
            f"{place} holds {len(segmentations)} DICOM segmentations: expected "
            "one; give the file",
            ONE_SERIES,
        )
    if segmentations:
        return read_dicom_segmentation(segmentations[0], max_bytes)
    return _read_label_file(place, max_bytes)


def _read_label_file(path: Path, max_bytes: int) -> Labels:
    """Read a segmentation from one file, or from a DICOM series."""
    image = _read_image(path, max_bytes)
    volumes = [_as_labels(values, path) for values in image.arrays]
    structures = read_segments(image.header, len(volumes))
    if not structures:
        header_names = read_header_names(path) if image.is_nifti else {}
        structures = _name_labels(volumes, header_names)
    return Labels.of(volumes, image.grid, structures)


def _as_scan(values: NDArray[Any], path: Path | str) -> NDArray[Any]:
    """Return a copy of a scan, in 16 bits where these hold its numbers.

    A file that states a slope is read as floating point numbers, four times as large.
    """
    lowest = values.min()  # of numbers with one that is none, that one
    highest = values.max()
    if not np.isfinite([lowest, highest]).all():
        raise VolumeError(
            f"{path} has {np.count_nonzero(~np.isfinite(values))} voxels that are no "
            "finite numbers (NaN or infinite): expected Hounsfield units; export the "
            "CT again, with -1000 (air) where nothing was measured"
        )
    limits = np.iinfo(np.int16)
    is_narrow = lowest >= limits.min and highest <= limits.max
    kind = np.int16 if is_narrow and are_whole(values) else values.dtype
    return copy_in_order(values, kind)


def _as_labels(values: NDArray[Any], path: Path | str) -> NDArray[Any]:
    """Return a copy of the values of a file as labels, in as few bytes as they need."""
    max_uint8_labels = 256  # so many values, 0 included, fit into a byte
    max_label = values.max()
    is_in_range = values.min() >= 0 and max_label <= np.iinfo(np.uint16).max
    if is_in_range and not are_whole(values):
        # Programs that compute with labels leave 0.99999994.
        rounding = 1e-3
        whole = np.rint(values)
        off = np.abs(values - whole)
        if off.max() > rounding:
            raise VolumeError(
                f"{path} holds {values.flat[int(off.argmax())]:.9g}: expected labels, "
                "which are whole numbers",
                EXPORT_LABELS,
            )
        values = whole
        max_label = values.max()
    if not is_in_range:
        raise VolumeError(
            f"{path} holds {values.min():g} to {values.max():g}: expected labels from "
            "0 to 65535",
            EXPORT_LABELS,
        )
    kind = np.uint8 if max_label < max_uint8_labels else np.uint16
    return copy_in_order(values, kind)


def _require_all_named(labels: Labels) -> None:
    """Refuse labels of which some belong to no structure."""
    labelled = sum(map(np.count_nonzero, labels.volumes))
    loose = labelled - sum(item.voxels for item in labels.structures)
    if loose:
        raise VolumeError(
            f"{loose} voxels have labels of no segment: its header is damaged",
            EXPORT_LABELS,
        )


def _name_labels(
    volumes: Sequence[NDArray[Any]], names: Mapping[int, str]
) -> list[Structure]:
    """Return a structure for every label up to the highest one."""
    if len(volumes) > 1:
        raise VolumeError(
            "several labels per voxel and no segments: expected a .seg.nrrd file",
            EXPORT_LABELS,
        )
    values = range(1, int(volumes[0].max()) + 1)
    return [
        Structure.named(names.get(value, f"label_{value}"), value) for value in values
    ]


def _read_image(path: Path, max_bytes: int) -> _Image:
    """Read a file or a folder; refuse what is damaged or does not say how it lies."""
    nifti_endings = (".nii", ".nii.gz")
    max_diagonal_m = 5.0  # of a volume; above it its unit is not the millimetre
    min_diagonal_m = 0.005  # of a volume; below it its unit is not the millimetre
    image = _open_image(path, max_bytes)
    if image.GetDimension() != 3 or min(image.GetSize()) < 2:
        raise VolumeError(
            f"{path} has {image.GetSize()} voxels: expected three dimensions"
        )
    spacing_mm = np.array(image.GetSpacing())
    axes_mm = np.array(image.GetDirection()).reshape(3, 3) * spacing_mm
    origin_m = M_PER_MM * np.array(image.GetOrigin())
    grid = Grid(image.GetSize(), origin_m, M_PER_MM * axes_mm)
    diagonal_m = float(np.linalg.norm(np.ptp(grid.corners_m(), axis=0)))
    if not min_diagonal_m < diagonal_m < max_diagonal_m:
        raise VolumeError(
            f"{path} measures {diagonal_m:.3g} m: expected a file in millimetres",
            EXPORT_VOLUME,
        )
    header = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys()}
    # SimpleITK copies the fields of a NIfTI file into an NRRD file that it writes.
    is_nifti = path.name.endswith(nifti_endings) and header.get("nifti_type") == "1"
    if is_nifti:
        require_whole_nifti(path, header, spacing_mm, grid.shape)
    elif path.suffix in (".nrrd", ".nhdr"):
        require_placed_nrrd(path)
    elif not path.is_dir():
        if path.suffix in (".dcm", ""):
            raise VolumeError(
                f"{path} is one DICOM file: expected the folder of a series, one slice "
                "per file; convert a multi-frame file with dcm2niix, or export it from "
                "3D Slicer as .nrrd",
                ONE_SERIES,
            )
        raise VolumeError(
            f"{path}: whether a file of this kind says how it lies, and is whole, is "
            "not known"
        )
    return _Image(_components(image), grid, header, is_nifti, image)


def _open_image(path: Path, max_bytes: int) -> Any:
    """Return the image of SimpleITK in a file or folder."""
    # First bytes of a NIfTI-2 file in either byte order: its header has 540.
    nifti_2_sizes = (b"\x1c\x02\x00\x00", b"\x00\x00\x02\x1c")
    import SimpleITK

    if path.is_file() and _first_bytes(path) in nifti_2_sizes:
        raise VolumeError(
            f"cannot read {path}: it is NIfTI-2; convert it to NIfTI-1, in Python: "
            "import nibabel; "
            "nibabel.Nifti1Image.from_image(nibabel.load(OLD)).to_filename(NEW)"
        )
    # What it warns of is refused here.
    SimpleITK.ProcessObject.GlobalWarningDisplayOff()
    language = locale.setlocale(locale.LC_CTYPE)
    try:
        if path.is_dir():
            return read_series(path)
        reader = SimpleITK.ImageFileReader()
        reader.SetFileName(str(path))
        reader.ReadImageInformation()
        _require_size(path, reader, max_bytes)
        return reader.Execute()
    except RuntimeError as error:
        reason = "no such file"
        if path.exists():
            reason = str(error).strip().splitlines()[-1]
        raise VolumeError(
            f"cannot read {path}: {reason}; expected DICOM, .nii, .nii.gz, .nrrd or "
            ".seg.nrrd"
        ) from error
    finally:  # the DICOM library sets C, and Python's text files would be ASCII
        locale.setlocale(locale.LC_CTYPE, language)


def _first_bytes(path: Path) -> bytes:
    """Return the first four bytes of a file, unpacked if it is packed."""
    with path.open("rb") as file:
        start = file.read(4)
    if start[:2] != b"\x1f\x8b":
        return start
    try:
        with gzip.open(path) as file:
            return file.read(4)
    except (EOFError, OSError, zlib.error):
        return b""  # what is wrong with the file is said where it is read


def _require_size(path: Path, reader: Any, max_bytes: int) -> None:
    """Refuse a file whose voxels take more memory than they may.

    Args:
        path: Of the file.
        reader: Of SimpleITK, which has read the header, and no voxel.
        max_bytes: The most that they may take.
    """
    gb_per_byte = 1e-9
    import SimpleITK

    one_voxel = SimpleITK.Image([1] * len(reader.GetSize()), reader.GetPixelID())
    voxel_bytes = reader.GetNumberOfComponents() * one_voxel.GetSizeOfPixelComponent()
    size_bytes = math.prod(reader.GetSize()) * voxel_bytes
    if size_bytes > max_bytes:
        raise VolumeError(
            f"{path} has {reader.GetSize()} voxels, {gb_per_byte * size_bytes:.3g} GB: "
            f"more than the limit of {gb_per_byte * max_bytes:.3g} GB",
            "Crop or resample it, or store it in a smaller type.",
        )


def _components(image: Any) -> list[NDArray[Any]]:
    """Return the numbers of an image, one array (i, j, k) per component.

    SimpleITK gives (k, j, i), or (k, j, i, component), in the memory of the image.
    """
    import SimpleITK

    values = SimpleITK.GetArrayViewFromImage(image).T
    return [values] if values.ndim == 3 else list(values)
