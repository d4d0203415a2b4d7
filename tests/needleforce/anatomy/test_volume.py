"""Scans and segmentations from files: places, names, refusals."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.anatomy.surface import (
    FORMATS,
    oblique_image,
    write_labels,
    write_series,
)
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

sitk = pytest.importorskip("SimpleITK")
pydicom = pytest.importorskip("pydicom")
ROOT = Path(__file__).resolve().parents[3]
CT = Path(os.environ.get("NEEDLEFORCE_DATA", ROOT.parent / "shared" / "data"))
CT = CT / "torso_ct_totalsegmentator"


def cube(shape=(6, 5, 4), spacing_m=1e-3):
    values = np.zeros(shape, np.uint8)
    values[2:4, 1:4, 1:3] = 1
    return values, Grid(shape, np.zeros(3), spacing_m * np.eye(3))


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, -1, 1), (1, 1, -1)])
def test_an_oblique_label_lies_where_it_was_written(tmp_path, name, signs):
    image, centre_m = oblique_image(np.array(signs, float), np.random.default_rng(3))
    write_labels(image, tmp_path / name)
    labels = read_labels(tmp_path / name, {1: "part"})

    np.testing.assert_allclose(labels.centroid_m("part"), centre_m, rtol=0.0, atol=1e-8)


def test_overlapping_segments_bring_names_colours_and_layers(tmp_path):
    values = np.zeros((14, 14, 14, 2), np.uint8)
    values[1:13, 1:13, 1:13, 0] = 1
    values[4:10, 4:10, 4:10, 1] = 1
    image = sitk.GetImageFromArray(values, isVector=True)
    fields = {
        "Segment0_ID": "s0", "Segment0_Name": "liver", "Segment0_LabelValue": "1",
        "Segment0_Layer": "0", "Segment0_Color": "0.5 0.25 0.125",
        "Segment1_ID": "s1", "Segment1_Name": "lesion", "Segment1_LabelValue": "1",
        "Segment1_Layer": "1", "Segment2_ID": "s2", "Segment2_Name": "nothing",
        "Segment2_LabelValue": "7", "Segment2_Layer": "0",
    }  # fmt: skip
    for key, value in fields.items():
        image.SetMetaData(key, value)

    sitk.WriteImage(image, str(tmp_path / "a.seg.nrrd"))
    labels = read_labels(tmp_path / "a.seg.nrrd")

    assert [(item.name, item.voxels) for item in labels.structures] == [
        ("liver", 1728),
        ("lesion", 216),
    ]
    assert labels["liver"].colour == (0.5, 0.25, 0.125)

    names = [
        layer.name
        for layer in labels.layers_along([-0.002, 0.0065, 0.0065], [0.0065] * 3)
    ]

    assert names == ["unlabelled", "liver", "lesion"]
    with pytest.raises(
        VolumeError, match="no structure with voxels is named 'nothing'"
    ):
        labels["nothing"]


def test_components_that_say_no_layer_are_segments(tmp_path):
    values = np.zeros((4, 4, 4, 2), np.uint8)  # as Slicer up to 4.10 wrote them
    values[1:3, 1:3, 1:3, 0] = values[2, 2, :, 1] = 1
    image = sitk.GetImageFromArray(values, isVector=True)
    for k, name in enumerate(("liver", "vessel")):
        image.SetMetaData(f"Segment{k}_ID", name)

    sitk.WriteImage(image, str(tmp_path / "a.seg.nrrd"))
    structures = [
        (item.name, item.voxels)
        for item in read_labels(tmp_path / "a.seg.nrrd").structures
    ]

    assert structures == [("liver", 8), ("vessel", 4)]


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("Layer", "2", "liver lies in layer 2; the file has 1"),
        ("LabelValue", "one", "liver: .*'one'; expected numbers"),
        ("Color", "red", "liver: .*'red'; expected numbers"),
        ("Color", "0.5 0.5", "liver: colour .* expected three"),
        ("Color", "nan 0 0", "liver: colour .* expected three"),
    ],
)
def test_segments_with_a_damaged_header_are_refused(tmp_path, key, value, why):
    image = sitk.GetImageFromArray(np.ones((4, 4, 4), np.uint8))
    for name, text in {"ID": "s0", "Name": "liver", key: value}.items():
        image.SetMetaData(f"Segment0_{name}", text)

    sitk.WriteImage(image, str(tmp_path / "a.seg.nrrd"))

    with pytest.raises(VolumeError, match=f"segment {why}"):
        read_labels(tmp_path / "a.seg.nrrd")


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"Segment1_ID": None}, "Segment1_ID is not in its header: expected 2"),
        ({"Segment0_ID": None}, "Segment0_ID is not in its header: expected 2"),
        ({"Segment1_LabelValue": "1"}, "segment lesion has the label 1 of another"),
        ({"Segment1_LabelValue": "3"}, "12 voxels have labels of no segment"),
    ],
)
def test_segments_and_voxels_belong_together(tmp_path, fields, why):
    values = np.repeat(np.arange(3, dtype=np.uint8), 12).reshape(3, 3, 4)
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((3.0, 3.0, 3.0))
    header = {}
    for k, name in enumerate(("liver", "lesion")):
        header |= {f"Segment{k}_ID": f"s{k}", f"Segment{k}_Name": name}
        header[f"Segment{k}_LabelValue"] = str(k + 1)

    for key, text in (header | fields).items():
        if text is not None:
            image.SetMetaData(key, text)

    sitk.WriteImage(image, str(tmp_path / "a.seg.nrrd"))

    with pytest.raises(VolumeError, match=why):
        read_labels(tmp_path / "a.seg.nrrd")


@pytest.mark.parametrize("names", [{1: None}, {"one": "liver"}, ["liver"]])
def test_names_that_name_no_label_are_refused(tmp_path, names):
    sitk.WriteImage(
        sitk.GetImageFromArray(np.ones((4, 4, 4), np.uint8)), str(tmp_path / "a.nrrd")
    )

    with pytest.raises(VolumeError, match="names"):
        read_labels(tmp_path / "a.nrrd", names)
    assert read_labels(tmp_path / "a.nrrd", {"1": "liver"})["liver"].voxels == 64


def nifti(path, place=0, kind="", *numbers):
    """Write a NIfTI file, with other numbers at a place of its header."""
    image = sitk.GetImageFromArray(
        np.random.default_rng(0).integers(0, 9, (44, 45, 46), np.int16)
    )
    image.SetSpacing((3.0, 3.0, 3.0))
    sitk.WriteImage(image, str(path))
    whole = bytearray(path.read_bytes())
    struct.pack_into(f"<{kind}", whole, place, *numbers)
    path.write_bytes(whole)


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_a_truncated_nifti_file_is_refused(tmp_path, name):
    path = tmp_path / name
    nifti(path)
    whole = path.read_bytes()

    assert read_volume(path).values.shape == (46, 45, 44)

    damaged = bytearray(whole)
    damaged[-6] ^= 255  # in the checksum; where all is read at once the library notices
    for content in (whole[:-20], whole[:-9], *[damaged] * (name == "a.nii.gz")):
        path.write_bytes(content)
        with pytest.raises(VolumeError, match=r"damaged|Unable to determine"):
            read_volume(path)


@pytest.mark.parametrize(
    ("place", "kind", "numbers", "why"),
    [
        (
            80,
            "3f",
            [1.0] * 3,
            r"spacing of \[1.0, 1.0, 1.0\] .* one of \[3.0, 3.0, 3.0\]",
        ),
        (80, "f168x2h", (0.0, 1, 0), "spacing of"),  # qform alone
        (80, "f", [np.nan], "spacing of"),
        (280, "f", [1.5], "one of .*1.5"),
        (252, "2h", (0, 0), "neither qform nor sform"),
    ],
)
def test_a_nifti_file_that_contradicts_itself_is_refused(
    tmp_path, place, kind, numbers, why
):
    nifti(tmp_path / "a.nii", place, kind, *numbers)
    with pytest.raises(VolumeError, match=why):
        read_volume(tmp_path / "a.nii")


def test_a_nifti_file_needs_qform_or_sform(tmp_path):
    """A NIfTI file with either qform or sform is read."""
    for place in (252, 254):
        nifti(tmp_path / "a.nii", place, "h", 0)
        assert read_volume(tmp_path / "a.nii").grid.spacing_m == pytest.approx(3e-3)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("space directions", "# ", "no `space directions`"),
        ("kinds", 'space units: "cm" "cm" "cm"\nkinds', "units are .*: expected mm"),
        ("left-posterior-superior", "scanner-xyz", "space is 'scanner-xyz'"),
        ("left-posterior-superior", "3D-right-handed", "space is '3D-right-handed'"),
        ("kinds", 'space units: "mm" "mm" "mm"\nkinds', None),
        ("left-posterior-superior", "RAS", None),
    ],
)
def test_an_nrrd_file_must_say_how_it_lies(tmp_path, old, new, why):
    path = tmp_path / "a.nrrd"
    sitk.WriteImage(sitk.GetImageFromArray(np.ones((4, 4, 4), np.uint8)), str(path))
    path.write_bytes(path.read_bytes().replace(old.encode(), new.encode(), 1))
    if why is None:
        assert read_volume(path).values.size == 64
    else:
        with pytest.raises(VolumeError, match=why):
            read_volume(path)


def edited_series(folder, edit):
    """Write eight slices, and change what lies in the folder."""
    image, _ = oblique_image(np.ones(3), np.random.default_rng(1))
    folder.mkdir()
    write_series(image, folder)
    edit(folder, image)


def another_series(folder, image):
    (folder / "more").mkdir()
    write_series(image, folder / "more", "2.25.43")
    for path in list((folder / "more").iterdir()):
        path.rename(folder / f"more-{path.name}")


def other_spacing(folder, image):
    image.SetSpacing((0.8, 0.9, 2.5))
    write_series(image[:, :, :3], folder)


class Slanted:
    """An image whose slices are shifted by so much more each, in their own axes."""

    def __init__(self, step_mm):
        self._image = sitk.Image(4, 4, 40, sitk.sitkInt16)
        self._step_mm = np.array(step_mm)
        self._image.SetSpacing((0.7, 0.9, 2.5))

    def __getattr__(self, name):
        return getattr(self._image, name)

    def __getitem__(self, key):
        return self._image[key]

    def TransformIndexToPhysicalPoint(self, index):
        return (
            self._image.TransformIndexToPhysicalPoint(index) + index[2] * self._step_mm
        )


@pytest.mark.parametrize(
    ("step_mm", "why"),
    [
        ((0.005, 0, 0), None),
        ((0.02, 0, 0), "sheared .* `dcm2niix -z y"),
        ((0, 0, -2.5), "at the same place"),
    ],
)
def test_shear_counts_over_the_whole_stack(tmp_path, step_mm, why):
    write_series(Slanted(step_mm), tmp_path)
    if why is None:
        assert read_volume(tmp_path).grid.spacing_m[2] == pytest.approx(
            2.5e-3, rel=1e-4
        )
    else:
        with pytest.raises(VolumeError, match=why):
            read_volume(tmp_path)


def test_the_series_of_a_cd_is_read_and_several_are_listed(tmp_path):
    image, _ = oblique_image(np.ones(3), np.random.default_rng(1))
    deep = tmp_path / "DICOM" / "PA0" / "ST0"
    (deep / "SE0").mkdir(parents=True)
    write_series(image, deep / "SE0")

    assert read_volume(tmp_path).grid.shape == image.GetSize()

    (deep / "SE1").mkdir()
    write_series(image, deep / "SE1", "2.25.43")
    with pytest.raises(VolumeError, match="2 DICOM series") as refused:
        read_volume(tmp_path)
    assert f"{deep / 'SE1'}: {image.GetSize()[2]} files" in str(refused.value)


def test_mr_is_named(tmp_path):
    image, _ = oblique_image(np.ones(3), np.random.default_rng(1))
    write_series(image, tmp_path)
    for path in tmp_path.iterdir():
        file = pydicom.dcmread(path)
        file.Modality = "MR"
        file.save_as(path)
    with pytest.raises(VolumeError, match="is MR"):
        read_volume(tmp_path)

    values = np.random.default_rng(1).uniform(0.0, 900.0, (20, 20, 20))
    grid = Grid(values.shape, np.zeros(3), 5e-3 * np.eye(3))
    labels = Labels.of([np.ones(grid.shape, np.uint8)], grid, [Structure.named("a", 1)])
    with pytest.raises(VolumeError, match="this is MR, or a CT whose air"):
        labels.with_body(Volume(values, grid))


@pytest.mark.parametrize("back", [1.0, -1.0])
def test_a_couch_that_touches_the_back_is_no_body(back):
    """A trunk that tapers on a hollow couch of 400 x 20 mm, which it touches."""
    x, y, z = (4e-3 * (np.arange(n) - n / 2) for n in (120, 80, 40))
    place = np.stack(np.meshgrid(x, back * y, z, indexing="ij"), axis=-1)
    half_m = 0.08 + 0.1 * place[..., 2]  # from front to back, 64 to 96 mm
    trunk = (place[..., 0] / 0.15) ** 2 + (place[..., 1] / half_m) ** 2 < 1.0
    across = np.abs(place[..., 0]) < 0.2
    depth_m = place[..., 1] - 0.088  # it reaches into the upper sections' back
    couch = across & (depth_m >= 0.0) & (depth_m < 0.02)
    filling = (np.abs(place[..., 0]) < 0.19) & (depth_m >= 5e-3) & (depth_m < 15e-3)
    scan_HU = np.where(trunk | (couch & ~filling), 40.0, -1000.0)
    scan_HU[filling] = -950.0
    grid = Grid(trunk.shape, np.zeros(3), np.diag([4e-3, back * 4e-3, 4e-3]))
    labels = Labels.of([trunk.astype(np.uint8)], grid, [Structure.named("liver", 1)])
    body = labels.with_body(Volume(scan_HU.astype(np.int16), grid)).volumes[1] > 0
    alone = trunk & ~(couch | (depth_m > 0.0))

    assert (body & couch).sum() < 0.02 * couch.sum()
    assert (alone & ~body).sum() < 0.01 * alone.sum()


class Rounded(Slanted):
    """Slices whose stated positions are rounded, as scanners write them."""

    def __init__(self, step_mm, decimals):
        super().__init__((0.0, 0.0, step_mm - 2.5))
        self.decimals = decimals

    def TransformIndexToPhysicalPoint(self, index):
        place = super().TransformIndexToPhysicalPoint(index)
        return [round(coordinate_mm, self.decimals) for coordinate_mm in place]


@pytest.mark.parametrize(("step_mm", "decimals"), [(0.625, 2), (1.25, 1), (2.517, 1)])
def test_rounded_positions_of_slices_are_read_and_a_gap_is_found(
    tmp_path, step_mm, decimals
):
    write_series(Rounded(step_mm, decimals), tmp_path)
    volume = read_volume(tmp_path)

    assert volume.grid.spacing_m[2] == pytest.approx(1e-3 * step_mm, rel=0.01)

    (tmp_path / "001.dcm").unlink()
    with pytest.raises(VolumeError, match="missing or doubled"):
        read_volume(tmp_path)


@pytest.mark.parametrize(
    ("edit", "why"),
    [
        (lambda folder, image: (folder / "004.dcm").unlink(), "missing or doubled"),
        (another_series, "2 DICOM series"),
        (other_spacing, "mixed series"),
        (
            lambda folder, image: [path.unlink() for path in folder.iterdir()],
            "0 DICOM series",
        ),
    ],
)
def test_an_incomplete_or_mixed_series_is_refused(tmp_path, edit, why):
    """A series with missing slices or of several scans is refused."""
    edited_series(tmp_path / "scan", edit)
    with pytest.raises(VolumeError, match=why):
        read_volume(tmp_path / "scan")


@pytest.mark.parametrize(
    ("values", "spacing", "why"),
    [
        (np.zeros((4, 4, 4), np.uint8), 1.0, "no voxel is labelled"),
        (np.full((4, 4, 4), 0.5, np.float32), 1.0, "expected labels"),
        (np.full((4, 4, 4), -3, np.int16), 1.0, "expected labels"),
        (np.ones((4, 4, 4), np.uint8), 1e-3, "expected a file in millimetres"),
        (np.ones((4, 4), np.uint8), 1.0, "expected three dimensions"),
    ],
)
def test_files_that_hold_no_labels_are_refused(tmp_path, values, spacing, why):
    image = sitk.GetImageFromArray(values)
    image.SetSpacing([spacing] * values.ndim)
    sitk.WriteImage(image, str(tmp_path / "labels.nrrd"))

    with pytest.raises(VolumeError, match=why):
        read_labels(tmp_path / "labels.nrrd")


def test_a_volume_beyond_the_limit_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "labels.nii.gz"
    values = np.random.default_rng(0).integers(0, 1000, (20, 20, 20), np.uint16)
    sitk.WriteImage(sitk.GetImageFromArray(values), str(path))

    assert read_volume(path, max_bytes=2 * values.size).values.shape == values.shape

    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])  # its voxels cannot be read
    for read in (read_volume, read_labels):
        with pytest.raises(VolumeError, match="more than the limit") as refused:
            read(path, max_bytes=2 * values.size - 1)

        assert "Crop or resample" in refused.value.advice


def test_missing_files_and_other_files_are_refused(tmp_path):
    """Missing files and files that are no images are refused."""
    (tmp_path / "a.nrrd").write_text("no volume")
    for name, why in (("none.nrrd", "no such file"), ("a.nrrd", "cannot read")):
        with pytest.raises(VolumeError, match=why):
            read_volume(tmp_path / name)


@pytest.mark.parametrize("name", ["a.hdr", "a.img", "a.tif", "a.mha"])
def test_files_of_other_kinds_are_refused(tmp_path, name):
    sitk.WriteImage(
        sitk.GetImageFromArray(np.ones((9, 9, 9), np.uint8)), str(tmp_path / name)
    )
    with pytest.raises(VolumeError, match="Export it again, as"):
        read_volume(tmp_path / name)


@pytest.mark.parametrize(
    ("shift_m", "cut", "why"),
    [
        ((0.0, 0.0, 0.0), False, None),
        ((0.0, 0.0, 0.0), True, None),
        ((0.0015, 0.0, 0.0), False, "as large as the scan's"),
        ((0.2, 0.0, 0.0), True, "voxels outside the scan"),
    ],
)
def test_labels_must_lie_in_the_scan(tmp_path, shift_m, cut, why):
    values, grid = cube()
    labelled = values[1:, 1:, :] if cut else values
    origin_mm = 1e3 * (np.array(shift_m) + (grid.points_m([1, 1, 0]) if cut else 0.0))
    image = sitk.GetImageFromArray(labelled.T.copy())
    image.SetOrigin(origin_mm.tolist())
    sitk.WriteImage(image, str(tmp_path / "labels.nrrd"))
    scan = Volume(np.zeros(grid.shape), grid)
    if why is None:
        assert read_labels(tmp_path / "labels.nrrd", scan=scan)["label_1"].voxels == 12
    else:
        with pytest.raises(VolumeError, match=why):
            read_labels(tmp_path / "labels.nrrd", scan=scan)


@pytest.mark.parametrize(("degrees", "size"), [(3.0, 1.0), (0.0, 0.9), (0.0, 0.5)])
def test_turned_or_rescaled_labels_are_refused(tmp_path, degrees, size):
    """Labels on as many voxels as the scan, but turned or rescaled, are refused."""
    values = np.zeros((30, 31, 32), np.uint8)
    values[14:17, 14:17, 14:17] = 1
    image = sitk.GetImageFromArray(values)
    scan = Volume(values.T, Grid((32, 31, 30), np.zeros(3), 1e-3 * np.eye(3)))
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    image.SetDirection(turn.ravel().tolist())
    image.SetSpacing([size] * 3)
    sitk.WriteImage(image, str(tmp_path / "a.nrrd"))

    with pytest.raises(VolumeError, match="as large as the scan's"):
        read_labels(tmp_path / "a.nrrd", scan=scan)


@pytest.mark.parametrize("change", [lambda v: v + 1024.0, lambda v: 0.0 * v - 1000.0])
def test_a_scan_without_air_or_body_is_refused(change):
    """A scan without air or without a body is refused."""
    values, grid = cube()
    labels = Labels.of([values], grid, [Structure.named("part", 1)])

    with pytest.raises(VolumeError, match=r"no body in a scan of .* Hounsfield"):
        labels.with_body(Volume(change(np.where(values, 40.0, -1000.0)), grid))


def test_names_say_what_stops_a_needle():
    stops = (
        "rib_left_7",
        "costal_cartilages",
        "hip_right",
        "vertebrae_L1",
        "Rib,_left",
        "Spine",
    )
    stops += (
        "bones",
        "mandible",
        "vertebral_body",
        "patella",
        "scapulae",
        "ribcage",
        "coccyx",
    )

    assert all(Structure.named(name, 1).is_obstacle for name in stops)

    goes = ("hippocampus", "liver", "tribology", "renal_pelvis", "kidney-pelvis")

    assert not any(Structure.named(name, 1).is_obstacle for name in goes)


def test_the_body_is_found_in_flipped_scans():
    """The body is found in a scan that is stored in another order."""
    torso = analytic_torso()
    shape = (56, 40, 52)
    axes = 6e-3 * np.eye(3)
    origin = np.array([-0.165, -0.117, -0.153])
    values = torso.voxels(shape, origin, axes)
    grid = Grid(shape, origin, axes)
    names = [Structure.named(f"part_{n}", n) for n in range(1, len(torso.shapes) + 1)]
    labels = Labels.of([values], grid, names)
    flipped = Grid(shape, grid.points_m([55, 39, 0]), axes * [-1.0, -1.0, 1.0])
    scan = Volume(np.where(values > 0, 40.0, -1000.0)[::-1, ::-1, :], flipped)
    body = labels.with_body(scan)

    assert body["body"].voxels == np.count_nonzero(values)
    np.testing.assert_allclose(
        body.centroid_m("body"), grid.points_m(np.argwhere(values).mean(0))
    )

    soft = np.where(values == 1, -90.0, scan.values[::-1, ::-1, :])[::-1, ::-1, :]
    parts = Labels.of([values], grid, names[1:]).with_body(
        Volume(soft, flipped), fat=True
    )

    assert parts["lean"].voxels + parts["fat"].voxels == np.count_nonzero(values)
    assert parts["fat"].voxels == pytest.approx(np.count_nonzero(values == 1), rel=0.1)


def test_there_is_no_body_outside_the_scan():
    scan = Volume(
        np.full((12, 12, 12), -1000.0), Grid((12,) * 3, np.zeros(3), 1e-3 * np.eye(3))
    )
    scan.values[3:9, 3:9, :] = 40.0  # cut off at both ends
    values = np.zeros((12, 12, 32), np.uint8)
    values[5, 5, 15] = 1
    grid = Grid(values.shape, np.array([0.0, 0.0, -0.01]), scan.grid.axes_m)
    body = Labels.of([values], grid, [Structure.named("part", 1)]).with_body(scan)

    assert body["body"].voxels == 6 * 6 * 12


@pytest.mark.skipif(
    not CT.is_dir(), reason="no recordings: NEEDLEFORCE_DATA names their folder"
)
def test_in_a_real_ct_left_is_left():
    scan = read_volume(CT / "ct.nii.gz")
    labels = read_labels(CT / "labels.nii.gz", CT / "labels.json", scan)

    assert len(labels.structures) == 61

    middle = labels.centroid_m("vertebrae_L1")
    spleen_m = labels.centroid_m("spleen") - middle
    liver_m = labels.centroid_m("liver") - middle

    assert spleen_m[0] > 0.05 > 0.0 > liver_m[0]  # LPS: x to the left
    assert labels.centroid_m("vertebrae_T12")[2] > labels.centroid_m("vertebrae_L4")[2]
    assert middle[1] > labels.centroid_m("liver")[1]  # y to the back
