"""Scans and segmentations from files: places, names, and what is refused."""

import numpy as np
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation

from needleforce.anatomy import (
    Grid,
    Volume,
    VolumeError,
    read_labels,
    read_markup,
    read_transform,
    read_volume,
)
from tests.needleforce.anatomy import made_files as made

RAS = [-1.0, -1.0, 1.0]
TURN = Rotation.from_rotvec([0.4, -0.2, 0.7]).as_matrix()


@pytest.mark.parametrize(
    "name", ["a.nii", "a.nii.gz", "a.nrrd", "a.seg.nrrd", "a.mha", "a.mhd"]
)
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, -1, 1), (1, 1, -1)])
def test_an_oblique_label_lies_where_it_was_written(tmp_path, name, signs):
    values = np.zeros((10, 12, 14), np.uint8)
    values[2:4, 3:5, 2:11] = values[2:4, 3:10, 2:4] = values[2:8, 3:5, 2:4] = 1
    axes = TURN * signs
    fields = {"Segment0_ID": "s", "Segment0_Name": "part", "Segment0_LabelValue": "1"}
    made.write_image(
        tmp_path / name, values, made.SPACING_mm, made.ORIGIN_mm, axes, fields
    )
    labels = read_labels(tmp_path / name, None if "nrrd" in name else {1: "part"})
    middle_mm = made.SPACING_mm * np.argwhere(values).mean(axis=0)
    centre_mm = made.ORIGIN_mm + axes @ middle_mm

    np.testing.assert_allclose(1e3 * labels.centroid_m("part"), centre_mm, atol=1e-5)


def test_an_oblique_series_lies_where_it_was_written(tmp_path):
    """Also in the folders of a CD, and in any order of its files."""
    places = [made.ORIGIN_mm + 1.25 * k * TURN[:, 2] for k in range(9)]
    slices = made.ct_slices((6, 5, 9), places, TURN)
    for k, item in enumerate(slices):
        item.PixelData = np.full((5, 6), 100 * k - 300, np.int16).tobytes()
    made.write_series(tmp_path.joinpath("PA0", "S", "S"), slices[::-1])
    scan = read_volume(tmp_path)
    middle_m = 1e-3 * (made.ORIGIN_mm + TURN @ (made.SPACING_mm * [2, 3, 4]))
    voxel = np.rint(scan.grid.indices(middle_m)).astype(int)

    np.testing.assert_allclose(scan.grid.points_m(voxel), middle_m, atol=1e-7)
    assert (scan.grid.shape, scan.values[tuple(voxel)]) == ((6, 5, 9), 100)


@pytest.mark.parametrize(("step_mm", "decimals"), [(0.625, 2), (1.25, 1), (2.517, 1)])
def test_rounded_positions_are_read_and_a_missing_slice_is_not(
    tmp_path, step_mm, decimals
):
    places = np.round([[0.0, 0.0, step_mm * k] for k in range(40)], decimals)
    made.write_series(tmp_path, made.ct_slices((4, 4, 40), places))

    spacing_m = read_volume(tmp_path).grid.spacing_m[2]
    assert spacing_m == pytest.approx(1e-3 * step_mm, rel=0.01)
    (tmp_path / "2-006.dcm").unlink()
    with pytest.raises(VolumeError, match="missing"):
        read_volume(tmp_path)


