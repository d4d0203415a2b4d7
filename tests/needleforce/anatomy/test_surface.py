"""Surfaces: closed, outward, of the right volume and at the right place."""

import numpy as np
import pytest

from benchmarks.anatomy.surface import distance_rms_m, label_ellipsoid
from groundtruth.torso import Ellipsoid
from needleforce.anatomy import Grid, Labels, Structure, Surface

pytest.importorskip("skimage")
trimesh = pytest.importorskip("trimesh")


def of_mask(mask, axes_m):
    grid = Grid(mask.shape, np.array([0.1, -0.2, 0.3]), axes_m)
    return Labels.of([mask.astype(np.uint8)], grid, [Structure.named("part", 1)])


@pytest.mark.parametrize(
    "spacing_mm", [(1.0, 1.0, 1.0), (3.0, 3.0, 3.0), (1.0, 1.0, 2.0)]
)
def test_an_ellipsoid_comes_back(spacing_mm):
    spacing_m = 1e-3 * np.array(spacing_mm)
    body = Ellipsoid(
        "body", np.array([0.01, 0.02, 0.03]), np.array([0.03, 0.02, 0.025]), np.eye(3)
    )
    labels = label_ellipsoid(body, spacing_m, np.random.default_rng(5))
    surface = labels.surfaces()["body"]

    assert surface.mesh.is_volume
    assert trimesh.Trimesh(
        surface.vertices_m, surface.triangles, process=False
    ).is_watertight

    voxels_m3 = labels["body"].voxels * labels.grid.voxel_m3

    assert surface.mesh.volume == pytest.approx(voxels_m3, rel=1e-6)
    assert distance_rms_m(surface, body) < 0.12 * np.cbrt(labels.grid.voxel_m3)


SHAPES = {
    "one voxel": lambda m: m[4, 4, 4],
    "two that touch at an edge": lambda m: (m[3, 3, 3], m[4, 4, 3]),
    "two that touch at a corner": lambda m: (m[3, 3, 3], m[4, 4, 4]),
    "cut off by the volume": lambda m: m[:, :, :5],
    "a shell": lambda m: (m[1:8, 1:8, 1:3], m[1:8, 1:8, 6:8], m[1:3, 1:8, 1:8]),
    "two parts": lambda m: (m[1:3, 1:3, 1:3], m[6:8, 6:8, 6:8]),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, 1)])
def test_awkward_structures_are_closed_and_keep_their_volume(name, signs):
    mask = np.zeros((9, 9, 9), bool)
    places = np.arange(mask.size).reshape(mask.shape)
    chosen = SHAPES[name](places)
    for group in chosen if isinstance(chosen, tuple) else (chosen,):
        mask.ravel()[np.ravel(group)] = True

    surface = of_mask(mask, 2e-3 * np.diag(np.array(signs, float))).surfaces()["part"]

    assert surface.mesh.is_volume
    assert surface.mesh.volume == pytest.approx(8e-9 * mask.sum(), rel=1e-3)


def test_random_voxels_are_closed():
    mask = np.random.default_rng(0).uniform(size=(12, 12, 12)) > 0.5
    surface = of_mask(mask, 1e-3 * np.eye(3)).surfaces()["part"]

    assert surface.mesh.is_volume


def test_an_open_or_twisted_surface_is_noticed():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    whole = Surface("part", corners, faces, (1.0, 1.0, 1.0))

    assert whole.mesh.is_volume
    assert whole.mesh.volume == pytest.approx(1.0 / 6.0)

    twisted = np.vstack([faces[:3], faces[3:, ::-1]])
    for bad in (faces[:3], twisted):
        assert not Surface("part", corners, bad, (1.0, 1.0, 1.0)).mesh.is_volume


