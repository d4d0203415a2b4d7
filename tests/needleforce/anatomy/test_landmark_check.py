"""Landmarks against each other, and names of labels as TotalSegmentator writes them."""

import gzip
import struct

import numpy as np
import pytest

pytest.importorskip("SimpleITK")
import SimpleITK as sitk

from needleforce.anatomy import (
    RegistrationError,
    VolumeError,
    fit_landmarks,
    read_labels,
)
from needleforce.anatomy.landmark_check import find_equal_order, judge_landmarks
from needleforce.anatomy.markups import read_markup
from tests.needleforce.anatomy.test_registration import FRONT_m, touched


def test_a_landmark_that_is_off_is_named():
    rng = np.random.default_rng(1000)
    named = 0
    for _ in range(100):
        robot, _ = touched(FRONT_m, rng, 1e-3)
        way = rng.normal(size=3)
        robot[2] += 8e-3 * way / np.linalg.norm(way)
        worst = min(
            judge_landmarks(FRONT_m, robot, 1e-3), key=lambda one: one.probability
        )
        named += worst.name == "3" and worst.is_doubtful

    assert named >= 90


@pytest.mark.slow
def test_good_landmarks_are_seldom_doubted():
    rng = np.random.default_rng(1001)
    doubted = 0
    for _ in range(200):
        robot, _ = touched(FRONT_m, rng, 1e-3)
        residuals = judge_landmarks(FRONT_m, robot, 1e-3)
        doubted += sum(one.is_doubtful for one in residuals)

    assert doubted / (200 * len(FRONT_m)) == pytest.approx(0.01, abs=0.01)


@pytest.mark.parametrize(("aside_m", "is_equal"), [(2.6e-3, True), (2.8e-3, False)])
def test_another_order_fits_as_well_within_ten_variances(aside_m, is_equal):
    """Landmarks 3 and 4 exchanged leave 9.4 and 10.9 of them."""
    landmarks_m = 1e-3 * np.array(
        [[0.0, 0, 0], [120, 0, 0], [50, 40, 0], [50 + 1e3 * aside_m, -40, 0]]
    )
    order = find_equal_order(landmarks_m, landmarks_m, 1e-3)

    assert order == ((0, 1, 3, 2) if is_equal else None)


def test_four_landmarks_are_not_verified():
    robot, _ = touched(FRONT_m[:4], np.random.default_rng(1002))
    residuals = judge_landmarks(FRONT_m[:4], robot, 1e-3)

    assert not any(np.isfinite(one.probability) for one in residuals)


def test_markers_of_a_square_are_refused_in_any_order():
    square_m = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    rng = np.random.default_rng(1003)
    for order in ([0, 1, 2, 3], [1, 0, 3, 2]):
        robot, _ = touched(square_m[order], rng, 1e-3)
        with pytest.raises(RegistrationError, match="in another order"):
            fit_landmarks(square_m, robot, std_m=1e-3)


TABLE = (
    '<?xml version="1.0" encoding="UTF-8"?> <CaretExtension>  <VolumeInformation '
    'Index="0">   <LabelTable>'
    '<Label Key="5" Red="0.2" Green="0.3" Blue="0.1" Alpha="1"><![CDATA[liver]]>'
    '</Label><Label Key="92" Red="0.9" Green="0.8" Blue="0.5" Alpha="1">'
    "<![CDATA[rib_left_1]]></Label>"
    "</LabelTable>  <VolumeType><![CDATA[Label]]></VolumeType>   </VolumeInformation>"
    "</CaretExtension>"
)


def blocks():
    labels = np.zeros((20, 20, 20), np.uint8)
    labels[4:12, 4:12, 4:12] = 5
    labels[14:16, 4:12, 4:12] = 92
    return labels


def write_nifti(path, values):
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((2.0, 2.0, 2.0))
    sitk.WriteImage(image, str(path))


