"""An example patient: CT, labels and landmarks of an analytic torso."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from groundtruth.torso import Ellipsoid, Torso, analytic_torso
from needleforce.anatomy import Grid
from needleforce.anatomy.markups import write_markup
from needleforce.files import whole_file

SPACING_m = (2.5e-3, 2.5e-3, 3e-3)
"""Of the CT."""


TISSUE_HU = {
    "fat": -100.0,
    "muscle": 55.0,
    "cavity": -90.0,
    "vertebra": 350.0,
    "rib_right": 450.0,
    "stomach": 40.0,
    "liver": 105.0,
    "vessel": 160.0,
    "lesion": 60.0,
    "flank": -100.0,
    "breast": -100.0,
}
"""Hounsfield units of the organs."""

NOISE_HU = 12.0
"""Standard deviation of the CT's noise."""


BULGES = (
    Ellipsoid(
        "flank",
        np.array([-0.135, -0.005, -0.055]),
        np.array([0.045, 0.055, 0.035]),
        np.eye(3),
    ),
    Ellipsoid(
        "breast",
        np.array([0.055, -0.092, 0.1]),
        np.array([0.05, 0.035, 0.04]),
        np.eye(3),
    ),
)
"""Of the skin, or the torso could turn about itself unnoticed."""

LANDMARKS = {
    "xiphoid": (0.0, 0.35),
    "navel": (0.0, -0.45),
    "rib right": (-0.62, 0.2),
    "rib left": (0.55, 0.15),
    "crest right": (-0.6, -0.5),
    "crest left": (0.6, -0.45),
}
"""Points of the front skin, by the fractions of the torso's half width and height."""


def write_torso_case(folder: Path, seed: int) -> Grid:
    """Write CT, labels, their names and landmarks of the torso into a folder.

    Args:
        folder: The folder; it exists.
        seed: Of the CT's noise.

    Returns:
        The grid of the CT.
    """
    margin_voxels = 4  # Air around the torso
    # Organs with labels, as a segmentation of organs has them.
    segmented = ("vertebra", "rib_right", "stomach", "liver", "vessel", "lesion")
    organs = analytic_torso().shapes
    torso = Torso((*organs[:1], *BULGES, *organs[1:]))
    half = np.ceil(torso["fat"].reach_m / SPACING_m).astype(int) + margin_voxels
    half += np.ceil(np.array([0.025, 0.02, 0.0]) / SPACING_m).astype(int)
    axes_m = np.diag(SPACING_m)
    grid = Grid(tuple((2 * half + 1).tolist()), -axes_m @ half, axes_m)
    voxels = torso.voxels(grid.shape, grid.origin_m, grid.axes_m)
    scan_HU = draw_scan(torso, voxels, np.random.default_rng(seed))
    _write_image(folder / "ct.nii.gz", scan_HU, grid)
    names = {value: name for value, name in enumerate(segmented, 1)}
    numbers = {body.name: number for number, body in enumerate(torso.shapes, 1)}
    labels = np.zeros_like(voxels)
    for value, name in names.items():
        labels[voxels == numbers[name]] = value
    _write_image(folder / "labels.nii.gz", labels, grid)
    with whole_file(folder / "labels.json") as file:
        file.write(msgspec.json.format(msgspec.json.encode(names), indent=1) + b"\n")
    points_m = np.array([_skin_point_m(torso, *at) for at in LANDMARKS.values()])
    write_markup(folder / "landmarks.mrk.json", "Fiducial", list(LANDMARKS), points_m)
    return grid


def draw_scan(
    torso: Torso, voxels: NDArray[Any], rng: np.random.Generator
) -> NDArray[np.int16]:
    """Return what a CT shows of the torso, with its noise [HU], shape (i, j, k).

    Args:
        torso: The torso.
        voxels: Number of the organ in every voxel, from 1; 0 for air.
        rng: Draws the noise.
    """
    air_HU = -1000.0
    values_HU = [air_HU, *(TISSUE_HU[body.name] for body in torso.shapes)]
    scan = np.array(values_HU, np.float32)[voxels]
    noise = rng.standard_normal(scan.shape, np.float32)
    return np.round(scan + NOISE_HU * noise).astype(np.int16)


def _write_image(path: Path, values: NDArray[Any], grid: Grid) -> None:
    """Write voxels (i, j, k) as NIfTI."""
    import SimpleITK

    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(values.T))
    image.SetOrigin((1e3 * grid.origin_m).tolist())
    image.SetSpacing((1e3 * grid.spacing_m).tolist())
    SimpleITK.WriteImage(image, str(path), useCompression=True)


def _skin_point_m(torso: Torso, left: float, up: float) -> Array:
    """Return the point of the front skin at fractions of half width and height."""
    radii_m = torso["fat"].radii_m
    start_m = np.array([left * radii_m[0], -2.0 * radii_m[1], up * radii_m[2]])
    backwards = np.array([0.0, 1.0, 0.0])
    depths_m = [d for body in torso.shapes for d in body.depths_m(start_m, backwards)]
    return start_m + min(depths_m) * backwards
