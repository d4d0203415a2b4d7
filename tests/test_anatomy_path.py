"""Surfaces of structures, and what a needle crosses, against an analytic torso."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("SimpleITK")
trimesh = pytest.importorskip("trimesh")
pytest.importorskip("skimage")
pytest.importorskip("manifold3d")

from groundtruth.torso import Ellipsoid, Torso, random_torso  # noqa: E402
from needleforce.anatomy import (  # noqa: E402
    Grid,
    Labels,
    PathError,
    Structure,
    StructureError,
    layers_along,
    surface_of,
    surfaces,
)

TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def labelled(torso, spacing_m, rotation=None):
    numbers, origin, axes = torso.voxels(spacing_m, rotation)
    structures = {n: Structure(n, name, (1.0, 0.0, 0.0)) for n, name in torso.names.items()}
    return Labels(Grid(origin, axes, numbers.shape), numbers, structures)


@pytest.fixture(scope="module")
def torso():
    return random_torso(np.random.default_rng(0))


@pytest.fixture(scope="module")
def labels(torso):
    return labelled(torso, 2e-3, TURN)


def egg():
    body = Ellipsoid("egg", np.zeros(3), np.array([0.03, 0.02, 0.025]), TURN)
    return body, Torso([body])


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_surface_is_closed_and_holds_its_volume(mirror):
    body, torso = egg()
    numbers, origin, axes = torso.voxels(1e-3)
    grid = Grid(origin * [mirror, 1, 1], np.diag([mirror, 1.0, 1.0]) @ axes, numbers.shape)
    labels = Labels(grid, numbers, {1: Structure(1, "egg", (1.0, 0.0, 0.0))})
    found = surface_of(labels, "egg")
    assert found.is_watertight
    assert found.volume_m3 == pytest.approx(labels.volume_m3("egg"), rel=1e-9)
    assert found.volume_m3 == pytest.approx(body.volume_m3, rel=5e-3)
    local = (found.vertices_m * [mirror, 1, 1]) @ TURN / body.radii_m
    off_m = (np.linalg.norm(local, axis=1) - 1.0) * 0.02
    assert np.sqrt((off_m**2).mean()) < 0.1e-3
    full = surface_of(labels, "egg", simplify=False)
    assert full.is_watertight
    assert len(full.triangles) > 1.5 * len(found.triangles)


def test_an_organ_that_the_volume_cuts_is_closed_too():
    numbers = np.ones((12, 9, 7), dtype=np.uint8)
    labels = Labels(
        Grid(np.zeros(3), 1e-3 * np.eye(3), numbers.shape),
        numbers,
        {1: Structure(1, "all", (0,) * 3)},
    )
    found = surface_of(labels, "all")
    assert found.is_watertight
    assert found.volume_m3 == pytest.approx(12 * 9 * 7 * 1e-9, rel=1e-6)


def test_all_surfaces_come_with_progress_and_small_ones_may_be_left_out(labels):
    done = []
    found = surfaces(labels, least_voxels=1000, progress=done.append)
    assert done[-1] == 1.0
    assert "liver" in [surface.structure.name for surface in found]
    small = [n for n in labels.structures if np.count_nonzero(labels.numbers == n) < 1000]
    assert len(found) == len(labels.structures) - len(small)
    with pytest.raises(StructureError, match="no structure"):
        surface_of(labels, "heart")
    empty = Labels(
        labels.grid, labels.numbers, {**labels.structures, 99: Structure(99, "x", (0,) * 3)}
    )
    with pytest.raises(StructureError, match="no voxels"):
        surface_of(empty, "x")


def paths(torso, rng, count):
    for _ in range(count):
        target = torso.bodies[5].center_m + 0.02 * rng.normal(size=3)
        axis = np.array([0.3 * rng.normal(), -1.0, 0.3 * rng.normal()])
        yield target + 0.16 * axis / np.linalg.norm(axis), target


def test_layers_are_those_of_the_torso_without_gaps(torso, labels):
    rng, errors, stated = np.random.default_rng(1), [], []
    compared = 0
    for entry, target in paths(torso, rng, 60):
        found, true = layers_along(labels, entry, target), torso.layers(entry, target)
        assert found[0].entry_m == 0.0
        assert found[-1].exit_m == pytest.approx(0.16)
        assert all(a.exit_m == b.entry_m for a, b in pairwise(found))
        if min(stop - start for _, start, stop in true) < 4e-3:
            continue
        compared += 1
        assert [layer.number for layer in found] == [number for number, _, _ in true]
        errors += [layer.exit_m - t[2] for layer, t in zip(found[:-1], true, strict=False)]
        stated += [layer.exit_std_m for layer in found[:-1]]
    assert compared > 30
    assert np.sqrt(np.mean(np.square(errors))) < 0.15 * 2e-3
    assert np.mean(np.abs(errors) < 2.0 * np.array(stated)) > 0.9


def test_rays_through_the_surfaces_say_the_same(torso, labels):
    (liver,) = [s for s in surfaces(labels) if s.structure.name == "liver"]
    entry, target = next(paths(torso, np.random.default_rng(5), 1))
    axis = (target - entry) / np.linalg.norm(target - entry)
    hits, _, _ = liver.mesh.ray.intersects_location([entry], [axis])
    depths = sorted((hits - entry) @ axis)
    inside = [layer for layer in layers_along(labels, entry, target) if layer.name == "liver"]
    assert inside[0].entry_m == pytest.approx(depths[0], abs=1e-3)


def test_bone_on_the_path_is_an_obstacle_and_air_is_named():
    numbers = np.zeros((20, 20, 20), dtype=np.uint8)
    numbers[:, 5:10], numbers[:, 10:12], numbers[:, 12:] = 1, 2, 1
    structures = {1: Structure(1, "muscle", (1, 0, 0)), 2: Structure(2, "rib_left_9", (1, 1, 1))}
    labels = Labels(Grid(np.zeros(3), 1e-3 * np.eye(3), (20, 20, 20)), numbers, structures)
    found = layers_along(labels, [0.01, 0.0, 0.01], [0.01, 0.018, 0.01])
    assert [(layer.name, layer.is_obstacle) for layer in found] == [
        ("unlabelled", False),
        ("muscle", False),
        ("rib_left_9", True),
        ("muscle", False),
    ]
    assert found[1].entry_m == pytest.approx(4.5e-3, abs=0.05e-3)


@pytest.mark.parametrize(
    ("entry", "target", "says"),
    [
        ([0, 0, 0], [0, 0, 0], "0 m apart"),
        ([0, 0, 0], [40, 60, 80], "in millimetres"),
        ([0, 0, 0], [0, 0, 0.9], "outside the volume"),
        ([0, 0], [0, 0, 0.1], "three metres"),
        ([0, np.nan, 0], [0, 0, 0.1], "three metres"),
    ],
)
def test_a_path_that_cannot_be_is_refused(labels, entry, target, says):
    with pytest.raises(PathError, match=says):
        layers_along(labels, entry, target)