@pytest.mark.parametrize(
    ("places", "change", "why"),
    [
        ([[0.0, 0.0, 0.0]] * 3, ("Modality", "CT"), "doubled"),
        ([[0.0, 0.0, 0.0]], ("Modality", "CT"), "one"),
        (None, ("Modality", "MR"), "MR"),
        (None, ("NumberOfFrames", 4), "4"),
        (None, ("PixelSpacing", [0.9, 0.7]), "mixed"),
        (None, ("ImageOrientationPatient", [1, 0, 0, 0, 0, 1]), "mixed"),
        (None, ("ImagePositionPatient", None), "1-003"),
        (None, ("SeriesInstanceUID", "2.25.77"), "2 DICOM series"),
    ],
)
def test_slices_that_are_not_one_whole_ct_are_refused(tmp_path, places, change, why):
    slices = made.ct_slices((4, 4, len(places or [0] * 5)), places, series=1)
    if change[1] is None:
        del slices[2][change[0]]
    else:
        setattr(slices[len(slices) // 2], *change)
    made.write_series(tmp_path, slices)

    with pytest.raises(VolumeError, match=why):
        read_volume(tmp_path)


@pytest.mark.parametrize("way", [(1, 0), (-1, 0), (0, 1), (0, -1)])
@pytest.mark.parametrize("shift_mm", [0.39, 0.41])
def test_slices_are_shifted_by_half_a_pixel_at_most(tmp_path, way, shift_mm):
    places = [(*np.array(way) * shift_mm * k / 39, 2.5 * k) for k in range(40)]
    made.write_series(tmp_path, made.ct_slices((4, 4, 40), places))
    with made.refused_if(shift_mm > 0.4, "shear"):  # pixels measure 0.8 and 0.9 mm
        np.testing.assert_allclose(
            read_volume(tmp_path).grid.spacing_m, [8e-4, 9e-4, 2.5e-3], rtol=1e-3
        )


def nifti(path, shape=(46, 45, 44)):
    rng = np.random.default_rng(0)
    made.write_image(path, rng.integers(0, 9, shape, np.int16), (3.0, 3.0, 3.0))


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_a_nifti_file_that_ends_early_or_is_damaged_is_refused(tmp_path, name):
    nifti(tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    damaged = whole[:-6] + bytes([whole[-6] ^ 255]) + whole[-5:]  # in the checksum

    for content in (whole[:-20], whole[:-9], whole[:200], *[damaged] * ("gz" in name)):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(VolumeError):
            read_volume(tmp_path / name)


PIXDIM = 80
QFORM = 252
SFORM = 280
"""Places in a NIfTI header; its matrix here is diag(-3, -3, 3) with an origin of 0."""


@pytest.mark.parametrize(
    ("place", "kind", "numbers", "is_read"),
    [
        (PIXDIM, "3f", (1.0, 1.0, 1.0), False),
        (PIXDIM, "f168x2h", (0.0, 1, 0), False),
        (PIXDIM, "f", (np.nan,), False),
        (SFORM, "f", (1.5,), False),
        (SFORM, "f", (3.0,), False),
        (SFORM + 12, "f", (40.0,), False),
        (SFORM + 12, "f", (1.6,), False),
        (SFORM + 12, "f", (np.nan,), False),
        (SFORM + 24, "f", (0.5,), False),
        (QFORM, "2h24x8f", (0, 1, -3, 0, 0, 0, 0.5, -3, 0, 0), False),
        (QFORM, "2h", (0, 0), False),
        (123, "b", (1,), False),
        (40, "8h", (4, 23, 45, 44, 2, 1, 1, 1), False),
        (40, "8h", (5, 23, 45, 44, 1, 2, 1, 1), False),
        (40, "8h", (5, 46, 45, 44, 1, 1, 1, 1), True),
        (QFORM, "2h", (0, 1), True),
        (QFORM, "2h", (1, 0), True),
        (SFORM + 12, "f", (1.4,), True),
    ],
)
def test_a_nifti_file_says_one_place_in_millimetres(
    tmp_path, place, kind, numbers, is_read
):
    nifti(tmp_path / "a.nii")
    made.patch(tmp_path / "a.nii", QFORM, "2h", 1, 2)
    made.patch(tmp_path / "a.nii", place, kind, *numbers)
    with made.refused_if(not is_read, "nii"):
        grid = read_volume(tmp_path / "a.nii").grid
        assert grid.shape == (46, 45, 44)
        np.testing.assert_allclose(grid.axes_m, 3e-3 * np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "x_m"),
    [
        ("space directions", "# ", None),
        ("kinds", 'space units: "cm" "cm" "cm"\nkinds', None),
        ("left-posterior-superior", "scanner-xyz", None),
        ("left-posterior-superior", "3D-right-handed", None),
        ("kinds", 'space units: "mm" "mm" "mm"\nkinds', 5e-3),
        ("left-posterior-superior", "RAS", -5e-3),
    ],
)
def test_an_nrrd_file_must_say_how_it_lies(tmp_path, old, new, x_m):
    path = tmp_path / "a.nrrd"
    made.write_image(path, np.ones((4, 4, 4), np.uint8), origin_mm=(5.0, 0.0, 0.0))
    path.write_bytes(path.read_bytes().replace(old.encode(), new.encode(), 1))
    with made.refused_if(x_m is None, "space"):
        assert read_volume(path).grid.origin_m[0] == pytest.approx(x_m)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Offset = ", "Comment = "),
        ("TransformMatrix = ", "Comment = "),
        ("ElementSpacing = ", "Comment = "),
        ("CenterOfRotation = 0 0 0", "DistanceUnits = cm"),
    ],
)
def test_a_metaimage_must_say_how_it_lies(tmp_path, old, new):
    path = tmp_path / "a.mha"
    values = np.arange(125, dtype=np.int16).reshape(5, 5, 5)
    made.write_image(path, values, (2.0, 2.0, 2.0))
    whole = path.read_bytes()

    np.testing.assert_array_equal(read_volume(path).values, values)
    path.write_bytes(whole.replace(b"Offset = ", b"Position=", 1))
    np.testing.assert_array_equal(read_volume(path).values, values)
    for content in (whole.replace(old.encode(), new.encode()), whole[:-9]):
        path.write_bytes(content)
        with pytest.raises(VolumeError, match="mha"):
            read_volume(path)


