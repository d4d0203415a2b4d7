"""Obstacles near a path: judged on voxels, none missed, clearances in metres."""

import json

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from needleforce.anatomy import (
    FreeSpace,
    Grid,
    Labels,
    Layer,
    PlanError,
    PlanMatch,
    Registration,
    Structure,
    VolumeError,
    VoxelBoxes,
    require_clear_path,
)
from needleforce.cli import main


def labels_of(values, names, spacing_m=(1e-3, 1e-3, 1e-3), rotation=None):
    axes_m = (np.eye(3) if rotation is None else rotation) * np.array(spacing_m)
    grid = Grid(values.shape, np.zeros(3), axes_m)
    structures = [Structure.named(name, k) for k, name in enumerate(names, 1)]
    return Labels.of([values], grid, structures)


def cage(spacing_m, rng):
    """Ribs as thin as a voxel around a lung, in any orientation."""
    shape = np.ceil(0.12 / spacing_m).astype(int)
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    places_m = places * spacing_m - 0.06
    radius_m = np.linalg.norm(places_m[..., :2], axis=-1)
    angle = np.arctan2(places_m[..., 1], places_m[..., 0])
    height = places_m[..., 2] - 0.012 * angle
    values = np.where(radius_m < 0.045, 1, 0).astype(np.uint8)
    is_rib = (np.abs(radius_m - 0.048) < 1.5e-3) & (np.mod(height, 0.024) < 5e-3)
    values[is_rib] = 2
    rotation = Rotation.random(random_state=rng).as_matrix()
    return labels_of(values, ["lung", "rib_left_9"], spacing_m, rotation)


def brute_distance_m(labels, name, entry_m, target_m):
    """Least distance of a fine row of points from the boxes of all voxels."""
    spacing_m = labels.grid.spacing_m
    centres_m = np.argwhere(labels.volumes[0] == labels[name].value) * spacing_m
    turn = labels.grid.axes_m / spacing_m
    points_m = (entry_m + np.linspace(0, 1, 301)[:, None] * (target_m - entry_m)) @ turn
    gaps_m = np.abs(points_m[:, None] - centres_m) - 0.5 * spacing_m
    return float(np.linalg.norm(np.maximum(gaps_m, 0.0), axis=-1).min())


@pytest.mark.slow
@pytest.mark.parametrize("slices_m", [1e-3, 3e-3, 10e-3])
def test_no_path_through_a_voxel_of_a_thin_rib_is_reported_clear(slices_m):
    rng = np.random.default_rng(1000)
    labels = cage(np.array([2e-3, 2e-3, slices_m]), rng)
    boxes = VoxelBoxes(labels, labels["rib_left_9"])
    corner = np.array(labels.grid.shape) - 1.0
    crossed = 0
    for _ in range(20):
        fractions = np.array([rng.uniform(0.0, 1.0, 3), rng.uniform(0.4, 0.6, 3)])
        entry_m, target_m = labels.grid.points_m(fractions * corner)
        true_m = brute_distance_m(labels, "rib_left_9", entry_m, target_m)
        nearest = boxes.nearest(entry_m, target_m)
        layers = labels.layers_along(entry_m, target_m)
        has_bone = any(layer.is_obstacle for layer in layers)

        assert nearest.distance_m == pytest.approx(true_m, abs=3e-4)
        assert has_bone or true_m > 0.0
        assert boxes.nearest(entry_m, target_m, true_m + 4e-4) == nearest
        assert true_m == 0.0 or boxes.nearest(entry_m, target_m, true_m - 4e-4) is None
        crossed += has_bone

    assert 1 < crossed < 20


def test_a_path_that_grazes_the_face_of_a_bone_voxel_has_bone():
    values = np.zeros((20, 20, 20), np.uint8)
    values[10, 10, 10] = 1
    labels = labels_of(values, ["rib"])
    layers = labels.layers_along([0.0, 0.0105, 0.010], [0.019, 0.0105, 0.010])

    assert [layer.name for layer in layers] == ["unlabelled", "rib", "unlabelled"]
    assert [layer.exit_m for layer in layers] == pytest.approx([0.0095, 0.0105, 0.019])


