"""Scans and segmentations: where they lie, and what is refused."""

import json
import shutil
from itertools import product

import numpy as np
import pytest

sitk = pytest.importorskip("SimpleITK")

from needleforce.anatomy import (  # noqa: E402
    AnatomyError,
    Grid,
    Image,
    Labels,
    Structure,
    StructureError,
    VolumeError,
    read_image,
    read_labels,
)

TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def written(path, numbers, axes_mm, origin_mm, meta=()):
    """A volume indexed [i, j, k] in a file, with columns of axes as they are in LPS."""
    image = sitk.GetImageFromArray(np.ascontiguousarray(numbers.T))
    spacing = np.linalg.norm(axes_mm, axis=0)
    image.SetSpacing(spacing.tolist())
    image.SetDirection((axes_mm / spacing).ravel().tolist())
    image.SetOrigin(list(origin_mm))
    for key, value in dict(meta).items():
        image.SetMetaData(key, value)
    sitk.WriteImage(image, str(path))
    return path


def two_organs():
    numbers = np.zeros((14, 11, 9), dtype=np.uint8)
    numbers[2:9, 3:6, 1:5] = 1
    numbers[9:13, 2:9, 4:8] = 7
    numbers[2, 3, 1] = 0  # nothing is symmetric
    return numbers


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha", ".seg.nrrd"])
@pytest.mark.parametrize("signs", list(product((1.0, -1.0), repeat=3)))
def test_a_label_lies_where_it_is_whatever_format_and_orientation(tmp_path, suffix, signs):
    numbers = two_organs()
    axes_mm = TURN * [0.9, 1.3, 2.1] * signs
    origin_mm = np.array([31.0, -57.0, 113.0])
    meta = {
        "Segment0_LabelValue": "1",
        "Segment0_Name": "liver",
        "Segment0_Layer": "0",
        "Segment0_Color": "0.5 0.25 0",
        "Segment1_LabelValue": "7",
        "Segment1_Name": "rib 9",
        "Segment1_Layer": "0",
    }
    path = written(
        tmp_path / f"labels{suffix}", numbers, axes_mm, origin_mm, meta if "seg" in suffix else ()
    )
    (tmp_path / "labels.json").write_text('{"1": "liver", "7": "rib 9"}')
    labels = read_labels(path)
    for name, number in (("liver", 1), ("rib 9", 7)):
        true_mm = origin_mm + np.argwhere(numbers == number).mean(axis=0) @ axes_mm.T
        assert np.abs(1e3 * labels.centroid_m(name) - true_mm).max() < 1e-5
        count = np.count_nonzero(numbers == number)
        assert labels.volume_m3(name) == pytest.approx(1e-9 * count * 0.9 * 1.3 * 2.1, rel=1e-6)
    assert labels.named("rib 9").is_obstacle
    assert not labels.named("liver").is_obstacle
    if "seg" in suffix:
        assert labels.named("liver").color == (0.5, 0.25, 0.0)


def test_of_overlapping_segments_the_later_lies_on_top(tmp_path):
    one, two = np.zeros((6, 6, 6), np.uint8), np.zeros((6, 6, 6), np.uint8)
    one[1:4], two[3:5] = 1, 1
    images = [sitk.GetImageFromArray(each.T.copy()) for each in (one, two)]
    both = sitk.Compose(images)
    for number, name in enumerate(("liver", "lesion")):
        both.SetMetaData(f"Segment{number}_LabelValue", "1")
        both.SetMetaData(f"Segment{number}_Name", name)
        both.SetMetaData(f"Segment{number}_Layer", str(number))
    sitk.WriteImage(both, str(tmp_path / "a.seg.nrrd"))
    labels = read_labels(tmp_path / "a.seg.nrrd")
    volumes = {name: round(labels.volume_m3(name) / 1e-9) for name in ("liver", "lesion")}
    assert volumes == {"liver": 72, "lesion": 72}


