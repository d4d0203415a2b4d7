"""Layers along a path: against the exact crossings, and against rays through the
surfaces."""

from itertools import pairwise

import numpy as np
import pytest

from benchmarks.anatomy.path import measure_path, random_path, scan_of
from groundtruth.torso import analytic_torso
from needleforce.anatomy import Grid, Labels, Structure, VolumeError

SPACING_MM = (3.0, 3.0, 3.0)

X = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def scanned():
    rng = np.random.default_rng(1001)
    torso = analytic_torso(rng)
    return torso, scan_of(torso, SPACING_MM, rng), rng


def test_torso_paths_are_right_without_gaps(scanned):
    """Paths through a torso are right and have no gaps."""
    torso, labels, rng = scanned
    paths = [measure_path(torso, labels, *random_path(torso, rng)) for _ in range(150)]
    errors = np.array([error for path in paths for error in path.errors_voxels])
    scores = np.abs([score for path in paths for score in path.scores])

    assert np.sqrt(np.mean(errors**2)) < 0.18
    assert np.mean([path.is_right for path in paths]) > 0.97
    assert not any(path.has_gaps for path in paths)
    assert 0.9 < np.mean(scores < 1.96) <= 1.0


def test_rays_cross_surfaces_where_layers_begin(scanned):
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    torso, labels, rng = scanned
    surface = labels.surfaces(["lesion"])["lesion"]
    mesh = trimesh.Trimesh(surface.vertices_m, surface.triangles, process=False)
    differences = []
    for _ in range(30):
        entry, _ = random_path(torso, rng)
        target = labels.centroid_m("lesion")
        layers = labels.layers_along(entry, target)
        assert layers[-1].name == "lesion"
        along = (target - entry) / np.linalg.norm(target - entry)
        hits, _, _ = mesh.ray.intersects_location(entry[None], along[None])
        depths = (hits - entry) @ along
        differences.append(layers[-1].entry_m - depths.min())

    assert np.sqrt(np.mean(np.square(differences))) < 0.2 * 1e-3 * SPACING_MM[0]


def slabs(names, spacing_m=1e-3, kind=np.uint8):
    """Structures of ten voxels each, one behind the other along x."""
    values = np.repeat(np.arange(1, len(names) + 1, dtype=kind), 10)
    values = np.broadcast_to(values[:, None, None], (len(values), 20, 20)).copy()
    grid = Grid(values.shape, np.zeros(3), spacing_m * np.eye(3))
    return Labels.of(
        [values], grid, [Structure.named(n, i) for i, n in enumerate(names, 1)]
    )


def drawn(values_at):
    """Structures fat, muscle, liver by values at the indices of 40 voxels a side."""
    values = values_at(np.indices((40, 40, 40), float)).astype(np.uint8)
    grid = Grid(values.shape, np.zeros(3), 1e-3 * np.eye(3))
    structures = [
        Structure.named(name, number)
        for number, name in enumerate(["fat", "muscle", "liver"], 1)
        if (values == number).any()
    ]
    return Labels.of([values], grid, structures)


def test_a_layer_thinner_than_a_voxel_begins_where_its_neighbour_ends():
    way = np.array([1.0, 0.31, 0.17])
    way /= np.linalg.norm(way)
    begin_voxels = 22.0
    end_voxels = 22.5

    def slanting(indices):
        along = np.tensordot(way, indices, axes=1)
        return 1 + (along > begin_voxels) + (along > end_voxels)

    labels = drawn(slanting)
    errors_mm = []
    for start in np.random.default_rng(1).uniform(10.0, 24.0, (60, 2)):
        entry = np.array([8.0, *start])
        layers = labels.layers_along(1e-3 * entry, 1e-3 * (entry + 18.0 * X))
        beside = way[1:] @ start
        for layer in layers:
            if layer.name == "muscle":
                ends = (1e3 * layer.entry_m, 1e3 * layer.exit_m)
                for found, true in zip(ends, (begin_voxels, end_voxels), strict=True):
                    errors_mm.append(found - ((true - beside) / way[0] - 8.0))

    assert len(errors_mm) > 40
    assert np.sqrt(np.mean(np.square(errors_mm))) < 0.15


def test_a_grazed_layer_states_how_little_is_known_of_its_ends():
    centre = np.array([20.0, 20.0, 20.0])
    radius = 9.0

    def ball(indices):
        away = indices - centre[:, None, None, None]
        return 1 + (np.linalg.norm(away, axis=0) < radius)

    labels = drawn(ball)
    scores = []
    for depth, turn in np.random.default_rng(1).uniform(
        [0.0, 0.0], [0.4, 7.0], (150, 2)
    ):
        beside = (radius - depth) * np.array([np.cos(turn), np.sin(turn)])
        entry = np.array([2.0, *(centre[1:] + beside)])
        layers = labels.layers_along(1e-3 * entry, 1e-3 * (entry + 36.0 * X))
        half = np.sqrt(radius**2 - beside @ beside)
        for layer in layers:
            if layer.name == "muscle":
                error_mm = 1e3 * layer.entry_m - (18.0 - half)
                scores.append(error_mm / (1e3 * layer.entry_std_m))

    assert len(scores) > 20
    assert np.sqrt(np.mean(np.square(scores))) < 1.3