@pytest.mark.parametrize(
    "name",
    ["a.hdr", "b.mha", "b.nrrd", "b.nii", "b.nii.gz", "none.nrrd", "none.nii"],
)
def test_files_of_other_kinds_and_missing_ones_are_refused(tmp_path, name):
    if name[:1] == "a":
        made.write_image(tmp_path / name, np.ones((9, 9, 9), np.uint8))
    elif name[:1] == "b":
        (tmp_path / name).write_text("no volume")
    for read in (read_volume, read_labels):
        with pytest.raises(VolumeError, match=name):
            read(tmp_path / name)


@pytest.mark.parametrize(
    ("read", "values", "spacing_mm", "why"),
    [
        (read_labels, np.full((4, 4, 4), 0.5, np.float32), 2.0, "0.5"),
        (read_labels, np.full((4, 4, 4), -3, np.int16), 2.0, "-3"),
        (read_labels, np.full((4, 4, 4), np.nan, np.float32), 2.0, "nan"),
        (read_labels, np.full((4, 4, 4), 65_536, np.int32), 2.0, "65536"),
        (read_labels, np.zeros((4, 4, 4), np.uint8), 2.0, "voxel"),
        (read_volume, np.full((4, 4, 4), np.nan, np.float32), 2.0, "finite"),
        (read_volume, np.full((4, 4, 4), np.inf, np.float32), 2.0, "finite"),
        # Their diagonals are 4.8 mm and 5.02 m.
        (read_volume, np.ones((4, 4, 4), np.uint8), 0.92, "millimetres"),
        (read_volume, np.ones((4, 4, 4), np.uint8), 966.0, "millimetres"),
        (read_volume, np.ones((4, 4), np.uint8), 2.0, "space|three|dimensions"),
        (read_labels, np.ones((4, 4), np.uint8), 2.0, "space|three|dimensions"),
        (read_volume, np.ones((40, 40, 1), np.uint8), 2.0, "three"),
    ],
)
@pytest.mark.parametrize("name", ["a.nrrd", "a.nii", "a.mha"])
def test_files_without_labels_or_a_volume_in_millimetres_are_refused(
    tmp_path, name, read, values, spacing_mm, why
):
    made.write_image(tmp_path / name, values, [spacing_mm] * values.ndim)

    with pytest.raises(VolumeError, match=why):
        read(tmp_path / name)


@pytest.mark.parametrize("name", ["a.nrrd", "a.nii.gz"])
@pytest.mark.parametrize(("off", "kind"), [(0.0, np.int16), (0.25, np.float64)])
def test_voxels_are_kept_in_as_few_bytes_as_they_need(tmp_path, name, off, kind):
    values = np.arange(-1000, 1000, 2).reshape(10, 10, 10) + off
    made.write_image(tmp_path / name, values, [2.0] * 3)

    found = read_volume(tmp_path / name).values
    np.testing.assert_array_equal(found, values.astype(kind), strict=True)
    # Programs that compute with labels leave this.
    made.write_image(tmp_path / name, (values > 1) * np.float32(0.9995), [2.0] * 3)
    labels = read_labels(tmp_path / name)
    assert (labels.volumes[0].dtype, labels["label_1"].voxels) == (np.uint8, 499)


