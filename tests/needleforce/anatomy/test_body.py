"""Labels against the body and against their CT; body, fat and bone found in it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from groundtruth import analytic_torso
from needleforce.anatomy import (
    Grid,
    Labels,
    Structure,
    Volume,
    VolumeError,
    read_labels,
)
from tests.needleforce.anatomy import made_files as made

SHOWN_HU = {
    "fat": -100.0, "muscle": 50.0, "cavity": -60.0, "vertebra": 250.0,
    "rib_right": 300.0, "stomach": 30.0, "liver": 60.0, "vessel": 150.0,
    "lesion": 20.0,
}  # fmt: skip


class Case:
    """A torso at 4 mm voxels: its labels, and a noisy scan of it."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        torso = analytic_torso(rng)
        shape = (90, 64, 84)
        self.grid = Grid(shape, np.array([-0.178, -0.126, -0.166]), 4e-3 * np.eye(3))
        self.values = torso.voxels(shape, self.grid.origin_m, self.grid.axes_m)
        units = [-1000.0, *(SHOWN_HU[shape.name] for shape in torso.shapes)]
        shown_HU = np.array(units)[self.values] + rng.normal(0.0, 20.0, shape)
        self.scan = Volume(shown_HU, self.grid)
        self.structures = [
            Structure.named(shape.name, k) for k, shape in enumerate(torso.shapes, 1)
        ]

    def labels(self, values=None, grid=None):
        chosen = np.ascontiguousarray(self.values if values is None else values)
        return Labels.of([chosen], grid or self.grid, self.structures)


def part(values, grid, name="part"):
    return Labels.of([values.astype(np.uint8)], grid, [Structure.named(name, 1)])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1000, 1001, 1002])
def test_right_labels_pass_and_say_what_was_checked(seed):
    case = Case(seed)

    assert "none was given" in case.labels().unchecked
    assert case.labels().with_body(case.scan).unchecked == ""
    case.structures = [Structure.named(f"s{k}", k) for k in range(1, 4)]
    assert "not checked" in case.labels().checked_against(case.scan).unchecked


@pytest.mark.parametrize("seed", [1000, 1001])
@pytest.mark.parametrize(
    "change",
    [
        lambda values: values[::-1],
        lambda values: values[:, ::-1],
        lambda values: values[:, :, ::-1],
        lambda values: np.roll(values, 5, axis=0),
        lambda values: np.roll(values, 5, axis=1),
        lambda values: np.roll(values, -5, axis=2),
    ],
    ids=["mirror x", "mirror y", "mirror z", "20 mm x", "20 mm y", "-20 mm z"],
)
def test_mirrored_and_shifted_labels_are_refused(seed, change):
    case = Case(seed)
    with pytest.raises(VolumeError):
        case.labels(change(case.values)).with_body(case.scan)


@pytest.mark.parametrize(
    ("name", "inside_HU"),
    [
        ("liver", -80.0), ("liver", 300.0), ("lung_left", 0.0), ("rib_left_3", 20.0),
        ("fat", 40.0), ("kidney_left", -100.0), ("spleen", -100.0), ("aorta", -100.0),
        ("gluteus_left", -150.0),
    ],
)  # fmt: skip
def test_every_kind_must_show_its_own_units(name, inside_HU):
    values = np.pad(np.ones((10, 10, 10), np.uint8), 10)
    grid = Grid(values.shape, np.zeros(3), 3e-3 * np.eye(3))
    scan = Volume(np.where(values, inside_HU, -1000.0), grid)

    with pytest.raises(VolumeError, match="HU"):
        part(values, grid, name).checked_against(scan)
    # A lesion in it may show anything.
    assert part(values, grid, f"{name}_lesion").checked_against(scan).unchecked