def test_a_path_inside_bone_from_end_to_end_is_no_clear_one():
    labels = labels_of(np.ones((20, 20, 20), np.uint8), ["femur"])
    boxes = VoxelBoxes(labels, labels.structures[0])

    assert boxes.nearest([0.009] * 3, [0.011] * 3) == (0.0, 0.0)
    assert boxes.nearest([0.009] * 3, [0.011] * 3, 0.0) == (0.0, 0.0)


def test_the_distance_is_that_of_the_nearest_box_and_the_depth_of_its_first_point():
    rng = np.random.default_rng(1000)
    spacing_m = np.array([0.7e-3, 0.9e-3, 1.5e-3])
    values = (ndimage.gaussian_filter(rng.normal(size=(24, 30, 27)), 2.5) > 0.08) * 1
    labels = labels_of(values.astype(np.uint8), ["rib"], spacing_m)
    boxes = VoxelBoxes(labels, labels.structures[0])
    low_m = (np.argwhere(values) - 0.5) * spacing_m
    for _ in range(60):
        ends_m = rng.uniform(-0.01, 0.05, (2, 3))
        found = boxes.nearest(*ends_m)
        points_m = ends_m[0] + np.linspace(0, 1, 401)[:, None] * (ends_m[1] - ends_m[0])
        # A box is nearest at one of its points: the clipped point of the path.
        nearest_m = np.clip(points_m[:, None], low_m, low_m + spacing_m)
        gaps_m = np.linalg.norm(points_m[:, None] - nearest_m, axis=-1).min(axis=1)
        step_m = np.linalg.norm(ends_m[1] - ends_m[0]) / 400

        assert found.distance_m <= gaps_m.min() + 1e-9
        # Half a step beside the nearest place the distance has grown by no more.
        assert found.distance_m >= gaps_m.min() - 0.5 * step_m - 1e-9
        at_m = ends_m[0] + found.depth_m / (400 * step_m) * (ends_m[1] - ends_m[0])
        gap_m = np.linalg.norm(at_m - np.clip(at_m, low_m, low_m + spacing_m), axis=-1)
        assert gap_m.min() == pytest.approx(found.distance_m, abs=2e-9)
        if gaps_m.min() == 0.0:
            assert found.depth_m <= step_m * np.argmin(gaps_m)


def slab_beside(distance_voxels):
    """A rib, a lung and a liver, the rib so many voxels beside the path along x."""
    values = np.zeros((30, 40, 30), np.uint8)
    values[10:14, 10 + distance_voxels :, :] = 1
    values[5:25, 0:4, :] = 2
    values[20:, 8:12, :] = 3
    return labels_of(values, ["rib_right_8", "lung_right", "liver"])


ENTRY_m = [0.0, 0.010, 0.015]
TARGET_m = [0.028, 0.010, 0.015]


def test_the_clearance_of_obstacles_and_structures_at_risk_is_stated():
    labels = slab_beside(6)
    found = labels.clearances(ENTRY_m, TARGET_m)

    assert [(one.name, one.is_obstacle) for one in found] == [
        ("rib_right_8", True),
        ("lung_right", False),
    ]
    assert [one.distance_m for one in found] == pytest.approx([5.5e-3, 6.5e-3])
    assert 9.4e-3 < found[0].depth_m < 13.6e-3

    (liver,) = labels.clearances(ENTRY_m, TARGET_m, ["liver"])

    assert (liver.distance_m, liver.depth_m) == (0.0, pytest.approx(19.5e-3))


def test_needle_margin_and_registration_are_kept_free():
    found = slab_beside(6).clearances(ENTRY_m, TARGET_m)
    require_clear_path(found, FreeSpace(1e-3, 2e-3, 1.2e-3))  # 5.4 mm of 5.5

    with pytest.raises(PlanError, match=r"rib_right_8 at 5.5 mm.* 5.6 mm: .* 2.6"):
        require_clear_path(found, FreeSpace(1e-3, 2e-3, 1.3e-3))

    require_clear_path(found, FreeSpace(1e-3, 2e-3, 1.3e-3), ["rib_right_8"])


