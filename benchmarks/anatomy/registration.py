"""Registration by landmarks and touches: errors stated and true.

Touches of organs: the truth is a smooth surface at a third of the scan's voxels, the
model what segmenting it at the scan's own voxels, turned and shifted, leaves of it.
Spleen and stomach were not looked at when the covariance was set.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation
from scipy.stats import special_ortho_group

from benchmarks.anatomy import CT_FOLDER, draw_on, rms
from benchmarks.jobs import Figure, Job, make_figures
from foundation.arrays import Array
from needleforce.anatomy import (
    Grid,
    Labels,
    Registration,
    RegistrationError,
    Structure,
    fit_landmarks,
    fit_surface,
    read_labels,
)

Pose = tuple[Array, Array]

LANDMARK_DRAWS = 10_000
FAR_STARTS = 100
MODELS = 120
FITS = 4
"""Surfaces of an organ, and fits to each, the first of which looks for other solutions:
a surface's error is alike for all fits to it, so with 120 a fraction of 0.95 is known
to some 0.01."""
STD_m = 0.5e-3
TOUCHES = 100
TARGET_m = np.array([-0.03, 0.0, 0.01])
ORGANS = ("liver", "kidney_right", "spleen", "stomach")
SKIN_m = np.array([0.16, 0.11, 0.15])
"""Half axes of the torso on which landmarks lie."""


def run(job: Job) -> Iterator[Figure]:
    """Yield the figures; those of organs need the CT."""
    rng = np.random.default_rng([job.seed, 7])
    yield from _landmarks(rng)
    if job.data is None:
        return
    labels = read_labels(job.data / CT_FOLDER / "labels.nii.gz")
    yield from _far_starts(labels, np.random.default_rng([job.seed, 8]))
    for name in ORGANS:
        yield from _organ(labels, name, rng)


def landmarks(count: int, rng: np.random.Generator) -> Array:
    """Draw points on the front and sides of a torso.

    No two are closer than 50 mm, and they do not lie on a line.
    """
    while True:
        angle = rng.uniform(-1.5, 1.5, count)
        height = rng.uniform(-0.8, 0.8, count)
        flat = np.sqrt(1.0 - height**2)
        points = SKIN_m * np.column_stack(
            (flat * np.sin(angle), -flat * np.cos(angle), height)
        )
        apart = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(count)
        width = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1]
        if apart.min() > 0.05 and width > 0.04 * np.sqrt(count):
            return points


def pose(rng: np.random.Generator) -> Pose:
    """Draw any rotation, and a shift of some decimetres."""
    return special_ortho_group.rvs(3, random_state=rng), 0.5 * rng.normal(size=3)


def _landmarks(rng: np.random.Generator) -> Iterator[Figure]:
    """Measure landmarks: how good the stated errors are."""
    for name, is_known in (
        ("deviation known", True),
        ("deviation from residuals", False),
    ):
        inside = []
        error = []
        stated = []
        for draw in range(LANDMARK_DRAWS):
            count = (3 if is_known else 4) + draw % (8 if is_known else 7)
            model = landmarks(count, rng)
            rotation, shift = pose(rng)
            robot = model @ rotation.T + shift + STD_m * rng.normal(size=model.shape)
            try:
                registration = fit_landmarks(
                    model, robot, std_m=STD_m, is_std_known=is_known
                )
            except RegistrationError:  # they lie symmetrically
                continue
            truth = rotation @ TARGET_m + shift
            inside.append(registration.region_contains(TARGET_m, truth))
            error.append(np.linalg.norm(registration.to_robot(TARGET_m) - truth))
            stated.append(registration.tre_m(TARGET_m))
        yield Figure("landmark_region_coverage_95", np.mean(inside), name)
        yield Figure("landmark_error_ratio", rms(error) / rms(stated), name)


def touch(mesh: Any, front: Array, rng: np.random.Generator) -> Array:
    """Draw touches of a mesh's side that looks to the front.

    One in ten has slipped off by 5 to 20 mm.
    """
    area = mesh.area_faces * (mesh.face_normals @ front > 0.15)
    points, normals = draw_on(mesh, area, TOUCHES, rng)
    points = points + STD_m * rng.normal(size=points.shape)
    slipped = rng.random(TOUCHES) < 0.1
    sign = rng.choice([-1.0, 1.0], (int(slipped.sum()), 1))
    far = sign * rng.uniform(5e-3, 20e-3, (int(slipped.sum()), 1))
    points[slipped] += far * normals[slipped]
    return points


def rough(points: Array, truth: Pose, rng: np.random.Generator) -> Registration:
    """Draw a start some 5 degrees and 8 mm off."""
    turned = truth[0] @ Rotation.from_rotvec(0.05 * rng.normal(size=3)).as_matrix()
    middle = points.mean(axis=0)
    shift = truth[0] @ middle + truth[1] - turned @ middle + 4.6e-3 * rng.normal(size=3)
    return Registration(turned, shift, np.eye(6), np.zeros(3), np.inf, 0.0)


def _far_starts(labels: Labels, rng: np.random.Generator) -> Iterator[Figure]:
    """Measure what becomes of starts outside the basin."""
    mesh, model = truth_and_model(labels, ORGANS[0], rng)
    center = mesh.center_mass
    refused = 0
    wrong = 0
    for _ in range(FAR_STARTS):
        front, axis, aside = rng.normal(size=(3, 3))
        points = touch(mesh, front / np.linalg.norm(front), rng)
        truth = pose(rng)
        # Farther than any start from which a fit finds its way back.
        turn = rng.uniform(np.pi / 4, np.pi) * axis / np.linalg.norm(axis)
        off = truth[0] @ Rotation.from_rotvec(turn).as_matrix()
        middle = points.mean(axis=0)
        shift = (
            (truth[0] - off) @ middle + truth[1] + 0.03 * aside / np.linalg.norm(aside)
        )
        start = Registration(off, shift, np.eye(6), np.zeros(3), np.inf, 0.0)
        try:
            registration = fit_surface(model, points @ truth[0].T + truth[1], start)
        except RegistrationError:
            refused += 1
            continue
        error_m = np.linalg.norm(
            registration.to_robot(center) - truth[0] @ center - truth[1]
        )
        wrong += int(error_m > 3e-3)  # up to which a fit is right
    parts_pct = {
        "far_starts_refused_or_right_pct": 100.0 * (1.0 - wrong / FAR_STARTS),
        "far_starts_refused_pct": 100.0 * refused / FAR_STARTS,
    }
    yield from make_figures(parts_pct, ORGANS[0])


def _organ(labels: Labels, name: str, rng: np.random.Generator) -> Iterator[Figure]:
    """Measure touches of an organ: errors, true and stated."""
    errors = []
    inside = []
    refused = 0
    for _ in range(MODELS):
        truth_mesh, model = truth_and_model(labels, name, rng)
        center = truth_mesh.center_mass
        for number in range(FITS):
            front = rng.normal(size=3)
            points = touch(truth_mesh, front / np.linalg.norm(front), rng)
            truth = pose(rng)
            try:
                robot = points @ truth[0].T + truth[1]
                start = rough(points, truth, rng)
                registration = fit_surface(model, robot, start, check=number == 0)
            except RegistrationError:
                refused += 1
                continue
            place = truth[0] @ center + truth[1]
            errors.append(
                1e3 * float(np.linalg.norm(registration.to_robot(center) - place))
            )
            inside.append(registration.region_contains(center, place))
    values = {
        "organ_error_p95_mm": np.quantile(errors, 0.95),
        "organ_region_coverage_95": np.mean(inside),
        "touches_wrongly_refused_pct": 100.0 * refused / (MODELS * FITS),
    }
    yield from make_figures(values, name)


def truth_and_model(
    labels: Labels, name: str, rng: np.random.Generator
) -> tuple[Any, Any]:
    """Return a smooth organ as a mesh [m], and its segmentation's surface.

    The segmentation is on another grid.
    """
    import trimesh
    from skimage.measure import marching_cubes

    step = float(labels.grid.spacing_m.min())
    field = gaussian_filter(np.pad(labels.mask(name), 4).astype(float), 1.0)
    fine = np.stack(
        np.meshgrid(
            *(np.arange(0.0, size - 1, 1 / 3) for size in field.shape), indexing="ij"
        )
    )
    vertices, triangles, _, _ = marching_cubes(
        map_coordinates(field, fine, order=1), 0.5
    )
    mesh = trimesh.Trimesh(vertices * step / 3.0, triangles)
    if mesh.volume < 0.0:
        mesh.invert()
    turn = Rotation.from_rotvec(0.3 * rng.normal(size=3)).as_matrix()
    middle = mesh.vertices.mean(axis=0)
    reach = np.linalg.norm(mesh.vertices - middle, axis=1).max() + 4.0 * step
    count = int(2.0 * reach / step)
    origin = (
        middle
        - turn @ np.full(3, 0.5 * (count - 1) * step)
        + step * rng.uniform(0.0, 1.0, 3)
    )
    grid = Grid((count,) * 3, origin, step * turn)
    index = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), axis=-1)
    places = grid.points_m(index) / step
    numbers = (
        map_coordinates(field, np.moveaxis(places, -1, 0), order=1) > 0.5
    ).astype(np.uint8)
    model = Labels.of([numbers], grid, [Structure.named(name, 1)])
    return mesh, model.surfaces()[name]