def test_a_negated_affine_is_refused_even_of_both_files(tmp_path):
    case = Case(1000)
    turn = np.diag([-1.0, -1.0, 1.0])
    grid = Grid(case.grid.shape, turn @ case.grid.origin_m, turn @ case.grid.axes_m)

    with pytest.raises(VolumeError):
        case.labels(grid=grid).checked_against(case.scan)
    made.write_image(tmp_path / "a.nii.gz", case.values[::-1, ::-1], [4.0] * 3)
    with pytest.raises(VolumeError, match="front"):
        read_labels(
            tmp_path / "a.nii.gz", {one.value: one.name for one in case.structures}
        )


def blocks(folder, places, **settings):
    """Read structures of a few voxels that lie at places in LPS [cm]."""
    values = np.zeros((61, 61, 61), np.uint8)
    for number, place in enumerate(places.values(), 1):
        i, j, k = 30 + np.array(place)
        values[i : i + 2, j : j + 2, k : k + 2] = number
    made.write_image(folder / "labels.nii.gz", values, [4.0] * 3)
    return read_labels(folder / "labels.nii.gz", dict(enumerate(places, 1)), **settings)


@pytest.mark.parametrize(
    ("places", "why"),
    [
        ({"kidney_left": (-6, 0, 0), "kidney_right": (6, 0, 0)}, "left"),
        ({"liver": (6, 0, 0), "spleen": (-6, 0, 0)}, "left"),
        ({"lung_left": (0, 0, -9), "urinary_bladder": (0, 0, 9)}, "head"),
        ({"skull": (0, 0, -9), "liver": (0, 0, 9)}, "head"),
        ({"vertebrae_L1": (0, 0, -9), "vertebrae_L3": (0, 0, 0)}, "head"),
        ({"vertebrae_L1": (0, 0, 0), "vertebrae_T12": (0, 0, -4)}, "head"),
        ({"liver": (0, 9, 0), "vertebrae_L1": (0, 0, 0)}, "front"),
    ],
)
def test_structures_that_lie_the_wrong_way_round_are_refused(tmp_path, places, why):
    with pytest.raises(VolumeError, match=why):
        blocks(tmp_path, places)

    mirrored = {name: tuple(-1 * np.array(place)) for name, place in places.items()}
    assert len(blocks(tmp_path, mirrored).structures) == 2


@pytest.mark.parametrize("count", [1, 6])
@pytest.mark.parametrize("is_inverse", [False, True])
def test_liver_and_spleen_must_be_right_whatever_else_is(tmp_path, count, is_inverse):
    side = -1 if is_inverse else 1
    ribs = {
        f"rib_{name}_{k}": (x_cm, 0, k)
        for name, x_cm in (("left", 10), ("right", -10))
        for k in range(count)
    }
    places = {"liver": (-6 * side, 5, 0), "spleen": (6 * side, 5, 0), **ribs}
    blocks(tmp_path, places, situs_inversus=is_inverse)
    with pytest.raises(VolumeError, match="situs"):
        blocks(tmp_path, places, situs_inversus=not is_inverse)
    # A single other pair may be wrong.
    wrong = {"kidney_left": (-4, 0, 0), "kidney_right": (4, 0, 0)}
    assert blocks(tmp_path, places | wrong, situs_inversus=is_inverse)


def blobs(rng, shape, level):
    """A mask of uneven bodies, some of which reach the edges."""
    return ndimage.gaussian_filter(rng.normal(size=shape), 2.5) > level


def largest(mask):
    parts, _ = ndimage.label(mask)
    return parts == np.bincount(parts[parts > 0]).argmax()


def filled(mask, head_axis):
    sections = np.moveaxis(mask, head_axis, 0)
    return np.moveaxis(
        np.array([ndimage.binary_fill_holes(one) for one in sections]), 0, head_axis
    )


