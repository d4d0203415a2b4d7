"""Surfaces: closed, outward, of the right volume and at the right place."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from needleforce.anatomy import Grid, Labels, Structure, Surface

ORIGIN_m = np.array([0.1, -0.2, 0.3])


def of_mask(mask, axes_m):
    grid = Grid(mask.shape, ORIGIN_m, axes_m)
    return Labels.of([mask.astype(np.uint8)], grid, [Structure.named("part", 1)])


@pytest.mark.parametrize(
    ("spacing_mm", "triangles"),
    [((1.0, 1.0, 1.0), 5000), ((3, 3, 3), 1300), ((1.0, 1.0, 2.0), 4000)],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_ellipsoid_comes_back(spacing_mm, triangles, sign):
    """Of 23,236, 2,576 and 15,344 triangles of its voxels so many are left at most."""
    radii_m = np.array([0.03, 0.02, 0.025])
    spacing_m = 1e-3 * np.array(spacing_mm)
    turn = Rotation.from_rotvec([0.4, -0.2, 0.7]).as_matrix() * [sign, 1.0, 1.0]
    places = np.moveaxis(np.indices(np.ceil(0.07 / spacing_m).astype(int)), 0, -1)
    centre_m = np.array([0.0341, 0.0357, 0.0349])
    inside = np.linalg.norm((places * spacing_m - centre_m) / radii_m, axis=-1) < 1.0
    labels = of_mask(inside, turn * spacing_m)
    surface = labels.surfaces()["part"]
    local_m = (surface.vertices_m - ORIGIN_m) @ turn - centre_m
    radii = np.linalg.norm(local_m / radii_m, axis=1)
    away_m = (radii - 1.0) / (np.linalg.norm(local_m / radii_m**2, axis=1) / radii)

    assert surface.mesh.is_volume
    assert len(surface.triangles) < triangles
    assert np.sqrt(np.mean(away_m**2)) < 0.16 * np.cbrt(spacing_m.prod())
    assert surface.mesh.volume == pytest.approx(
        labels["part"].voxels * labels.grid.voxel_m3, rel=1e-6
    )


SHAPES = {
    "one voxel": lambda m: [m[4, 4, 4]],
    "two that touch at an edge": lambda m: [m[3, 3, 3], m[4, 4, 3]],
    "two that touch at a corner": lambda m: [m[3, 3, 3], m[4, 4, 4]],
    "cut off by the volume": lambda m: [m[:, :, :5]],
    "a shell": lambda m: [m[1:8, 1:8, 1:3], m[1:8, 1:8, 6:8], m[1:3, 1:8, 1:8]],
    "two parts": lambda m: [m[1:3, 1:3, 1:3], m[6:8, 6:8, 6:8]],
    "random": lambda m: [m[np.random.default_rng(0).uniform(size=m.shape) > 0.5]],
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("signs", [(1.0, 1.0, 1.0), (-1.0, 1.0, 1.0)])
def test_awkward_structures_are_closed_and_keep_their_volume(name, signs):
    numbers = np.arange(9**3).reshape(9, 9, 9)
    mask = np.isin(numbers, np.concatenate([*map(np.ravel, SHAPES[name](numbers))]))
    fractions = []
    labels = of_mask(mask, 2e-3 * np.diag(signs))
    surface = labels.surfaces(progress=fractions.append)["part"]

    assert surface.mesh.is_volume
    assert surface.mesh.volume == pytest.approx(8e-9 * mask.sum(), rel=1e-3)
    assert fractions == [1.0]
    assert len(labels.skin().triangles) == len(surface.triangles)


@pytest.mark.parametrize("spacing_mm", [[0.75] * 3, [0.5, 1.0, 4.0]])
def test_surfaces_to_look_at_have_larger_voxels(spacing_mm):
    spacing_m = 1e-3 * np.array(spacing_mm)
    places = np.moveaxis(np.indices(np.ceil(0.05 / spacing_m).astype(int)), 0, -1)
    away_m = places * spacing_m - 0.025
    labels = of_mask(np.linalg.norm(away_m, axis=-1) < 0.02, np.diag(spacing_m))
    coarse = labels.surfaces(voxel_m=3e-3)["part"]
    radii_m = np.linalg.norm(coarse.vertices_m - labels.centroid_m("part"), axis=1)

    assert len(coarse.triangles) < 0.5 * len(labels.surfaces()["part"].triangles)
    assert coarse.mesh.is_volume
    assert 0.0185 < radii_m.min() < radii_m.max() < 0.0215
    # A sheet so thin that no larger voxel is half full stays.
    sheet = of_mask(np.abs(away_m[..., 0]) < 0.6 * spacing_m[0], np.diag(spacing_m))
    assert sheet.surfaces(voxel_m=3e-3)["part"].mesh.is_volume


@pytest.mark.parametrize("count", [1, 5, 40])
def test_the_nearest_of_large_and_small_triangles_is_found(count):
    rng = np.random.default_rng(1000 + count)
    corners = rng.normal(size=(count, 3, 3)) * rng.uniform(0.1, 2.0, (count, 1, 1))
    corners[-1, 2] = 0.5 * (corners[-1, 0] + corners[-1, 1]) + 1e-9  # a sliver
    points = (2.0 * rng.normal(size=(60, 3))).repeat(count, axis=0)
    triangles = np.arange(3 * count).reshape(count, 3)
    places, normals = Surface("part", corners.reshape(-1, 3), triangles).nearest(points)
    every = trimesh.triangles.closest_point(np.tile(corners, (60, 1, 1)), points)
    gaps = np.linalg.norm(every - points, axis=1).reshape(60, count).min(axis=1)

    np.testing.assert_allclose(
        np.linalg.norm(places - points, axis=1), gaps.repeat(count), atol=1e-6
    )
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_mean_normals_weigh_triangles_by_area_on_the_same_side():
    ball = trimesh.creation.icosphere(3, 0.05)
    surface = Surface("body", ball.vertices * [1.0, 0.6, 0.3], ball.faces)
    mesh = surface.mesh
    places, facets = surface.nearest(1.02 * mesh.vertices[::40])
    away_m = np.linalg.norm(mesh.triangles_center - places[:, None], axis=2)
    counts = (away_m < 12e-3) & (facets @ mesh.face_normals.T > 0.0)
    areas = counts * mesh.area_faces
    expected = areas @ mesh.face_normals / areas.sum(axis=1, keepdims=True)

    np.testing.assert_allclose(
        surface.mean_normals(places, facets, 12e-3), expected, atol=1e-12
    )
    # Farther from every middle than the reach: the normal itself.
    np.testing.assert_array_equal(surface.mean_normals(places, facets, 1e-9), facets)
