"""Labels against their scan and against the body: what is refused, what passes."""

from dataclasses import replace

import numpy as np
import pytest

from groundtruth.torso import analytic_torso
from needleforce.anatomy import (
    Grid,
    Labels,
    Structure,
    Volume,
    VolumeError,
    read_labels,
    read_volume,
)
from needleforce.anatomy.body_order import require_body_order

sitk = pytest.importorskip("SimpleITK")
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
        noise = rng.normal(0.0, 20.0, shape)
        self.scan = Volume(np.array(units)[self.values] + noise, self.grid)
        self.structures = [
            Structure.named(shape.name, k) for k, shape in enumerate(torso.shapes, 1)
        ]

    def labels(self, values=None, grid=None):
        chosen = self.values if values is None else values
        return Labels.of([chosen], grid or self.grid, self.structures)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1000, 1001, 1002])
def test_right_labels_pass_and_say_what_was_checked(seed):
    case = Case(seed)
    labels = case.labels()
    require_body_order(labels)

    assert labels.unchecked == "labels not checked against a scan: none was given"
    assert labels.checked_against(case.scan).unchecked == ""
    assert labels.with_body(case.scan).unchecked == ""


def test_names_that_say_nothing_cannot_be_checked():
    case = Case(1000)
    structures = [replace(item, name=f"s{item.value}") for item in case.structures]
    structures = [Structure.named(item.name, item.value) for item in structures]
    labels = Labels.of([case.values], case.grid, structures)

    assert "none is named as bone" in labels.checked_against(case.scan).unchecked


def shifted(values, axis, voxels):
    moved = np.zeros_like(values)
    width = values.shape[axis] - voxels
    taken = np.take(values, range(width), axis)
    index = [slice(None)] * 3
    index[axis] = slice(voxels, None)
    moved[tuple(index)] = taken
    return moved


@pytest.mark.parametrize("seed", [1000, 1001])
@pytest.mark.parametrize(
    "change",
    [
        lambda values: values[::-1],
        lambda values: values[:, ::-1],
        lambda values: values[:, :, ::-1],
        lambda values: shifted(values, 0, 5),
        lambda values: shifted(values, 1, 5),
        lambda values: shifted(values, 2, 5),
    ],
    ids=["mirror x", "mirror y", "mirror z", "20 mm x", "20 mm y", "20 mm z"],
)
def test_mirrored_and_shifted_labels_are_refused(seed, change):
    case = Case(seed)
    labels = case.labels(np.ascontiguousarray(change(case.values)))

    with pytest.raises(VolumeError, match=r"HU in the scan|fit the scan better"):
        labels.checked_against(case.scan)


def test_a_negated_affine_is_refused_even_of_both_files():
    case = Case(1000)
    turn = np.diag([-1.0, -1.0, 1.0])
    grid = Grid(case.grid.shape, turn @ case.grid.origin_m, turn @ case.grid.axes_m)

    with pytest.raises(VolumeError, match=r"beside it|outside the scan|HU"):
        case.labels(grid=grid).checked_against(case.scan)
    with pytest.raises(VolumeError, match=r"vertebra does not lie behind .* front and"):
        require_body_order(case.labels(grid=grid))


def blocks(**places_m):
    """Structures of a few voxels, at places in LPS."""
    grid = Grid((81, 81, 81), np.full(3, -0.2), 5e-3 * np.eye(3))
    values = np.zeros(grid.shape, np.uint8)
    for number, place_m in enumerate(places_m.values(), 1):
        i, j, k = np.rint(grid.indices(place_m)).astype(int)
        values[i : i + 2, j : j + 2, k : k + 2] = number
    structures = [Structure.named(name, k) for k, name in enumerate(places_m, 1)]
    return Labels.of([values], grid, structures)


