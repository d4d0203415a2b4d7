"""Segmentations and transforms as TotalSegmentator, 3D Slicer and ITK write them."""

import gzip
import struct
from contextlib import suppress

import numpy as np
import pytest

from needleforce.anatomy import VolumeError, read_labels, read_transform, read_volume
from needleforce.anatomy.label_names import read_header_names
from needleforce.anatomy.renaming import rename
from needleforce.cli import main
from tests.needleforce.anatomy import slicer_files

sitk = pytest.importorskip("SimpleITK")

LIVER = slicer_files.anatomical("Liver")
MASS = slicer_files.terms(
    "49755003^Morphologically Altered Structure",
    "4147007",
    "Mass",
    region="SCT^10200004^Liver",
)
LEFT_RIB = slicer_files.anatomical("Rib", "SCT^7771000^Left")
NOTHING = slicer_files.NOTHING_SAID


def masks():
    """Liver, a lesion in it, a rib, and something else."""
    liver, lesion, rib, other = (np.zeros((12, 11, 10), np.uint8) for _ in range(4))
    liver[1:9, 1:9, 1:9] = 1
    lesion[3:6, 3:6, 3:6] = 1
    rib[9:11, 2:4, 2:4] = 1
    other[9:11, 6:8, 6:8] = 1
    return liver, lesion, rib, other


def slicer_10(path):
    """As Slicer 4.10: a component per segment."""
    segments = [
        ("Segment_1", LIVER, 0, 0),
        ("Segment_2", MASS, 0, 0),
        ("Rippe 7 links", LEFT_RIB, 0, 0),
        ("Läsion", NOTHING, 0, 0),
    ]
    slicer_files.write_seg_nrrd(path, masks(), segments, is_old=True)


def slicer_5(path):
    """As Slicer 5: segments that do not overlap share a layer."""
    liver, lesion, rib, other = masks()
    segments = [
        ("Segment_1", LIVER, 0, 1),
        ("Segment_2", MASS, 1, 1),
        ("Rippe 7 links", LEFT_RIB, 0, 3),
        ("Läsion", NOTHING, 0, 4),
    ]
    layers = (liver + 3 * rib + 4 * other, lesion)
    slicer_files.write_seg_nrrd(path, layers, segments)


@pytest.mark.parametrize("write", [slicer_10, slicer_5])
def test_segments_of_slicer_lie_and_are_called_as_there(tmp_path, write):
    write(tmp_path / "a.seg.nrrd")
    labels = read_labels(tmp_path / "a.seg.nrrd")

    names = [item.name for item in labels.structures]
    assert names == ["liver", "mass", "Rippe 7 links", "Läsion"]
    for name, mask in zip(names, masks(), strict=True):
        place_mm = slicer_files.place_mm(np.argwhere(mask).mean(axis=0))
        assert labels[name].voxels == mask.sum()
        np.testing.assert_allclose(1e3 * labels.centroid_m(name), place_mm, atol=1e-9)


def test_terms_say_what_a_needle_must_avoid(tmp_path):
    slicer_5(tmp_path / "a.seg.nrrd")
    labels = read_labels(tmp_path / "a.seg.nrrd")

    assert labels["Rippe 7 links"].is_obstacle
    assert labels["Rippe 7 links"].anatomy == "left rib"
    assert not labels["Läsion"].is_obstacle
    assert not labels["liver"].is_obstacle


def test_segments_of_one_term_keep_their_names_apart(tmp_path):
    liver, _, rib, other = masks()
    segments = [(f"Segment_{n}", LEFT_RIB, 0, n) for n in (1, 2, 3)]
    slicer_files.write_seg_nrrd(
        tmp_path / "a.seg.nrrd", [liver + 2 * rib + 3 * other], segments
    )

    assert [item.name for item in read_labels(tmp_path / "a.seg.nrrd").structures] == [
        "left rib (Segment_1)",
        "left rib (Segment_2)",
        "left rib (Segment_3)",
    ]