def bodies(*, overlap=True):
    """Masks of liver, a lesion in it, a rib, and something else."""
    liver, lesion, rib, other = (np.zeros((12, 11, 10), np.uint8) for _ in range(4))
    liver[1:9, 1:9, 1:9] = lesion[3:6, 3:6, 3:6] = 1
    rib[9:11, 2:4, 2:4] = other[9:11, 6:8, 6:8] = 1
    return liver if overlap else liver - lesion, lesion, rib, other


LIVER = {"Name": "Segment_1", "Tags": made.slicer_tags("Liver")}
MASS = {
    "Name": "Segment_2",
    "Tags": made.slicer_tags("Mass", region="SCT^10200004^Liver"),
}
RIB = {"Name": "Rippe links", "Tags": made.slicer_tags("Rib", "SCT^7771000^Left")}
OTHER = {"Name": "Läsion", "Tags": made.slicer_tags("Tissue")}


def slicer_5(path):
    """Segments that do not overlap share a layer."""
    liver, lesion, rib, other = bodies()
    segments = [
        LIVER | {"Layer": 0, "LabelValue": 1},
        MASS | {"Layer": 1, "LabelValue": 1},
        RIB | {"Layer": 0, "LabelValue": 3},
        OTHER | {"Layer": 0, "LabelValue": 4},
    ]
    made.write_seg_nrrd(path, (liver + 3 * rib + 4 * other, lesion), segments)


def require_bodies(labels, names, expected):
    assert [item.name for item in labels.structures] == names
    for name, mask in zip(names, expected, strict=True):
        place_mm = made.place_mm(np.argwhere(mask).mean(axis=0))
        assert labels[name].voxels == mask.sum()
        np.testing.assert_allclose(1e3 * labels.centroid_m(name), place_mm, atol=1e-7)


def test_segments_of_slicer_lie_and_are_called_as_there(tmp_path):
    slicer_5(tmp_path / "a.seg.nrrd")
    labels = read_labels(tmp_path / "a.seg.nrrd")

    require_bodies(labels, ["liver", "mass", "Rippe links", "Läsion"], bodies())
    # Terms say what a needle must avoid.
    (rib,) = [item for item in labels.structures if item.is_obstacle]
    assert (rib.name, rib.anatomy) == ("Rippe links", "left rib")
    with pytest.raises(VolumeError, match="spleen"):
        labels["spleen"]


def test_segments_of_one_term_are_told_apart(tmp_path):
    liver, _, rib, other = bodies()
    segments = [{**RIB, "Name": f"Segment_{n}", "LabelValue": n} for n in (1, 2, 3)]
    path = tmp_path / "a.seg.nrrd"
    made.write_seg_nrrd(path, [liver + 2 * rib + 3 * other], segments)

    assert names_of(path) == [f"left rib (Segment_{n})" for n in (1, 2, 3)]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"Layer": 1}, "1"),
        ({"Layer": -1}, "-1"),
        ({"LabelValue": "one"}, "one"),
        ({"LabelValue": 2}, "liver"),
        ({"LabelValue": 3}, "512"),  # the liver's voxels belong to no segment
        ({"LabelValue": None}, "LabelValue"),
    ],
)
def test_segments_with_a_damaged_header_are_refused(tmp_path, changes, why):
    liver, _, rib, _ = bodies()
    changed = {"Name": "liver", "LabelValue": 1} | changes
    written = {key: value for key, value in changed.items() if value is not None}
    segments = [{"Name": "lesion", "LabelValue": 2}, written]
    made.write_seg_nrrd(tmp_path / "a.seg.nrrd", [liver + 2 * rib], segments)
    with pytest.raises(VolumeError, match=why):
        read_labels(tmp_path / "a.seg.nrrd")


TABLE = (
    '<?xml version="1.0" encoding="UTF-8"?><CaretExtension><VolumeInformation '
    'Index="0"><LabelTable>{}</LabelTable></VolumeInformation></CaretExtension>'
)
NAMES = "".join(
    f'<Label Key="{value}" Red="1" Alpha="1"><![CDATA[{name}]]></Label>'
    for value, name in {5: "liver", 92: "rib_left_1", 93: "rib_left_2"}.items()
)


def names_of(path, *names):
    return [item.name for item in read_labels(path, *names).structures]


