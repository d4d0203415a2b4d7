"""Scans from files: a folder with one DICOM series, NIfTI, or NRRD.

nibabel reads NIfTI and SimpleITK the others. What they would take in spite of doubt
where it lies is refused: an invented place, two places that differ, slices missing.
"""

import gzip
import locale
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.markups import RAS_TO_LPS
from needleforce.anatomy.volume import Grid, Volume

MAX_VOLUME_BYTES = 2 << 30
"""Memory that the voxels of a file may take by default: four times a CT of 512 x 512 x
1000; a small damaged file can ask for any."""

M_PER_MM = 1e-3


class Image(NamedTuple):
    """What a file holds.

    Attributes:
        arrays: One (i, j, k) per number of a voxel.
        grid: Where the voxels lie.
        fields: Of the header of an NRRD file.
        names: Of labels, in the header of a NIfTI file.
    """

    arrays: list[NDArray[Any]]
    grid: Grid
    fields: Mapping[str, str]
    names: Mapping[int, str]


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
    image = read_image(Path(path), max_bytes)
    if len(image.arrays) != 1:
        raise VolumeError(f"{path} has several numbers per voxel: expected a scan")
    values = image.arrays[0]
    if not np.isfinite([values.min(), values.max()]).all():
        raise VolumeError(
            f"{path} has voxels that are no finite numbers (NaN or infinite): expected "
            "Hounsfield units, -1000 (air) where nothing was measured"
        )
    limits = np.iinfo(np.int16)
    is_narrow = values.min() >= limits.min and values.max() <= limits.max
    # A file that states a slope is read as floating point numbers, four times as large.
    kind = np.int16 if is_narrow and are_whole(values) else values.dtype
    return Volume(values.astype(kind, order="C"), image.grid)


def are_whole(values: NDArray[Any]) -> bool:
    """Return whether all numbers of a volume are whole."""
    return np.issubdtype(values.dtype, np.integer) or all(
        np.array_equal(section, np.rint(section)) for section in values
    )


def read_image(path: Path, max_bytes: int) -> Image:
    """Read a file or a folder; refuse what is damaged or does not say how it lies."""
    min_diagonal_m = 0.005  # a smaller volume is not in millimetres
    max_diagonal_m = 5.0  # nor is a larger one
    if path.name.endswith((".nii", ".nii.gz")):
        image = _read_nifti(path, max_bytes)
    elif path.is_dir() or path.suffix in (".nrrd", ".nhdr"):
        image = _read_with_itk(path, max_bytes)
    else:
        raise VolumeError(
            f"{path}: expected .nii, .nii.gz, .nrrd, .seg.nrrd, or the folder of a "
            "DICOM series with one slice per file"
        )
    diagonal_m = float(np.linalg.norm(np.ptp(image.grid.corners_m(), axis=0)))
    if not min_diagonal_m < diagonal_m < max_diagonal_m:
        raise VolumeError(f"{path} measures {diagonal_m:.3g} m: expected millimetres")
    return image


def require_size(shape: Sequence[int], voxel_bytes: int, max_bytes: int) -> None:
    """Refuse what is no volume, or takes more memory than it may.

    Raises:
        VolumeError: It is.
    """
    if len(shape) != 3 or min(shape) < 2:
        raise VolumeError(f"{tuple(shape)} voxels: expected three dimensions")
    size_bytes = math.prod(shape) * voxel_bytes
    if size_bytes > max_bytes:
        raise VolumeError(
            f"{tuple(shape)} voxels take {size_bytes:.3g} bytes: more than the limit "
            f"of {max_bytes:.3g}; crop or resample it"
        )


def _read_nifti(path: Path, max_bytes: int) -> Image:
    """Read a NIfTI file, of version 1 or 2."""
    import nibabel
    from nibabel.filebasedimages import ImageFileError
    from nibabel.spatialimages import HeaderDataError

    damage = (
        *(OSError, ValueError, EOFError, zlib.error, ElementTree.ParseError, KeyError),
        ImageFileError,
        HeaderDataError,
    )
    try:
        kind: Any = type(nibabel.load(path))
        is_packed = path.suffix == ".gz"
        with gzip.open(path) if is_packed else path.open("rb") as file:
            # As it stands in the file: nibabel mends what is not plausible.
            header = kind.header_class.from_fileobj(file, check=False)
            file.seek(0)
            image = kind.from_stream(file)
            shape = [*image.shape]
            while len(shape) > 3 and shape[-1] == 1:
                shape.pop()
            number = image.header.get_data_dtype()
            require_size(shape, number.itemsize, max_bytes)
            values = np.asanyarray(image.dataobj).reshape(shape)
            file.read()  # up to the check sum
        grid = _nifti_grid(header, shape)
        parts = values.dtype.names or ()  # of colours
        arrays = [values[part] for part in parts] or [values]
        return Image(arrays, grid, {}, _nifti_names(header))
    except damage as error:
        raise VolumeError(f"cannot read {path}: {error}") from error


