"""Segmentations in DICOM: the objects called SEG.

`highdicom` decodes them: frames of one segment each, in any order and without the empty
ones, or labels.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.extras import install_command
from needleforce.anatomy.errors import (
    COPY_AGAIN,
    EXPORT_LABELS,
    EXPORT_VOLUME,
    VolumeError,
)
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.mask_folder import MAX_NAMES, first_free
from needleforce.anatomy.segment_names import NamedSegment, Term, name_structures
from needleforce.anatomy.volume import Grid

M_PER_MM = 1e-3


STEP_TOLERANCE = 0.1
"""Fraction of the step between slices by which they may miss their places: scanners
round positions."""

BACKGROUND = 0
"""Label of no segment, which files of labels describe as well."""


class _Segment(NamedTuple):
    """A segment as the file describes it.

    Attributes:
        name: Its label.
        number: Of the segment, and the value of its voxels.
        term: Its coded terms.
    """

    name: str
    number: int
    term: Term


class _Stack(NamedTuple):
    """How the frames lie.

    Attributes:
        geometry: Of highdicom.
        options: With which it finds that geometry.
    """

    geometry: Any
    options: dict[str, Any]


class _Joined(NamedTuple):
    """Segments as labels.

    Attributes:
        volumes: Labels, (slice, row, column) each.
        places: In which volume each segment lies.
    """

    volumes: list[NDArray[Any]]
    places: list[int]


def read_dicom_segmentation(path: Path, max_bytes: int) -> Labels:
    """Read the segments of a DICOM segmentation.

    Args:
        path: The file.
        max_bytes: The most memory that its voxels may take.

    Raises:
        VolumeError: `highdicom` is missing; the file is damaged, too large, fractional,
            or its frames do not lie evenly.
    """
    file = _open(path)
    if file.segmentation_type.value == "FRACTIONAL":
        raise VolumeError(
            f"{path} holds fractional segments, whose borders are not stated: export "
            "it as a binary segmentation",
            EXPORT_LABELS,
        )
    stack = _find_stack(file)
    if stack is None:  # rounded positions with gaps: the step has to be found first
        with suppress(AttributeError, IndexError):  # frames that say no place
            file = _with_step(file)
        stack = _find_stack(file)
    if stack is None:
        raise VolumeError(
            f"{path}: its frames do not lie evenly, one behind the other, and make no "
            "volume",
            EXPORT_VOLUME,
        )
    segments = _read_segments(file)
    _require_size(path, stack.geometry.spatial_shape, len(segments), max_bytes)
    try:
        joined = _join(file, segments, stack)
    except (RuntimeError, ValueError, EOFError, OSError) as error:
        raise VolumeError(f"{path} is damaged: {error}", COPY_AGAIN) from error
    affine = M_PER_MM * stack.geometry.affine
    grid = Grid(tuple(stack.geometry.spatial_shape), affine[:3, 3], affine[:3, :3])
    structures = name_structures(
        [
            NamedSegment(segment.name, segment.number, place, segment.term)
            for segment, place in zip(segments, joined.places, strict=True)
        ]
    )
    return Labels.of(joined.volumes, grid, structures)


def _open(path: Path) -> Any:
    """Return the segmentation that highdicom reads.

    Raises:
        VolumeError: It is missing, or cannot read the file.
    """
    try:
        import highdicom
    except ImportError as error:
        raise VolumeError(
            f"{path} is a DICOM segmentation, which needs highdicom: "
            f"{install_command('patient')}; or save the segmentation as .seg.nrrd"
        ) from error
    try:
        return highdicom.seg.segread(str(path))
    except Exception as error:  # of damaged files: whatever is met first
        raise VolumeError(f"cannot read {path}: {error}", COPY_AGAIN) from error


def _find_stack(file: Any) -> _Stack | None:
    """Return how the frames lie; None where they make no volume.

    Where no slice is missing the step is the mean one, so that rounding does not add
    up.
    """
    for may_miss in (False, True):
        options = {"rtol": STEP_TOLERANCE, "allow_missing_positions": may_miss}
        geometry = file.get_volume_geometry(**options)
        if geometry is not None:
            return _Stack(geometry, options)
    return None


def _with_step(file: Any) -> Any:
    """Return a segmentation that states the step between its slices.

    Frames without voxels are left out, and scanners round positions: single steps give
    the step well enough to count those in wider gaps.
    """
    import highdicom

    shared = file.SharedFunctionalGroupsSequence[0]
    directions = np.array(shared.PlaneOrientationSequence[0].ImageOrientationPatient)
    normal = np.cross(directions[:3].astype(float), directions[3:].astype(float))
    heights_mm = np.unique(
        [
            normal
            @ np.array(frame.PlanePositionSequence[0].ImagePositionPatient, float)
            for frame in file.PerFrameFunctionalGroupsSequence
        ]
    )
    gaps_mm = np.sort(np.diff(heights_mm))
    step_mm = float(gaps_mm[0])
    steps = 0
    for count, gap_mm in enumerate(gaps_mm, 1):
        steps += max(round(float(gap_mm) / step_mm), 1)
        step_mm = float(gaps_mm[:count].sum()) / steps
    shared.PixelMeasuresSequence[0].SpacingBetweenSlices = step_mm
    return highdicom.seg.Segmentation.from_dataset(file)


def _require_size(
    path: Path, shape: Sequence[int], segments: int, max_bytes: int
) -> None:
    """Refuse a segmentation whose voxels take more memory than they may."""
    bytes_per_gb = 1e9
    size_bytes = math.prod(shape) * _label_type(segments).itemsize
    if size_bytes > max_bytes:
        raise VolumeError(
            f"{path} has {tuple(shape)} voxels, {size_bytes / bytes_per_gb:.3g} GB: "
            f"more than the limit of {max_bytes / bytes_per_gb:.3g} GB",
            "Crop or resample it, or store it in a smaller type.",
        )


def _label_type(segments: int) -> np.dtype[Any]:
    """Return the type of labels of so many segments."""
    return np.dtype(np.uint8 if segments <= MAX_NAMES else np.uint16)


def _join(file: Any, segments: Sequence[_Segment], stack: _Stack) -> _Joined:
    """Return the labels of all segments; those that overlap lie in further volumes."""
    numbers = [segment.number for segment in segments]
    kind = _label_type(max(numbers))
    try:
        whole = file.get_volume(combine_segments=True, **stack.options).array
        return _Joined([whole.astype(kind)], [0] * len(segments))
    except RuntimeError:  # segments overlap
        joined = _Joined([], [])
    for number in numbers:
        labels = file.get_volume(
            segment_numbers=[number], combine_segments=True, **stack.options
        ).array
        mask = labels != BACKGROUND
        place = first_free(joined.volumes, mask)
        if place == len(joined.volumes):
            joined.volumes.append(np.zeros(mask.shape, kind))
        joined.volumes[place][mask] = number
        joined.places.append(place)
    return joined


def _read_segments(file: Any) -> list[_Segment]:
    """Return the segments as the file describes them."""
    segments: list[_Segment] = []
    for number in file.segment_numbers:
        if number == BACKGROUND:
            continue
        description = file.get_segment_description(number)
        segments.append(
            _Segment(str(description.segment_label), int(number), _term_of(description))
        )
    return segments


def _term_of(description: Any) -> Term:
    """Return the coded terms of a segment."""
    what = description.get("SegmentedPropertyTypeCodeSequence")
    region = description.get("AnatomicRegionSequence")
    return Term(
        _meaning(what),
        _modifier(what, "SegmentedPropertyTypeModifierCodeSequence"),
        _meaning(region),
        _modifier(region, "AnatomicRegionModifierSequence"),
    )


def _meaning(codes: Any) -> str:
    """Return the meaning of the first code of a sequence; empty if there is none."""
    return str(codes[0].get("CodeMeaning", "")) if codes else ""


def _modifier(codes: Any, name: str) -> str:
    """Return the meaning of a modifier inside the first code of a sequence."""
    return _meaning(codes[0].get(name)) if codes else ""
