"""Segmentations from files: 3D Slicer's, NIfTI, NRRD, DICOM SEG, a folder of masks."""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.body_order import require_body_order
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.scan_files import (
    M_PER_MM,
    MAX_VOLUME_BYTES,
    are_whole,
    read_image,
    read_volume,
    require_size,
)
from needleforce.anatomy.structures import Structure, is_known
from needleforce.anatomy.volume import Grid, Volume

Names = Mapping[Any, str] | Path | str | None
"""Names of labels, by their values or by the names in the file; or a JSON file with
them."""

AUTOMATIC = re.compile(r"(segment|label)?[ _]?\d+([ _]\d+)*|segment", re.IGNORECASE)
"""Names that say nothing."""

MASKS = (".nii.gz", ".nii", ".nrrd")
"""Endings of files with masks."""


class _Segment(NamedTuple):
    """A segment as a file describes it.

    Attributes:
        name: As the file has it.
        value: Of its voxels.
        volume: Index of the volume in which it lies.
        kind: What coded terms say that it is; empty if nothing known.
        colour: Red, green, blue from 0 to 1; empty where none is stated.
    """

    name: str
    value: int
    volume: int
    kind: str
    colour: tuple[float, ...] = ()


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
        beside = place.with_name("labels.json")
        is_unnamed = all(AUTOMATIC.fullmatch(item.name) for item in labels.structures)
        if names is None and is_unnamed and beside.exists():
            names = beside
        if names is not None:
            labels = _rename(labels, names)
        require_body_order(labels, situs_inversus=situs_inversus)
        return labels if scan is None else labels.checked_against(scan)
    except VolumeError as error:
        if str(path) in str(error):
            raise
        raise error.reworded(f"{path}: {error}") from None


def _read_structures(place: Path, max_bytes: int) -> Labels:
    """Read a segmentation from a file or a folder, with the names that it has."""
    files = [place]
    if place.is_dir():
        files = sorted(one for one in place.iterdir() if one.name[0] != ".")
    masks = [one for one in files if one.name.endswith(MASKS)] * place.is_dir()
    if masks:
        return _join_masks(masks, max_bytes)
    objects = [one for one in files if _is_segmentation(one)]
    if len(objects) > 1:
        raise VolumeError(f"{len(objects)} DICOM segmentations: expected one file")
    if objects:
        return _read_dicom_segments(objects[0], max_bytes)
    image = read_image(place, max_bytes)
    volumes = [_as_labels(values) for values in image.arrays]
    segments = _slicer_segments(image.fields, len(volumes))
    structures = _name_structures(segments)
    if not segments and len(volumes) == 1:
        structures = [
            Structure.named(image.names.get(value, f"label_{value}"), value)
            for value in range(1, int(volumes[0].max()) + 1)
        ]
    labels = Labels.of(volumes, image.grid, structures)
    loose = sum(map(np.count_nonzero, volumes)) - sum(
        item.voxels for item in labels.structures
    )
    if loose:
        raise VolumeError(f"{loose} voxels have labels of no segment")
    return labels


def _as_labels(values: NDArray[Any]) -> NDArray[Any]:
    """Return the values of a file as labels, in as few bytes as they need."""
    rounding = 1e-3  # programs that compute with labels leave 0.99999994
    whole = values if are_whole(values) else np.rint(values)
    off = np.abs(values - whole).max()
    is_label = whole.min() >= 0 and whole.max() <= np.iinfo(np.uint16).max
    if not is_label or not off <= rounding:  # nan is none, either
        wrong = values.flat[int(np.abs(values - whole).argmax())]
        shown = wrong if off > rounding else (values.min(), values.max())
        raise VolumeError(f"it holds {shown}: expected whole labels from 0 to 65535")
    kind = np.uint8 if whole.max() <= np.iinfo(np.uint8).max else np.uint16
    return whole.astype(kind, order="C")


def _lay(volumes: list[NDArray[Any]], mask: NDArray[np.bool_], value: int) -> int:
    """Write a mask into the first volume where it overlaps none; return its index."""
    for place, volume in enumerate(volumes):
        if not volume[mask].any():
            volume[mask] = value
            return place
    volumes.append(np.where(mask, np.uint16(value), np.uint16(0)))
    return len(volumes) - 1