def test_nearest_places_lie_on_large_triangles_too():
    box = trimesh.creation.box((0.1, 0.08, 0.06))
    corner = trimesh.creation.icosphere(3, 0.01).apply_translation([0.05, 0.04, 0.03])
    mesh = trimesh.util.concatenate([box, corner])
    surface = Surface("part", np.array(mesh.vertices), mesh.faces)

    assert len(surface.colour) == 3

    points = np.random.default_rng(0).uniform(-0.05, 0.05, (100, 3))
    places, normals = surface.nearest(points)
    rows = np.arange(100).repeat(len(mesh.faces))
    all_places_mm = trimesh.triangles.closest_point(
        np.tile(1e3 * mesh.triangles, (100, 1, 1)), 1e3 * points[rows]
    )
    all_distances_m = 1e-3 * np.linalg.norm(
        all_places_mm - 1e3 * points[rows], axis=1
    ).reshape(100, -1)
    distances_m = np.linalg.norm(places - points, axis=1)

    np.testing.assert_allclose(distances_m, all_distances_m.min(axis=1), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_mean_normals_ignore_bumps_and_far_side():
    ball = trimesh.creation.icosphere(5, 0.05)
    outward = ball.vertices / 0.05
    bumps = 0.3e-3 * np.prod(np.sin(ball.vertices / 3.7e-3), axis=1)
    bumpy = Surface("ball", ball.vertices + bumps[:, None] * outward, ball.faces)
    points = outward[::50] * 0.051
    places, facets = bumpy.nearest(points)
    means = bumpy.mean_normals(places, facets, 7.4e-3)
    flatness = np.linalg.norm(means, axis=1)
    tilts = [
        np.linalg.norm(np.cross(normals, outward[::50]), axis=1).mean()
        for normals in (facets, means / flatness[:, None])
    ]

    # The mean normal of a cap of a ball that reaches so far.
    assert flatness.mean() == pytest.approx(1.0 - (7.4 / 50.0) ** 2 / 4.0, abs=0.01)
    assert tilts[1] < 0.4 * tilts[0]

    plate = (
        trimesh.creation.box((0.1, 0.1, 0.004))
        .subdivide()
        .subdivide()
        .subdivide()
        .subdivide()
    )
    flat = Surface("plate", plate.vertices, plate.faces)
    places = np.array([[0, 0, 0.002]])
    up = flat.mean_normals(places, np.array([[0.0, 0.0, 1.0]]), 8e-3)

    np.testing.assert_allclose(up, [[0.0, 0.0, 1.0]], atol=1e-9)


def test_mean_normals_weigh_triangles_by_their_areas():
    ball = trimesh.creation.icosphere(3, 0.05)
    stretched = ball.vertices * [1.0, 0.6, 0.3]
    surface = Surface("body", stretched, ball.faces)
    mesh = surface.mesh
    places, facets = surface.nearest(1.02 * stretched[::40])
    means = surface.mean_normals(places, facets, 12e-3)
    for place, normal, mean in zip(places, facets, means, strict=True):
        counts = np.linalg.norm(mesh.triangles_center - place, axis=1) < 12e-3
        counts &= mesh.face_normals @ normal > 0.0
        areas = mesh.area_faces[counts]
        expected = areas @ mesh.face_normals[counts] / areas.sum()

        np.testing.assert_allclose(mean, expected, atol=1e-12)

    # Farther from every middle than the reach: the normal itself.
    np.testing.assert_array_equal(surface.mean_normals(places, facets, 1e-9), facets)


@pytest.mark.parametrize("count", [1, 2, 5, 40])
def test_the_nearest_of_few_triangles_is_found(count):
    rng = np.random.default_rng(1000 + count)
    corners = rng.normal(size=(count, 3, 3))
    corners[-1, 2] = 0.5 * (corners[-1, 0] + corners[-1, 1]) + 1e-9  # a sliver
    points = 2.0 * rng.normal(size=(60, 3))
    triangles = np.arange(3 * count).reshape(count, 3)
    surface = Surface("part", corners.reshape(-1, 3), triangles)
    places, _ = surface.nearest(points)
    distances = np.linalg.norm(places - points, axis=1)
    every = trimesh.triangles.closest_point(
        np.tile(corners, (60, 1, 1)), points.repeat(count, axis=0)
    )
    gaps = np.linalg.norm(every - points.repeat(count, axis=0), axis=1)

    np.testing.assert_allclose(
        distances, gaps.reshape(60, count).min(axis=1), atol=1e-6
    )


def test_progress_reaches_one():
    fractions = []
    of_mask(np.pad(np.ones((3, 3, 3), bool), 2), 1e-3 * np.eye(3)).surfaces(
        progress=fractions.append
    )

    assert fractions == [1.0]
