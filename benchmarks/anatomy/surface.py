"""Surfaces of ellipsoids and of a real CT, and places read back from every format."""

import locale
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.anatomy import CT_FOLDER
from benchmarks.jobs import Figure, Job
from groundtruth.torso import Ellipsoid
from needleforce.anatomy import (
    Grid,
    Labels,
    Structure,
    Surface,
    read_labels,
    read_volume,
)

ELLIPSOIDS = 12
MIN_VOXELS = 500
"""Structures that are smaller are not judged."""
FORMATS = ("DICOM", "label.nii.gz", "label.nrrd", "label.seg.nrrd")


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of all formats, both spacings and, with data, the CT."""
    rng = np.random.default_rng(job.seed)
    yield from _centroids(rng)
    for spacing_mm in (1.0, 3.0):
        yield from _ellipsoids(spacing_mm, rng)
    if job.data is not None:
        yield from _real_ct(job.data / CT_FOLDER)


def _ellipsoids(spacing_mm: float, rng: np.random.Generator) -> Iterator[Figure]:
    """Measure surfaces of drawn ellipsoids."""
    truth = []
    voxels = []
    rms = []
    closed = []
    while len(rms) < ELLIPSOIDS:
        radii = 1e-3 * np.exp(rng.uniform(np.log(12.0), np.log(60.0), 3))
        turned = Rotation.random(rng=rng).as_matrix()
        body = Ellipsoid("body", rng.uniform(-0.1, 0.1, 3), radii, turned)
        labels = label_ellipsoid(body, np.full(3, 1e-3 * spacing_mm), rng)
        surface = labels.surfaces()["body"]
        truth.append(100.0 * abs(surface.mesh.volume / body.volume_m3 - 1.0))
        voxels.append(_volume_error(labels, surface))
        rms.append(distance_rms_m(surface, body) / (1e-3 * spacing_mm))
        closed.append(surface.mesh.is_volume)
    source = f"ellipsoids, {spacing_mm:g} mm"
    pooled_voxel = np.sqrt(np.mean(np.square(rms)))
    closed_pct = 100.0 * np.mean(closed)
    yield Figure("volume_error_max_pct", max(truth), source)
    yield Figure("voxel_volume_error_max_pct", max(voxels), source)
    yield Figure("surface_distance_rms_voxel", pooled_voxel, source)
    yield Figure("surface_distance_max_voxel", max(rms), source)
    yield Figure("watertight_pct", closed_pct, source)


def label_ellipsoid(
    body: Ellipsoid, spacing_m: NDArray[np.float64], rng: np.random.Generator
) -> Labels:
    """Label an ellipsoid on a grid that begins anywhere in a voxel."""
    low = body.centre_m - body.reach_m - (2.0 + rng.uniform(size=3)) * spacing_m
    shape = tuple(int(n) for n in np.ceil((2.0 * body.reach_m) / spacing_m) + 5)
    grid = Grid(shape, low, np.diag(spacing_m))
    indices = np.moveaxis(np.indices(shape), 0, -1)
    inside = np.sum(body.scaled(grid.points_m(indices)) ** 2, axis=-1) < 1.0
    return Labels.of([inside.astype(np.uint8)], grid, [Structure.named("body", 1)])


def distance_rms_m(surface: Surface, body: Ellipsoid) -> float:
    """Return the rms distance of a surface from an ellipsoid, over its area."""
    a, b, c = (surface.vertices_m[surface.triangles[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    mixes = np.array([[2, 2, 2], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6.0
    squares = sum(
        body.distance_m(x * a + y * b + z * c) ** 2 for x, y, z in mixes
    ) / len(mixes)
    return float(np.sqrt(np.sum(squares * areas) / np.sum(areas)))


def _volume_error(labels: Labels, surface: Surface) -> float:
    """Return how far the volume is from that of the voxels, in per cent."""
    voxels_m3 = labels[surface.name].voxels * labels.grid.voxel_m3
    return 100.0 * abs(surface.mesh.volume / voxels_m3 - 1.0)


def _real_ct(folder: Path) -> Iterator[Figure]:
    """Measure the surfaces of the CT."""
    scan = read_volume(folder / "ct.nii.gz")
    labels = read_labels(folder / "labels.nii.gz", folder / "labels.json", scan)
    judged = [item.name for item in labels.structures if item.voxels >= MIN_VOXELS]
    surfaces = labels.surfaces(judged).values()
    closed = float(100.0 * np.mean([surface.mesh.is_volume for surface in surfaces]))
    worst = max(_volume_error(labels, surface) for surface in surfaces)
    yield Figure("watertight_pct", closed, "CT")
    yield Figure("voxel_volume_error_max_pct", worst, "CT")
    triangles = sum(len(surface.triangles) for surface in surfaces)
    yield Figure("triangles", triangles, "CT")


def _centroids(rng: np.random.Generator) -> Iterator[Figure]:
    """Measure the centroid of a part as every format gives it back."""
    errors: dict[str, list[float]] = {name: [] for name in FORMATS}
    with TemporaryDirectory() as folder:
        for number, flips in enumerate(np.ndindex(2, 2, 2)):
            image, truth_m = oblique_image(1.0 - 2.0 * np.array(flips), rng)
            for name in FORMATS:
                place = Path(folder) / str(number) / name
                place.parent.mkdir(exist_ok=True)
                write_labels(image, place)
                labels = read_labels(place, {1: "part"})
                errors[name].append(
                    1e3 * float(np.abs(labels.centroid_m("part") - truth_m).max())
                )
    for name, errors_mm in errors.items():
        yield Figure("centroid_error_max_mm", max(errors_mm), name)


def oblique_image(
    signs: NDArray[np.float64], rng: np.random.Generator
) -> tuple[Any, NDArray[np.float64]]:
    """Make an image of an L in an oblique, anisotropic grid; and its centroid [m].

    The image is one of SimpleITK.
    """
    import SimpleITK

    values = np.zeros((14, 12, 10), np.uint8)  # k, j, i
    values[2:11, 3:5, 2:4] = 1
    values[2:4, 3:10, 2:4] = 1
    values[2:4, 3:5, 2:8] = 1
    spacing = np.array([0.7, 0.9, 2.5])
    origin = rng.uniform(-150.0, 150.0, 3)
    directions = Rotation.random(rng=rng).as_matrix() * signs
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing(spacing.tolist())
    image.SetOrigin(origin.tolist())
    image.SetDirection(directions.ravel().tolist())
    centre = np.argwhere(values.T).mean(axis=0)
    return image, 1e-3 * (origin + directions @ (spacing * centre))


def write_labels(image: Any, path: Path) -> None:
    """Write an image in the format of the name.

    Without a suffix: a folder of DICOM slices.
    """
    import SimpleITK

    if path.suffix:
        if path.name.endswith(".seg.nrrd"):
            for key, value in (
                ("ID", "s1"),
                ("Name", "part"),
                ("LabelValue", "1"),
                ("Layer", "0"),
            ):
                image.SetMetaData(f"Segment0_{key}", value)
        SimpleITK.WriteImage(image, str(path))
        return
    path.mkdir()
    write_series(image, path)


def write_series(image: Any, folder: Path, uid: str = "2.25.42") -> None:
    """Write an image as a DICOM series, one file per slice."""
    import SimpleITK

    size = image.GetSize()
    cosines = np.array(image.GetDirection()).reshape(3, 3)
    writer = SimpleITK.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    turned = "\\".join(f"{cosine:.12f}" for cosine in cosines[:, :2].T.ravel())
    for k in range(size[2]):
        section = SimpleITK.Cast(image[:, :, k], SimpleITK.sitkInt16)
        place = image.TransformIndexToPhysicalPoint((0, 0, k))
        for tag, value in (
            ("0008|0060", "CT"),
            ("0020|000d", uid),
            ("0020|000e", f"{uid}.1"),
            ("0008|0018", f"{uid}.1.{k + 1}"),
            ("0020|0013", str(k)),
            (
                "0020|0032",
                "\\".join(f"{coordinate_mm:.10f}" for coordinate_mm in place),
            ),
            ("0020|0037", turned),
        ):
            section.SetMetaData(tag, value)
        writer.SetFileName(str(folder / f"{k:03d}.dcm"))
        language = locale.setlocale(locale.LC_CTYPE)
        writer.Execute(section)
        locale.setlocale(locale.LC_CTYPE, language)  # the DICOM library sets C
