"""The CT in three planes through the tip of the needle, as pictures.

Two planes hold the needle, one along the other across the body; the third is the
probe's-eye view, perpendicular to it at the tip.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.needle_on_plan import PlannedPath
from needleforce.plots.needle_view import NeedleView, patient_side
from needleforce.scene.nodes import TARGET_COLOR, NeedlePose, PlanScene

PIXELS = 280
PIXEL_m = 0.4e-3
"""Size of a picture, and of its pixels."""

NEEDLE_COLOR = (255, 212, 0)
"""Seen on grey by all."""

TITLES = (
    "along the needle, side to side",
    "along the needle, head to feet",
    "probe's eye: across the needle at its tip, head up",
)
"""What the three pictures show, 112 mm wide; letters are sides of the patient, green
are planned path and target. Until the needle comes near to its entry the cuts are those
along the path, at the target."""


def draw_slices(
    plan: PlanScene, path: PlannedPath, needle: NeedlePose | None
) -> list[NDArray[np.uint8]]:
    """Return the three pictures, each of shape (n, n, 3).

    Args:
        plan: With its scan.
        path: Its path.
        needle: None for the planned path, without a needle, at its target.
    """
    place = NeedlePose(path.target_m, path.axis) if needle is None else needle
    view = NeedleView.along(plan.rotation.T @ place.axis)
    # Rows and columns of a plane, and the row of the tip: below the middle where the
    # plane holds the needle.
    planes = (
        (view.axis, view.side, 160),
        (view.axis, view.up, 160),
        (-view.up, view.side, PIXELS // 2),
    )
    return [
        _draw_plane(plan, path, place.tip_m, np.array([down, right]), tip_row, needle)
        for down, right, tip_row in planes
    ]


def _draw_plane(
    plan: PlanScene,
    path: PlannedPath,
    tip_m: Array,
    axes: Array,
    tip_row: int,
    needle: NeedlePose | None,
) -> NDArray[np.uint8]:
    """Return the picture of a plane through a tip.

    Args:
        plan: With its scan.
        path: Its path.
        tip_m: In the robot's base, shape (3,).
        axes: Directions of the rows and the columns in the patient, shape (2, 3).
        tip_row: Row of the tip; it stands in the middle column.
        needle: None for a picture without needle.
    """
    from PIL import Image, ImageDraw

    middle = PIXELS // 2
    down, right = axes
    image = Image.fromarray(_cut(plan, tip_m, axes, tip_row)).convert("RGB")
    draw = ImageDraw.Draw(image)
    ends_m = np.array([path.entry_m, path.target_m]) - tip_m
    ends_rc = ends_m @ plan.rotation @ axes.T / PIXEL_m + [tip_row, middle]
    draw.line(ends_rc[:, ::-1].ravel().tolist(), TARGET_COLOR, width=2)
    y, x = ends_rc[1].tolist()
    draw.rectangle((x - 5, y - 5, x + 5, y + 5), TARGET_COLOR)
    sides = {(8, middle): -right, (PIXELS - 8, middle): right}
    if tip_row == middle:
        sides |= {(middle, 12): -down, (middle, PIXELS - 12): down}
        if needle is not None:
            draw.line((middle - 10, middle, middle + 10, middle), NEEDLE_COLOR, width=2)
            draw.line((middle, middle - 10, middle, middle + 10), NEEDLE_COLOR, width=2)
    elif needle is not None:
        draw.line((middle, 0, middle, tip_row), NEEDLE_COLOR, width=4)
    for place, direction in sides.items():
        side = patient_side(direction)
        draw.text(place, side, NEEDLE_COLOR, anchor="mm", font_size=16)
    return np.asarray(image)


def _cut(plan: PlanScene, tip_m: Array, axes: Array, tip_row: int) -> NDArray[np.uint8]:
    """Return the grey values of a plane through the tip, shape (n, n)."""
    rows_m = PIXEL_m * (np.arange(PIXELS) - tip_row)
    columns_m = PIXEL_m * (np.arange(PIXELS) - PIXELS // 2)
    points_m = (
        (tip_m - plan.translation_m) @ plan.rotation
        + rows_m[:, None, None] * axes[0]
        + columns_m[None, :, None] * axes[1]
    )
    scan: Any = plan.scan
    index = np.moveaxis(scan.grid.indices(points_m), -1, 0)
    values_HU = ndimage.map_coordinates(
        scan.values,
        index,
        output=float,
        order=1,
        cval=-1000.0,  # air outside the scan
    )
    # From black to white: soft tissue.
    return np.interp(values_HU, (-160.0, 240.0), (0.0, 255.0)).astype(np.uint8)
