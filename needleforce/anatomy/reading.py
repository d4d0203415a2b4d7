"""Scans and segmentations from files, and what is refused of them.

SimpleITK reads every format, in LPS millimetres, and takes much as it comes: it fills
what is missing of a file with zeros, and where a file does not say how it lies it
invents that.
"""

import gzip
import json
import locale
import os
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from needleforce.anatomy.errors import Array, VolumeError
from needleforce.anatomy.volume import (
    Grid,
    Labels,
    Structure,
    Volume,
    require_agreement,
)

SIZES_M = (0.005, 5.0)
"""Least and most diagonal of a volume: beyond them its unit is not the millimetre."""
NIFTI_SPACING = {348: ("f4", 80), 540: ("f8", 104)}
"""By the first number in a NIfTI file: type and place of its spacing."""
NRRD_SPACES = (
    "left-posterior-superior right-anterior-superior left-anterior-superior lps ras las"
)


def read_volume(path: Path | str) -> Volume:
    """Read a scan: a folder with one DICOM series, a NIfTI file or an NRRD file.

    Raises:
        VolumeError: Not readable, damaged, not three-dimensional, not in millimetres,
            or without a word on how it lies; of DICOM: no series or several, slices
            that are missing, doubled, of different sizes or sheared.
    """
    arrays, grid, _ = _read(Path(path))
    if len(arrays) != 1:
        raise VolumeError(f"{path} has several numbers per voxel: expected a scan")
    return Volume(arrays[0], grid)


def read_labels(
    path: Path | str,
    names: Mapping[Any, str] | Path | str | None = None,
    scan: Volume | None = None,
) -> Labels:
    """Read a segmentation: 3D Slicer's ``.seg.nrrd``, or NIfTI or NRRD with one label
    per voxel.

    Args:
        path: The file, or a folder with a DICOM series.
        names: Of label values, or a JSON file with them (``{"5": "liver"}``), by
            default ``labels.json`` beside the file; labels without a name are called
            ``label_5``. Segments of a ``.seg.nrrd`` bring names and colours.
        scan: The CT to which the labels belong: places must agree.

    Raises:
        VolumeError: As `read_volume`; values that are no labels, no voxel labelled, or
            labels that lie elsewhere than the scan.
    """
    arrays, grid, header = _read(Path(path))
    beside = Path(path).with_name("labels.json")
    names = beside if names is None and beside.exists() else names
    volumes = []
    for values in arrays:
        whole = (
            values
            if np.issubdtype(values.dtype, np.integer)
            else values.astype(np.int32)
        )
        if (
            whole.min() < 0
            or whole.max() > np.iinfo(np.uint16).max
            or np.any(whole != values)
        ):
            raise VolumeError(
                f"{path} holds {values.min():g} to {values.max():g}: expected labels"
            )
        volumes.append(
            whole.astype(np.uint8 if whole.max() < 256 else np.uint16, copy=False)
        )
    try:
        segments = _segments(header, len(volumes)) or _plain_structures(volumes, names)
        labels = Labels.of(volumes, grid, segments)
        loose = sum(map(np.count_nonzero, volumes)) - sum(
            one.voxels for one in labels.structures
        )
        if loose:
            raise VolumeError(
                f"{loose} voxels have labels of no segment: its header is damaged"
            )
    except VolumeError as error:
        raise VolumeError(f"{path}: {error}") from None
    if scan is not None:
        require_agreement(labels, scan)
    return labels


def _plain_structures(
    volumes: Sequence[NDArray[Any]], names: Mapping[Any, str] | Path | str | None
) -> list[Structure]:
    try:
        read = (
            json.loads(Path(names).read_bytes())
            if isinstance(names, Path | str)
            else names
        )
        given = msgspec.convert(read or {}, dict[int, str], strict=False)
    except (OSError, ValueError, msgspec.ValidationError) as error:
        raise VolumeError(f"cannot read names from {names}: {error}") from error
    if len(volumes) > 1:
        raise VolumeError(
            "several labels per voxel and no segments: expected a .seg.nrrd file"
        )
    values = range(1, int(volumes[0].max()) + 1)
    return [Structure.named(given.get(k, f"label_{k}"), k) for k in values]