def test_labels_of_totalsegmentator_bring_their_names(tmp_path):
    liver, _, rib, _ = bodies()
    values = 5 * liver + 92 * rib
    path = tmp_path / "a.nii.gz"
    made.write_labels_with_table(path, values, TABLE.format(NAMES).encode())
    (tmp_path / "labels.json").write_text('{"5": "spleen"}', encoding="utf-8")

    assert names_of(path) == ["liver", "rib_left_1"]
    # Stated names replace those of the file; a file beside it serves where it has none.
    assert names_of(path, {5: "spleen", 60: "nothing"}) == ["spleen", "rib_left_1"]
    made.write_image(path, values, (1.5, 1.5, 1.5))
    assert names_of(path) == ["spleen", "label_92"]


@pytest.mark.parametrize(
    "table",
    [
        TABLE[:-20] + "<Label",
        TABLE.format('<Label Key="five">liver</Label>'),
        TABLE.format("<Label>liver</Label>"),
        # It would need gigabytes.
        "<!DOCTYPE a [<!ENTITY e0 'liver'>"
        + "".join(f"<!ENTITY e{k + 1} '{f'&e{k};' * 10}'>" for k in range(9))
        + "]><a><Label Key='5'>&e9;</Label></a>",
    ],
)
def test_a_damaged_table_of_names_is_refused(tmp_path, table):
    made.write_labels_with_table(tmp_path / "a.nii.gz", bodies()[0], table.encode())
    with pytest.raises(VolumeError, match="table"):
        read_labels(tmp_path / "a.nii.gz")


def test_structures_are_renamed_by_name_or_value(tmp_path):
    path = tmp_path / "a.seg.nrrd"
    slicer_5(path)
    (tmp_path / "names.json").write_text('{"mass": "cyst"}', encoding="utf-8")

    assert names_of(path, {"Läsion": "rib", "mass": "rib"}) == [
        "liver",
        "rib (mass)",
        "Rippe links",
        "rib (Läsion)",
    ]
    assert read_labels(path, {"Läsion": "rib"})["rib"].is_obstacle
    assert names_of(path, tmp_path / "names.json")[1] == "cyst"
    # A value does not say which of the overlapping structures is meant.
    for wrong in ({"Leber": "liver"}, {"1": "liver"}, {1: None}, ["liver"]):
        with pytest.raises(VolumeError):
            read_labels(path, wrong)


SEGMENTS = [
    made.segment(1, "Segment_1", "Liver"),
    made.segment(2, "Segment_3", "Kidney", "Left"),
    made.segment(3, "Rippe", "Rib"),
]


@pytest.mark.parametrize(
    ("kind", "overlap"), [("BINARY", False), ("BINARY", True), ("LABELMAP", False)]
)
def test_dicom_segments_lie_and_are_called_as_in_the_file(tmp_path, kind, overlap):
    expected = bodies(overlap=overlap)[:3]
    made.write_dicom_segmentation(tmp_path / "seg.dcm", expected, SEGMENTS, kind)
    labels = read_labels(tmp_path / "seg.dcm")

    require_bodies(labels, ["liver", "left kidney", "Rippe"], expected)
    assert [item.is_obstacle for item in labels.structures] == [False, False, True]


def test_dicom_files_without_whole_binary_segments_are_refused(tmp_path):
    path = tmp_path / "seg.dcm"
    made.write_dicom_segmentation(path, bodies()[:3], SEGMENTS, "FRACTIONAL")
    fractional = path.read_bytes()
    made.write_dicom_segmentation(path, bodies()[:3], SEGMENTS)
    whole = path.read_bytes()
    made.write_series(tmp_path, made.ct_slices((4, 4, 1)))
    of_ct = (tmp_path / "2-001.dcm").read_bytes()
    for content in (whole[:600], whole[:-40], of_ct, fractional):
        path.write_bytes(content)
        with pytest.raises(VolumeError, match="SEG"):
            read_labels(path)


