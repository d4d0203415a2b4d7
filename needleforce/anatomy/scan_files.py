"""Scans from files: a folder with one DICOM series, NIfTI, or NRRD.

nibabel reads NIfTI and SimpleITK the others. What they would take in spite of doubt
where it lies is refused: an invented place, two places that differ, slices missing.
"""

import gzip
import locale
import re
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.markups import RAS_TO_LPS
from needleforce.anatomy.volume import Grid, Volume

M_PER_MM = 1e-3


def read_volume(path: Path | str) -> Volume:
    """Read a scan: a folder with one DICOM series, a NIfTI file or an NRRD file.

    Args:
        path: The file or folder.

    Raises:
        VolumeError: Not readable, damaged, not three-dimensional, not in millimetres,
            or without a word on how it lies; of DICOM: no series or several, slices
            that are missing, doubled, of different sizes or sheared.
    """
    scan = read_image(Path(path))
    values = scan.values
    if values.ndim != 3:
        raise VolumeError(f"{path} has several numbers per voxel: expected a scan")
    if not np.isfinite([values.min(), values.max()]).all():
        raise VolumeError(
            f"{path} has voxels that are no finite numbers (NaN or infinite): expected "
            "Hounsfield units, -1000 (air) where nothing was measured"
        )
    # A file that states a slope is read as floating point numbers, four times as large.
    limits = np.iinfo(np.int16)
    whole = np.rint(np.clip(values, limits.min, limits.max)).astype(np.int16)
    kept = whole if np.array_equal(whole, values) else values
    return Volume(np.ascontiguousarray(kept), scan.grid)


def read_image(path: Path) -> Volume:
    """Read a file or a folder; refuse what is damaged or does not say how it lies.

    Returns:
        Values (i, j, k), or (component, i, j, k) of a file with several per voxel.
    """
    min_diagonal_m = 0.005  # a smaller volume is not in millimetres
    max_diagonal_m = 5.0  # nor is a larger one
    if path.name.endswith((".nii", ".nii.gz")):
        image = _read_nifti(path)
    elif path.is_dir() or path.suffix in (".nrrd", ".nhdr"):
        image = _read_with_itk(path)
    else:
        raise VolumeError(
            f"{path}: expected .nii, .nii.gz, .nrrd, .seg.nrrd, or the folder of a "
            "DICOM series with one slice per file"
        )
    diagonal_m = float(np.linalg.norm(np.ptp(image.grid.corners_m(), axis=0)))
    if not min_diagonal_m < diagonal_m < max_diagonal_m:
        raise VolumeError(f"{path} measures {diagonal_m:.3g} m: expected millimetres")
    return image


def _require_volume(shape: Sequence[int]) -> None:
    """Refuse what is no volume of one number per voxel."""
    if len(shape) < 3 or min(shape[:3]) < 2 or any(size != 1 for size in shape[3:]):
        raise VolumeError(f"{tuple(shape)} voxels: expected three dimensions")


def _read_nifti(path: Path) -> Volume:
    """Read a NIfTI file, of version 1 or 2."""
    import nibabel
    from nibabel.filebasedimages import ImageFileError
    from nibabel.spatialimages import HeaderDataError

    damage = (OSError, ValueError, EOFError, MemoryError, zlib.error)
    try:
        kind: Any = type(nibabel.load(path))
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            # As it stands in the file: nibabel mends what is not plausible.
            header = kind.header_class.from_fileobj(file, check=False)
            file.seek(0)
            image = kind.from_stream(file)
            _require_volume(image.shape)
            if image.get_data_dtype().names:
                raise ValueError("it holds colours: expected one number per voxel")
            values = np.asanyarray(image.dataobj).reshape(image.shape[:3])
            file.read()  # up to the check sum
        grid = _nifti_grid(header, image.shape[:3])
    except (*damage, ImageFileError, HeaderDataError) as error:
        raise VolumeError(f"cannot read {path}: {error}") from error
    return Volume(values, grid)