def _join_masks(masks: Sequence[Path], max_bytes: int) -> Labels:
    """Return the structures of masks; a structure is named as its file."""
    max_shift_voxels = 0.01  # grids that differ by more are not the same
    volumes: list[NDArray[Any]] = []
    structures: list[Structure] = []
    grid = None
    for value, path in enumerate(masks, 1):
        scan = read_volume(path, max_bytes=max_bytes)
        grid = grid or scan.grid
        shift_m = np.inf
        if scan.grid.shape == grid.shape:
            shift_m = np.abs(scan.grid.corners_m() - grid.corners_m()).max()
        mask = scan.values != 0
        is_mask = np.isin(scan.values[mask], scan.values.max()).all()
        if not is_mask or shift_m > max_shift_voxels * grid.spacing_m.min():
            raise VolumeError(
                f"{path} is no mask of two values on the grid of {masks[0].name}, as "
                "every file in a folder of masks"
            )
        volume = _lay(volumes, mask, value)
        structures.append(Structure.named(path.name.split(".")[0], value, volume))
    return Labels.of(volumes, grid or Grid((), np.zeros(3), np.eye(3)), structures)


def _is_segmentation(path: Path) -> bool:
    """Return whether a file is a DICOM segmentation; refuse contours."""
    from pydicom.filereader import read_file_meta_info
    from pydicom.misc import is_dicom

    images = "1.2.840.10008.5.1.4.1.1"
    if not path.is_file() or not is_dicom(path):
        return False
    meta = read_file_meta_info(path)
    sop_class = str(meta.get("MediaStorageSOPClassUID", ""))
    if sop_class == f"{images}.481.3":
        raise VolumeError(
            f"{path} is a structure set of radiotherapy (RTSTRUCT), whose contours are "
            "not read: 3D Slicer with SlicerRT saves it as .seg.nrrd"
        )
    return sop_class in (f"{images}.66.4", f"{images}.66.7")


def _read_dicom_segments(path: Path, max_bytes: int) -> Labels:
    """Read the segments of a DICOM segmentation, which `highdicom` decodes.

    Raises:
        VolumeError: The file is damaged, too large, fractional, or its frames do not
            lie evenly.
    """
    step_tolerance = 0.1  # of the step between slices: scanners round positions
    import highdicom

    try:
        file = highdicom.seg.segread(str(path))
    except Exception as error:  # of damaged files: whatever is met first
        raise VolumeError(f"cannot read {path}: {error}") from error
    if file.segmentation_type.value == "FRACTIONAL":
        raise VolumeError(f"{path} holds fractional segments: expected binary ones")
    options: dict[str, Any] = {"rtol": step_tolerance}
    geometry = file.get_volume_geometry(**options)
    if geometry is None:  # frames without voxels may be left out
        options["allow_missing_positions"] = True
        geometry = file.get_volume_geometry(**options)
    if geometry is None:
        raise VolumeError(f"{path}: its frames do not lie evenly, one behind the other")
    require_size(geometry.spatial_shape, np.uint16().itemsize, max_bytes)
    volumes: list[NDArray[Any]] = []
    segments: list[_Segment] = []
    for number in file.segment_numbers:
        if number == 0:  # the background, which files of labels describe as well
            continue
        described = file.get_segment_description(number)
        try:
            only = file.get_volume(
                segment_numbers=[number], combine_segments=True, **options
            )
        except (RuntimeError, ValueError, EOFError, OSError) as error:
            raise VolumeError(f"{path} is damaged: {error}") from error
        volume = _lay(volumes, only.array != 0, int(number))
        name = str(described.segment_label)
        segments.append(_Segment(name, int(number), volume, _coded_kind(described)))
    affine = M_PER_MM * geometry.affine
    grid = Grid(tuple(geometry.spatial_shape), affine[:3, 3], affine[:3, :3])
    return Labels.of(volumes, grid, _name_structures(segments))


def _coded_kind(described: Any) -> str:
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
    what, side, region, region_side = terms
    for name, modifier in ((what, side), (region, region_side)):
        if is_known(name):
            return f"{modifier} {name}".strip().lower()
    return ""


