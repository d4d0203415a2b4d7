"""What spares time and memory on large volumes changes no result."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from needleforce.anatomy import (
    Grid,
    Labels,
    Structure,
    Volume,
    read_labels,
    read_volume,
)
from needleforce.anatomy import deepest_point as deepest_point_module
from needleforce.anatomy import slabs as slabs_module
from needleforce.anatomy.deepest_point import deepest_point_m
from needleforce.anatomy.resampling import resample_nearest

SPACING_m = np.array([0.7e-3, 0.9e-3, 1.5e-3])


@pytest.fixture(params=[4_000_000, 900])
def slab_voxels(request, monkeypatch):
    """Volumes as one slab, and as many."""
    monkeypatch.setattr(slabs_module, "SLAB_VOXELS", request.param)


def blobs(rng, shape=(24, 30, 27), level=0.0):
    """A mask of uneven bodies, some of which reach the edges."""
    return ndimage.gaussian_filter(rng.normal(size=shape), 2.5) > level


def labels_of(*masks, spacing_m=SPACING_m):
    values = np.zeros(masks[0].shape, np.uint8)
    for value, mask in enumerate(masks, 1):
        values[mask] = value
    names = [Structure.named(f"rib_{k}", k) for k in range(1, len(masks) + 1)]
    grid = Grid(values.shape, np.array([0.1, -0.2, 0.3]), np.diag(spacing_m))
    return Labels.of([values], grid, names)


@pytest.mark.parametrize("head_axis", [0, 1, 2])
def test_body_and_fat_are_those_of_whole_volumes(head_axis, slab_voxels):
    rng = np.random.default_rng(1000 + head_axis)
    shape = (26, 22, 24)
    places = np.stack(np.meshgrid(*[np.linspace(-1, 1, n) for n in shape]), axis=-1)
    inside = np.linalg.norm(places, axis=-1).swapaxes(0, 1) < 0.8
    scan_HU = np.where(inside, 40.0, -1000.0)
    scan_HU[inside & blobs(rng, shape, 0.02)] = -100.0
    scan_HU[inside & blobs(rng, shape, 0.06)] = -900.0  # holes, closed and open
    scan_HU += 45.0 * rng.normal(size=shape)
    axes_m = np.roll(1e-3 * np.eye(3), head_axis - 2, axis=1)
    grid = Grid(shape, np.zeros(3), axes_m)
    labels = Labels.of(
        [inside.astype(np.uint8)], grid, [Structure.named("part", 1)]
    ).with_body(Volume(scan_HU.astype(np.int16), grid), fat=True)

    parts, _ = ndimage.label(scan_HU.astype(np.int16) > -300)
    body = parts == np.bincount(parts[parts > 0]).argmax()
    for section in np.moveaxis(body, head_axis, 0):
        section[:] = ndimage.binary_fill_holes(section)
    is_fat = body & (ndimage.median_filter(scan_HU.astype(np.int16), 3) < -30)

    np.testing.assert_array_equal(labels.volumes[1] == labels["fat"].value, is_fat)
    np.testing.assert_array_equal(labels.volumes[1] > 0, body)
    assert labels["fat"].voxels == is_fat.sum() > 100


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
def test_labels_on_another_grid_take_the_nearest_voxel(turn, step, shift):
    rng = np.random.default_rng(1000)
    values = rng.integers(0, 3, (24, 30, 27)).astype(np.uint8)
    oblique = Rotation.from_rotvec([0.4, -0.2, 0.7]).as_matrix()
    source = Grid(values.shape, np.array([0.1, 0.2, 0.0]), oblique * 1e-3)
    axes_m = source.axes_m @ (turn * step)
    target = Grid((40, 33, 36), source.points_m(shift), axes_m)
    if np.array_equal(turn, np.eye(3)) and step == [1.0, 1.0, 1.0]:
        target = source
    expected = ndimage.affine_transform(
        values,
        turn * step,
        np.array(shift),
        target.shape,
        order=0,
        mode="grid-constant",
    )

    np.testing.assert_array_equal(resample_nearest(values, source, target), expected)


def test_the_deepest_point_is_found_by_blocks(monkeypatch):
    rng = np.random.default_rng(1000)
    for level in (0.0, 0.08):
        labels = labels_of(blobs(rng, (60, 50, 40), level))
        whole_m = deepest_point_m(labels, "rib_1")
        monkeypatch.setattr(deepest_point_module, "MAX_VOXELS", 0)
        np.testing.assert_array_equal(deepest_point_m(labels, "rib_1"), whole_m)
        monkeypatch.undo()


def test_centroids_are_means_of_voxels():
    rng = np.random.default_rng(1000)
    labels = labels_of(blobs(rng))
    places_m = labels.grid.points_m(np.argwhere(labels.volumes[0] == 1))

    np.testing.assert_allclose(labels.centroid_m("rib_1"), places_m.mean(axis=0))


def test_files_with_a_slope_take_no_more_memory(tmp_path):
    sitk = pytest.importorskip("SimpleITK")
    values = np.arange(-1000, 1000, 2).reshape(10, 10, 10)
    for kind, expected in ((np.float64, np.int16), (np.int32, np.int16)):
        sitk.WriteImage(
            sitk.GetImageFromArray(values.astype(kind)), str(tmp_path / "a.nii")
        )
        scan = read_volume(tmp_path / "a.nii")

        assert scan.values.dtype == expected
        assert scan.values.flags.c_contiguous
        np.testing.assert_array_equal(scan.values, values.T)

    fine = sitk.GetImageFromArray(values + 0.25)
    sitk.WriteImage(fine, str(tmp_path / "a.nii"))
    np.testing.assert_array_equal(
        read_volume(tmp_path / "a.nii").values, values.T + 0.25
    )
    whole = sitk.GetImageFromArray((values > 0).astype(np.float32))
    sitk.WriteImage(whole, str(tmp_path / "b.nii"))
    assert read_labels(tmp_path / "b.nii").volumes[0].dtype == np.uint8


@pytest.mark.parametrize("spacing_mm", [[0.75] * 3, [0.5, 1.0, 4.0]])
def test_surfaces_to_look_at_have_larger_voxels(spacing_mm):
    pytest.importorskip("manifold3d")
    spacing_m = 1e-3 * np.array(spacing_mm)
    shape = np.ceil(0.05 / spacing_m).astype(int)
    places_m = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    ball = np.linalg.norm(places_m * spacing_m - 0.025, axis=-1) < 0.02
    labels = labels_of(ball, spacing_m=spacing_m)
    fine = labels.surfaces()["rib_1"]
    coarse = labels.surfaces(voxel_m=3e-3)["rib_1"]
    middle_m = labels.centroid_m("rib_1")
    radii_m = np.linalg.norm(coarse.vertices_m - middle_m, axis=1)

    assert len(coarse.triangles) < 0.5 * len(fine.triangles)
    assert coarse.mesh.is_volume
    assert radii_m.min() > 0.0185
    assert radii_m.max() < 0.0215


def test_a_thin_structure_stays_among_larger_voxels():
    pytest.importorskip("manifold3d")
    sheet = np.zeros((20, 20, 20), bool)
    sheet[2:18, 2:18, 9] = True
    surface = labels_of(sheet, spacing_m=np.full(3, 0.5e-3)).surfaces(voxel_m=3e-3)

    assert surface["rib_1"].mesh.is_volume
