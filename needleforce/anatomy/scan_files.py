"""Scans from files: a folder with one DICOM series, NIfTI, NRRD, or MetaImage.

nibabel reads NIfTI and SimpleITK the others. What they would take in spite of doubt
where it lies is refused: an invented place, two places that differ, slices missing.
"""

import gzip
import locale
import re
import zlib
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.volume import RAS_TO_LPS, Grid, Volume

M_PER_MM = 1e-3


def read_volume(path: Path | str) -> Volume:
    """Read a scan: a folder with one DICOM series, or a file: NIfTI, NRRD, ``.mha``.

    Args:
        path: The file or folder.

    Raises:
        VolumeError: Not readable, damaged, not three-dimensional, not in millimetres,
            or without a word on how it lies; of DICOM: no series or several, slices
            that are missing, doubled, of different sizes or sheared.
    """
    scan = read_image(Path(path))
    values = scan.values
    if values.ndim != 3 or not np.isfinite(values).all():
        raise VolumeError(
            f"{path} has voxels of several numbers, or of such that are not finite: "
            "expected Hounsfield units, -1000 (air) where nothing was measured"
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
    elif path.is_dir() or path.suffix in (".nrrd", ".nhdr", ".mha", ".mhd"):
        image = _read_with_itk(path)
    else:
        raise VolumeError(
            f"{path}: expected .nii, .nii.gz, .nrrd, .seg.nrrd, .mha, or the folder of "
            "a DICOM series with one slice per file"
        )
    diagonal_m = float(np.linalg.norm(np.ptp(image.grid.corners_m(), axis=0)))
    is_volume = min(image.grid.shape) >= 2 and image.values.dtype.kind in "iuf"
    if not (is_volume and min_diagonal_m < diagonal_m < max_diagonal_m):
        raise VolumeError(
            f"{path} has {image.grid.shape} voxels of {image.values.dtype} over "
            f"{diagonal_m:.3g} m: expected numbers in three dimensions, in millimetres"
        )
    return image


def _read_nifti(path: Path) -> Volume:
    """Read a NIfTI file, of version 1 or 2."""
    import nibabel
    from nibabel.filebasedimages import ImageFileError
    from nibabel.spatialimages import HeaderDataError

    damage = (OSError, ValueError, EOFError, MemoryError, zlib.error)
    try:
        kind: Any = type(nibabel.load(path))
        content = path.read_bytes()
        if path.suffix == ".gz":
            content = gzip.decompress(content)  # which verifies its check sum
        # As it stands in the file: nibabel mends what is not plausible.
        header = kind.header_class.from_fileobj(BytesIO(content), check=False)
        values = np.asanyarray(kind.from_bytes(content).dataobj)
        shape = values.shape[:3]  # axes behind the third may have one voxel
        if len(shape) < 3 or values.size != np.prod(shape):
            raise ValueError(f"{values.shape} voxels: expected three dimensions")
        grid = _nifti_grid(header, shape)
    except (*damage, ImageFileError, HeaderDataError) as error:
        raise VolumeError(f"cannot read {path}: {error}") from error
    return Volume(values.reshape(shape), grid)


def _nifti_grid(header: Any, shape: tuple[int, ...]) -> Grid:
    """Return where the voxels of a NIfTI file lie.

    Raises:
        ValueError: The header does not say it in millimetres, or says two things.
    """
    max_shear = 0.01  # difference of stretches up to which axes count as orthogonal
    spacing_tolerance = 0.01  # relative difference of two spacings that mean the same
    # The quaternion of the qform knows no shear, so it comes first.
    stated = (header.get_qform(coded=True)[0], header.get_sform(coded=True)[0])
    forms_mm = np.array([form for form in stated if form is not None])
    stated_mm = np.array(header.get_zooms()[:3], float)
    unit = header.get_xyzt_units()[0]
    is_placed = len(forms_mm) > 0 and stated_mm.min() > 0.0
    if not is_placed or unit not in ("unknown", "mm"):
        raise ValueError(
            f"its unit is {unit}, its spacing {stated_mm.tolist()}, qform_code "
            f"{header['qform_code']}, sform_code {header['sform_code']}: expected mm, "
            "and one that says how it lies"
        )
    lengths_mm = np.linalg.norm(forms_mm[:, :3, :3], axis=1)
    corners_mm = [Grid(shape, one[:3, 3], one[:3, :3]).corners_m() for one in forms_mm]
    apart_mm = np.linalg.norm(corners_mm[0] - corners_mm[-1], axis=1).max()
    left, stretches, right = np.linalg.svd(forms_mm[0, :3, :3] / lengths_mm[0])
    is_spaced = np.allclose(lengths_mm, stated_mm, rtol=spacing_tolerance, atol=0.0)
    # Programs take the qform or the sform.
    is_one = is_spaced and apart_mm <= 0.5 * lengths_mm.min()
    if not is_one or np.abs(stretches**2 - 1.0).max() > max_shear:
        raise ValueError(
            f"its header contradicts itself: a spacing of {stated_mm.tolist()} mm "
            f"(pixdim) and {lengths_mm.round(4).tolist()} (matrices), qform and sform "
            f"{apart_mm:.3g} mm apart, axes stretched by {stretches.round(3).tolist()}"
        )
    axes_mm = RAS_TO_LPS[:, None] * (left @ right) * lengths_mm[0]
    origin_mm = RAS_TO_LPS * forms_mm[0, :3, 3]
    return Grid(shape, M_PER_MM * origin_mm, M_PER_MM * axes_mm)


def read_nifti_names(path: Path) -> dict[int, str]:
    """Return names by label from a NIfTI header, as TotalSegmentator writes them.

    They are the XML text of a Caret label table in an extension of the header:
    ``<Label Key="5" ...><![CDATA[liver]]></Label>``.

    Raises:
        VolumeError: The table is damaged.
    """
    import nibabel

    image: Any = nibabel.load(path)
    contents = [extension.get_content() for extension in image.header.extensions]
    tables = [one for one in contents if isinstance(one, bytes) and b"<Label" in one]
    try:
        trees = [ElementTree.fromstring(table.strip(b"\0 \r\n")) for table in tables]
        labels = [label for tree in trees for label in tree.iter("Label")]
        names = {int(one.attrib["Key"]): (one.text or "").strip() for one in labels}
    except (ValueError, KeyError, ElementTree.ParseError) as error:
        raise VolumeError(f"its table of labels is damaged: {error}") from error
    return {value: name for value, name in names.items() if name}


def _read_with_itk(path: Path) -> Volume:
    """Read an NRRD file, a MetaImage, or the series in a folder, with SimpleITK."""
    import SimpleITK

    SimpleITK.ProcessObject.GlobalWarningDisplayOff()  # what it warns of is refused
    language = locale.setlocale(locale.LC_CTYPE)
    try:
        files = _series_files(path) if path.is_dir() else _placed_file(path)
        image = SimpleITK.ReadImage(files)
    except (RuntimeError, OSError) as error:
        reason = str(error).strip().splitlines()[-1]
        raise VolumeError(f"cannot read {path}: {reason}") from error
    finally:  # the DICOM library sets C, and Python's text files would be ASCII
        locale.setlocale(locale.LC_CTYPE, language)
    axes_mm = np.array(image.GetDirection()).reshape(3, 3) * image.GetSpacing()
    origin_m = M_PER_MM * np.array(image.GetOrigin())
    grid = Grid(image.GetSize(), origin_m, M_PER_MM * axes_mm)
    return Volume(SimpleITK.GetArrayFromImage(image).T, grid)


def _placed_file(path: Path) -> str:
    """Return the name of a file whose header says in millimetres how it lies."""
    sides = ("left-posterior", "right-anterior", "left-anterior")
    spaces = ("lps", "ras", "las", *(f"{side}-superior" for side in sides))
    # What ITK would invent where it is missing; its MetaImage files are in LPS.
    needed = {"offset", "transformmatrix", "elementspacing"}
    end_of_header = rb"\r?\n\r?\n|(?<=\nElementDataFile = )"
    header = re.split(end_of_header, path.read_bytes(), maxsplit=1)[0]
    pattern = r"(?m)^([^:=\n]+?)(?:: | = )(.*?)\r?$"
    fields = dict(re.findall(pattern, header.decode("latin-1").lower()))
    unit = fields.get("space units", fields.get("distanceunits", "mm"))
    units = {*re.findall(r'[^"\s]+', unit)}
    if path.suffix in (".mha", ".mhd"):
        is_placed = needed <= fields.keys()
    else:
        is_placed = fields.get("space") in spaces and "space directions" in fields
    if not is_placed or units - {"mm", "millimeter", "millimetre"}:
        raise VolumeError(
            f"{path} has the space {fields.get('space')!r}, its `space directions` are "
            f"{fields.get('space directions', 'missing')}, its units "
            f"{', '.join(units)}: expected left-posterior-superior, RAS or LAS, mm; of "
            f"a MetaImage {', '.join(needed)}"
        )
    return str(path)


def _series_files(folder: Path) -> Sequence[str]:
    """Return the files of the one DICOM series in a folder, after a look at its slices.

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
    _require_one_ct(
        folder,
        [
            pydicom.dcmread(name, stop_before_pixels=True, force=True)
            for name in series[0]
        ],
    )
    return series[0]


def _require_one_ct(folder: Path, slices: Sequence[Any]) -> None:
    """Refuse slices that are not those of one whole CT."""
    tags = {"ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"}
    max_shear_pixels = 0.5  # over the whole stack, slices may be shifted by so much
    rounding_mm = 0.06  # scanners round positions to a tenth of a millimetre
    for one in slices:
        kind = one.get("Modality", "CT")
        frames = one.get("NumberOfFrames") or 1
        if kind == "MR" or frames != 1 or not tags <= {*one.dir()}:
            raise VolumeError(
                f"{one.filename} is {kind} with {frames} frames: expected one slice of "
                f"a CT per file, with {', '.join(sorted(tags))}; dcm2niix converts a "
                "multi-frame one"
            )
    geometry = [
        (*one.ImageOrientationPatient, *one.PixelSpacing, one.Rows, one.Columns)
        for one in slices
    ]
    if len(slices) < 2 or np.ptp(np.array(geometry, float), axis=0).any():
        raise VolumeError(
            f"{folder}: one slice, or slices that differ in size or orientation: mixed "
            "series"
        )
    row_axis, column_axis = np.array(geometry[0][:6], float).reshape(2, 3)
    frame = np.array([row_axis, column_axis, np.cross(row_axis, column_axis)])
    places_mm = np.array([one.ImagePositionPatient for one in slices], float) @ frame.T
    # Scanners round positions, so they are compared with a line over the whole stack.
    numbers = np.arange(len(slices))
    step_mm, start_mm = np.polyfit(numbers, places_mm, 1)
    off_mm = np.abs(places_mm - start_mm - np.outer(numbers, step_mm)).max()
    between_mm = abs(float(step_mm[2]))
    # A missing slice shifts the ends of a stack by more than 0.15 of a step.
    tolerance_mm = min(max(0.01 * between_mm, rounding_mm), 0.15 * between_mm)
    shift_mm = float(np.abs(step_mm[:2]).max() * numbers[-1])
    max_shift_mm = max_shear_pixels * min(geometry[0][6:8])
    if between_mm < 1e-3 or off_mm > tolerance_mm or shift_mm > max_shift_mm:
        raise VolumeError(
            f"{folder}: slices {between_mm:.3f} mm apart lie up to {off_mm:.3f} mm off "
            f"that, {shift_mm:.2f} mm aside: one is missing or doubled, or they are "
            f"sheared (gantry tilt): `dcm2niix -z y -f ct -o . {folder}` resamples "
            "those, give its ct_Tilt_1.nii.gz"
        )
