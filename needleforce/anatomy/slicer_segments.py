"""Segments that 3D Slicer describes in the header of a ``.seg.nrrd`` file.

Since 4.11 segments that do not overlap share a layer: ``Segment0_Layer`` says which,
``Segment0_LabelValue`` with which value. Up to 4.10 each component of the file is a
segment, and neither is stated. `Segmentation_ReferenceImageExtentOffset` says where the
file's voxels lie in the source image; the file's origin contains it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from needleforce.anatomy.errors import EXPORT_LABELS, VolumeError
from needleforce.anatomy.segment_names import (
    NamedSegment,
    Term,
    name_structures,
    read_tags,
)
from needleforce.anatomy.structures import Structure


class _Segment(NamedTuple):
    """A segment as the header describes it.

    Attributes:
        name: Of the structure.
        volume: Index of the component in which it lies.
        value: Of its voxels.
        colour: Red, green, blue from 0 to 1; empty where none is stated.
        term: Its coded terms.
    """

    name: str
    volume: int
    value: int
    colour: tuple[float, ...]
    term: Term


def read_segments(header: Mapping[str, str], volumes: int) -> list[Structure]:
    """Return the segments that a header describes; none in files of other kinds.

    Args:
        header: Of the file.
        volumes: How many components the file has.

    Raises:
        VolumeError: A segment's fields are damaged, or contradict those of another.
    """
    count = len({key.split("_")[0] for key in header if re.match(r"Segment\d+_", key)})
    segments = [
        _read_segment(header, number, count, volumes) for number in range(count)
    ]
    places: set[tuple[int, int]] = set()
    for segment in segments:
        if not 0 <= segment.volume < volumes:
            raise VolumeError(
                f"segment {segment.name} lies in layer {segment.volume}; the file has "
                f"{volumes}",
                EXPORT_LABELS,
            )
        place = (segment.volume, segment.value)
        if place in places:
            raise VolumeError(
                f"segment {segment.name} has the label {segment.value} of another",
                EXPORT_LABELS,
            )
        places.add(place)
    structures = name_structures(
        [NamedSegment(one.name, one.value, one.volume, one.term) for one in segments]
    )
    return _with_colours(structures, segments)


def _with_colours(
    structures: Sequence[Structure], segments: Sequence[_Segment]
) -> list[Structure]:
    """Return structures with the colours that the file states."""
    return [
        replace(structure, colour=segment.colour or structure.colour)
        for structure, segment in zip(structures, segments, strict=True)
    ]


def _read_segment(
    header: Mapping[str, str], number: int, count: int, volumes: int
) -> _Segment:
    """Return one segment of a header."""
    prefix = f"Segment{number}_"
    fields = {key.removeprefix(prefix): text for key, text in header.items()}
    if "ID" not in fields:
        raise VolumeError(
            f"{prefix}ID is not in its header: expected {count} segments from 0 on",
            EXPORT_LABELS,
        )
    name = fields.get("Name", fields["ID"])
    # Slicer up to 4.10 states neither layer nor label: each component is a segment.
    is_component = volumes == count
    try:
        return _Segment(
            name=name,
            volume=int(fields.get("Layer", number if is_component else 0)),
            value=int(fields.get("LabelValue", 1 if is_component else number + 1)),
            colour=_read_colour(fields.get("Color", "")),
            term=read_tags(fields.get("Tags", "")),
        )
    except ValueError as error:
        raise VolumeError(
            f"segment {name}: {error}; expected numbers in its header",
            EXPORT_LABELS,
        ) from error


def _read_colour(text: str) -> tuple[float, ...]:
    """Return the numbers of a colour, none of an empty text."""
    colour = tuple(float(number) for number in text.split())
    is_in_range = all(0.0 <= number <= 1.0 for number in colour)
    if len(colour) not in (0, 3) or not is_in_range:
        raise ValueError(f"colour {colour}: expected three from 0 to 1")
    return colour
