"""A DICOM series from a folder, and what is refused of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import (
    EXPORT_VOLUME,
    ONE_SERIES,
    VolumeError,
)

STEP_TOLERANCE = 0.01
"""Fraction of the usual step by which a slice may miss its place in an even stack."""


SLICE_TAGS = {
    "0020|0032": "position",
    "0020|0037": "orientation",
    "0028|0030": "spacing",
    "0028|0010": "rows",
    "0028|0011": "columns",
}
"""Tags that say how a slice lies."""


class _Slice(NamedTuple):
    """How a slice lies.

    Attributes:
        position_mm: Centre of its first pixel in LPS, shape (3,).
        geometry: Axes of rows and columns, spacing [mm] and size: the same in all
            slices of a scan, shape (10,).
    """

    position_mm: Array
    geometry: Array

    @property
    def axes(self) -> Array:
        """Directions of rows and columns, shape (2, 3)."""
        return self.geometry[:6].reshape(2, 3)

    @property
    def spacing_mm(self) -> Array:
        """Distance of the pixels, shape (2,)."""
        return self.geometry[6:8]


def read_series(folder: Path) -> Any:
    """Read a DICOM series after a look at where its slices lie.

    Returns:
        The image of SimpleITK.

    Raises:
        VolumeError: No series or several; slices that are missing, doubled, of
            different sizes or sheared.
    """
    import SimpleITK

    reader = SimpleITK.ImageSeriesReader()
    folders = [folder, *sorted(path for path in folder.rglob("*") if path.is_dir())]
    # CDs lay a series in DICOM/PA0/ST0/SE1 or the like.
    series = [
        reader.GetGDCMSeriesFileNames(str(place), identifier)
        for place in folders
        for identifier in reader.GetGDCMSeriesIDs(str(place))
    ]
    if len(series) != 1:
        choice = "".join(f"\n  {_describe_series(files)}" for files in series[:20])
        raise VolumeError(
            f"{folder} holds {len(series)} DICOM series: expected one"
            + (
                f"; give the folder of one, or copy it to its own:{choice}"
                * bool(choice)
            ),
            ONE_SERIES,
        )
    (files,) = series
    _require_one_scan(folder, files)
    reader.SetFileNames(files)
    return reader.Execute()


def _describe_series(files: Sequence[str]) -> str:
    """Return in words where a series lies, and what its first file says of it."""
    import SimpleITK

    reader = SimpleITK.ImageFileReader()
    reader.SetFileName(files[0])
    reader.ReadImageInformation()
    said = [
        reader.GetMetaData(tag).strip()
        for tag in ("0008|0060", "0008|103e")  # modality, description of the series
        if reader.HasMetaDataKey(tag)
    ]
    return f"{Path(files[0]).parent}: {len(files)} files, {', '.join(said)}"


def _require_one_scan(folder: Path, files: Any) -> None:
    """Refuse slices that are not those of one whole scan."""
    max_shear_pixels = 0.5  # over the whole stack, slices may be shifted by so much
    # Of the usual step: a missing slice shifts the ends of a stack by more.
    max_step_tolerance = 0.15
    # By so much scanners round positions of slices: to a tenth of a millimetre.
    rounding_mm = 0.06
    min_step_mm = 1e-3  # slices that are nearer to each other lie at the same place
    slices = [_read_slice(name) for name in files]
    if np.ptp([item.geometry for item in slices], axis=0).any():
        raise VolumeError(
            f"{folder}: slices differ in size, spacing or orientation: mixed series",
            ONE_SERIES,
        )
    axes = slices[0].axes
    to_slice_axes = np.vstack((axes, np.cross(axes[0], axes[1]))).T
    positions_mm = np.array([item.position_mm for item in slices]) @ to_slice_axes
    stack = _fit_stack(positions_mm)
    usual_mm = abs(float(stack.step_mm[2]))
    if usual_mm < min_step_mm:
        raise VolumeError(
            f"{folder}: one slice, or all at the same place: expected one scan",
            ONE_SERIES,
        )
    tolerance_mm = min(
        max(STEP_TOLERANCE * usual_mm, rounding_mm), max_step_tolerance * usual_mm
    )
    if np.abs(stack.residuals_mm[:, 2]).max() > tolerance_mm:
        distances_mm = np.abs(np.diff(positions_mm[:, 2]))
        middle_mm = float(np.median(distances_mm))
        worst = int(np.abs(distances_mm - middle_mm).argmax())
        raise VolumeError(
            f"{folder}: slices are {middle_mm:.3f} mm apart, but "
            f"{distances_mm[worst]:.3f} mm after {Path(files[worst]).name}: a slice is "
            "missing or doubled",
            ONE_SERIES,
        )
    total_mm = np.abs(stack.step_mm[:2]).max() * (len(slices) - 1)
    is_straight = np.abs(stack.residuals_mm[:, :2]).max() <= tolerance_mm
    max_total_mm = max_shear_pixels * slices[0].spacing_mm.min()
    if not is_straight or total_mm > max_total_mm:
        raise VolumeError(
            f"{folder}: slices are sheared (gantry tilt): resample the scan with "
            f"`dcm2niix -z y -f ct -o . {folder}` (pip install dcm2niix), and give "
            "ct_Tilt_1.nii.gz",
            EXPORT_VOLUME,
        )


class _Stack(NamedTuple):
    """A line through the positions of slices.

    Attributes:
        step_mm: From a slice to the next, in axes of the slices, (3,).
        residuals_mm: Of the positions from the line, (n, 3).
    """

    step_mm: Array
    residuals_mm: Array


def _fit_stack(positions_mm: Array) -> _Stack:
    """Fit evenly spaced slices to positions (n, 3), which scanners round."""
    numbers = np.arange(len(positions_mm)) - 0.5 * (len(positions_mm) - 1)
    scale = float(numbers @ numbers) or 1.0  # of one slice
    offsets_mm = positions_mm - positions_mm.mean(axis=0)
    step_mm = numbers @ offsets_mm / scale
    return _Stack(step_mm, offsets_mm - np.outer(numbers, step_mm))


def _read_slice(name: str) -> _Slice:
    """Return how the slice in a DICOM file lies."""
    import SimpleITK

    reader = SimpleITK.ImageFileReader()
    reader.SetFileName(name)
    reader.ReadImageInformation()
    modality = "0008|0060"
    if reader.HasMetaDataKey(modality) and reader.GetMetaData(modality).strip() == "MR":
        raise VolumeError(
            f"{name} is MR (its modality): expected a CT, in whose Hounsfield units "
            "body, bone and air are found"
        )
    numbers: list[float] = []
    frames = "0028|0008"
    count = reader.GetMetaData(frames).strip() if reader.HasMetaDataKey(frames) else "1"
    if count != "1":
        raise VolumeError(
            f"{name} is an Enhanced (multi-frame) DICOM of {count} frames, expected "
            "one slice per file: convert it with dcm2niix, or export it from 3D Slicer "
            "as .nrrd",
            ONE_SERIES,
        )
    for tag in SLICE_TAGS:
        if not reader.HasMetaDataKey(tag):
            raise VolumeError(
                f"{name} has no DICOM tag {tag}: expected slices of one scan",
                ONE_SERIES,
            )
        numbers += [float(text) for text in reader.GetMetaData(tag).split("\\")]
    return _Slice(np.array(numbers[:3]), np.array(numbers[3:]))
