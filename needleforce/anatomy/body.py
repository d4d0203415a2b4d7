"""The patient's body in a CT, its fat and its lean tissue; labels on another grid."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.volume import Grid, Volume

BODY_HU = -300.0
"""Between air and fat, in Hounsfield units."""

FAT_HU = -30.0
"""Between fat and lean tissue, in Hounsfield units."""

LEAN = 1
"""Value of lean tissue, and of the whole body where fat is not separated."""

FAT = 2
"""Value of fat."""


def find_body(
    scan: Volume, *, fat: bool, progress: Callable[[float], None]
) -> NDArray[np.uint8]:
    """Return which voxels of a CT belong to the largest body, its holes filled.

    Args:
        scan: The CT.
        fat: Tell fat from lean tissue.
        progress: Called with the fraction done.

    Returns:
        0 outside of the body, `LEAN` in it, `FAT` where it is separated, (i, j, k).

    Raises:
        VolumeError: There is only air, or no air around.
    """
    import SimpleITK

    body = _largest_part(scan.values > BODY_HU)
    progress(0.5)
    air_around = np.count_nonzero(~body) - np.count_nonzero(~body[1:-1, 1:-1, 1:-1])
    if not body.any() or not air_around:
        raise VolumeError(
            f"no body in a scan of {scan.values.min():g} to {scan.values.max():g}: "
            f"expected a CT in Hounsfield units with air, below {BODY_HU:g}, around "
            "the patient (no MR, and air at -1000)"
        )
    body = _without_couch(body, scan.grid)
    # Lungs are open at the top of a scan, so holes are filled section by section.
    head_axis = int(np.abs(scan.grid.axes_m[2]).argmax())
    for section in np.moveaxis(body, head_axis, 0):
        image = SimpleITK.GetImageFromArray(section.astype(np.uint8))
        filled = SimpleITK.BinaryFillhole(image, foregroundValue=1)
        section[:] = SimpleITK.GetArrayViewFromImage(filled)
    kinds = body.astype(np.uint8)  # true is `LEAN`
    if fat:
        # Scans are noisy: the median of a voxel and the 26 around it decides.
        median = SimpleITK.Median(SimpleITK.GetImageFromArray(scan.values), [1, 1, 1])
        kinds[body & (SimpleITK.GetArrayViewFromImage(median) < FAT_HU)] = FAT
    progress(1.0)
    return kinds


def _largest_part(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which voxels belong to the largest part of a mask."""
    import SimpleITK

    image = SimpleITK.GetImageFromArray(mask.astype(np.uint8))
    parts = SimpleITK.RelabelComponent(SimpleITK.ConnectedComponent(image))
    return np.asarray(SimpleITK.GetArrayViewFromImage(parts) == 1)


def _without_couch(body: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
    """Return the body without the couch, where that touches the back.

    A couch is alike in all sections, wide, and lies behind what else is.
    """
    least_common = 0.95  # of the sections have something there
    min_width_m = 0.2
    head_axis, left_axis = (int(np.abs(grid.axes_m[k]).argmax()) for k in (2, 0))
    back_axis = 3 - head_axis - left_axis
    backwards = -1 if grid.axes_m[1, back_axis] < 0.0 else 1
    # A view of the same voxels, left to right, front to back, along the body.
    ordered = body.transpose(left_axis, back_axis, head_axis)[:, ::backwards]
    labelled: Any = ndimage.label(ordered.mean(axis=2) > least_common)
    parts, count = labelled
    boxes = ndimage.find_objects(parts)
    sizes = np.bincount(parts.ravel())
    trunk_stop = boxes[sizes[1:].argmax()][1].stop if count else 0
    couches = [
        number
        for number, box in enumerate(boxes, 1)
        if (box[0].stop - box[0].start) * grid.spacing_m[left_axis] > min_width_m
        and box[1].stop > trunk_stop
    ]
    if not couches:
        return body
    # Its edges, whose voxels are half air, go with it; so does its filling.
    edged = ndimage.binary_dilation(np.isin(parts, couches))
    ordered[np.asarray(ndimage.binary_fill_holes(edged), bool)] = False
    return _largest_part(body)


def resample_nearest(
    values: NDArray[np.uint8], source: Grid, target: Grid
) -> NDArray[np.uint8]:
    """Return values on another grid, which may be flipped, cropped or finer.

    Args:
        values: On the source grid, (i, j, k).
        source: Their grid.
        target: The other grid; outside of the source the result is 0.
    """
    import SimpleITK

    # From indices of the target to those of the source.
    turn = np.linalg.inv(source.axes_m) @ target.axes_m
    shift = source.indices(target.origin_m)
    taken = SimpleITK.Resample(
        SimpleITK.GetImageFromArray(values.T),
        [int(size) for size in target.shape],
        SimpleITK.AffineTransform(turn.ravel().tolist(), shift.tolist()),
        SimpleITK.sitkNearestNeighbor,
    )
    return np.ascontiguousarray(SimpleITK.GetArrayViewFromImage(taken).T)