def _segments(header: Mapping[str, str], layers: int) -> list[Structure]:
    """Return the segments that 3D Slicer described in the file's header, none in
    other files.
    """
    found: dict[tuple[int, int], Structure] = {}
    count = len({key.split("_")[0] for key in header if re.match(r"Segment\d+_", key)})
    for k in range(count):
        fields = {
            key.removeprefix(f"Segment{k}_"): text for key, text in header.items()
        }
        if "ID" not in fields:
            raise VolumeError(
                f"Segment{k}_ID is not in its header: expected {count} segments from 0 on"
            )
        name = fields.get("Name", fields["ID"])
        try:
            # Slicer up to 4.10 says neither: each component is a segment.
            place, label = (k, 1) if layers == count else (0, k + 1)
            volume = int(fields.get("Layer", place))
            value = int(fields.get("LabelValue", label))
            colour = tuple(float(part) for part in fields.get("Color", "").split())
            if len(colour) not in (0, 3) or not all(
                0.0 <= part <= 1.0 for part in colour
            ):
                raise ValueError(f"colour {colour}: expected three from 0 to 1")
        except ValueError as error:
            raise VolumeError(
                f"segment {name}: {error}; expected numbers in its header"
            ) from error
        if not 0 <= volume < layers:
            raise VolumeError(
                f"segment {name} lies in layer {volume}; the file has {layers}"
            )
        if (volume, value) in found:
            raise VolumeError(
                f"segment {name} has the label {value} of another: give it its own"
            )
        made = Structure.named(name, value, volume)
        found[volume, value] = replace(made, colour=colour or made.colour)
    return list(found.values())


def _read(path: Path) -> tuple[list[NDArray[Any]], Grid, dict[str, str]]:
    """Return one array (i, j, k) per component, their grid, and the file's header."""
    import SimpleITK

    SimpleITK.ProcessObject.GlobalWarningDisplayOff()  # what it warns of is refused here
    language = locale.setlocale(locale.LC_CTYPE)
    try:
        image = _read_series(path) if path.is_dir() else SimpleITK.ReadImage(str(path))
    except RuntimeError as error:
        why = (
            "no such file" if not path.exists() else str(error).strip().splitlines()[-1]
        )
        raise VolumeError(
            f"cannot read {path}: {why}; expected DICOM, .nii, .nii.gz, .nrrd or .seg.nrrd"
        ) from error
    finally:  # the DICOM library sets C, and Python's text files would be ASCII
        locale.setlocale(locale.LC_CTYPE, language)
    if image.GetDimension() != 3 or min(image.GetSize()) < 2:
        raise VolumeError(
            f"{path} has {image.GetSize()} voxels: expected three dimensions"
        )
    axes = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
    grid = Grid(image.GetSize(), 1e-3 * np.array(image.GetOrigin()), 1e-3 * axes)
    diagonal = float(np.linalg.norm(np.ptp(grid.corners_m(), axis=0)))
    if not SIZES_M[0] < diagonal < SIZES_M[1]:
        raise VolumeError(
            f"{path} measures {diagonal:.3g} m: expected a file in millimetres"
        )
    values = SimpleITK.GetArrayFromImage(
        image
    ).T  # it gives (k, j, i), or (k, j, i, component)
    header = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys()}
    if header.get("nifti_type") == "1":
        _require_sound_nifti(path, header, np.array(image.GetSpacing()))
    elif path.suffix in (".nrrd", ".nhdr"):
        _require_placed_nrrd(path)
    elif not path.is_dir():
        raise VolumeError(
            f"{path}: whether a file of this kind says how it lies, and is whole, is not known; "
            "export it as .nii, .nii.gz or .nrrd, or give the folder of a DICOM series"
        )
    return [values] if values.ndim == 3 else list(values), grid, header


