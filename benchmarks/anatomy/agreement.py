"""Labels against their scan: right ones pass, mirrored and shifted ones do not.

Analytic torsos with noise, and parts of the CT where it is at hand; each with axes
stored in any direction.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.anatomy import CT_FOLDER
from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from groundtruth.torso import analytic_torso
from needleforce.anatomy import (
    Grid,
    Labels,
    Structure,
    Volume,
    VolumeError,
    read_labels,
    read_volume,
)
from needleforce.anatomy.body_order import require_body_order

CASES = 40
SHIFT_m = 21e-3
NOISE_HU = 20.0
SHOWN_HU = {
    "fat": -100.0,
    "muscle": 50.0,
    "cavity": -60.0,
    "vertebra": 250.0,
    "rib_right": 300.0,
    "stomach": 30.0,
    "liver": 60.0,
    "vessel": 150.0,
    "lesion": 20.0,
}
SHAPE = (120, 84, 112)
SPACING_m = 3e-3
MIN_PART = np.array([70, 60, 45])
"""Voxels of a part of the CT along each axis, at least."""


class LabelledScan(NamedTuple):
    """A scan and what is labelled in it.

    Attributes:
        values: Of the labels, (i, j, k).
        scan: The scan, on the same grid.
        structures: Structures of the labels.
    """

    values: NDArray[Any]
    scan: Volume
    structures: tuple[Structure, ...]

    def is_accepted(self, values: NDArray[Any], grid: Grid | None = None) -> bool:
        """Return whether labels with other values, or elsewhere, are accepted."""
        place = self.scan.grid if grid is None else grid
        try:
            labels = Labels.of([np.ascontiguousarray(values)], place, self.structures)
            require_body_order(labels)
            labels.checked_against(self.scan)
        except VolumeError:
            return False
        return True


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Yield how many right labels pass, and how many wrong ones are refused."""
    sources: dict[str, Callable[[np.random.Generator], LabelledScan]] = {
        "torso": draw_torso
    }
    if job.data is not None:
        folder = job.data / CT_FOLDER
        ct = read_volume(folder / "ct.nii.gz")
        labels = read_labels(folder / "labels.nii.gz")
        sources["CT"] = lambda rng: draw_part(ct, labels, rng)
    for number, (name, draw) in enumerate(sources.items()):
        accepted = 0
        refused = dict.fromkeys((*FAULTS, "negated affine"), 0)
        for turn in range(CASES):
            rng = np.random.default_rng([job.seed, 22, number, turn])
            case = draw(rng)
            accepted += case.is_accepted(case.values)
            for fault, spoil in FAULTS.items():
                values = spoil(case, rng)
                refused[fault] += not case.is_accepted(values)
            grid = case.scan.grid
            turned = np.diag([-1.0, -1.0, 1.0])
            place = Grid(grid.shape, turned @ grid.origin_m, turned @ grid.axes_m)
            refused["negated affine"] += not case.is_accepted(case.values, place)
            progress((number + (turn + 1) / CASES) / len(sources))
        yield Figure("labels_accepted_pct", 100.0 * accepted / CASES, name)
        for fault, count in refused.items():
            percent = 100.0 * count / CASES
            yield Figure("labels_refused_pct", percent, f"{name}, {fault}")


def draw_torso(rng: np.random.Generator) -> LabelledScan:
    """Draw a torso and its noisy scan."""
    torso = analytic_torso(rng)
    grid = Grid(SHAPE, -0.5 * SPACING_m * np.array(SHAPE), SPACING_m * np.eye(3))
    values = torso.voxels(SHAPE, grid.origin_m, grid.axes_m)
    shown_HU = [-1000.0, *(SHOWN_HU[shape.name] for shape in torso.shapes)]
    scan_HU = np.array(shown_HU)[values] + rng.normal(0.0, NOISE_HU, SHAPE)
    structures = tuple(
        Structure.named(shape.name, k) for k, shape in enumerate(torso.shapes, 1)
    )
    return LabelledScan(values, Volume(scan_HU, grid), structures)


def draw_part(ct: Volume, labels: Labels, rng: np.random.Generator) -> LabelledScan:
    """Draw a part of a CT, with axes stored in any direction, and noise."""
    shape = np.array(ct.grid.shape)
    size = rng.integers(MIN_PART, shape)
    corner = rng.integers(0, shape - size + 1)
    box = tuple(slice(a, a + n) for a, n in zip(corner, size, strict=True))
    values = labels.volumes[0][box]
    scan_HU = ct.values[box] + rng.normal(0.0, NOISE_HU, values.shape)
    origin_m = ct.grid.points_m(corner)
    axes_m = ct.grid.axes_m.copy()
    for axis in np.flatnonzero(rng.random(3) < 0.5).tolist():
        values = np.flip(values, axis)
        scan_HU = np.flip(scan_HU, axis)
        origin_m = origin_m + axes_m[:, axis] * (values.shape[axis] - 1)
        axes_m[:, axis] *= -1.0
    grid = Grid(values.shape, origin_m, axes_m)
    structures = tuple(
        Structure.named(item.name, item.value) for item in labels.structures
    )
    return LabelledScan(values, Volume(scan_HU, grid), structures)


def _mirror(axis: int) -> Callable[[LabelledScan, np.random.Generator], NDArray[Any]]:
    """Return what mirrors labels along an axis of their array."""
    return lambda case, rng: np.flip(case.values, axis)


def _shift(axis: int) -> Callable[[LabelledScan, np.random.Generator], NDArray[Any]]:
    """Return what shifts labels along an axis, to either side."""

    def spoil(case: LabelledScan, rng: np.random.Generator) -> NDArray[Any]:
        voxels = round(SHIFT_m / case.scan.grid.spacing_m[axis])
        moved = np.roll(case.values, voxels, axis)
        lost = [slice(None)] * 3
        lost[axis] = slice(0, voxels)
        moved[tuple(lost)] = 0
        return moved

    return spoil


def _foreign(case: LabelledScan, rng: np.random.Generator) -> NDArray[Any]:
    """Return labels of another place and size."""
    moved = np.roll(case.values, rng.integers(12, 40, 3).tolist(), (0, 1, 2))
    return np.flip(moved, int(rng.integers(0, 3)))


FAULTS: dict[str, Callable[[LabelledScan, np.random.Generator], NDArray[Any]]] = {
    "mirrored x": _mirror(0),
    "mirrored y": _mirror(1),
    "mirrored z": _mirror(2),
    "21 mm along x": _shift(0),
    "21 mm along y": _shift(1),
    "21 mm along z": _shift(2),
    "foreign": _foreign,
}
