"""What a segment is, by its name and by the terms that programs write beside it.

3D Slicer and DICOM describe a segment by coded terms: what it is (``Rib``), and where
(``Left``). Names that were given automatically, as ``Segment_1``, say nothing.
"""

import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from needleforce.anatomy.structures import Structure, is_known

AUTOMATIC = re.compile(r"(segment|label)?[ _]?\d+([ _]\d+)*|segment", re.IGNORECASE)
"""Names that say nothing."""


class Term(NamedTuple):
    """Coded terms of a segment, each empty where it is not stated.

    Attributes:
        what: What it is, such as ``Kidney`` or ``Mass``.
        side: Modifier of that, such as ``Left``.
        region: Where it is, such as ``Liver``.
        region_side: Modifier of the region.
    """

    what: str = ""
    side: str = ""
    region: str = ""
    region_side: str = ""

    def anatomy(self) -> str:
        """Return what a segment is, in small letters; empty if nothing known is said.

        The region counts where the segment itself is only called *tissue* or *organ*.
        """
        for name, side in ((self.what, self.side), (self.region, self.region_side)):
            if is_known(name):
                return f"{side} {name}".strip().lower()
        return ""


def read_tags(tags: str) -> Term:
    """Return the terms in the tags of a segment of 3D Slicer.

    Tags are ``KEY:VALUE`` with ``|`` between them; the entry has seven parts with ``~``
    between them, each of them a context, or scheme, code and meaning with ``^`` between
    them.
    """
    region_side_at = 6
    region_at = 5
    type_side_at = 3
    type_at = 2  # place of the term that says what a segment is, in Slicer's entry
    terminology = "TerminologyEntry"  # tag of 3D Slicer with the terms of a segment
    for tag in tags.split("|"):
        key, _, entry = tag.partition(":")
        if key.strip() == terminology:
            parts = [part.split("^")[-1].strip() for part in entry.split("~")]
            parts += [""] * (region_side_at + 1 - len(parts))
            return Term(
                parts[type_at],
                parts[type_side_at],
                parts[region_at],
                parts[region_side_at],
            )
    return Term()


class NamedSegment(NamedTuple):
    """A segment of a file, before its structure is named.

    Attributes:
        name: As the file has it.
        value: Of its voxels.
        volume: Index of the volume in which it lies.
        term: Its coded terms.
    """

    name: str
    value: int
    volume: int
    term: Term


def name_structures(segments: Sequence[NamedSegment]) -> list[Structure]:
    """Return the structures of segments.

    A segment whose name was given automatically is called as its terms say; one with a
    name of its own keeps it, and its terms say what it is.
    """
    anatomies = [segment.term.anatomy() for segment in segments]
    names = [
        anatomy if anatomy and AUTOMATIC.fullmatch(segment.name) else segment.name
        for anatomy, segment in zip(anatomies, segments, strict=True)
    ]
    unique = tell_apart(names, [segment.name for segment in segments])
    return [
        Structure.named(name, segment.value, segment.volume, anatomy)
        for name, anatomy, segment in zip(unique, anatomies, segments, strict=True)
    ]


def tell_apart(names: Sequence[str], old_names: Sequence[str]) -> list[str]:
    """Return names with the old one behind those that were given several times."""
    counts = Counter(names)
    return [
        f"{name} ({old})" if counts[name] > 1 and name != old else name
        for name, old in zip(names, old_names, strict=True)
    ]
