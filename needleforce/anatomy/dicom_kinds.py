"""What kind of object a DICOM file is, by its first bytes."""

import struct
from pathlib import Path

from needleforce.anatomy.errors import EXPORT_LABELS, VolumeError

START_BYTES = 1024
"""The group of the file's own description lies within."""


_STORAGE = "1.2.840.10008.5.1"
_IMAGES = f"{_STORAGE}.4.1.1"
"""Beginning of the numbers of classes."""

SEGMENTATION = frozenset((f"{_IMAGES}.66.4", f"{_IMAGES}.66.7"))
"""Classes of segmentations: of binary or fractional segments, and of labels."""

CONTOURS = f"{_IMAGES}.481.3"
"""Class of the structure sets of radiotherapy (RTSTRUCT)."""


def find_label_objects(place: Path) -> tuple[list[Path], list[Path]]:
    """Return the DICOM files with structures: a file itself, or those in a folder.

    Returns:
        Those of DICOM SEG, and those of RTSTRUCT.
    """
    segmentations: list[Path] = []
    contours: list[Path] = []
    for path in sorted(place.iterdir()) if place.is_dir() else [place]:
        sop_class = _read_class(path)
        if sop_class in SEGMENTATION:
            segmentations.append(path)
        elif sop_class == CONTOURS:
            contours.append(path)
    return segmentations, contours


def refuse_contours(path: Path) -> None:
    """Refuse a structure set of radiotherapy, and say how it is converted.

    Raises:
        VolumeError: Always.
    """
    raise VolumeError(
        f"{path} is a structure set of radiotherapy (RTSTRUCT): contours, which are "
        "not read here. In 3D Slicer with the extension SlicerRT: load CT and "
        "structure set in the DICOM module; in Segmentations, under Representations, "
        "create Binary labelmap and make it the source; save the segmentation as "
        ".seg.nrrd (File, Save Data), and give that file",
        EXPORT_LABELS,
    )


def _read_class(path: Path) -> str:
    """Return the class of the object in a DICOM file; empty of other files."""
    # Tag and type of the class of the object, always little-endian and explicit.
    sop_class_tag = b"\x02\x00\x02\x00UI"
    preamble_bytes = 128  # of a DICOM file, before ``DICM``
    try:
        with path.open("rb") as file:
            start = file.read(START_BYTES)
    except OSError:
        return ""  # what is wrong with the file is said where it is read
    place = start.find(sop_class_tag)
    if start[preamble_bytes : preamble_bytes + 4] != b"DICM" or place < 0:
        return ""
    place += len(sop_class_tag)
    size = struct.unpack_from("<H", start, place)[0]
    text = start[place + 2 : place + 2 + size]
    return text.rstrip(b"\0 ").decode("ascii", "replace")