def nifti_of_totalsegmentator(path):
    """One file of labels, whose names are an extension of its header."""
    liver, _, rib, _ = masks()
    image = sitk.GetImageFromArray((5 * liver + 92 * rib).T)
    image.SetSpacing((1.5, 1.5, 1.5))
    sitk.WriteImage(image, str(path))
    whole = path.read_bytes()
    names = {5: "liver", 92: "rib_left_1", 93: "rib_left_2"}
    table = "".join(
        f'<Label Key="{key}" Red="1" Green="0" Blue="0" Alpha="1">'
        f"<![CDATA[{name}]]></Label>"
        for key, name in names.items()
    )
    xml = (
        '<?xml version="1.0" encoding="UTF-8"?><CaretExtension>'
        '<Date><![CDATA[2013-07-14T05:45:09]]></Date><VolumeInformation Index="0">'
        f"<LabelTable>{table}</LabelTable></VolumeInformation></CaretExtension>"
    ).encode()
    size = -(-(len(xml) + 8) // 16) * 16
    extension = struct.pack("<2i", size, 0) + xml.ljust(size - 8, b"\0")
    header = bytearray(whole[:348])
    struct.pack_into("<f", header, 108, 352.0 + size)
    path.write_bytes(bytes(header) + b"\1\0\0\0" + extension + whole[352:])


def test_labels_of_totalsegmentator_bring_their_names(tmp_path):
    nifti_of_totalsegmentator(tmp_path / "a.nii")
    (tmp_path / "labels.json").write_text('{"5": "spleen"}', encoding="utf-8")
    labels = read_labels(tmp_path / "a.nii")

    assert [item.name for item in labels.structures] == ["liver", "rib_left_1"]
    assert labels["rib_left_1"].is_obstacle


def test_masks_of_totalsegmentator_bring_their_names(tmp_path):
    liver, lesion, rib, _ = masks()
    for name, mask in (("liver", liver), ("lesion", lesion), ("rib_left_1", rib)):
        image = sitk.GetImageFromArray(mask.T.copy())
        sitk.WriteImage(image, str(tmp_path / f"{name}.nii.gz"))
    labels = read_labels(tmp_path)

    assert {item.name: item.voxels for item in labels.structures} == {
        "lesion": 27,
        "liver": 512,
        "rib_left_1": 8,
    }


def test_an_nrrd_file_that_was_copied_from_nifti_is_read(tmp_path):
    nifti_of_totalsegmentator(tmp_path / "a.nii")
    image = sitk.ReadImage(str(tmp_path / "a.nii"))
    assert image.GetMetaData("nifti_type") == "1"
    sitk.WriteImage(image, str(tmp_path / "a.nrrd"))
    copy = read_labels(tmp_path / "a.nrrd")
    original = read_labels(tmp_path / "a.nii")

    assert [item.name for item in copy.structures] == ["label_5", "label_92"]
    np.testing.assert_allclose(
        copy.centroid_m("label_5"), original.centroid_m("liver"), atol=1e-12
    )


def test_structures_are_renamed_by_name_or_value(tmp_path):
    slicer_5(tmp_path / "a.seg.nrrd")
    labels = read_labels(
        tmp_path / "a.seg.nrrd", {"Läsion": "rib", "Rippe 7 links": "rib"}
    )
    nifti_of_totalsegmentator(tmp_path / "a.nii")
    by_value = read_labels(tmp_path / "a.nii", {5: "spleen", 60: "nothing"})

    assert [item.name for item in labels.structures] == [
        "liver",
        "mass",
        "rib (Rippe 7 links)",
        "rib (Läsion)",
    ]
    assert all(item.is_obstacle for item in labels.structures[2:])
    assert [item.name for item in by_value.structures] == ["spleen", "rib_left_1"]
    with pytest.raises(VolumeError, match=r"called Leber: there are liver, mass"):
        rename(labels, {"Leber": "liver"})
    # A value does not say which of the overlapping structures is meant.
    with pytest.raises(VolumeError, match="no structure is called 1: "):
        rename(labels, {"1": "liver"})


def transform(matrix, shift_mm=(10.0, 20.0, 30.0)):
    affine = sitk.AffineTransform(3)
    affine.SetMatrix(np.asarray(matrix, float).ravel().tolist())
    affine.SetTranslation(shift_mm)
    return affine


TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("name", ["a.h5", "a.tfm"])
def test_a_transform_of_itk_carries_points_of_the_ct_to_the_robot(tmp_path, name):
    centred = transform(TURN)
    centred.SetCenter((1.0, 2.0, 3.0))
    sitk.WriteTransform(centred, str(tmp_path / name))
    motion = read_transform(tmp_path / name, "itk")
    point_mm = [4.0, 5.0, -6.0]
    expected_mm = centred.TransformPoint(point_mm)

    place_m = motion.rotation @ (1e-3 * np.array(point_mm)) + motion.translation_m
    np.testing.assert_allclose(1e3 * place_m, expected_mm, atol=1e-9)


@pytest.mark.parametrize("name", ["a.h5", "a.tfm"])
def test_a_transform_of_slicer_does_what_slicer_shows(tmp_path, name):
    """Slicer shows RAS to RAS, and writes the inverse, in LPS."""
    shown = np.eye(4)
    shown[:3, :3] = TURN
    shown[:3, 3] = (100.0, -50.0, 25.0)
    flip = np.diag((-1.0, -1.0, 1.0, 1.0))
    written = flip @ np.linalg.inv(shown) @ flip
    affine = transform(written[:3, :3], written[:3, 3].tolist())
    sitk.WriteTransform(affine, str(tmp_path / name))
    motion = read_transform(tmp_path / name, "slicer")
    point_ras_mm = np.array([12.0, 34.0, 56.0, 1.0])
    point_m = 1e-3 * (flip @ point_ras_mm)[:3]

    place_mm = 1e3 * (motion.rotation @ point_m + motion.translation_m)
    np.testing.assert_allclose(place_mm, (shown @ point_ras_mm)[:3], atol=1e-9)


@pytest.mark.parametrize(
    ("made", "why"),
    [
        (transform(1.01 * TURN), "stretches by 1.01"),
        (transform(np.diag([-1.0, 1.0, 1.0])), "mirror image"),
        (transform([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), "stretches"),
        (transform(TURN, (2e4, 0.0, 0.0)), "expected a file in millimetres"),
        (sitk.BSplineTransform(3), "holds a BSplineTransform"),
        (sitk.Euler2DTransform(), "holds a Euler2DTransform"),
    ],
)
def test_transforms_that_are_no_rigid_motion_are_refused(tmp_path, made, why):
    sitk.WriteTransform(made, str(tmp_path / "a.tfm"))
    with pytest.raises(VolumeError, match=why) as refused:
        read_transform(tmp_path / "a.tfm", "itk")
    assert "Save a rigid transform" in refused.value.advice


@pytest.mark.parametrize(
    ("name", "why"),
    [("a.h5", "no HDF5 file"), ("a.tfm", "ITK ERROR"), ("none.h5", "No such file")],
)
def test_files_without_a_transform_are_refused(tmp_path, capfd, name, why):
    if name != "none.h5":
        (tmp_path / name).write_text("no transform", encoding="utf-8")
    with pytest.raises(VolumeError, match=why):
        read_transform(tmp_path / name, "slicer")
    assert capfd.readouterr().err == ""


def dicom_file(path, sop_class):
    """The start of a DICOM file of a class."""
    text = sop_class.encode()
    text += b"\0" * (len(text) % 2)
    meta = b"\x02\x00\x02\x00UI" + struct.pack("<H", len(text)) + text
    path.write_bytes(b"\0" * 128 + b"DICM" + meta + b"\0" * 64)


@pytest.mark.parametrize("is_folder", [True, False])
def test_contours_are_refused_with_the_way_to_labels(tmp_path, is_folder):
    dicom_file(tmp_path / "RS.dcm", ".".join(("1.2.840.10008.5.1", "4.1.1", "481.3")))
    with pytest.raises(VolumeError, match=r"RTSTRUCT.*SlicerRT.*\.seg\.nrrd"):
        read_labels(tmp_path if is_folder else tmp_path / "RS.dcm")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("label_1=boen", "'boen' is no known kind; expected one of bone, rib"),
        ("label_1=", "'label_1=' is not NAME=KIND"),
        ("label_1=rib,label_1=liver", "label_1 stands in it twice"),
    ],
)
def test_structures_that_cannot_be_meant_are_refused(capsys, text, why):
    arguments = ["plan", "--ct", "ct", "--labels", "a", "--target", "b"]

    assert main([*arguments, "--structures", text]) == 2
    assert why in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["utf-16-be", "utf-16-le", "utf-8", "cp037"])