def _require_sound_nifti(
    path: Path, header: Mapping[str, str], spacing_mm: Array
) -> None:
    """Refuse a file that is cut short or damaged, or does not say how it lies, or says
    two things.

    SimpleITK fills what is missing with zeros, and takes spacing and directions from
    two places.
    """
    sizes = [int(header[f"dim[{k}]"]) for k in range(1, int(header["dim[0]"]) + 1)]
    needed = float(header["vox_offset"]) + np.prod(sizes) * int(header["bitpix"]) / 8
    try:
        with path.open("rb") as plain:
            file = (
                gzip.GzipFile(fileobj=plain)
                if plain.peek(2)[:2] == b"\x1f\x8b"
                else plain
            )
            start = file.read(128)
            found = file.seek(0, os.SEEK_END)
        if found < needed:
            raise EOFError(f"{found} bytes of {needed:.0f}")
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise VolumeError(
            f"{path} ends early or is damaged: {error}; copy it again"
        ) from error
    has_matrix = header["sform_code"] != "0"
    if not has_matrix and header["qform_code"] == "0":
        raise VolumeError(
            f"{path} does not say how it lies (neither qform nor sform): left and right are "
            "unknown; export it again"
        )
    order = "<" if start[0] else ">"
    kind, place = NIFTI_SPACING[int(np.frombuffer(start, f"{order}i4", 1)[0])]
    stated = np.frombuffer(start, order + kind, 3, place)
    rows = [
        [float(part) for part in header[f"srow_{axis}"].split()[:3]] for axis in "xyz"
    ]
    lengths = np.linalg.norm(rows, axis=0) if has_matrix else spacing_mm
    if not np.allclose([stated, lengths], spacing_mm, rtol=0.01, atol=0.0):
        raise VolumeError(
            f"{path}: its header states a spacing of {stated.tolist()} mm (pixdim), and its matrix "
            f"(sform) one of {np.round(lengths, 4).tolist()}: expected the same; export it again"
        )


def _require_placed_nrrd(path: Path) -> None:
    """Refuse a file that does not say in millimetres of the patient how it lies."""
    with path.open("rb") as file:
        start = re.split(
            r"\r?\n\r?\n", file.read(1 << 22).decode("latin-1"), maxsplit=1
        )[0]
    fields = {
        key.lower(): text
        for key, text in re.findall(r"(?m)^([^:\n]+): (.*?)\r?$", start)
    }
    space = fields.get("space", "none")
    units = fields.get("space units", "")
    if space.lower() not in NRRD_SPACES.split():
        why = f"its space is {space!r}: expected left-posterior-superior, or RAS or LAS"
    elif "space directions" not in fields:
        why = "it has no `space directions`: spacing and orientation are unknown"
    elif set(units.replace('"', " ").split()) - {"mm", "millimeter", "millimetre"}:
        why = f"its space units are {units}: expected mm"
    else:
        return
    raise VolumeError(f"{path}: {why}; export it again")


def _read_series(folder: Path) -> Any:
    """Read a DICOM series after a look at where its slices lie."""
    import SimpleITK

    reader = SimpleITK.ImageSeriesReader()
    if len(series := reader.GetGDCMSeriesIDs(str(folder))) != 1:
        raise VolumeError(
            f"{folder} holds {len(series)} DICOM series: expected one; put each into its own folder"
        )
    files = reader.GetGDCMSeriesFileNames(str(folder), series[0])
    headers = np.array([_slice_header(name) for name in files])
    if np.ptp(headers[:, 3:], axis=0).any():
        raise VolumeError(
            f"{folder}: slices differ in size, spacing or orientation: mixed series"
        )
    axes = headers[0, 3:9].reshape(2, 3)
    steps = (
        np.diff(headers[:, :3], axis=0)
        @ np.vstack((axes, np.cross(axes[0], axes[1]))).T
    )
    apart = np.abs(steps[:, 2])
    usual = float(np.median(apart)) if len(apart) else 0.0
    if usual < 1e-3:
        raise VolumeError(
            f"{folder}: one slice, or all at the same place: expected one scan"
        )
    worst = int(np.abs(apart - usual).argmax())
    if abs(apart[worst] - usual) > 0.01 * usual:
        raise VolumeError(
            f"{folder}: slices are {usual:.3f} mm apart, but {apart[worst]:.3f} mm after "
            f"{Path(files[worst]).name}: a slice is missing or doubled"
        )
    aside = np.abs(steps[:, :2]).max(), np.abs(np.cumsum(steps[:, :2], axis=0)).max()
    if aside[0] > 0.01 * usual or aside[1] > 0.5 * headers[0, 9:11].min():
        raise VolumeError(
            f"{folder}: slices are sheared (gantry tilt): resample the scan"
        )
    reader.SetFileNames(files)
    return reader.Execute()


def _slice_header(name: str) -> list[float]:
    """Position, orientation, spacing and size of a DICOM slice, 13 numbers."""
    import SimpleITK

    reader = SimpleITK.ImageFileReader()
    found = []
    reader.SetFileName(name)
    reader.ReadImageInformation()
    for tag in ("0020|0032", "0020|0037", "0028|0030", "0028|0010", "0028|0011"):
        if not reader.HasMetaDataKey(tag):
            raise VolumeError(
                f"{name} has no DICOM tag {tag}: expected slices of one scan"
            )
        found += [float(part) for part in reader.GetMetaData(tag).split("\\")]
    return found