def _slicer_kind(tags: str) -> str:
    """Return what the tags of a segment of 3D Slicer say that it is.

    Tags are ``KEY:VALUE`` with ``|`` between them; the entry of terms has seven parts
    with ``~`` between them, each of them a context, or scheme, code and meaning with
    ``^`` between them: the third is the type, then its modifier, the sixth the region.
    """
    entries = re.findall(r"TerminologyEntry:([^|]*)", tags)
    parts = [part.split("^")[-1].strip() for part in "".join(entries).split("~")]
    parts += [""] * 7
    return _kind_of_terms([*parts[2:4], *parts[5:7]])


def _slicer_segments(header: Mapping[str, str], volumes: int) -> list[_Segment]:
    """Return the segments that 3D Slicer describes in a header; none in other files.

    Since 4.11 segments that do not overlap share a layer: ``Segment0_Layer`` says
    which, ``Segment0_LabelValue`` with which value. Up to 4.10 each component of the
    file is a segment, and neither is stated.
    """
    count = len({key.split("_")[0] for key in header if re.match(r"Segment\d+_", key)})
    is_component = volumes == count
    segments: list[_Segment] = []
    for number in range(count):
        prefix = f"Segment{number}_"
        fields = {key.removeprefix(prefix): text for key, text in header.items()}
        name = fields.get("Name", fields.get("ID", ""))
        try:
            colour = tuple(float(one) for one in fields.get("Color", "").split())
            segment = _Segment(
                name=name,
                value=int(fields.get("LabelValue", 1 if is_component else number + 1)),
                volume=int(fields.get("Layer", number if is_component else 0)),
                kind=_slicer_kind(fields.get("Tags", "")),
                colour=colour,
            )
        except ValueError as error:
            raise VolumeError(f"segment {name}: {error}; expected numbers") from error
        is_colour = len(colour) in (0, 3) and all(0.0 <= one <= 1.0 for one in colour)
        if "ID" not in fields or not is_colour or not 0 <= segment.volume < volumes:
            raise VolumeError(
                f"{prefix}: ID {fields.get('ID', 'missing')}, layer {segment.volume} "
                f"of {volumes}, colour {colour}: expected an ID, a layer of the file, "
                "three shades from 0 to 1"
            )
        if any(one[1:3] == segment[1:3] for one in segments):
            raise VolumeError(f"segment {name} has the label of another")
        segments.append(segment)
    return segments


def _name_structures(segments: Sequence[_Segment]) -> list[Structure]:
    """Return the structures of segments.

    A segment whose name was given automatically is called as its terms say; one with a
    name of its own keeps it, and its terms say what it is.
    """
    names = [
        one.kind if one.kind and AUTOMATIC.fullmatch(one.name) else one.name
        for one in segments
    ]
    unique = _tell_apart(names, [one.name for one in segments])
    structures = [
        Structure.named(name, one.value, one.volume, one.kind)
        for name, one in zip(unique, segments, strict=True)
    ]
    return [
        replace(structure, colour=one.colour or structure.colour)
        for structure, one in zip(structures, segments, strict=True)
    ]


def _tell_apart(names: Sequence[str], old_names: Sequence[str]) -> list[str]:
    """Return names with the old one behind those that were given several times."""
    counts = Counter(names)
    return [
        f"{name} ({old})" if counts[name] > 1 and name != old else name
        for name, old in zip(names, old_names, strict=True)
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
    old_names = [item.name for item in labels.structures]
    has_values = len(labels.volumes) == 1  # a value says which structure is meant
    unknown = by_key.keys() - {*old_names}
    if any(not (has_values and key.isdecimal()) for key in unknown):
        raise VolumeError(
            f"no structure is called {', '.join(sorted(unknown))}: there are "
            f"{', '.join(old_names)}"
        )
    new_names = [
        by_key.get(item.name, by_key.get(str(item.value), item.name))
        for item in labels.structures
    ]
    renamed = [
        item
        if item.name == name
        else replace(
            Structure.named(name, item.value, item.volume),
            voxels=item.voxels,
            box=item.box,
        )
        for item, name in zip(
            labels.structures, _tell_apart(new_names, old_names), strict=True
        )
    ]
    return Labels.of(labels.volumes, labels.grid, renamed)