@pytest.mark.parametrize(
    ("shift_mm", "turn_deg", "size", "is_cut", "is_right"),
    [
        (0.0, 0.0, 1.0, False, True),
        (0.0, 0.0, 1.0, True, True),
        (1.5, 0.0, 1.0, False, False),
        (200.0, 0.0, 1.0, True, False),
        (0.0, 3.0, 1.0, False, False),
        (0.0, 0.0, 0.9, False, False),
        (0.0, 0.0, 0.5, False, False),
    ],
)
def test_labels_must_lie_in_their_scan(
    tmp_path, shift_mm, turn_deg, size, is_cut, is_right
):
    values = np.zeros((32, 31, 30), np.uint8)
    values[14:17, 14:17, 14:17] = 1
    scan = Volume(0.0 * values, Grid(values.shape, np.zeros(3), 1e-3 * np.eye(3)))
    origin_mm = (shift_mm + is_cut, 0.0, 0.0)
    turn = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    path = tmp_path / "a.nrrd"
    made.write_image(path, values[is_cut:], [size] * 3, origin_mm, turn)
    with made.refused_if(not is_right, "nrrd"):
        assert read_labels(path, scan=scan)["label_1"].voxels == 27


def test_in_a_real_ct_left_is_left(recordings_dir):
    folder = recordings_dir / "torso_ct_totalsegmentator"
    scan = read_volume(folder / "ct.nii.gz")
    labels = read_labels(folder / "labels.nii.gz", folder / "labels.json", scan)
    names = ("vertebrae_L1", "spleen", "liver", "vertebrae_T12")
    middle_m, spleen_m, liver_m, upper_m = map(labels.centroid_m, names)

    assert (len(labels.structures), labels.unchecked) == (61, "")
    assert spleen_m[0] - middle_m[0] > 0.05 > 0.0 > liver_m[0] - middle_m[0]
    assert upper_m[2] > middle_m[2]
    assert middle_m[1] > liver_m[1]


POINTS = (
    '{"markups": [{"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": '
    '"mm", "controlPoints": [{"label": "", "position": [10.0, 20.0, 30.0]}, {"label": '
    '"b", "positionStatus": "undefined", "position": null}, {"label": "c", '
    '"position": [0, 0, 0]}]}]}'
)


FCSV = """\
# Markups fiducial file version = 4.11
# CoordinateSystem = LPS
# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID
1,10,20,30.5,0,0,0,1,1,1,0,"rib, right",,
2,1,2,3,0,0,0,1,1,1,0,navel,,
"""
TABLE_OF_POINTS = "name,x_lps_mm,y_lps_mm,z_lps_mm\nrib,10,20,30.5\n,1,2,3\n"


NAMES_OF_POINTS = {
    ".mrk.json": ("1", "c"),
    ".fcsv": ("rib, right", "navel"),
    ".csv": ("rib", "2"),
    ".txt": ("rib", "2"),
}