@pytest.mark.parametrize("head_axis", [0, 1, 2])
def test_the_largest_body_is_found_with_its_holes_and_its_fat(head_axis):
    rng = np.random.default_rng(1000 + head_axis)
    shape = (26, 22, 24)
    sides = np.meshgrid(*[np.linspace(-1, 1, n) for n in shape], indexing="ij")
    inside = np.linalg.norm(sides, axis=0) < 0.8
    scan_HU = np.where(inside, 40.0, -1000.0)
    scan_HU[inside & blobs(rng, shape, 0.02)] = -100.0
    scan_HU[inside & blobs(rng, shape, 0.06)] = -900.0  # holes, closed and open
    scan_HU = (scan_HU + 45.0 * rng.normal(size=shape)).astype(np.int16)
    grid = Grid(shape, np.zeros(3), np.roll(1e-3 * np.eye(3), head_axis - 2, axis=1))
    fractions = []
    labels = part(inside, grid).with_body(
        Volume(scan_HU, grid), fat=True, progress=fractions.append
    )
    body = filled(largest(scan_HU > -300), head_axis)
    is_fat = body & (ndimage.median_filter(scan_HU, 3) < -30)

    np.testing.assert_array_equal(labels.volumes[1] == labels["fat"].value, is_fat)
    np.testing.assert_array_equal(labels.volumes[1] > 0, body)
    assert labels["fat"].voxels == is_fat.sum() > 100
    assert fractions[-1] == 1.0


@pytest.mark.parametrize(
    ("turn", "step", "shift"),
    [
        (np.eye(3), [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]),
        (np.diag([-1.0, -1.0, 1.0]), [1.0, 1.0, 1.0], [23.0, 29.0, 0.0]),
        (np.eye(3)[[2, 0, 1]], [1.0, 0.41, 2.31], [3.2, -4.4, 1.1]),
        (np.eye(3), [0.25, 0.25, 0.25], [-0.375, -0.375, -0.375]),
        (Rotation.from_rotvec([0.1, 0.3, -0.2]).as_matrix(), [1, 1, 1], [2, 0, 1]),
    ],
)
def test_the_body_on_another_grid_is_that_of_the_nearest_voxel(turn, step, shift):
    rng = np.random.default_rng(1000)
    inside = filled(largest(np.pad(blobs(rng, (22, 28, 25), -0.2), 1)), 2)
    oblique = Rotation.from_rotvec([0.1, -0.05, 0.1]).as_matrix()
    source = Grid(inside.shape, np.array([0.1, 0.2, 0.0]), oblique * 1e-3)
    target = Grid((40, 33, 36), source.points_m(shift), source.axes_m @ (turn * step))
    values = np.zeros(target.shape, np.uint8)
    middle_m = source.points_m(0.5 * np.array(source.shape))
    voxel = np.rint(target.indices(middle_m)).astype(int)
    values[tuple(np.minimum(voxel, np.array(target.shape) - 1))] = 1
    scan = Volume(np.where(inside, 40, -1000).astype(np.int16), source)
    body = part(values, target).with_body(scan).volumes[1]
    expected = ndimage.affine_transform(
        inside.astype(np.uint8),
        turn * step,
        np.array(shift, float),
        target.shape,
        order=0,
        mode="grid-constant",
    )

    # Ties between two voxels may go either way.
    assert np.count_nonzero(body != expected) < 2e-4 * expected.size


@pytest.mark.parametrize("back", [1.0, -1.0])
def test_a_couch_that_touches_the_back_is_no_body(back):
    """A trunk that tapers on a hollow couch of 400 x 20 mm, which it touches."""
    steps_m = ((120, 4e-3), (80, back * 4e-3), (40, 4e-3))
    sides = (step_m * (np.arange(n) - n / 2) for n, step_m in steps_m)
    x_m, y_m, z_m = np.meshgrid(*sides, indexing="ij")
    # From front to back, 64 to 96 mm.
    trunk = (x_m / 0.15) ** 2 + (y_m / (0.08 + 0.1 * z_m)) ** 2 < 1.0
    depth_m = y_m - 0.088  # it reaches into the upper sections' back
    couch = (np.abs(x_m) < 0.2) & (depth_m >= 0.0) & (depth_m < 0.02)
    filling = (np.abs(x_m) < 0.19) & (depth_m >= 5e-3) & (depth_m < 15e-3)
    scan_HU = np.select([filling, trunk | couch], [-950, 40], -1000)
    grid = Grid(trunk.shape, np.zeros(3), np.diag([4e-3, back * 4e-3, 4e-3]))
    scan = Volume(scan_HU.astype(np.int16), grid)
    body = part(trunk, grid).with_body(scan).volumes[1] > 0
    alone = trunk & (depth_m <= 0.0) & ~couch

    assert (body & couch).sum() < 0.02 * couch.sum()
    assert (alone & ~body).sum() < 0.01 * alone.sum()