def _nifti_grid(header: Any, shape: Sequence[int]) -> Grid:
    """Return where the voxels of a NIfTI file lie.

    Raises:
        VolumeError: The header does not say it in millimetres, or says two things.
    """
    max_shear = 0.01  # cosine of two axes up to which they count as orthogonal
    spacing_tolerance = 0.01  # relative difference of two spacings that mean the same
    qform_mm, _ = header.get_qform(coded=True)
    sform_mm, _ = header.get_sform(coded=True)
    unit, _ = header.get_xyzt_units()
    # The quaternion of the qform knows no shear.
    affine_mm = sform_mm if qform_mm is None else qform_mm
    if affine_mm is None or unit not in ("unknown", "mm"):
        raise VolumeError(
            f"its unit is {unit}, qform_code {header['qform_code']} and sform_code "
            f"{header['sform_code']}: expected mm, and one that says how it lies"
        )
    spacing_mm = np.linalg.norm(affine_mm[:3, :3], axis=0)
    stated_mm = np.array(header.get_zooms()[:3], float)
    forms_mm = [affine_mm if sform_mm is None else sform_mm, affine_mm]
    lengths_mm = np.linalg.norm(np.array(forms_mm)[:, :3, :3], axis=1)
    is_one = np.allclose(lengths_mm, stated_mm, rtol=spacing_tolerance, atol=0.0)
    if not is_one or not stated_mm.min() > 0.0:
        raise VolumeError(
            f"its header states a spacing of {stated_mm.tolist()} mm (pixdim), and its "
            f"matrices {lengths_mm.round(4).tolist()}: expected the same"
        )
    grids = [Grid(tuple(shape), form[:3, 3], form[:3, :3]) for form in forms_mm]
    apart_mm = np.linalg.norm(grids[0].corners_m() - grids[1].corners_m(), axis=1).max()
    # Programs take one or the other.
    if not apart_mm <= 0.5 * spacing_mm.min():
        raise VolumeError(f"its qform and sform disagree by {apart_mm:.3g} mm")
    directions = affine_mm[:3, :3] / spacing_mm
    if not np.abs(directions.T @ directions - np.eye(3)).max() <= max_shear:
        raise VolumeError("its sform is sheared: expected orthogonal axes")
    left, _, right = np.linalg.svd(directions)
    origin_m = M_PER_MM * RAS_TO_LPS * affine_mm[:3, 3]
    axes_mm = RAS_TO_LPS[:, None] * (left @ right) * spacing_mm
    return Grid(tuple(shape), origin_m, M_PER_MM * axes_mm)


def _nifti_names(header: Any) -> dict[int, str]:
    """Return names by label from a NIfTI header, as TotalSegmentator writes them.

    They are the XML text of a Caret label table in an extension of the header:
    ``<Label Key="5" ...><![CDATA[liver]]></Label>``.
    """
    names: dict[int, str] = {}
    for extension in header.extensions:
        content = extension.get_content()
        if not isinstance(content, bytes) or b"<Label" not in content:
            continue
        # Decoded before it is looked at, and parsed as text: whatever encoding the XML
        # declares, the parser sees what was checked here.
        text = content.rstrip(b"\0").decode("utf-8-sig").strip()
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise VolumeError("the table of labels in its header defines entities")
        try:
            labels = list(ElementTree.fromstring(text).iter("Label"))
        except ElementTree.ParseError as error:
            raise VolumeError(f"its table of labels is damaged: {error}") from error
        names |= {int(one.attrib["Key"]): (one.text or "").strip() for one in labels}
    return {value: name for value, name in names.items() if name}


def _read_with_itk(path: Path, max_bytes: int) -> Image:
    """Read an NRRD file, or the series in a folder, with SimpleITK."""
    import SimpleITK

    SimpleITK.ProcessObject.GlobalWarningDisplayOff()  # what it warns of is refused
    language = locale.setlocale(locale.LC_CTYPE)
    try:
        image = _read_series(path) if path.is_dir() else _read_nrrd(path, max_bytes)
    except (RuntimeError, OSError) as error:
        reason = (
            str(error).strip().splitlines()[-1] if path.exists() else "no such file"
        )
        raise VolumeError(f"cannot read {path}: {reason}") from error
    finally:  # the DICOM library sets C, and Python's text files would be ASCII
        locale.setlocale(locale.LC_CTYPE, language)
    spacing_m = M_PER_MM * np.array(image.GetSpacing())
    axes_m = np.array(image.GetDirection()).reshape(3, 3) * spacing_m
    grid = Grid(image.GetSize(), M_PER_MM * np.array(image.GetOrigin()), axes_m)
    # (k, j, i), or (k, j, i, component).
    values = SimpleITK.GetArrayFromImage(image).T
    arrays = [values] if values.ndim == 3 else list(values)
    fields = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys()}
    return Image(arrays, grid, fields, {})


