"""Scans and segmentations from files.

nibabel reads NIfTI, highdicom DICOM SEG, and SimpleITK a folder with one DICOM series,
NRRD, also 3D Slicer's, and MetaImage. What they would take in spite of doubt where it
lies is refused: an invented place, two places that differ, slices missing.
"""

import gzip
import json
import locale
import re
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.labels import Labels, require_body_order
from needleforce.anatomy.volume import RAS_TO_LPS, Grid, Structure, Volume, is_known

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
    if image.GetDimension() != 3:
        raise VolumeError(
            f"{path} has {image.GetDimension()} dimensions: expected a volume, with 3"
        )
    axes_mm = np.array(image.GetDirection()).reshape(3, 3) * image.GetSpacing()
    origin_m = M_PER_MM * np.array(image.GetOrigin())
    grid = Grid(image.GetSize(), origin_m, M_PER_MM * axes_mm)
    return Volume(SimpleITK.GetArrayFromImage(image).T, grid)


def _placed_file(path: Path) -> str:
    """Return the name of a file whose header says in millimetres how it lies."""
    sides = ("left-posterior", "right-anterior", "left-anterior")
    spaces = ("lps", "ras", "las", *(f"{side}-superior" for side in sides))
    # What ITK would invent where it is missing; its MetaImage files are in LPS.
    places = {"offset", "position", "origin"}
    directions = {"transformmatrix", "orientation", "rotation"}
    end_of_header = rb"\r?\n\r?\n|\r?\nElementDataFile"
    header = re.split(end_of_header, path.read_bytes(), maxsplit=1)[0]
    pattern = r"(?m)^([^:=\n]+?)(?:: | ?= ?)(.*?)\r?$"
    fields = dict(re.findall(pattern, header.decode("latin-1").lower()))
    unit = fields.get("space units", fields.get("distanceunits", "mm"))
    units = {*re.findall(r'[^"\s]+', unit)}
    if path.suffix in (".mha", ".mhd"):
        is_placed = bool(places & fields.keys() and directions & fields.keys())
        is_placed &= "elementspacing" in fields
    else:
        is_placed = fields.get("space") in spaces and "space directions" in fields
    if not is_placed or units - {"mm", "millimeter", "millimetre"}:
        raise VolumeError(
            f"{path} has the space {fields.get('space')!r}, its `space directions` are "
            f"{fields.get('space directions', 'missing')}, its units "
            f"{', '.join(units)}: expected left-posterior-superior, RAS or LAS, mm; of "
            "a MetaImage Offset, TransformMatrix and ElementSpacing"
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


Names = Mapping[Any, str] | Path | str | None
"""Names of labels, by their values or by the names in the file; or a JSON file with
them."""

AUTOMATIC = re.compile(r"(segment|label)?[ _]?\d+([ _]\d+)*|segment", re.IGNORECASE)
"""Names that say nothing."""


def read_labels(
    path: Path | str,
    names: Names = None,
    scan: Volume | None = None,
    *,
    situs_inversus: bool = False,
) -> Labels:
    """Read a segmentation: ``.seg.nrrd``, NIfTI, NRRD, ``.mha``, or DICOM SEG.

    Files but those of 3D Slicer and DICOM have one label per voxel.

    Args:
        path: The file.
        names: By label value, or by the name in the file, or a JSON file with them
            (``{"5": "liver", "Segment_2": "rib"}``). They replace those in the file:
            segments, and NIfTI of TotalSegmentator, bring names; other labels are
            called as in ``labels.json`` beside the file, or ``label_5``.
        scan: The CT to which the labels belong: places and Hounsfield units must
            agree.
        situs_inversus: Liver and spleen of this patient are exchanged.

    Raises:
        VolumeError: As `read_volume`; values that are no labels, no voxel labelled,
            structures that lie the wrong way round, or elsewhere than the scan shows
            them.
    """
    place = Path(path)
    try:
        labels = _read_structures(place)
        beside = place.with_name("labels.json")
        is_unnamed = all(AUTOMATIC.fullmatch(item.name) for item in labels.structures)
        if names is None and is_unnamed and beside.exists():
            names = beside
        if names is not None:
            labels = _rename(labels, names)
        require_body_order(labels, situs_inversus=situs_inversus)
        return labels if scan is None else labels.checked_against(scan)
    except VolumeError as error:
        raise error.reworded(f"{path}: {error}") from None


def _read_structures(place: Path) -> Labels:
    """Read a segmentation with the names that its file has."""
    from pydicom.misc import is_dicom

    if place.is_dir():
        raise VolumeError(
            "it is a folder: expected one file, .seg.nrrd, .nii.gz, .mha or DICOM SEG "
            "(`TotalSegmentator --ml` writes one)"
        )
    if place.is_file() and is_dicom(place):
        return _read_dicom_segments(place)
    image = read_image(place)
    volumes = [*_as_labels(image.values).reshape(-1, *image.grid.shape)]
    is_nifti = place.name.endswith((".nii", ".nii.gz"))
    is_nrrd = place.suffix in (".nrrd", ".nhdr")
    structures = _slicer_segments(place, len(volumes)) if is_nrrd else []
    if not structures and len(volumes) == 1:
        names = read_nifti_names(place) if is_nifti else {}
        structures = [
            Structure.named(names.get(value, f"label_{value}"), value)
            for value in np.unique(volumes[0]).tolist()
            if value
        ]
    found = Labels.of(volumes, image.grid, _named_by_terms(structures))
    held = sum(item.voxels for item in found.structures)
    if loose := sum(map(np.count_nonzero, volumes)) - held:
        raise VolumeError(f"{loose} voxels have labels of no segment")
    return found


def _as_labels(values: NDArray[Any]) -> NDArray[Any]:
    """Return the values of a file as labels, in as few bytes as they need."""
    rounding = 1e-3  # programs that compute with labels leave 0.99999994
    whole = np.rint(values).astype(values.dtype)
    is_whole = np.abs(values - whole).max() <= rounding  # nan is not
    if not is_whole or whole.min() < 0 or whole.max() > np.iinfo(np.uint16).max:
        raise VolumeError(
            f"it holds {values.min()} to {values.max()}: expected whole labels from 0 "
            "to 65535"
        )
    return whole.astype(np.min_scalar_type(int(whole.max())), order="C")


def _lay(volumes: list[NDArray[Any]], mask: NDArray[np.bool_], value: int) -> int:
    """Write a mask into the first volume where it overlaps none; return its index."""
    for number, volume in enumerate(volumes):
        if not volume[mask].any():
            volume[mask] = value
            return number
    volumes.append(np.where(mask, np.uint16(value), np.uint16(0)))
    return len(volumes) - 1


def _read_dicom_segments(path: Path) -> Labels:
    """Read the segments of a DICOM segmentation, which `highdicom` decodes.

    Raises:
        VolumeError: The file is no segmentation, damaged or fractional, or its frames
            do not lie evenly.
    """
    import highdicom

    options: dict[str, Any] = {
        "rtol": 0.1,  # of the step between slices: scanners round positions
        "allow_missing_positions": True,  # frames without voxels may be left out
    }
    volumes: list[NDArray[Any]] = []
    segments: list[Structure] = []
    try:
        file = highdicom.seg.segread(str(path))
        geometry = file.get_volume_geometry(**options)
        if file.segmentation_type.value == "FRACTIONAL" or geometry is None:
            raise ValueError("its segments are fractional, or do not lie evenly")
        # Files of labels may describe the background, number 0, as well.
        for number in filter(None, file.segment_numbers):
            only = file.get_volume(
                segment_numbers=[number], combine_segments=True, **options
            )
            described = file.get_segment_description(number)
            name = str(described.SegmentLabel)
            volume = _lay(volumes, only.array != 0, number)
            segments.append(Structure.named(name, number, volume, _coded(described)))
    except Exception as error:  # of damaged files: whatever is met first
        raise VolumeError(f"cannot read {path} as DICOM SEG: {error}") from error
    affine = M_PER_MM * geometry.affine
    grid = Grid(tuple(geometry.spatial_shape), affine[:3, 3], affine[:3, :3])
    return Labels.of(volumes, grid, _named_by_terms(segments))


def _coded(described: Any) -> str:
    """Return what the coded terms of a DICOM segment say that it is."""
    terms: list[str] = []
    for term, modifier in (
        ("SegmentedPropertyTypeCode", "SegmentedPropertyTypeModifierCode"),
        ("AnatomicRegion", "AnatomicRegionModifier"),
    ):
        codes = described.get(f"{term}Sequence") or [{}]
        sides = codes[0].get(f"{modifier}Sequence") or [{}]
        terms += [str(one.get("CodeMeaning", "")) for one in (codes[0], sides[0])]
    return _kind_of_terms(terms)


def _kind_of_terms(terms: Sequence[str]) -> str:
    """Return what a segment is, in small letters; empty if nothing known is said.

    The region counts where the segment itself is only called *tissue* or *organ*.

    Args:
        terms: What it is, such as ``Kidney``, and a modifier of that, such as
            ``Left``; the region, such as ``Liver``, and its modifier.
    """
    for name, modifier in (terms[:2], terms[2:]):
        if is_known(name):
            return f"{modifier} {name}".strip().lower()
    return ""


def _slicer_segments(path: Path, volumes: int) -> list[Structure]:
    """Return the segments that 3D Slicer describes in a header; none in other files.

    Segments that do not overlap share a layer: ``Segment0_Layer`` says which,
    ``Segment0_LabelValue`` with which value. Tags are ``KEY:VALUE`` with ``|`` between
    them; the entry of terms has seven parts with ``~`` between them, each of them a
    context, or scheme, code and meaning with ``^`` between them: the third is the type,
    then its modifier, the sixth the region.

    Args:
        path: The file.
        volumes: How many layers it has.
    """
    header = re.split(rb"\r?\n\r?\n", path.read_bytes(), maxsplit=1)[0]
    pattern = r"(?m)^Segment(\d+)_(\w+):=(.*?)\r?$"
    fields: dict[int, dict[str, str]] = {}
    for number, key, text in re.findall(pattern, header.decode("utf-8", "replace")):
        fields.setdefault(int(number), {})[key] = text
    segments: list[Structure] = []
    for number, field in sorted(fields.items()):
        entry = re.search(r"TerminologyEntry:([^|]*)", field.get("Tags", ""))
        entries = entry[1].split("~") if entry else []
        parts = [*(part.split("^")[-1].strip() for part in entries), *[""] * 7]
        kind = _kind_of_terms([*parts[2:4], *parts[5:7]])
        name = field.get("Name", f"Segment{number}")
        try:
            value = int(field["LabelValue"])
            layer = int(field.get("Layer", 0))
            if layer not in range(volumes):
                raise ValueError(f"layer {layer} of {volumes}")
        except (KeyError, ValueError) as error:
            raise VolumeError(
                f"Segment{number} has {error}: expected a label value and a layer of "
                "the file, as 3D Slicer writes them since 4.11"
            ) from error
        segments.append(Structure.named(name, value, layer, kind))
    return segments


def _named_by_terms(segments: Sequence[Structure]) -> list[Structure]:
    """Return segments, those with automatic names called as their terms say.

    One with a name of its own keeps it, and its terms say what it is.
    """
    names = [
        one.kind if one.kind and AUTOMATIC.fullmatch(one.name) else one.name
        for one in segments
    ]
    return _called(segments, names)


def _called(items: Sequence[Structure], names: Sequence[str]) -> list[Structure]:
    """Return structures called otherwise, if several alike with the old name behind."""
    counts = Counter(names)
    unique = [
        f"{name} ({item.name})" if counts[name] > 1 and name != item.name else name
        for name, item in zip(names, items, strict=True)
    ]
    return [
        item if name == item.name else Structure.named(name, item.value, item.volume)
        for name, item in zip(unique, items, strict=True)
    ]


def _rename(labels: Labels, names: Mapping[Any, str] | Path | str) -> Labels:
    """Return labels whose structures are called as a user says.

    Several structures may get one name: each then has its old one behind it.

    Raises:
        VolumeError: The names cannot be read, or belong to no structure of the file.
    """
    try:
        is_file = isinstance(names, Path | str)
        stated = json.loads(Path(names).read_bytes()) if is_file else names
        by_key = {str(key): name for key, name in stated.items()}
        msgspec.convert(by_key, dict[str, str])
    except (OSError, ValueError, AttributeError, msgspec.ValidationError) as error:
        raise VolumeError(f"cannot read names from {names}: {error}") from error
    items = labels.structures
    has_values = len(labels.volumes) == 1  # a value says which structure is meant
    unknown = by_key.keys() - {item.name for item in items}
    if any(not (has_values and key.isdecimal()) for key in unknown):
        raise VolumeError(
            f"no structure is called {', '.join(sorted(unknown))}: there are "
            f"{', '.join(item.name for item in items)}"
        )
    new_names = [
        by_key.get(item.name, by_key.get(str(item.value), item.name)) for item in items
    ]
    return Labels.of(labels.volumes, labels.grid, _called(items, new_names))
