"""What is refused of NIfTI and NRRD files.

SimpleITK fills what is missing of a file with zeros, takes spacing and directions from
two places, and where a file does not say how it lies it invents that.
"""

import gzip
import io
import os
import re
import zlib
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from needleforce.anatomy.errors import (
    COPY_AGAIN,
    EXPORT_VOLUME,
    VolumeError,
)

START_BYTES = 136
"""Of a NIfTI file; its spacing lies within."""


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
    """Where a NIfTI header holds ``pixdim``: handedness, then the spacing.

    Attributes:
        kind: Type of its numbers, without byte order.
        offset: Of the first one, in bytes.
    """

    kind: str
    offset: int


def require_whole_nifti(
    path: Path, header: Mapping[str, str], spacing_mm: Array, shape: Sequence[int]
) -> None:
    """Refuse a NIfTI file that is cut short, or contradicts itself.

    Args:
        path: The file.
        header: Its fields.
        spacing_mm: Distance of voxels along each axis, as it was read, (3,).
        shape: Voxels along each axis.

    Raises:
        VolumeError: The file ends early, is damaged, does not say how it lies, or
            states two spacings or places.
    """
    spacing_tolerance = 0.01  # relative difference of two spacings that mean the same
    start = _read_start(path, header)
    has_matrix = header["sform_code"] != "0"
    if not has_matrix and header["qform_code"] == "0":
        raise VolumeError(
            f"{path} does not say how it lies (neither qform nor sform): left and "
            "right are unknown",
            EXPORT_VOLUME,
        )
    metre = 1  # of the lowest three bits; 2 is the millimetre, 0 is not stated
    if int(header.get("xyzt_units", "0")) & 7 == metre:
        raise VolumeError(
            f"{path}: its unit is the metre (xyzt_units), expected millimetres: export "
            "it in millimetres",
            EXPORT_VOLUME,
        )
    pixdim = _read_pixdim(start)
    stated_mm = pixdim[1:]
    matrix_mm = _matrix_spacing_mm(header) if has_matrix else spacing_mm
    if not np.allclose(
        [stated_mm, matrix_mm], spacing_mm, rtol=spacing_tolerance, atol=0.0
    ):
        raise VolumeError(
            f"{path}: its header states a spacing of {stated_mm.tolist()} mm (pixdim), "
            f"and its matrix (sform) one of {np.round(matrix_mm, 4).tolist()}: "
            "expected the same",
            EXPORT_VOLUME,
        )
    if has_matrix:
        handedness = -1.0 if pixdim[0] < 0.0 else 1.0
        qform_axes_mm = spacing_mm * np.array([1.0, 1.0, handedness])
        _require_one_place(path, header, qform_axes_mm, shape)


def _require_one_place(
    path: Path, header: Mapping[str, str], qform_axes_mm: Array, shape: Sequence[int]
) -> None:
    """Refuse a matrix (sform) that is sheared, or lies elsewhere than the qform.

    Programs take one or the other.

    Args:
        path: The file.
        header: Its fields.
        qform_axes_mm: Spacing, negative where the qform turns an axis round, (3,).
        shape: Voxels along each axis.
    """
    max_shear = 0.01  # cosine of two axes up to which they count as orthogonal
    # By so much of the smallest spacing two statements of the place may differ.
    max_disagreement_voxels = 0.5
    sform_mm = _sform_mm(header)
    if header["qform_code"] != "0":
        qform_mm = _qform_mm(header, qform_axes_mm)
        last = np.array(shape) - 1.0
        corners = np.array(
            [(*corner, 1.0) for corner in product(*zip(0.0 * last, last, strict=True))]
        )
        corner_distances_mm = np.linalg.norm(corners @ (sform_mm - qform_mm).T, axis=1)
        worst = corners[corner_distances_mm.argmax()]
        distance_mm = float(corner_distances_mm.max())
        if distance_mm <= max_disagreement_voxels * np.abs(qform_axes_mm).min():
            return
        reason = (
            f"its qform and sform disagree by {distance_mm:.3g} mm: voxel "
            f"{worst[:3].astype(int).tolist()} lies at "
            f"{np.round(qform_mm @ worst, 1).tolist()} mm (RAS) by the qform, at "
            f"{np.round(sform_mm @ worst, 1).tolist()} by the sform"
        )
    else:
        axes = sform_mm[:, :3] / np.linalg.norm(sform_mm[:, :3], axis=0)
        largest_cosine = float(np.abs(axes.T @ axes - np.eye(3)).max())
        if largest_cosine <= max_shear:
            return
        reason = (
            "its sform is sheared: the cosine of two of its axes is "
            f"{largest_cosine:.3f}"
        )
    raise VolumeError(f"{path}: {reason}", EXPORT_VOLUME)