def write_with_table(path, table):
    """Write labels with a table in the header, as nibabel writes an extension."""
    plain = path.with_name("plain.nii")
    write_nifti(plain, blocks())
    content = bytearray(plain.read_bytes())
    text = table.encode()
    size = 16 * -(-(len(text) + 8) // 16)
    extension = struct.pack("<ii", size, 0) + text.ljust(size - 8, b"\0")
    voxels = bytes(content[352:])
    struct.pack_into("<f", content, 108, 352.0 + size)
    content[348:352] = b"\1\0\0\0"
    path.write_bytes(gzip.compress(bytes(content[:352]) + extension + voxels))
    plain.unlink()


def test_names_in_the_header_of_a_nifti_file_are_read(tmp_path):
    path = tmp_path / "segmentation.nii.gz"
    write_with_table(path, TABLE)
    labels = read_labels(path)

    assert {item.name: item.value for item in labels.structures} == {
        "liver": 5,
        "rib_left_1": 92,
    }
    assert labels["rib_left_1"].is_obstacle


def test_a_damaged_table_of_names_is_refused(tmp_path):
    path = tmp_path / "segmentation.nii.gz"
    write_with_table(path, TABLE.replace("</LabelTable>", ""))

    with pytest.raises(VolumeError, match="table of labels"):
        read_labels(path)


def test_a_folder_of_masks_is_read_by_the_names_of_its_files(tmp_path):
    values = blocks()
    write_nifti(tmp_path / "liver.nii.gz", (values == 5).astype(np.uint8))
    write_nifti(tmp_path / "rib_left_1.nii.gz", (values == 92).astype(np.uint8))
    write_nifti(tmp_path / "spleen.nii.gz", np.zeros_like(values))
    labels = read_labels(tmp_path)

    assert {item.name: item.voxels for item in labels.structures} == {
        "liver": 512,
        "rib_left_1": 128,
    }
    write_nifti(tmp_path / "ct.nii.gz", values)

    with pytest.raises(VolumeError, match=r"ct\.nii\.gz holds 0 to 92"):
        read_labels(tmp_path)


@pytest.mark.parametrize(("frame", "sign"), [("LPS", 1.0), ("RAS", -1.0)])
def test_points_of_slicer_are_read_in_either_frame(frame, sign, tmp_path):
    path = tmp_path / "points.mrk.json"
    path.write_text(
        f'{{"markups": [{{"type": "Fiducial", "coordinateSystem": "{frame}", '
        '"coordinateUnits": "mm", "controlPoints": [{"id": "1", "label": "F-1", '
        '"position": [10.0, 20.0, 30.0], "positionStatus": "defined"}]}]}',
        encoding="utf-8",
    )
    markup = read_markup(path)

    assert markup.names == ("F-1",)
    assert np.allclose(markup.points_m, [[sign * 0.01, sign * 0.02, 0.03]])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset_m", "count", "draws"),
    [(0, 4, 300), (3e-3, 4, 300), (3e-3, 6, 100), (5e-3, 5, 300), (10e-3, 6, 30)],
)
def test_the_region_holds_or_the_fit_is_refused_with_one_landmark_off(
    offset_m, count, draws
):
    rng = np.random.default_rng(1010)
    target_m = np.array([0.0, 0.05, 0.0])
    inside = []
    refused = 0
    for _ in range(draws):
        robot, (rotation, shift) = touched(FRONT_m[:count], rng, 1e-3)
        way = rng.normal(size=3)
        robot[rng.integers(count)] += offset_m * way / np.linalg.norm(way)
        try:
            fit = fit_landmarks(FRONT_m[:count], robot, std_m=1e-3, is_std_known=True)
        except RegistrationError:
            refused += 1
            continue
        inside.append(fit.region_contains(target_m, rotation @ target_m + shift))

    assert refused > 0.8 * draws or np.mean(inside) == pytest.approx(0.95, abs=0.04)
    assert refused == 0 or offset_m > 3e-3


def test_an_order_of_three_is_named():
    robot, _ = touched(FRONT_m[[1, 2, 0, 3, 4, 5]], np.random.default_rng(1011), 1e-3)

    with pytest.raises(RegistrationError, match=r"fit in the order 3, 1, 2, 4, 5, 6"):
        fit_landmarks(FRONT_m, robot, std_m=1e-3)
