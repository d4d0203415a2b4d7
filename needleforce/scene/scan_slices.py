"""The CT in three planes through the tip of the needle, as pictures.

Two planes hold the needle, one along the other across the body; the third is the
probe's-eye view, perpendicular to it at the tip.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.scene.nodes import NeedlePose, PlanScene

PIXELS = 140
PIXEL_M = 0.8e-3
"""Size of a picture, and of its pixels [m]."""

TIP_ROW = 80
"""Row of the tip in the planes that hold the needle."""

WINDOW_HU = (-160.0, 240.0)
"""From black to white: soft tissue."""

AIR_HU = -1000.0
"""Of what lies outside the scan."""

NEEDLE_COLOR = (255, 212, 0)
"""Seen on grey by all."""

MIN_TRAVEL_M = 0.5e-3
"""So far the tip moves before the pictures are drawn anew."""

MAX_COSINE = 0.9
"""Of the angle between the needle and the direction to the head; above it the back of
the body is up instead."""

SIZE_MM = round(1e3 * PIXELS * PIXEL_M)

TITLES = (
    f"along the needle, side to side, {SIZE_MM} mm wide",
    f"along the needle, head to feet, {SIZE_MM} mm wide",
    f"probe's eye: across the needle at its tip, head up, {SIZE_MM} mm wide",
)
"""What the three pictures show."""


class NeedleFrame(NamedTuple):
    """Directions of the needle in the robot's base, each of shape (3,).

    Attributes:
        axis: Of the needle.
        side: Across it.
        up: To the head, as far as it can be.
    """

    axis: Array
    side: Array
    up: Array


def needle_frame(axis: Array, rotation: Array) -> NeedleFrame:
    """Return the directions of a needle in a patient.

    Args:
        axis: Of the needle in the robot's base, shape (3,).
        rotation: From the patient (LPS) to the robot's base, shape (3, 3).
    """
    head = rotation[:, 2]
    towards = rotation[:, 1] if abs(axis @ head) > MAX_COSINE else head
    up = towards - (towards @ axis) * axis
    up = up / np.linalg.norm(up)
    return NeedleFrame(axis, np.cross(axis, up), up)


class SlicePictures(NamedTuple):
    """The pictures of the three planes, each of shape (n, n, 3).

    Attributes:
        side: Along the needle, side to side.
        head: Along the needle, head to feet.
        probe: Across the needle at its tip.
    """

    side: NDArray[np.uint8]
    head: NDArray[np.uint8]
    probe: NDArray[np.uint8]


class ScanSlices:
    """Cuts the CT of a plan at the needle.

    Args:
        plan: With its scan.

    Attributes:
        latest: The pictures drawn last; None before the first.
    """

    def __init__(self, plan: PlanScene) -> None:
        self._plan = plan
        self._drawn_at: NeedlePose | None = None
        self.latest: SlicePictures | None = None

    def draw(self, needle: NeedlePose) -> SlicePictures | None:
        """Return the three pictures; None if the needle stands."""
        drawn = self._drawn_at
        if drawn is not None:
            travel_m = np.linalg.norm(needle.tip_m - drawn.tip_m)
            turn = np.linalg.norm(needle.axis - drawn.axis) * PIXELS * PIXEL_M
            if max(travel_m, turn) < MIN_TRAVEL_M:
                return None
        self._drawn_at = needle
        frame = needle_frame(needle.axis, self._plan.rotation)
        side = self._cut(needle.tip_m, frame.axis, frame.side, TIP_ROW)
        head = self._cut(needle.tip_m, frame.axis, frame.up, TIP_ROW)
        probe = self._cut(needle.tip_m, -frame.up, frame.side, PIXELS // 2)
        middle = PIXELS // 2
        for picture in (side, head):
            picture[:TIP_ROW, middle - 1 : middle + 1] = NEEDLE_COLOR
        probe[middle, middle - 5 : middle + 6] = NEEDLE_COLOR
        probe[middle - 5 : middle + 6, middle] = NEEDLE_COLOR
        self.latest = SlicePictures(side, head, probe)
        return self.latest

    def _cut(
        self, tip_m: Array, row_axis: Array, column_axis: Array, tip_row: int
    ) -> NDArray[np.uint8]:
        """Return the picture of a plane through the tip, rows along one direction."""
        rows_m = PIXEL_M * (np.arange(PIXELS) - tip_row)
        columns_m = PIXEL_M * (np.arange(PIXELS) - PIXELS // 2)
        points_m = (
            tip_m
            + rows_m[:, None, None] * row_axis
            + columns_m[None, :, None] * column_axis
        )
        model_m = (points_m - self._plan.translation_m) @ self._plan.rotation
        scan: Any = self._plan.scan
        index = np.moveaxis(scan.grid.indices(model_m), -1, 0)
        values_HU = np.full((PIXELS, PIXELS), AIR_HU)
        ndimage.map_coordinates(
            scan.values, index, output=values_HU, order=1, cval=AIR_HU
        )
        low_HU, high_HU = WINDOW_HU
        grey = np.clip((values_HU - low_HU) / (high_HU - low_HU), 0.0, 1.0)
        pixels = (255.0 * grey).astype(np.uint8)
        return np.repeat(pixels[:, :, None], 3, axis=2)