def test_flat_layers_are_exact_and_bone_obstructs():
    labels = slabs(["fat", "rib_left_9", "muscle"])
    layers = labels.layers_along([-0.0105, 0.01, 0.01], [0.0255, 0.01, 0.01])
    names = ["unlabelled", "fat", "rib_left_9", "muscle"]

    assert [layer.name for layer in layers] == names
    assert [layer.is_obstacle for layer in layers] == [False, False, True, False]

    ends = [layer.exit_m for layer in layers]

    np.testing.assert_allclose(ends, [0.010, 0.020, 0.030, 0.036], atol=2e-5)
    assert all(
        layer.exit_m == next_layer.entry_m for layer, next_layer in pairwise(layers)
    )
    assert all(
        layer.exit_std_m == next_layer.entry_std_m
        for layer, next_layer in pairwise(layers)
    )
    assert layers[0].entry_std_m == layers[-1].exit_std_m == 0.0


def test_a_slanting_path_and_uncertain_boundaries_state_more():
    labels = slabs(["fat", "muscle"])
    straight = labels.layers_along([0.002, 0.01, 0.01], [0.017, 0.01, 0.01])[
        1
    ].entry_std_m
    slanting = labels.layers_along([0.005, 0.002, 0.01], [0.014, 0.017, 0.01])[
        1
    ].entry_std_m
    cosine = 9.0 / np.hypot(9.0, 15.0)

    assert slanting == pytest.approx(straight / cosine, rel=0.1)

    wide = labels.layers_along([0.002, 0.01, 0.01], [0.017, 0.01, 0.01], 0.5e-3)[
        1
    ].entry_std_m

    assert wide == pytest.approx(np.hypot(straight, 0.5e-3), rel=0.02)


@pytest.mark.parametrize(
    "spacing_mm", [(5.0, 0.7, 0.7), (0.7, 5.0, 0.7), (0.7, 0.7, 5.0)]
)
def test_uncertain_boundaries_of_flat_voxels_state_as_much(spacing_mm):
    labels = slabs(["fat", "muscle"], 1e-3 * np.array(spacing_mm))
    entry, target = labels.grid.points_m([[2.0, 10.0, 10.0], [17.0, 10.0, 10.0]])
    plain, wide = (
        labels.layers_along(entry, target, std)[1].entry_std_m for std in (0.0, 1e-3)
    )

    assert wide == pytest.approx(np.hypot(plain, 1e-3), rel=0.02)


@pytest.mark.parametrize("kind", [np.int16, np.int32, np.int64])
def test_labels_may_be_integers_of_any_size(kind):
    way = [0.002, 0.01, 0.01], [0.017, 0.01, 0.01]
    expected = slabs(["fat", "muscle"]).layers_along(*way)

    assert slabs(["fat", "muscle"], kind=kind).layers_along(*way) == expected


def test_a_path_from_outside_stays_in_order():
    layers = slabs(["fat", "muscle"]).layers_along(
        [-0.05, -0.02, -0.02], [0.019, 0.01, 0.01]
    )
    depths = [layer.entry_m for layer in layers]

    assert depths == sorted(depths)
    assert layers[-1].name == "muscle"


@pytest.mark.parametrize(
    ("entry", "target", "why"),
    [
        ([0, 0, 0], [10, 10, 10], "outside the volume"),
        ([0, 0, np.nan], [0.01, 0.01, 0.01], "two points of 3 numbers"),
        (
            [-60.0, 10.0, 10.0],
            [0.01, 0.01, 0.01],
            "60 m outside the volume: expected metres",
        ),
        ([0, 0], [0.01, 0.01, 0.01], "two points of 3 numbers"),
        ([0.01, 0.01, 0.01], [0.01, 0.01, 0.01], "same point"),
    ],
)
def test_paths_that_cannot_be_are_refused(entry, target, why):
    with pytest.raises(VolumeError, match=why):
        slabs(["fat", "muscle"]).layers_along(entry, target)


@pytest.mark.parametrize("std_m", [np.nan, -1e-3, np.inf, 0.5])
def test_an_impossible_boundary_deviation_is_refused(std_m):
    with pytest.raises(
        VolumeError, match=r"boundary_std_m=.*standard deviation in metres"
    ):
        slabs(["fat", "muscle"]).layers_along([0, 0, 0], [0.01, 0.01, 0.01], std_m)