def _nifti_grid(header: Any, shape: tuple[int, ...]) -> Grid:
    """Return where the voxels of a NIfTI file lie.

    Raises:
        VolumeError: The header does not say it in millimetres, or says two things.
    """
    max_shear = 0.01  # cosine of two axes up to which they count as orthogonal
    spacing_tolerance = 0.01  # relative difference of two spacings that mean the same
    # The quaternion of the qform knows no shear, so it comes first.
    stated = (header.get_qform(coded=True)[0], header.get_sform(coded=True)[0])
    forms_mm = np.array([form for form in stated if form is not None])
    unit = header.get_xyzt_units()[0]
    if not len(forms_mm) or unit not in ("unknown", "mm"):
        raise VolumeError(
            f"its unit is {unit}, qform_code {header['qform_code']} and sform_code "
            f"{header['sform_code']}: expected mm, and one that says how it lies"
        )
    stated_mm = np.array(header.get_zooms()[:3], float)
    lengths_mm = np.linalg.norm(forms_mm[:, :3, :3], axis=1)
    is_one = np.allclose(lengths_mm, stated_mm, rtol=spacing_tolerance, atol=0.0)
    if not is_one or not stated_mm.min() > 0.0:
        raise VolumeError(
            f"its header states a spacing of {stated_mm.tolist()} mm (pixdim), and its "
            f"matrices {lengths_mm.round(4).tolist()}: expected the same"
        )
    corners_mm = [Grid(shape, one[:3, 3], one[:3, :3]).corners_m() for one in forms_mm]
    apart_mm = np.linalg.norm(corners_mm[0] - corners_mm[-1], axis=1).max()
    # Programs take one or the other.
    if not apart_mm <= 0.5 * lengths_mm.min():
        raise VolumeError(f"its qform and sform disagree by {apart_mm:.3g} mm")
    directions = forms_mm[0, :3, :3] / lengths_mm[0]
    if not np.abs(directions.T @ directions - np.eye(3)).max() <= max_shear:
        raise VolumeError("its sform is sheared: expected orthogonal axes")
    left, _, right = np.linalg.svd(directions)
    axes_mm = RAS_TO_LPS[:, None] * (left @ right) * lengths_mm[0]
    origin_mm = RAS_TO_LPS * forms_mm[0, :3, 3]
    return Grid(shape, M_PER_MM * origin_mm, M_PER_MM * axes_mm)


def read_nifti_names(path: Path) -> dict[int, str]:
    """Return names by label from a NIfTI header, as TotalSegmentator writes them.

    They are the XML text of a Caret label table in an extension of the header:
    ``<Label Key="5" ...><![CDATA[liver]]></Label>``.

    Raises:
        VolumeError: The table is damaged, or defines entities.
    """
    import nibabel

    names: dict[int, str] = {}
    image: Any = nibabel.load(path)
    for extension in image.header.extensions:
        content = extension.get_content()
        if not isinstance(content, bytes) or b"<Label" not in content:
            continue
        try:
            # Decoded before it is looked at, and parsed as text: whatever encoding the
            # XML declares, the parser sees what is checked here.
            text = content.rstrip(b"\0").decode("utf-8-sig").strip()
            if "<!DOCTYPE" in text or "<!ENTITY" in text:
                raise ValueError("it defines entities")
            for label in ElementTree.fromstring(text).iter("Label"):
                names[int(label.attrib["Key"])] = (label.text or "").strip()
        except (ValueError, KeyError, ElementTree.ParseError) as error:
            raise VolumeError(f"its table of labels is damaged: {error}") from error
    return {value: name for value, name in names.items() if name}


