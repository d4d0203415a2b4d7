"""What the library that reads volumes takes as it comes: files cut short, places that are guessed.

It fills what is missing of a NIfTI file with zeros, takes its spacing from one part of the header
and its directions from another, and where a file does not say how it lies invents that.
"""

import gzip
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from needleforce.anatomy.errors import Array, VolumeError

CHUNK = 1 << 22  # Bytes of a file that are held at once
NIFTI_STARTS = {348: ("3f", 80), 540: ("3d", 104)}
"""By the first number in a NIfTI file: type and place of its spacing."""
NRRD_SPACES = "left-posterior-superior right-anterior-superior left-anterior-superior lps ras las"


def require_whole_nifti(path: Path, header: Mapping[str, str], spacing_mm: Array) -> None:
    """Refuse a NIfTI file that ends early or is damaged, or whose header contradicts itself."""
    sizes = [int(header[f"dim[{k}]"]) for k in range(1, int(header["dim[0]"]) + 1)]
    needed = float(header["vox_offset"]) + np.prod(sizes) * int(header["bitpix"]) / 8
    try:
        with path.open("rb") as plain:
            file = gzip.GzipFile(fileobj=plain) if plain.read(2) == b"\x1f\x8b" else plain
            plain.seek(0)
            start = file.read(CHUNK)
            found = len(start) + sum(map(len, iter(lambda: file.read(CHUNK), b"")))
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise VolumeError(f"{path} ends early or is damaged ({error}); copy it again") from error
    if found < needed:
        raise VolumeError(
            f"{path} ends early or is damaged: {found} bytes of {needed:.0f}; copy it again"
        )
    _require_places(path, header, start, spacing_mm)


def _require_places(path: Path, header: Mapping[str, str], start: bytes, spacing_mm: Array) -> None:
    """Refuse a NIfTI file that does not say how it lies, or says two things."""
    order = "<" if int.from_bytes(start[:4], "little") in NIFTI_STARTS else ">"
    kind, place = NIFTI_STARTS[struct.unpack(f"{order}i", start[:4])[0]]
    stated = struct.unpack_from(order + kind, start, place)
    has_matrix = header["sform_code"] != "0"
    if not has_matrix and header["qform_code"] == "0":
        raise VolumeError(
            f"{path} does not say how it lies (neither qform nor sform): left and right are "
            "unknown; export it again"
        )
    by = np.array([[float(v) for v in header[f"srow_{axis}"].split()[:3]] for axis in "xyz"])
    lengths = np.linalg.norm(by, axis=0) if has_matrix else spacing_mm
    if not np.allclose([stated, lengths], spacing_mm, rtol=0.01, atol=0.0):
        raise VolumeError(
            f"{path}: its header states a spacing of {list(stated)} mm (pixdim), and its matrix "
            f"(sform) one of {np.round(lengths, 4).tolist()}: expected the same; export it again"
        )


def require_placed_nrrd(path: Path) -> None:
    """Refuse an NRRD file that does not say in millimetres of the patient how it lies."""
    fields = {}
    with path.open("rb") as file:
        for line in iter(lambda: file.readline(CHUNK).decode("latin-1").strip(), ""):
            name, _, value = line.partition(": ")
            fields[name.lower()] = value.strip()
    space, units = fields.get("space", "none"), fields.get("space units", "")
    if space.lower() not in NRRD_SPACES.split():
        why = f"its space is {space!r}: expected left-posterior-superior, or RAS or LAS"
    elif "space directions" not in fields:
        why = "it has no `space directions`: spacing and orientation are unknown"
    elif set(units.replace('"', " ").split()) - {"mm", "millimeter", "millimetre"}:
        why = f"its space units are {units}: expected mm"
    else:
        return
    raise VolumeError(f"{path}: {why}; export it again")
