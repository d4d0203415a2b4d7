"""What is refused of NIfTI and NRRD files.

SimpleITK fills what is missing of a file with zeros, takes spacing and directions from
two places, and where a file does not say how it lies it invents that.
"""

import gzip
import os
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import AnatomyCode, VolumeError

START_BYTES = 128
"""Of a NIfTI file; its spacing lies within."""

SPACING_TOLERANCE = 0.01
"""Relative difference of two spacings that mean the same."""

MAX_NRRD_HEADER_BYTES = 1 << 22
"""The header of an NRRD file is shorter."""

GZIP_MAGIC = b"\x1f\x8b"

NRRD_SPACES = frozenset(
    (
        "left-posterior-superior",
        "right-anterior-superior",
        "left-anterior-superior",
        "lps",
        "ras",
        "las",
    )
)
"""Spaces of the patient that SimpleITK understands."""

MILLIMETRES = frozenset(("mm", "millimeter", "millimetre"))


class _SpacingField(NamedTuple):
    """Where a NIfTI header holds the spacing.

    Attributes:
        kind: Type of its numbers, without byte order.
        offset: Of the first one, in bytes.
    """

    kind: str
    offset: int


SPACING_FIELDS = {348: _SpacingField("f4", 80), 540: _SpacingField("f8", 104)}
"""By the first number in a NIfTI file, the size of its header: versions 1 and 2."""


def require_whole_nifti(
    path: Path, header: Mapping[str, str], spacing_mm: Array
) -> None:
    """Refuse a NIfTI file that is cut short, or contradicts itself.

    Raises:
        VolumeError: The file ends early, is damaged, does not say how it lies, or
            states two spacings.
    """
    start = _read_start(path, header)
    has_matrix = header["sform_code"] != "0"
    if not has_matrix and header["qform_code"] == "0":
        raise VolumeError(
            f"{path} does not say how it lies (neither qform nor sform): left and "
            "right are unknown",
            AnatomyCode.GEOMETRY,
        )
    stated_mm = _stated_spacing_mm(start)
    matrix_mm = _matrix_spacing_mm(header) if has_matrix else spacing_mm
    if not np.allclose(
        [stated_mm, matrix_mm], spacing_mm, rtol=SPACING_TOLERANCE, atol=0.0
    ):
        raise VolumeError(
            f"{path}: its header states a spacing of {stated_mm.tolist()} mm (pixdim), "
            f"and its matrix (sform) one of {np.round(matrix_mm, 4).tolist()}: "
            "expected the same",
            AnatomyCode.GEOMETRY,
        )


def _read_start(path: Path, header: Mapping[str, str]) -> bytes:
    """Return the first bytes of a NIfTI file, once it is known to be whole."""
    axes = int(header["dim[0]"])
    sizes = [int(header[f"dim[{axis}]"]) for axis in range(1, axes + 1)]
    data_bytes = np.prod(sizes) * int(header["bitpix"]) / 8
    expected_bytes = float(header["vox_offset"]) + data_bytes
    try:
        with path.open("rb") as raw:
            is_packed = raw.peek(2)[:2] == GZIP_MAGIC
            file = gzip.GzipFile(fileobj=raw) if is_packed else raw
            start = file.read(START_BYTES)
            file_bytes = file.seek(0, os.SEEK_END)
        if file_bytes < expected_bytes:
            raise EOFError(f"{file_bytes} bytes of {expected_bytes:.0f}")
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise VolumeError(
            f"{path} ends early or is damaged: {error}", AnatomyCode.DAMAGED
        ) from error
    return start


def _stated_spacing_mm(start: bytes) -> Array:
    """Return the spacing that the first bytes of a NIfTI file state (pixdim)."""
    order = "<" if start[0] else ">"
    header_bytes = int(np.frombuffer(start, f"{order}i4", 1)[0])
    field = SPACING_FIELDS[header_bytes]
    return np.frombuffer(start, order + field.kind, 3, field.offset)


def _matrix_spacing_mm(header: Mapping[str, str]) -> Array:
    """Return the spacing that the matrix of a NIfTI header states (sform)."""
    rows = [
        [float(number) for number in header[f"srow_{axis}"].split()[:3]]
        for axis in "xyz"
    ]
    return np.linalg.norm(rows, axis=0)


def require_placed_nrrd(path: Path) -> None:
    """Refuse an NRRD file that does not say in millimetres of the patient how it lies.

    Raises:
        VolumeError: Space, directions or units are missing, or not the patient's.
    """
    with path.open("rb") as file:
        start = file.read(MAX_NRRD_HEADER_BYTES).decode("latin-1")
    header = re.split(r"\r?\n\r?\n", start, maxsplit=1)[0]
    fields = {
        key.lower(): text
        for key, text in re.findall(r"(?m)^([^:\n]+): (.*?)\r?$", header)
    }
    space = fields.get("space", "none")
    units = fields.get("space units", "")
    if space.lower() not in NRRD_SPACES:
        reason = (
            f"its space is {space!r}: expected left-posterior-superior, or RAS or LAS"
        )
    elif "space directions" not in fields:
        reason = "it has no `space directions`: spacing and orientation are unknown"
    elif set(units.replace('"', " ").split()) - MILLIMETRES:
        reason = f"its space units are {units}: expected mm"
    else:
        return
    raise VolumeError(f"{path}: {reason}", AnatomyCode.GEOMETRY)
