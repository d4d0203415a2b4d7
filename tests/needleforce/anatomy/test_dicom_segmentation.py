"""DICOM segmentations: places, names, overlaps, refusals."""

import sys

import numpy as np
import pytest

from needleforce.anatomy import VolumeError, read_labels

pytest.importorskip("highdicom")
pytest.importorskip("SimpleITK")

from tests.needleforce.anatomy import dicom_files


def masks(*, overlap=False):
    """Liver, rib and kidney; empty slices around and between them."""
    liver, rib, kidney = (np.zeros((10, 12, 14), bool) for _ in range(3))
    kidney[3:5, 4:6, 3:5] = True
    liver[2:8, 3:9, 2:6] = True
    if not overlap:
        liver &= ~kidney
    rib[2:5, 3:9, 8:12] = True
    return liver, rib, kidney


SEGMENTS = [
    dicom_files.segment(1, "Segment_1", "Liver"),
    dicom_files.segment(2, "Rippe", "Rib"),
    dicom_files.segment(3, "Segment_3", "Kidney", "Left"),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "overlap"), [("BINARY", False), ("BINARY", True), ("LABELMAP", False)]
)
@pytest.mark.parametrize("is_folder", [False, True])
def test_segments_lie_and_are_called_as_in_the_file(tmp_path, kind, overlap, is_folder):
    expected = masks(overlap=overlap)
    path = tmp_path / "seg.dcm"
    dicom_files.write_segmentation(path, expected, SEGMENTS, kind)
    labels = read_labels(tmp_path if is_folder else path)

    names = [item.name for item in labels.structures]
    assert names == ["liver", "Rippe", "left kidney"]
    assert [item.is_obstacle for item in labels.structures] == [False, True, False]
    for name, mask in zip(names, expected, strict=True):
        assert labels[name].voxels == mask.sum()
        np.testing.assert_allclose(
            1e3 * labels.centroid_m(name),
            dicom_files.place_mm(np.argwhere(mask).mean(axis=0)),
            atol=1e-9,
        )


@pytest.mark.parametrize("first_slice", [6, 8])
def test_rounded_positions_are_read(tmp_path, first_slice):
    """Also where empty slices between two structures are left out."""
    liver, rib, kidney = masks()
    rib[:] = False
    rib[2:5, 3:9, first_slice : first_slice + 4] = True
    path = tmp_path / "seg.dcm"
    dicom_files.write_segmentation(path, [liver, rib, kidney], SEGMENTS, decimals=1)
    labels = read_labels(path)

    centre_mm = dicom_files.place_mm(np.argwhere(rib).mean(axis=0))
    assert labels.grid.spacing_m[0] == pytest.approx(1.25e-3, rel=0.01)
    np.testing.assert_allclose(1e3 * labels.centroid_m("Rippe"), centre_mm, atol=0.08)


def test_fractional_segments_are_refused(tmp_path):
    path = tmp_path / "seg.dcm"
    dicom_files.write_segmentation(path, masks(), SEGMENTS, "FRACTIONAL")
    with pytest.raises(VolumeError, match=r"fractional segments.*binary"):
        read_labels(path)


def test_a_damaged_segmentation_is_refused(tmp_path):
    path = tmp_path / "seg.dcm"
    dicom_files.write_segmentation(path, masks(), SEGMENTS)
    whole = path.read_bytes()
    for size in (600, len(whole) - 40):
        path.write_bytes(whole[:size])
        with pytest.raises(VolumeError):
            read_labels(path)


def test_a_segmentation_beyond_the_limit_is_refused(tmp_path):
    path = tmp_path / "seg.dcm"
    dicom_files.write_segmentation(path, masks(), SEGMENTS)
    with pytest.raises(VolumeError, match="more than the limit"):
        read_labels(path, max_bytes=100)


def test_without_highdicom_the_extra_is_named(tmp_path, monkeypatch):
    path = tmp_path / "seg.dcm"
    dicom_files.write_segmentation(path, masks(), SEGMENTS)
    monkeypatch.setitem(sys.modules, "highdicom", None)
    with pytest.raises(VolumeError, match=r"needs highdicom: .*patient"):
        read_labels(path)