def _sform_mm(header: Mapping[str, str]) -> Array:
    """Return the matrix of a NIfTI header (sform), in RAS, shape (3, 4)."""
    return np.array(
        [[float(number) for number in header[f"srow_{axis}"].split()] for axis in "xyz"]
    )


def _qform_mm(header: Mapping[str, str], qform_axes_mm: Array) -> Array:
    """Return the matrix that a NIfTI header's quaternion means, in RAS, shape (3, 4).

    Args:
        header: Fields of the file.
        qform_axes_mm: See `_require_one_place`.
    """
    vector = np.array([float(header[f"quatern_{part}"]) for part in "bcd"])
    scalar = np.sqrt(max(1.0 - vector @ vector, 0.0))
    rotation = Rotation.from_quat([*vector, scalar]).as_matrix()
    origin_mm = [float(header[f"qoffset_{axis}"]) for axis in "xyz"]
    return np.column_stack([rotation * qform_axes_mm, origin_mm])


def _read_start(path: Path, header: Mapping[str, str]) -> bytes:
    """Return the first bytes of a NIfTI file, once it is known to be whole."""
    # Types of numbers by the ``datatype`` of a NIfTI header, of those that can be NaN.
    float_kinds = {"16": "f4", "64": "f8"}
    gzip_magic = b"\x1f\x8b"
    axes = int(header["dim[0]"])
    sizes = [int(header[f"dim[{axis}]"]) for axis in range(1, axes + 1)]
    data_bytes = np.prod(sizes) * int(header["bitpix"]) / 8
    expected_bytes = float(header["vox_offset"]) + data_bytes
    try:
        with path.open("rb") as raw:
            is_packed = raw.peek(2)[:2] == gzip_magic
            file = gzip.GzipFile(fileobj=raw) if is_packed else raw
            start = file.read(START_BYTES)
            kind = float_kinds.get(header["datatype"])
            if kind is not None:
                file.seek(int(float(header["vox_offset"])))
                order = "<" if start[0] else ">"
                _require_finite(path, file, np.dtype(order + kind))
            file_bytes = file.seek(0, os.SEEK_END)
        if file_bytes < expected_bytes:
            raise EOFError(f"{file_bytes} bytes of {expected_bytes:.0f}")
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise VolumeError(
            f"{path} ends early or is damaged: {error}", COPY_AGAIN
        ) from error
    return start


def _require_finite(path: Path, file: io.BufferedIOBase, kind: np.dtype[Any]) -> None:
    """Refuse voxels that are NaN or infinite: SimpleITK reads them as 0.

    Args:
        path: For the message.
        file: Read from its first voxel on.
        kind: Of the voxels.
    """
    chunk_bytes = 1 << 22
    bad = 0
    while chunk := file.read(chunk_bytes):
        voxels = np.frombuffer(chunk, kind, len(chunk) // kind.itemsize)
        bad += int(np.count_nonzero(~np.isfinite(voxels)))
    if bad:
        raise VolumeError(
            f"{path} has {bad} voxels that are no finite numbers (NaN or infinite): "
            "export it again, a CT with -1000 (air) where nothing was measured"
        )


def _read_pixdim(start: bytes) -> Array:
    """Return ``pixdim`` from the first bytes of a NIfTI file: handedness, spacing."""
    # By the first number in a NIfTI file, the size of its header: versions 1 and 2.
    spacing_fields = {348: _SpacingField("f4", 76), 540: _SpacingField("f8", 104)}
    order = "<" if start[0] else ">"
    header_bytes = int(np.frombuffer(start, f"{order}i4", 1)[0])
    field = spacing_fields[header_bytes]
    return np.frombuffer(start, order + field.kind, 4, field.offset)


def _matrix_spacing_mm(header: Mapping[str, str]) -> Array:
    """Return the spacing that the matrix of a NIfTI header states (sform)."""
    return np.linalg.norm(_sform_mm(header)[:, :3], axis=0)


def require_placed_nrrd(path: Path) -> None:
    """Refuse an NRRD file that does not say in millimetres of the patient how it lies.

    Raises:
        VolumeError: Space, directions or units are missing, or not the patient's.
    """
    max_nrrd_header_bytes = 1 << 22  # the header of an NRRD file is shorter
    with path.open("rb") as file:
        start = file.read(max_nrrd_header_bytes).decode("latin-1")
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
    raise VolumeError(f"{path}: {reason}", EXPORT_VOLUME)