def test_a_table_of_labels_with_entities_is_not_read(tmp_path, encoding):
    # Bytes of "<Label" in another encoding, so that the table is looked at.
    disguise = b"<Label".decode("utf-16-be" if encoding == "utf-16-be" else "utf-16-le")
    comment = f"<!--{disguise}-->" if encoding.startswith("utf-16") else ""
    table = (
        f'<!DOCTYPE a [<!ENTITY e "liver">]>{comment}<a><Label Key="5">&e;</Label></a>'
    )
    text = table.encode(encoding)
    if encoding.startswith("utf-16"):
        text = "\ufeff".encode(encoding) + text
    if encoding == "cp037":
        text = b'<?xml version="1.0" encoding="cp037"?>' + b"<!--<Label-->" + text
    path = tmp_path / "a.nii"
    size = len(text) + 8
    header = bytearray(348)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<f", header, 108, 352.0 + size)
    path.write_bytes(bytes(header) + b"\1\0\0\0" + struct.pack("<2i", size, 0) + text)

    with suppress(VolumeError):  # of what is no UTF-8
        assert read_header_names(path) == {}


def test_labels_that_were_computed_with_are_rounded_and_others_named(tmp_path):
    values = np.zeros((8, 8, 8), np.float32)
    values[2:6, 2:6, 2:6] = 0.99999994
    image = sitk.GetImageFromArray(values)
    image.SetSpacing([8.0, 8.0, 8.0])
    sitk.WriteImage(image, str(tmp_path / "labels.nii.gz"))

    assert read_labels(tmp_path / "labels.nii.gz")["label_1"].voxels == 64

    sitk.WriteImage(0.5 * image, str(tmp_path / "half.nii.gz"))
    with pytest.raises(VolumeError, match=r"0\.4999.*whole numbers"):
        read_labels(tmp_path / "half.nii.gz")