@pytest.mark.parametrize(
    ("places_m", "why"),
    [
        (
            {"kidney_left": (-0.06, 0.0, 0.0), "kidney_right": (0.06, 0.0, 0.0)},
            "kidney_left does not lie left of kidney_right.* left and right are",
        ),
        (
            {"liver": (0.06, 0.0, 0.0), "spleen": (-0.06, 0.0, 0.0)},
            "spleen does not lie left of liver",
        ),
        (
            {"lung_lower_lobe_left": (0.0, 0.0, -0.1), "urinary_bladder": (0, 0, 0.1)},
            "lung_lower_lobe_left does not lie above urinary_bladder.* head and feet",
        ),
        (
            {"vertebrae_L1": (0.0, 0.0, -0.1), "vertebrae_L3": (0.0, 0.0, 0.0)},
            "vertebrae_l1 does not lie above vertebrae_l3",
        ),
    ],
)
def test_structures_that_lie_the_wrong_way_round_are_refused(places_m, why):
    with pytest.raises(VolumeError, match=why):
        require_body_order(blocks(**places_m))


def test_a_situs_inversus_passes_where_it_is_stated():
    inverse = blocks(liver=(0.06, 0.0, 0.0), spleen=(-0.06, 0.0, 0.0))
    require_body_order(inverse, situs_inversus=True)
    usual = blocks(liver=(-0.06, 0.0, 0.0), spleen=(0.06, 0.0, 0.0))
    require_body_order(usual)

    with pytest.raises(VolumeError, match="liver does not lie left of spleen"):
        require_body_order(usual, situs_inversus=True)


def nifti_with_sform(path, **rows):
    """Write a NIfTI file whose qform lies at the origin, with another sform."""
    image = sitk.GetImageFromArray(np.ones((20, 30, 40), np.int16))
    image.SetSpacing((0.8, 0.9, 2.5))
    sitk.WriteImage(image, str(path))
    content = bytearray(path.read_bytes())
    matrix = np.array(
        [[-0.8, 0.0, 0.0, 0.0], [0.0, -0.9, 0.0, 0.0], [0.0, 0.0, 2.5, 0.0]], "<f4"
    )
    for axis, row in rows.items():
        matrix["xyz".index(axis)] = row
    content[280:328] = matrix.tobytes()
    content[252:256] = np.array([1, 2], "<i2").tobytes()  # both forms count
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("rows", "distance"),
    [
        ({"x": [-0.8, 0.0, 0.0, 40.0]}, "40 mm"),
        ({"x": [0.8, 0.0, 0.0, 0.0]}, "62.4 mm"),
        ({"y": [0.0, -0.9, 0.5, 0.0], "z": [0.0, 0.0, 2.449, 0.0]}, r"9.\d+ mm"),
        ({"x": [-0.8, 0.0, 0.0, 0.5]}, "0.5 mm"),
    ],
)
def test_qform_and_sform_that_disagree_are_refused(tmp_path, rows, distance):
    nifti_with_sform(tmp_path / "a.nii", **rows)

    with pytest.raises(
        VolumeError, match=f"qform and sform disagree by {distance}.* by the qform"
    ):
        read_volume(tmp_path / "a.nii")


def test_qform_and_sform_that_differ_by_less_than_half_a_voxel_are_read(tmp_path):
    nifti_with_sform(tmp_path / "a.nii", x=[-0.8, 0.0, 0.0, 0.3])

    assert read_volume(tmp_path / "a.nii").values.shape == (40, 30, 20)


def test_labels_of_a_file_are_checked_against_their_scan(tmp_path):
    case = Case(1000)
    image = sitk.GetImageFromArray(np.ascontiguousarray(case.values[::-1].T))
    image.SetSpacing([4.0] * 3)
    image.SetOrigin((1e3 * case.grid.origin_m).tolist())
    sitk.WriteImage(image, str(tmp_path / "labels.nii.gz"))
    names = {item.value: item.name for item in case.structures}

    assert "none was given" in read_labels(tmp_path / "labels.nii.gz", names).unchecked
    with pytest.raises(VolumeError, match=r"labels.nii.gz: .*HU in the scan"):
        read_labels(tmp_path / "labels.nii.gz", names, case.scan)