def dicom(folder, count=6, *, leave_out=(), series="1.2.3"):
    folder.mkdir(exist_ok=True)
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    for k in range(count):
        if k in leave_out:
            continue
        image = sitk.GetImageFromArray(np.full((5, 4), 10 * k, np.int16))
        image.SetSpacing((0.7, 0.8))
        tags = {
            "0008|0060": "CT",
            "0020|000e": series,
            "0020|0032": f"3\\4\\{2.0 * k:g}",
            "0020|0037": "1\\0\\0\\0\\1\\0",
            "0018|0050": "2.0",
            "0020|0013": str(k),
        }
        for tag, value in tags.items():
            image.SetMetaData(tag, value)
        writer.SetFileName(str(folder / f"{series}-{k}.dcm"))
        writer.Execute(image)
    return folder


def test_a_dicom_series_is_read(tmp_path):
    image = read_image(dicom(tmp_path / "a"))
    assert image.grid.shape == image.values.shape == (4, 5, 6)
    assert np.allclose(1e3 * image.grid.spacing_m, [0.7, 0.8, 2.0])
    assert image.values[1, 2, 3] == 30


def test_what_cannot_be_a_scan_is_refused_by_name(tmp_path):
    with pytest.raises(VolumeError, match="slices are missing or double"):
        read_image(dicom(tmp_path / "gap", leave_out=(2,)))
    mixed = dicom(tmp_path / "mixed")
    dicom(mixed, series="1.2.4")
    with pytest.raises(VolumeError, match="holds 2 DICOM series"):
        read_image(mixed)
    (tmp_path / "empty").mkdir()
    with pytest.raises(VolumeError, match="no DICOM series"):
        read_image(tmp_path / "empty")
    with pytest.raises(VolumeError, match="does not exist"):
        read_image(tmp_path / "none.nii")
    (tmp_path / "text.nii").write_text("no volume")
    with pytest.raises(VolumeError, match="no volume that can be read"):
        read_image(tmp_path / "text.nii")
    fractions = written(tmp_path / "f.nrrd", np.full((3, 3, 3), 0.5), np.eye(3), np.zeros(3))
    with pytest.raises(VolumeError, match="fractions"):
        read_labels(fractions)
    nothing = written(tmp_path / "0.nrrd", np.zeros((3, 3, 3), np.uint8), np.eye(3), np.zeros(3))
    with pytest.raises(VolumeError, match="every voxel is 0"):
        read_labels(nothing)
    shutil.copy(nothing, tmp_path / "names.nrrd")
    with pytest.raises(VolumeError, match="expected a JSON object"):
        read_labels(nothing, tmp_path / "names.nrrd")


def test_names_come_from_the_caller_too(tmp_path):
    path = written(tmp_path / "a.nrrd", two_organs(), np.eye(3), np.zeros(3))
    assert read_labels(path, {1: "liver"}).named("liver").number == 1
    assert read_labels(path).named("label 7").number == 7
    (tmp_path / "n.json").write_text(json.dumps({"7": "spleen"}))
    labels = read_labels(path, tmp_path / "n.json")
    assert labels.name_of(7) == "spleen"
    assert labels.name_of(0) == "unlabelled"
    with pytest.raises(StructureError, match="there are: label 1, spleen"):
        labels.named("heart")
    assert issubclass(StructureError, AnatomyError)


def test_a_segmentation_of_another_scan_is_refused():
    grid = Grid(np.zeros(3), 1e-3 * np.eye(3), (14, 11, 9))
    labels = Labels(grid, two_organs(), {1: Structure(1, "liver", (1.0, 0.0, 0.0))})
    scan = Image(grid, np.zeros(grid.shape))
    labels.require_same_space(scan)
    moved = Grid(np.array([0.0, 0.0, 0.2]), grid.axes_m, grid.shape)
    with pytest.raises(VolumeError, match="outside the scan"):
        labels.require_same_space(Image(moved, scan.values))
    thicker = Grid(grid.origin_m, 1e-3 * np.diag([1.0, 1.0, 1.5]), grid.shape)
    with pytest.raises(VolumeError, match="different axes or spacing"):
        labels.require_same_space(Image(thicker, scan.values))
    with pytest.raises(VolumeError, match="expected one"):
        Labels(grid, np.zeros((2, 2, 2), np.uint8), {})
