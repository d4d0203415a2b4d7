"""Layers along a path, clearances beside it, paths that are found, the needle on it."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial.transform import Rotation

from groundtruth import analytic_torso
from needleforce.anatomy import (
    FreeSpace,
    Grid,
    Labels,
    NeedleSurroundings,
    PathLimits,
    PlanError,
    Registration,
    Structure,
    VolumeError,
    VoxelBoxes,
    find_paths,
    require_clear_path,
)
from needleforce.anatomy.path_search import judge_line

X_m = np.array([1e-3, 0.0, 0.0])


def labels_of(values, names, spacing_m=1e-3, rotation=None, origin_m=(0.0, 0.0, 0.0)):
    axes_m = (np.eye(3) if rotation is None else rotation) * np.array(spacing_m)
    grid = Grid(values.shape, np.array(origin_m), axes_m)
    structures = [Structure.named(name, k) for k, name in enumerate(names, 1)]
    return Labels.of([values], grid, structures)


def slabs(*names, spacing_m=1e-3):
    """Structures of ten voxels each, one behind the other along x."""
    values = np.repeat(np.arange(1, len(names) + 1, dtype=np.uint8), 10)
    return labels_of(np.tile(values[:, None, None], (1, 20, 20)), names, spacing_m)


def drawn(values_at, starts, depth_mm):
    """Layers of muscle along x, and the offsets across of each [mm].

    Of structures fat, muscle, liver by values at the indices of 40 voxels a side.
    """
    values = values_at(np.indices((40, 40, 40), float)).astype(np.uint8)
    labels = labels_of(values, ["fat", "muscle", "liver"][: values.max()])
    return [
        (layer, start[1:])
        for start in starts
        for layer in labels.layers_along(1e-3 * start, 1e-3 * start + depth_mm * X_m)
        if layer.name == "muscle"
    ]


def test_paths_through_a_torso_are_right_without_gaps():
    rng = np.random.default_rng(1001)
    torso = analytic_torso(rng)
    origin_m = np.array([-0.18, -0.127, -0.168]) + 3e-3 * rng.uniform(size=3)
    values = torso.voxels((120, 86, 112), origin_m, 3e-3 * np.eye(3))
    labels = labels_of(
        values, [body.name for body in torso.shapes], 3e-3, origin_m=origin_m
    )
    liver = torso["liver"]
    errors = []
    for _ in range(150):
        aside = rng.uniform(-0.4, 0.4, 3)
        target_m = liver.centre_m + liver.axes @ (aside * liver.radii_m)
        turn = rng.uniform(-2.6, -0.8)
        away = np.array([np.cos(turn), np.sin(turn), rng.uniform(-0.5, 0.5)])
        entry_m = target_m + 0.16 * away / np.linalg.norm(away)
        layers = labels.layers_along(entry_m, target_m)
        for pair in pairwise(torso.crossings(entry_m, target_m)):
            sides = [one.name or "unlabelled" for one in pair]
            found = [
                [b.entry_m - pair[1].entry_m, b.entry_std_m]
                for a, b in pairwise(layers)
                if [a.name, b.name] == sides
            ]
            errors += sorted(found, key=lambda error: abs(error[0]))[:1]
        ends_m = (layers[0].entry_m, layers[-1].exit_m)
        assert ends_m == (0.0, pytest.approx(0.16))
        assert all(a.exit_m == b.entry_m >= a.entry_m for a, b in pairwise(layers))

    off_m, std_m = np.transpose(errors)
    assert len(off_m) > 600
    assert np.sqrt(np.mean(off_m**2)) < 0.18 * 3e-3
    assert 0.9 < np.mean(np.abs(off_m) < 1.96 * std_m) <= 1.0


def test_a_layer_thinner_than_a_voxel_begins_where_its_neighbour_ends():
    way = np.array([1.0, 0.31, 0.17]) / np.sqrt(1.125)
    ends = np.array([22.0, 22.5])
    places = np.random.default_rng(1).uniform(10.0, 24.0, (60, 2))
    found = drawn(
        lambda index: (
            1 + np.sum([np.tensordot(way, index, 1) > k for k in ends], axis=0)
        ),
        [np.array([8.0, *place]) for place in places],
        18.0,
    )
    errors_mm = [
        1e3 * np.array([one.entry_m, one.exit_m])
        - ((ends - way[1:] @ at) / way[0] - 8.0)
        for one, at in found
    ]

    assert len(found) > 20
    assert np.sqrt(np.mean(np.square(errors_mm))) < 0.15
    assert all(0.0 < one.entry_std_m < 2e-3 for one, _ in found)


def test_a_grazed_layer_states_how_little_is_known_of_its_ends():
    middle = np.full((3, 1, 1, 1), 20.0)
    draws = np.random.default_rng(1).uniform([0.0, 0.0], [0.4, 7.0], (150, 2))
    turned = np.transpose([np.cos(draws[:, 1]), np.sin(draws[:, 1])])
    across = 20.0 + (9.0 - draws[:, :1]) * turned
    found = drawn(
        lambda index: 1 + (np.linalg.norm(index - middle, axis=0) < 9.0),
        [np.array([2.0, *place]) for place in across],
        36.0,
    )
    scores = [
        (1e3 * one.entry_m - 18.0 + np.sqrt(81.0 - ((at - 20.0) ** 2).sum()))
        / (1e3 * one.entry_std_m)
        for one, at in found
    ]

    assert len(scores) > 20
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.3


def test_flat_layers_are_exact_and_bone_obstructs():
    labels = slabs("fat", "rib_left_9", "muscle")
    layers = labels.layers_along([-0.0105, 0.01, 0.01], [0.0255, 0.01, 0.01])

    assert [(layer.name, layer.is_obstacle) for layer in layers] == [
        ("unlabelled", False),
        ("fat", False),
        ("rib_left_9", True),
        ("muscle", False),
    ]
    ends_m = [layer.exit_m for layer in layers]
    np.testing.assert_allclose(ends_m, [0.010, 0.020, 0.030, 0.036], atol=2e-5)
    assert all(a.exit_std_m == b.entry_std_m > 0.0 for a, b in pairwise(layers))
    assert layers[0].entry_std_m == layers[-1].exit_std_m == 0.0


@pytest.mark.parametrize("spacing_mm", [(5.0, 0.7, 0.7), (0.7, 5.0, 0.7), (1, 1, 1)])
def test_slanting_paths_state_more(spacing_mm):
    labels = slabs("fat", "muscle", spacing_m=1e-3 * np.array(spacing_mm))
    plain_m, slanting_m = (
        labels.layers_along(*labels.grid.points_m(ends))[1].entry_std_m
        for ends in ([[2, 10, 10], [17, 10, 10]], [[5, 2, 10], [14, 17, 10]])
    )
    cosine = 9.0 / np.hypot(9.0, 15.0 * spacing_mm[1] / spacing_mm[0])

    assert plain_m == pytest.approx(0.105e-3 * spacing_mm[0], rel=0.05)
    assert slanting_m == pytest.approx(plain_m / cosine, rel=0.1)


@pytest.mark.parametrize(
    ("entry", "target"),
    [
        ([0, 0, 0], [0.0, 0.0, -5.1e-4]),
        ([0, 0, 0], [0.0, 0.0, 19.51e-3]),
        ([0, 0, np.nan], [0.01, 0.01, 0.01]),
        ([0, 0, 0], [0.01, 0.01, np.nan]),
        ([-1.01, 0.0, 0.0], [0.01, 0.01, 0.01]),
        ([0.0, 0.0, 1.03], [0.01, 0.01, 0.01]),
        ([0.01, 0.01, 0.01], [0.01, 0.01, 0.01]),
    ],
)
def test_a_path_leads_from_within_a_metre_into_the_volume(entry, target):
    labels = slabs("fat", "muscle")
    with pytest.raises(VolumeError):
        labels.layers_along(entry, target)
    for right in ([-0.99, 0.0, 0.0], [0.0, 0.0, -4.9e-4], [0.0, 0.0, 19.49e-3]):
        assert labels.layers_along(right, [0.01, 0.01, 0.01])
        assert labels.layers_along([0.01, 0.01, 0.01], np.maximum(right, -4.9e-4))


@pytest.mark.parametrize("name", ["rib", "portal_vein"])
def test_a_structure_of_one_voxel_is_a_layer(name):
    values = np.ones((30, 30, 30), np.uint8)
    values[15, 14, :] = 2
    labels = labels_of(values, ["liver", name])
    # Its face is grazed where the path runs along it.
    for y_m in (0.0143, *[0.0145] * (name == "rib")):
        layers = labels.layers_along([0.002, y_m, 0.015], [0.028, y_m, 0.015])
        assert [layer.name for layer in layers] == ["liver", name, "liver"]
        ends_m = [layers[1].entry_m, layers[1].exit_m]
        assert ends_m == pytest.approx([12.5e-3, 13.5e-3])
        assert layers[1].is_obstacle is (name == "rib")


def test_of_overlapping_structures_the_smallest_counts():
    liver = np.ones((30, 30, 30), np.uint8)
    vessel = np.pad(np.ones((10, 10, 10), np.uint8), 10)
    structures = [Structure.named("liver", 1), Structure.named("vessel", 1, volume=1)]
    grid = Grid(liver.shape, np.zeros(3), 1e-3 * np.eye(3))
    labels = Labels.of([liver, vessel], grid, structures)

    assert [
        layer.name for layer in labels.layers_along([0.0, 0.0145, 0.0145], [0.0145] * 3)
    ] == ["liver", "vessel"]


@pytest.mark.parametrize("seed", range(8))
def test_the_clearance_is_that_of_the_nearest_voxels_box(seed):
    rng = np.random.default_rng(seed)
    spacing_m = rng.uniform(0.5e-3, 3e-3, 3)
    noise = ndimage.gaussian_filter(rng.normal(size=(14, 12, 13)), 1.5)
    values = (noise > np.quantile(noise, rng.uniform(0.7, 0.99))).astype(np.uint8)
    labels = labels_of(
        values,
        ["rib"],
        spacing_m,
        Rotation.random(rng=rng).as_matrix(),
        (0.1, -0.2, 0.3),
    )
    boxes = VoxelBoxes(labels, labels["rib"])
    low_m = (np.argwhere(values) - 0.5) * spacing_m
    for _ in range(5):
        ends = rng.uniform(-0.4, 1.4, (2, 3)) * values.shape
        ends_m = labels.grid.points_m(ends)
        found = boxes.nearest(*ends_m)
        length_m = np.linalg.norm(ends_m[1] - ends_m[0])
        depths_m = np.append(np.linspace(0.0, length_m, 101), found.depth_m)
        way_m = (ends[1] - ends[0]) * spacing_m / length_m
        places_m = ends[0] * spacing_m + depths_m[:, None, None] * way_m
        gaps_m = places_m - np.clip(places_m, low_m, low_m + spacing_m)
        all_m = np.linalg.norm(gaps_m, axis=2).min(axis=1)
        least_m = all_m[:-1].min()

        # Half a step beside the nearest place the distance has grown by no more.
        assert least_m - 0.005 * length_m - 1e-8 <= found.distance_m <= least_m + 1e-8
        on_path_m = ends_m[0] + found.depth_m * (ends_m[1] - ends_m[0]) / length_m
        off_m = np.linalg.norm(found.place_m - on_path_m)
        assert (all_m[-1], off_m) == pytest.approx([found.distance_m] * 2, abs=1e-8)
        if least_m == 0.0:  # the first voxel that is crossed counts
            assert found.depth_m <= 0.01 * length_m * all_m.argmin() + 1e-8
        else:
            assert [
                boxes.nearest(*ends_m, found.distance_m + more_m)
                for more_m in (1e-6, -1e-6)
            ] == [found, None]


def test_a_path_inside_bone_from_end_to_end_is_no_clear_one():
    labels = labels_of(np.ones((20, 20, 20), np.uint8), ["femur"])
    (found,) = labels.clearances([0.009] * 3, [0.011] * 3)

    assert (found.distance_m, found.depth_m) == (0.0, 0.0)


def test_axes_that_are_not_orthogonal_are_refused():
    axes_m = 1e-3 * (np.eye(3) + 0.1 * np.eye(3, k=1))
    labels = labels_of(np.ones((4, 4, 4), np.uint8), ["rib"], 1.0, axes_m)

    with pytest.raises(VolumeError, match="orthogonal"):
        labels.clearances([0.0, 0.0, 0.0], [0.002, 0.002, 0.002])


ENTRY_m = [0.0, 0.010, 0.015]
TARGET_m = [0.028, 0.010, 0.015]


def beside(distance_voxels):
    """A rib so many voxels beside the path along x, a lung and a liver."""
    values = np.zeros((30, 40, 30), np.uint8)
    values[10:14, 10 + distance_voxels :, :] = 1
    values[5:25, 0:4, :] = 2
    values[20:, 8:12, :] = 3
    return labels_of(values, ["rib_right_8", "lung_right", "liver"])


def test_clearances_are_stated_and_radius_margin_and_registration_kept_free():
    labels = beside(6)
    found = labels.clearances(ENTRY_m, TARGET_m)
    (liver,) = labels.clearances(ENTRY_m, TARGET_m, ["liver"])

    assert [(one.name, one.is_obstacle) for one in (*found, liver)] == [
        ("rib_right_8", True),
        ("lung_right", False),
        ("liver", False),
    ]
    np.testing.assert_allclose(
        [(1e3 * one.distance_m, 1e3 * one.depth_m) for one in (*found, liver)],
        [[5.5, 9.5], [6.5, 4.5], [0.0, 19.5]],
        atol=1e-6,
    )
    assert labels.clearances([1.0, 0.2, 0.0], [0.9, 0.2, 0.0]) == []
    with pytest.raises(VolumeError, match="spleen"):
        labels.clearances(ENTRY_m, TARGET_m, ["spleen"])

    require_clear_path(found, FreeSpace(1e-3, 2e-3, 1.2e-3))  # 5.4 mm of 5.5
    wide = FreeSpace(1e-3, 2e-3, 1.3e-3)
    with pytest.raises(PlanError, match="rib_right_8"):
        require_clear_path(found, wide)
    require_clear_path([*found, liver], wide, ["rib_right_8"])
    # An 18 G needle with its sheath, and 2 mm.
    assert FreeSpace().needed_m == pytest.approx(2.8e-3)


def block():
    """A body of 80 x 60 x 60 mm, a plate of bone in front, and a lesion in it."""
    values = np.zeros((50, 40, 40), np.uint8)
    values[5:45, 5:35, 5:35] = 1
    values[21:29, 8:12, 8:32] = 2
    values[24:27, 19:22, 19:22] = 3
    return labels_of(values, ("body", "rib", "lesion"), 2e-3)


TARGET = 2e-3 * np.array([25.0, 20.0, 20.0])


def test_paths_lead_from_the_skin_and_keep_their_distance():
    labels = block()
    limits = PathLimits(0.035, np.radians(20.0), FreeSpace(1e-3, 3e-3))
    fractions = []
    found = find_paths(labels, TARGET, ["rib"], limits, fractions.append)
    costs = [path.cost for path in found]

    assert len(costs) > 2
    assert (fractions[-1], costs) == (1.0, sorted(costs))
    for path, other in combinations(found, 2):
        assert np.linalg.norm(other.entry_m - path.entry_m) >= 0.0149
    for path in found:
        voxel = labels.grid.indices(path.entry_m)
        assert np.abs(voxel - [[4.5] * 3, [44.5, 34.5, 34.5]]).min() < 0.6
        assert 0.02 < path.length_m < 0.035
        # From a flat face the angle is that to the nearest axis.
        way = np.abs(path.entry_m - path.target_m) / path.length_m
        assert path.angle_rad == pytest.approx(np.arccos(way.max()), abs=0.25)
        assert path.angle_rad <= np.radians(20.0)
        (rib,) = path.clearances
        assert rib.distance_m > 4e-3
        assert [layer.name for layer in path.layers] == ["body", "lesion"]
    # Short, steep and clear is best: straight up or down, not past the rib.
    best = (found[0].entry_m - TARGET) / found[0].length_m
    assert abs(best[2]) > 0.97 or best[1] > 0.97


@pytest.mark.parametrize(
    ("limits", "word"),
    [
        (PathLimits(0.02), "20 mm"),
        (PathLimits(max_angle_rad=0.001), "normal"),
        (PathLimits(space=FreeSpace(1e-3, 50e-3)), "rib"),
    ],
)
def test_where_there_is_no_path_it_is_said_why(limits, word):
    with pytest.raises(PlanError, match=word):
        find_paths(block(), TARGET, ["rib"], limits)


def test_lines_are_turned_round_and_judged():
    labels = block()
    outside_m = TARGET - [0.0, 0.045, 0.0]
    limits = PathLimits(0.04, np.radians(20.0), FreeSpace(1e-3, 3e-3))
    # The cost counts length, angle and clearance, whichever end lies in the patient.
    path = judge_line(labels, np.array([TARGET, TARGET * [1.0, 1.0, 3.5]]), limits)
    np.testing.assert_array_equal(path.target_m, TARGET)
    (rib,) = labels.clearances(path.entry_m, TARGET, ["rib"])
    cost = path.length_m / 0.04 + path.angle_rad / np.radians(20.0)
    assert path.length_m == pytest.approx(29e-3, abs=1e-3)
    assert path.cost == pytest.approx(cost + 4e-3 / rib.distance_m, rel=0.05)
    for ends_m in ([TARGET, TARGET], [outside_m, outside_m - 0.01]):
        with pytest.raises(VolumeError):
            judge_line(labels, np.array(ends_m))
    for target_m, name in ((outside_m, "rib"), (TARGET, "spleen")):
        with pytest.raises(VolumeError):
            find_paths(labels, target_m, [name])


TURN = Rotation.from_rotvec([0.3, -0.2, 0.5])
SHIFT_m = np.array([0.5, -0.1, 0.2])
PLANNED_m = np.array([[0.04, 0.04, 0.0], [0.04, 0.04, 0.06]])


def surroundings(gap_mm=20, rib_mm=30, **changes):
    """A vessel along y beside the path at 40 mm depth, its face at a gap from it, and a
    rib 30 mm to the other side; voxels of 1 mm."""
    volume = np.zeros((80, 80, 80), np.uint8)
    volume[40 + gap_mm, :, 40] = 1
    volume[40 - rib_mm, 40, 20] = 2
    labels = labels_of(volume, ["portal_vein", "rib_left_7"])
    registration = Registration(
        TURN.as_matrix(), SHIFT_m, np.zeros((6, 6)), SHIFT_m, np.inf, 0.0
    )
    space = FreeSpace(needle_radius_m=1e-3, margin_m=5e-3, std_m=0.5e-3)
    return NeedleSurroundings(labels, registration, *PLANNED_m, space, **changes)


def to_robot(point_m):
    return TURN.apply(point_m) + SHIFT_m


def judge(around, depth_m, aside_m=0.0, turn_rad=0.0):
    axis = Rotation.from_rotvec([0.0, turn_rad, 0.0]).apply([0.0, 0.0, 1.0])
    tip_m = PLANNED_m[0] + [aside_m, 0.0, 0.0] + depth_m * axis
    return {
        one.name: one for one in around.clearances(to_robot(tip_m), TURN.apply(axis))
    }


def test_needle_and_way_ahead_are_measured_apart():
    around = surroundings()
    above, below = (judge(around, depth_m)["portal_vein"] for depth_m in (0.02, 0.05))

    # The face of the vessel's voxels stands 19.5 mm beside the path, its upper edge at
    # a depth of 39.5 mm.
    found_m = [above.needle_m, above.ahead_m, below.needle_m, below.ahead_m]
    expected_mm = [np.hypot(19.5, 19.5), 19.5, 19.5, np.hypot(19.5, 9.5)]
    np.testing.assert_allclose(found_m, 1e-3 * np.array(expected_mm))
    stated = (above.needed_m, above.std_m, above.is_too_near)
    assert stated == (pytest.approx(6e-3), 0.5e-3, False)
    assert (above.is_ahead, below.is_ahead) == (True, False)
    # In front of the skin the needle itself is near to nothing.
    assert judge(around, -0.01)["portal_vein"].needle_m == np.inf
    for found, z_m in ((above, 39.5e-3), (below, 40e-3)):
        place_m = TURN.inv().apply([found.x_m, found.y_m, found.z_m] - SHIFT_m)
        assert place_m[2] == pytest.approx(z_m, abs=0.51e-3)
        np.testing.assert_allclose(place_m[:2], [59.5e-3, 40e-3])


def test_what_is_too_near_comes_first_and_the_target_is_left_out():
    # The plan passes the vessel at 3.5 mm, so it may be 2.5 mm near; the rib, further
    # away, may be 6 mm near.
    found = judge(surroundings(gap_mm=4, rib_mm=7), 0.045, aside_m=-0.7e-3)

    assert [(one.name, one.is_too_near) for one in found.values()] == [
        ("rib_left_7", True),
        ("portal_vein", False),
    ]
    left = judge(surroundings(leave_out=["portal_vein"]), 0.0)
    far, near = (judge(surroundings(), depth_m) for depth_m in (-0.06, -0.04))
    assert [{*left}, far, {*near}] == [
        {"rib_left_7"},
        {},
        {"portal_vein", "rib_left_7"},
    ]


@pytest.mark.parametrize(
    ("gap_mm", "aside_mm", "turn_deg", "is_too_near"),
    [(20, 13, 0, False), (20, 14, 0, True), (4, 0.8, 0, False), (4, 1.2, 0, True),
     (20, 0, 20, True), (20, 0, 10, False)],
)  # fmt: skip
def test_a_needle_beside_its_plan_or_turned_is_too_near_though_the_plan_is_not(
    gap_mm, aside_mm, turn_deg, is_too_near
):
    around = surroundings(gap_mm)
    depth_m = 0.005 if turn_deg else 0.045

    assert not judge(around, depth_m)["portal_vein"].is_too_near
    found = judge(around, depth_m, 1e-3 * aside_mm, np.radians(turn_deg))["portal_vein"]
    assert (found.is_too_near, found.is_ahead) == (is_too_near, bool(turn_deg))
    part = "way ahead" if turn_deg else "needle"
    assert f"the {part} passes portal_vein" in str(found)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), step_mm=st.sampled_from([0.02, 0.2, 2.0]))
def test_distances_are_right_to_a_tenth_whatever_was_measured_before(seed, step_mm):
    around = surroundings()
    fresh = surroundings()
    aside_m = 0.0
    for step_m in np.random.default_rng(seed).normal(0.0, 1e-3 * step_mm, 50):
        judge(fresh, 0.02)
        aside_m = float(np.clip(aside_m + step_m, 0.0, 0.018))
        kept = judge(around, 0.045, aside_m)["portal_vein"]
        assert kept.distance_m == pytest.approx(19.5e-3 - aside_m, abs=0.1e-3)
        # What is said of a place depends on nothing that was said before.
        assert kept == judge(fresh, 0.045, aside_m)["portal_vein"]