@pytest.mark.parametrize(
    ("name", "text", "first_mm"),
    [
        ("a.mrk.json", POINTS, [10, 20, 30]),
        ("a.mrk.json", POINTS.replace("LPS", "RAS"), [-10, -20, 30]),
        ("a.mrk.json", POINTS.replace('"LPS"', "0"), [-10, -20, 30]),
        ("a.mrk.json", POINTS.replace('"LPS"', "1"), [10, 20, 30]),
        ("a.mrk.json", POINTS.replace('"mm"', '"cm"'), [100, 200, 300]),
        ("a.mrk.json", POINTS.replace("LPS", "IJK"), None),
        ("a.mrk.json", POINTS.replace("coordinateSystem", "axes"), None),
        ("a.mrk.json", POINTS.replace('"mm"', '"inch"'), None),
        ("a.mrk.json", POINTS.replace('"c"', '"1"'), None),
        ("a.mrk.json", POINTS.replace("[10.0,", "[1e999,"), None),
        ("a.mrk.json", POINTS.replace('"markups": [', '"markups": [{},'), None),
        ("a.mrk.json", POINTS.replace("position", "place"), None),
        ("a.mrk.json", POINTS.replace("markups", "points"), None),
        ("a.mrk.json", POINTS.replace("{", ""), None),
        ("a.fcsv", FCSV, [10, 20, 30.5]),
        ("a.fcsv", FCSV.replace("LPS", "1"), [10, 20, 30.5]),
        ("a.fcsv", FCSV.replace("LPS", "0"), [-10, -20, 30.5]),
        ("a.fcsv", FCSV.replace("LPS", "RAS"), [-10, -20, 30.5]),
        # 3D Slicer 5 writes two fields that it does not name.
        ("a.fcsv", FCSV.replace(",,\n", ",,,2,0\n"), [10, 20, 30.5]),
        ("a.fcsv", FCSV.replace("\n", "\r\n"), [10, 20, 30.5]),
        ("a.fcsv", FCSV.replace("LPS", "2"), None),
        ("a.fcsv", FCSV.replace("navel", '"rib, right"'), None),
        ("a.csv", TABLE_OF_POINTS, [10, 20, 30.5]),
        ("a.csv", TABLE_OF_POINTS.replace("_lps_mm", " [LPS, m]"), None),
        ("a.csv", TABLE_OF_POINTS.replace("_lps_mm", "_ras_cm"), [-100, -200, 305]),
        (
            "a.txt",
            TABLE_OF_POINTS.replace(",", "\t").replace("_lps", " LPS"),
            [10, 20, 30.5],
        ),
        (
            "a.csv",
            TABLE_OF_POINTS.replace(",", ";").replace(".", ","),
            [10, 20, 30.5],
        ),
        ("a.csv", "# unit = mm\n" + TABLE_OF_POINTS.replace("_mm", ""), [10, 20, 30.5]),
        ("a.csv", "# unit = mm\n" + TABLE_OF_POINTS, [10, 20, 30.5]),
        ("a.csv", "# unit = m\n" + TABLE_OF_POINTS, None),
        ("a.csv", "# CoordinateSystem = 1\n" + TABLE_OF_POINTS, [10, 20, 30.5]),
        ("a.csv", "# CoordinateSystem = RAS\n" + TABLE_OF_POINTS, None),
        ("a.csv", TABLE_OF_POINTS.replace("30.5", "30,5"), None),
        ("a.csv", TABLE_OF_POINTS.replace("30.5", '"30,5"'), None),
        ("a.csv", TABLE_OF_POINTS.replace("30.5", ""), None),
        ("a.csv", TABLE_OF_POINTS.replace("30.5", "nan"), None),
        ("a.csv", TABLE_OF_POINTS.replace("y_lps_mm", "y_lps_m"), None),
        ("a.csv", TABLE_OF_POINTS.replace("y_lps_mm", "y_ras_mm"), None),
        ("a.csv", TABLE_OF_POINTS.replace("y_lps_mm", "height"), None),
        ("a.csv", "rib,10,20,30.5\n", None),
        ("a.csv", TABLE_OF_POINTS.split("\n")[0], None),
        ("a.csv", "", None),
        ("a.mrk.json", "[" * 20_000, None),
    ],
)
def test_points_lie_in_the_stated_frame_and_unit(tmp_path, name, text, first_mm):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with made.refused_if(first_mm is None, name):
        markup = read_markup(path)
        assert (markup.names, markup.is_line) == (NAMES_OF_POINTS[name[1:]], False)
        np.testing.assert_allclose(1e3 * markup.points_m[0], first_mm)