def test_the_largest_deviation_of_a_registration_counts():
    covariance = np.diag([1e-4, 0.0, 0.0, 1e-6, 4e-6, 0.0])
    registration = Registration(
        np.eye(3), np.zeros(3), covariance, np.zeros(3), np.inf, 0.0
    )

    assert registration.largest_std_m([[0.0, 0.0, 0.0]]) == pytest.approx(2e-3)
    # A turn of 10 mrad about x moves y by 1 mm at 100 mm along z.
    assert registration.largest_std_m(
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]
    ) == pytest.approx(np.sqrt(5.0) * 1e-3)


def test_axes_that_are_not_orthogonal_are_refused():
    axes_m = 1e-3 * (np.eye(3) + 0.1 * np.eye(3, k=1))
    values = np.ones((4, 4, 4), np.uint8)
    grid = Grid(values.shape, np.zeros(3), axes_m)
    labels = Labels.of([values], grid, [Structure.named("rib", 1)])

    with pytest.raises(VolumeError, match=r"axes .* not orthogonal"):
        labels.clearances([0.0, 0.0, 0.0], [0.002, 0.002, 0.002])


def test_a_plan_through_bone_is_refused_unless_the_bone_is_accepted():
    layers = [
        Layer("fat", 0.0, 0.01, 0.0, 1e-3, False),
        Layer("rib_left_7", 0.01, 0.014, 1e-3, 1e-3, True),
        Layer("lung", 0.014, 0.04, 1e-3, 1e-3, False),
    ]

    with pytest.raises(PlanError, match=r"rib_left_7 from 10.0 to 14.0 mm"):
        PlanMatch(layers, 3e-3)

    match = PlanMatch(layers, 3e-3, accepted_obstacles=["rib_left_7"])

    assert match.state(0.005).is_obstacle_next


def test_an_arm_is_not_watched_on_a_path_too_near_to_bone(tmp_path, capsys):
    sitk = pytest.importorskip("SimpleITK")
    labels = slab_beside(4)
    image = sitk.GetImageFromArray(labels.volumes[0].T)
    sitk.WriteImage(image, str(tmp_path / "labels.nii.gz"))
    names = {k: one.name for k, one in enumerate(labels.structures, 1)}
    (tmp_path / "labels.json").write_text(json.dumps(names))
    plan = {"entry_m": ENTRY_m, "target_m": TARGET_m, "offset_std_m": 1e-3}
    (tmp_path / "plan.json").write_text(json.dumps(plan))

    assert main(["live", "sim:gel-25-constant", "--plan", str(tmp_path)]) == 2
    assert "passes rib_right_8 at 3.5 mm" in capsys.readouterr().err


def test_a_boundary_passed_by_less_than_an_alarm_takes_is_not_yet_missed():
    layers = [
        Layer("gel", 0.0, 0.02, 0.0, 1e-4, False),
        Layer("muscle", 0.02, 0.06, 1e-4, 1e-4, False),
    ]
    match = PlanMatch(layers, 2e-4)
    before, at, behind = (
        match.state(depth_m, contact_m=0.0) for depth_m in (0.0195, 0.0203, 0.022)
    )

    assert before.name == at.name == "gel"
    assert before.probability > 0.98
    assert at.probability > 0.7
    assert behind.name == "muscle"


def test_a_vessel_of_one_voxel_is_a_layer():
    values = np.ones((30, 30, 30), np.uint8)
    values[15, 14, :] = 2
    labels = labels_of(values, ["liver", "portal_vein"])
    layers = labels.layers_along([0.002, 0.0143, 0.015], [0.028, 0.0143, 0.015])

    assert [layer.name for layer in layers] == ["liver", "portal_vein", "liver"]
    assert layers[1].entry_m == pytest.approx(12.5e-3)
    assert layers[1].exit_m == pytest.approx(13.5e-3)