@pytest.mark.parametrize("shown_HU", [(-1000.0, -1000.0), (24.0, 1064.0), (0.0, 900.0)])
def test_a_scan_without_air_or_body_is_refused(shown_HU):
    values = np.zeros((6, 5, 4), np.uint8)
    values[2:4, 1:4, 1:3] = 1
    grid = Grid(values.shape, np.zeros(3), 1e-3 * np.eye(3))
    scan = Volume(np.array(shown_HU)[values], grid)

    with pytest.raises(VolumeError, match="air"):
        part(values, grid).with_body(scan)


def test_what_is_dense_as_bone_and_not_labelled_is_an_obstacle():
    values = np.zeros((40, 40, 40))
    values[10:14, 10:14, :] = 400.0  # labelled as a rib
    values[20:24, 20:24, :] = 300.0  # nobody labelled it
    values[30, 30:38, 30] = 900.0  # 8 mm³: a calcification
    grid = Grid(values.shape, np.zeros(3), 1e-3 * np.eye(3))
    volume = np.zeros(values.shape, np.uint8)
    volume[10:14, 10:14, :] = 1
    volume[22:, 20:, :] = 2
    structures = [Structure.named("rib_left_7", 1), Structure.named("lean", 2)]
    labels = Labels.of([volume], grid, structures)
    found = labels.with_dense(Volume(values, grid))
    near = found.clearances([0.0, 0.0215, 0.02], [0.039, 0.0215, 0.02])[0]
    soft = Volume(np.minimum(values, 100.0), grid)

    assert found["dense_as_bone"].voxels == 4 * 4 * 40 == found["rib_left_7"].voxels
    seen = (near.name, near.distance_m, near.is_obstacle)
    assert seen == ("dense_as_bone", 0.0, True)
    assert labels.with_dense(soft).structures == labels.structures


def test_two_structures_of_one_name_are_refused():
    grid = Grid((2, 2, 2), np.zeros(3), np.eye(3))
    values = np.arange(8).reshape(grid.shape)
    with pytest.raises(VolumeError, match="rib"):
        Labels.of([values], grid, [Structure.named("rib", k) for k in (1, 2)])


@pytest.mark.parametrize(
    ("name", "is_obstacle", "is_risk"),
    [
        *((name, True, False) for name in (
            "RightRib9", "Rib7R", "CostalCartilage", "rib_left_7", "RIB", "CTRib",
            "L3Vertebra", "costal_cartilages", "hip_right", "vertebrae_L1", "Rib,_left",
            "Spine", "bones", "mandible", "vertebral_body", "scapulae", "ribcage",
            "pelvis",
        )),
        *((name, False, True) for name in ("lung_left", "portal_vein", "Colon")),
        *((name, False, False) for name in (
            "hippocampus", "liver", "tribology", "RenalPelvis", "kidney-pelvis", "L5",
        )),
    ],
)  # fmt: skip
def test_names_say_what_stops_a_needle_and_what_is_at_risk(name, is_obstacle, is_risk):
    structure = Structure.named(name, 1)

    assert (structure.is_obstacle, structure.is_risk) == (is_obstacle, is_risk)
    assert all(0.0 <= shade <= 1.0 for shade in structure.colour)
    coded = replace(Structure.named("x1", 1, kind="Rib"), volume=1)
    assert (coded.is_obstacle, coded.anatomy) == (True, "Rib")