def test_voxels_that_are_no_numbers_are_refused(tmp_path):
    values = np.zeros((8, 8, 8), np.float32)
    values[0, 0, :2] = np.nan
    image = sitk.GetImageFromArray(values)
    image.SetSpacing([8.0, 8.0, 8.0])
    sitk.WriteImage(image, str(tmp_path / "ct.nii.gz"))

    with pytest.raises(VolumeError, match="2 voxels that are no finite numbers"):
        read_volume(tmp_path / "ct.nii.gz")


def test_the_unit_metre_and_version_2_are_named(tmp_path):
    image = sitk.GetImageFromArray(np.zeros((8, 8, 8), np.int16))
    image.SetSpacing([8.0, 8.0, 8.0])
    sitk.WriteImage(image, str(tmp_path / "ct.nii"))
    content = bytearray((tmp_path / "ct.nii").read_bytes())
    content[123] = 1  # xyzt_units: metre
    (tmp_path / "metres.nii").write_bytes(content)
    (tmp_path / "version2.nii").write_bytes(struct.pack("<i", 540) + content[4:])

    packed = gzip.compress((tmp_path / "version2.nii").read_bytes())
    (tmp_path / "packed.nii.gz").write_bytes(packed)

    with pytest.raises(VolumeError, match="NIfTI-2; convert it to NIfTI-1"):
        read_volume(tmp_path / "packed.nii.gz")
    with pytest.raises(VolumeError, match="metre"):
        read_volume(tmp_path / "metres.nii")
    with pytest.raises(VolumeError, match="NIfTI-2; convert it to NIfTI-1"):
        read_volume(tmp_path / "version2.nii")
