"""Segmentations from files: 3D Slicer's, NIfTI, NRRD, MetaImage, DICOM SEG."""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.label_checks import require_body_order
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.scan_files import (
    M_PER_MM,
    read_image,
    read_nifti_names,
)
from needleforce.anatomy.structures import Structure, is_known
from needleforce.anatomy.volume import Grid, Volume

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