def _read_nrrd(path: Path, max_bytes: int) -> Any:
    """Return the image in an NRRD file that says in millimetres how it lies."""
    spaces = ("left-posterior-superior", "right-anterior-superior", "lps", "ras")
    spaces += ("left-anterior-superior", "las")
    import SimpleITK

    reader = SimpleITK.ImageFileReader()
    reader.SetFileName(str(path))
    reader.ReadImageInformation()
    one_voxel = SimpleITK.Image([1] * len(reader.GetSize()), reader.GetPixelID())
    voxel_bytes = reader.GetNumberOfComponents() * one_voxel.GetSizeOfPixelComponent()
    require_size(reader.GetSize(), voxel_bytes, max_bytes)
    header = re.split(rb"\r?\n\r?\n", path.read_bytes(), maxsplit=1)[0].decode(
        "latin-1"
    )
    fields = dict(re.findall(r"(?m)^([^:\n]+): (.*?)\r?$", header.lower()))
    space = fields.get("space", "none")
    units = set(re.findall(r'[^"\s]+', fields.get("space units", "mm")))
    is_placed = space in spaces and "space directions" in fields
    if not is_placed or units - {"mm", "millimeter", "millimetre"}:
        raise VolumeError(
            f"{path} has the space {space!r}, its `space directions` are "
            f"{fields.get('space directions', 'missing')}, its units "
            f"{', '.join(units)}: expected left-posterior-superior, RAS or LAS, mm"
        )
    return reader.Execute()


def _read_series(folder: Path) -> Any:
    """Return the image of the one DICOM series in a folder, after a look at its slices.

    CDs lay a series in DICOM/PA0/ST0/SE1 or the like.
    """
    import pydicom
    import SimpleITK

    reader = SimpleITK.ImageSeriesReader()
    series = [
        reader.GetGDCMSeriesFileNames(str(place), identifier)
        for place in (folder, *sorted(one for one in folder.rglob("*") if one.is_dir()))
        for identifier in reader.GetGDCMSeriesIDs(str(place))
    ]
    if len(series) != 1:
        places = [f"\n  {Path(one[0]).parent}: {len(one)} files" for one in series[:20]]
        raise VolumeError(
            f"{folder} holds {len(series)} DICOM series: expected one{''.join(places)}"
        )
    (files,) = series
    slices = [
        pydicom.dcmread(name, stop_before_pixels=True, force=True) for name in files
    ]
    _require_one_ct(folder, slices)
    reader.SetFileNames(files)
    return reader.Execute()


def _require_one_ct(folder: Path, slices: Sequence[Any]) -> None:
    """Refuse slices that are not those of one whole CT."""
    max_shear_pixels = 0.5  # over the whole stack, slices may be shifted by so much
    for one in slices:
        tags = ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing")
        missing = [tag for tag in tags if tag not in one]
        kind = one.get("Modality", "CT")
        frames = one.get("NumberOfFrames") or 1
        if missing or kind == "MR" or frames != 1:
            raise VolumeError(
                f"{one.filename} is {kind} with {frames} frames and without "
                f"{', '.join(missing) or 'nothing'}: expected one slice of a CT per "
                "file; dcm2niix converts a multi-frame one"
            )
    geometry = np.array(
        [
            (*one.ImageOrientationPatient, *one.PixelSpacing, one.Rows, one.Columns)
            for one in slices
        ],
        float,
    )
    if np.ptp(geometry, axis=0).any():
        raise VolumeError(
            f"{folder}: slices differ in size or orientation: mixed series"
        )
    row_axis, column_axis = geometry[0, :6].reshape(2, 3)
    frame = np.array([row_axis, column_axis, np.cross(row_axis, column_axis)])
    places_mm = np.array([one.ImagePositionPatient for one in slices], float) @ frame.T
    if np.ptp(places_mm[:, 2]) < 1e-3:
        raise VolumeError(f"{folder}: one slice, or all at the same place")
    # Scanners round positions, so they are compared with a line over the whole stack.
    numbers = np.arange(len(slices))
    step_mm, start_mm = np.polyfit(numbers, places_mm, 1)
    residuals_mm = np.abs(places_mm - start_mm - np.outer(numbers, step_mm)).max(axis=0)
    tolerance_mm = _step_tolerance_mm(abs(float(step_mm[2])))
    if residuals_mm[2] > tolerance_mm:
        gaps_mm = np.abs(np.diff(places_mm[:, 2]))
        raise VolumeError(
            f"{folder}: slices are {gaps_mm.min():.3f} to {gaps_mm.max():.3f} mm "
            "apart: one is missing or doubled"
        )
    shift_mm = np.abs(step_mm[:2]).max() * (len(slices) - 1)
    is_straight = residuals_mm[:2].max() <= tolerance_mm
    if not is_straight or shift_mm > max_shear_pixels * geometry[0, 6:8].min():
        raise VolumeError(
            f"{folder}: slices are sheared (gantry tilt): `dcm2niix -z y -f ct -o . "
            f"{folder}` resamples them, give its ct_Tilt_1.nii.gz"
        )


def _step_tolerance_mm(step_mm: float) -> float:
    """Return by how much slices may miss their places in an even stack."""
    rounding_mm = 0.06  # scanners round to a tenth of a millimetre
    # A missing slice shifts the ends of a stack by more than 0.15 of a step.
    return min(max(0.01 * step_mm, rounding_mm), 0.15 * step_mm)