def test_what_a_table_leaves_unsaid_is_asked_for_and_what_it_says_counts(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("label;x;y;z\na;1;2;3\n", encoding="utf-8")

    with pytest.raises(VolumeError, match="--frame"):
        read_markup(path, unit="mm")
    with pytest.raises(VolumeError, match="--unit"):
        read_markup(path, frame="lps")
    np.testing.assert_allclose(read_markup(path, "m", "ras").points_m, [[-1, -2, 3]])
    path.write_text("x.0,y.0,z.0\n1,2,3\n", encoding="utf-8")
    np.testing.assert_allclose(read_markup(path, "m", "lps").points_m, [[1, 2, 3]])
    path.write_text(TABLE_OF_POINTS, encoding="utf-8")
    np.testing.assert_allclose(read_markup(path, "mm", "lps").points_m[1, 0], 1e-3)
    with pytest.raises(VolumeError, match="--unit"):
        read_markup(path, "m", "lps")
    with pytest.raises(VolumeError, match="--frame"):
        read_markup(path, "mm", "ras")


def transform(matrix, shift_mm=(10.0, 20.0, 30.0), centre_mm=(0.0, 0.0, 0.0)):
    numbers = np.ravel(matrix).astype(float).tolist()
    return SimpleITK.AffineTransform(numbers, shift_mm, centre_mm)


@pytest.mark.parametrize("name", ["a.h5", "a.tfm", "a.mat", "a.txt"])
def test_a_transform_of_itk_carries_points_and_slicers_is_its_inverse_in_ras(
    tmp_path, name
):
    centred = transform(TURN, centre_mm=(1.0, 2.0, 3.0))
    SimpleITK.WriteTransform(centred, str(tmp_path / name))
    point_mm = [4.0, 5.0, -6.0]
    shown_mm = np.array(centred.GetInverse().TransformPoint(point_mm))
    expected_mm = [centred.TransformPoint(point_mm), shown_mm * RAS]
    places_m = [
        read_transform(tmp_path / name, source).to_robot(1e-3 * np.array([point_mm]))[0]
        for source in ("itk", "slicer")
    ]

    np.testing.assert_allclose(1e3 * np.array(places_m), expected_mm, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.txt", "{0}\n{1}\n{2}\n{3}\n"),
        ("a.csv", "# CT to base\n{0}\n{1}\n{2}\n{3}"),
        ("a.json", "[[{0}], [{1}], [{2}], [{3}]]"),
        ("a.json", '{{"T_base_ct": [[{0}], [{1}], [{2}], [{3}]]}}'),
    ],
)
@pytest.mark.parametrize(("unit", "size"), [(None, 1.0), ("mm", 1.0), ("m", 1e-3)])
def test_a_matrix_carries_points_of_the_ct_as_lps_or_as_slicer_shows_them(
    tmp_path, name, text, unit, size
):
    shift_mm = np.array([10.0, 20.0, 30.0])
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([TURN, size * shift_mm])
    separator = " " if name == "a.txt" else ","
    rows = [separator.join(map(str, row)) for row in matrix.tolist()]
    (tmp_path / name).write_text(text.format(*rows), encoding="utf-8")
    point_mm = np.array([4.0, 5.0, -6.0])
    expected_mm = [TURN @ point + shift_mm for point in (point_mm, point_mm * RAS)]
    places_m = [
        read_transform(tmp_path / name, source, unit).to_robot(1e-3 * point_mm[None])[0]
        for source in ("itk", "slicer")
    ]

    np.testing.assert_allclose(1e3 * np.array(places_m), expected_mm, atol=1e-9)


NO_RIGID_MOTIONS = [
    (transform(1.01 * TURN), "1.01"),
    (transform(np.diag([-1.0, 1.0, 1.0])), "mirror"),
    (transform([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), None),
    (transform(TURN, (2e4, 0.0, 0.0)), "millimetres"),
    (SimpleITK.BSplineTransform(3), "BSpline"),
    (SimpleITK.Euler2DTransform(), "three"),
    (None, "cannot read"),
    ("no transform", "cannot read"),
]


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        *(
            (n, content, why)
            for n in ("a.h5", "a.tfm")
            for content, why in NO_RIGID_MOTIONS
        ),
        ("a.txt", "1 0 0 0.5\n0 1 0 0.2\n0 0 1 0.1\n0 0 0 1", "--unit"),
        ("a.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n500 200 100 1", "0 0 0 1"),
        ("a.txt", "1 0 0 500\n0 1 0 200\n0 0 1 100", "0 0 0 1"),
        ("a.txt", "1 0 0 nan\n0 1 0 200\n0 0 1 100\n0 0 0 1", "cannot read"),
        ("a.txt", "1,0 0,0 0,0 500,0\n" * 4, "0 0 0 1"),
        ("a.txt", "0 1 0 500\n1 0 0 200\n0 0 1 100\n0 0 0 1", "mirror"),
        ("a.json", '{"a": [[1]], "b": [[1]]}', "0 0 0 1"),
        ("a.json", "{}", "0 0 0 1"),
        ("a.json", "[", "0 0 0 1"),
        ("a.txt", "", "0 0 0 1"),
        ("a.txt", "1 0 0 inf\n0 1 0 200\n0 0 1 100\n0 0 0 1", "0 0 0 1"),
        ("a.mat", "MATLAB 5.0 MAT-file", "cannot read"),
        ("none.json", None, "none"),
    ],
)
def test_files_without_a_rigid_motion_are_refused(tmp_path, capfd, name, content, word):
    if isinstance(content, str):
        (tmp_path / name).write_text(content, encoding="utf-8")
    elif content is not None:
        SimpleITK.WriteTransform(content, str(tmp_path / name))
    with pytest.raises(VolumeError, match=word):
        read_transform(tmp_path / name, "itk")
    assert capfd.readouterr().err == ""
