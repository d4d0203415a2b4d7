"""The patient's body in a CT, its fat and its lean tissue."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.slabs import slabs_of
from needleforce.anatomy.volume import Volume

BODY_HU = -300.0
"""Between air and fat, in Hounsfield units."""


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
    body = _largest_part(scan)
    progress(0.5)
    inner = body[1:-1, 1:-1, 1:-1]
    body_voxels = np.count_nonzero(body)
    fills_edge = body_voxels - np.count_nonzero(inner) == body.size - inner.size
    if not body_voxels or fills_edge:
        lowest = scan.values.min()
        reason = ""
        if lowest > BODY_HU:
            reason = "; this is MR, or a CT whose air was not shifted to -1000"
        raise VolumeError(
            f"no body in a scan of {lowest:g} to {scan.values.max():g}: "
            f"expected a CT in Hounsfield units with air, below {BODY_HU:g}, around "
            f"the patient{reason}",
            "Give a CT in Hounsfield units that holds air around the patient.",
        )
    body = _without_couch(body, scan)
    # Lungs are open at the top of a scan, so holes are filled section by section.
    head_axis = int(np.abs(scan.grid.axes_m[2]).argmax())
    for section in np.moveaxis(body, head_axis, 0):
        section[:] = _fill_holes(section)
    progress(0.8)
    kinds = body.view(np.uint8)  # true is `LEAN`
    if fat:
        for slab in slabs_of(body.shape):
            is_fat = body[slab] & _has_low_median(scan, slab)
            kinds[slab] += is_fat.view(np.uint8)
    progress(1.0)
    return kinds


def _largest_part(scan: Volume) -> NDArray[np.bool_]:
    """Return which voxels belong to the largest part of what is denser than air."""
    parts: NDArray[np.int32] = np.zeros(scan.grid.shape, np.int32)
    ndimage.label(scan.values > BODY_HU, output=parts)
    count = int(parts.max())
    voxels = np.zeros(count + 1, np.intp)
    for slab in slabs_of(parts.shape):
        voxels += np.bincount(parts[slab].ravel(), minlength=count + 1)
    voxels[0] = -1  # the air
    return (
        np.asarray(parts == voxels.argmax()) if count else np.zeros(parts.shape, bool)
    )


def _without_couch(body: NDArray[np.bool_], scan: Volume) -> NDArray[np.bool_]:
    """Return the body without the couch, where that touches the back.

    A couch is alike in all sections, wide, and lies behind what else is.
    """
    head_axis, left_axis = (int(np.abs(scan.grid.axes_m[k]).argmax()) for k in (2, 0))
    back_axis = 3 - head_axis - left_axis
    # Where nearly all sections have something, as (left to right, front to back).
    order = (left_axis, back_axis, head_axis)
    fractions: Array = body.transpose(order).mean(axis=2)
    is_common: NDArray[np.bool_] = fractions > 0.95
    if scan.grid.axes_m[1, back_axis] < 0.0:
        is_common = is_common[:, ::-1]
    parts: NDArray[np.int32] = np.zeros(is_common.shape, np.int32)
    ndimage.label(is_common, output=parts)
    boxes = ndimage.find_objects(parts)
    if len(boxes) < 2:
        return body
    trunk = int(np.bincount(parts[parts > 0]).argmax())
    couch = np.zeros(is_common.shape, bool)
    for number, box in enumerate(boxes, 1):
        width_m = (box[0].stop - box[0].start) * scan.grid.spacing_m[left_axis]
        lies_behind = box[1].stop > boxes[trunk - 1][1].stop
        if number != trunk and width_m > 0.2 and lies_behind:
            couch |= parts == number
    if not couch.any():
        return body
    # Its edges, whose voxels are half air, go with it; so does its filling.
    couch = _fill_holes(np.asarray(ndimage.binary_dilation(couch), bool))
    if scan.grid.axes_m[1, back_axis] < 0.0:
        couch = couch[:, ::-1]
    rest = body.transpose(order) & ~couch[..., None]
    pieces: NDArray[np.int32] = np.zeros(rest.shape, np.int32)
    ndimage.label(rest, output=pieces)
    counts = np.bincount(pieces.ravel())
    counts[0] = 0  # the air
    kept = np.asarray(pieces == counts.argmax())
    return np.ascontiguousarray(kept.transpose(np.argsort(order)))


def _fill_holes(section: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a section of the body with what does not reach its edge filled."""
    parts: NDArray[np.int32] = np.zeros(section.shape, np.int32)
    ndimage.label(~section, output=parts)
    is_filled = np.ones(int(parts.max()) + 1, bool)
    for edge in (parts[0], parts[-1], parts[:, 0], parts[:, -1]):
        is_filled[edge] = False
    is_filled[0] = True  # the body itself
    return np.asarray(is_filled[parts])


def _has_low_median(scan: Volume, slab: slice) -> NDArray[np.bool_]:
    """Return where the median around a voxel is that of fat, in a slab of a CT.

    At the edge of the scan its outermost voxels count twice.
    """
    # The median of a voxel and the 26 around it decides between fat and lean, since
    # scans are noisy: it is low where at least so many of the 27 are.
    median_rank = 14
    fat_HU = -30.0  # between fat and lean tissue, in Hounsfield units
    start = max(slab.start - 1, 0)
    stop = min(slab.stop + 1, scan.grid.shape[0])
    counts = (scan.values[start:stop] < fat_HU).view(np.uint8)
    for axis in range(3):
        counts = _sum_three(counts, axis)
    return counts[slab.start - start : slab.stop - start] >= median_rank


def _sum_three(counts: NDArray[np.uint8], axis: int) -> NDArray[np.uint8]:
    """Return the sums of every number and the two beside it along an axis."""
    before = np.moveaxis(counts, axis, 0)
    sums = before.copy()
    sums[1:] += before[:-1]
    sums[:1] += before[:1]
    sums[:-1] += before[1:]
    sums[-1:] += before[-1:]
    return np.moveaxis(sums, 0, axis)