def _read_with_itk(path: Path) -> Volume:
    """Read an NRRD file, or the series in a folder, with SimpleITK."""
    import SimpleITK

    SimpleITK.ProcessObject.GlobalWarningDisplayOff()  # what it warns of is refused
    language = locale.setlocale(locale.LC_CTYPE)
    try:
        image = _read_series(path) if path.is_dir() else _read_nrrd(path)
    except (RuntimeError, OSError) as error:
        reason = str(error).strip().splitlines()[-1]
        if not path.exists():
            reason = "no such file"
        raise VolumeError(f"cannot read {path}: {reason}") from error
    finally:  # the DICOM library sets C, and Python's text files would be ASCII
        locale.setlocale(locale.LC_CTYPE, language)
    _require_volume(image.GetSize())
    axes_mm = np.array(image.GetDirection()).reshape(3, 3) * image.GetSpacing()
    origin_m = M_PER_MM * np.array(image.GetOrigin())
    grid = Grid(image.GetSize(), origin_m, M_PER_MM * axes_mm)
    return Volume(SimpleITK.GetArrayFromImage(image).T, grid)


def _read_nrrd(path: Path) -> Any:
    """Return the image in an NRRD file that says in millimetres how it lies."""
    spaces = ("left-posterior-superior", "right-anterior-superior", "lps", "ras")
    spaces += ("left-anterior-superior", "las")
    import SimpleITK

    header = re.split(rb"\r?\n\r?\n", path.read_bytes(), maxsplit=1)[0]
    text = header.decode("latin-1").lower()
    fields = dict(re.findall(r"(?m)^([^:\n]+): (.*?)\r?$", text))
    image = SimpleITK.ReadImage(str(path))
    space = fields.get("space", "none")
    units = {*re.findall(r'[^"\s]+', fields.get("space units", "mm"))}
    is_placed = space in spaces and "space directions" in fields
    if not is_placed or units - {"mm", "millimeter", "millimetre"}:
        raise VolumeError(
            f"{path} has the space {space!r}, its `space directions` are "
            f"{fields.get('space directions', 'missing')}, its units "
            f"{', '.join(units)}: expected left-posterior-superior, RAS or LAS, mm"
        )
    return image


def _read_series(folder: Path) -> Any:
    """Return the image of the one DICOM series in a folder, after a look at its slices.

    CDs lay a series in DICOM/PA0/ST0/SE1 or the like.
    """
    import pydicom
    import SimpleITK

    series = [
        SimpleITK.ImageSeriesReader.GetGDCMSeriesFileNames(str(place), identifier)
        for place in (folder, *sorted(one for one in folder.rglob("*") if one.is_dir()))
        for identifier in SimpleITK.ImageSeriesReader.GetGDCMSeriesIDs(str(place))
    ]
    if len(series) != 1:
        places = [f"\n  {Path(one[0]).parent}: {len(one)} files" for one in series[:20]]
        raise VolumeError(
            f"{folder} holds {len(series)} DICOM series: expected one{''.join(places)}"
        )
    slices = [
        pydicom.dcmread(name, stop_before_pixels=True, force=True) for name in series[0]
    ]
    _require_one_ct(folder, slices)
    return SimpleITK.ReadImage(series[0])


def _require_one_ct(folder: Path, slices: Sequence[Any]) -> None:
    """Refuse slices that are not those of one whole CT."""
    max_shear_pixels = 0.5  # over the whole stack, slices may be shifted by so much
    rounding_mm = 0.06  # scanners round positions to a tenth of a millimetre
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
    if len(slices) < 2 or np.ptp(geometry, axis=0).any():
        raise VolumeError(
            f"{folder}: one slice, or slices that differ in size or orientation: mixed "
            "series"
        )
    row_axis, column_axis = geometry[0, :6].reshape(2, 3)
    frame = np.array([row_axis, column_axis, np.cross(row_axis, column_axis)])
    places_mm = np.array([one.ImagePositionPatient for one in slices], float) @ frame.T
    # Scanners round positions, so they are compared with a line over the whole stack.
    numbers = np.arange(len(slices))
    step_mm, start_mm = np.polyfit(numbers, places_mm, 1)
    residuals_mm = np.abs(places_mm - start_mm - np.outer(numbers, step_mm)).max(axis=0)
    between_mm = abs(float(step_mm[2]))
    # A missing slice shifts the ends of a stack by more than 0.15 of a step.
    tolerance_mm = min(max(0.01 * between_mm, rounding_mm), 0.15 * between_mm)
    if between_mm < 1e-3 or residuals_mm[2] > tolerance_mm:
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
