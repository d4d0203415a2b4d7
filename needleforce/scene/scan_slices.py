"""The CT in three planes through the tip of the needle, as pictures.

Two planes hold the needle, one along the other across the body; the third is the
probe's-eye view, perpendicular to it at the tip.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.plots.needle_view import NeedleView, patient_side
from needleforce.scene.nodes import TARGET_COLOR, NeedlePose, PlanScene

PIXELS = 140
PIXEL_M = 0.8e-3
"""Size of a picture, and of its pixels [m]."""

TIP_ROW = 80
"""Row of the tip in the planes that hold the needle."""

NEEDLE_COLOR = (255, 212, 0)
"""Seen on grey by all."""

SIZE_MM = round(1e3 * PIXELS * PIXEL_M)

TITLES = (
    f"along the needle, side to side, {SIZE_MM} mm wide",
    f"along the needle, head to feet, {SIZE_MM} mm wide",
    f"probe's eye: across the needle at its tip, head up, {SIZE_MM} mm wide",
)
"""What the three pictures show; green are planned path and target. Until the needle
comes near to its entry the cuts are those along the path, at the target."""


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

    def draw(self, needle: NeedlePose | None) -> SlicePictures | None:
        """Return the three pictures; None if they are those drawn last.

        Args:
            needle: None for the planned path, without a needle, at its target.
        """
        place = needle
        if place is None:
            path = self._plan.path
            if path is None:
                return None
            place = NeedlePose(path.target_m, path.axis)
        drawn = self._drawn_at
        if drawn is not None:
            travel_m = np.linalg.norm(place.tip_m - drawn.tip_m)
            turn_m = np.linalg.norm(place.axis - drawn.axis) * PIXELS * PIXEL_M
            if max(travel_m, turn_m) < 0.5e-3:  # less than a pixel
                return None
        self._drawn_at = place
        rotation = self._plan.rotation
        view = NeedleView.along(rotation.T @ place.axis)
        across = rotation @ view.side
        up = rotation @ view.up
        middle = PIXELS // 2
        side = self._cut(place.tip_m, place.axis, across, TIP_ROW)
        head = self._cut(place.tip_m, place.axis, up, TIP_ROW)
        probe = self._cut(place.tip_m, -up, across, middle)
        if needle is not None:
            for picture in (side, head):
                picture[:TIP_ROW, middle - 1 : middle + 1] = NEEDLE_COLOR
            probe[middle, middle - 5 : middle + 6] = NEEDLE_COLOR
            probe[middle - 5 : middle + 6, middle] = NEEDLE_COLOR
        _name_sides(side, view.side)
        _name_sides(head, view.up)
        _name_sides(probe, view.side)
        _write_side(probe, patient_side(view.up), middle, 2)
        _write_side(probe, patient_side(-view.up), middle, PIXELS - 12)
        self.latest = SlicePictures(side, head, probe)
        return self.latest

    def _draw_path(
        self,
        picture: NDArray[np.uint8],
        tip_m: Array,
        axes: Array,
        tip_pixel: tuple[int, int],
    ) -> None:
        """Draw the planned path into a plane, and its target as a square.

        Args:
            picture: Of the plane.
            tip_m: Where the plane was cut.
            axes: Directions of its rows and columns, shape (2, 3).
            tip_pixel: Row and column of that place.
        """
        path = self._plan.path
        if path is None:
            return
        points_m = np.linspace(path.entry_m, path.target_m, 2 * PIXELS)
        pixels = np.rint((points_m - tip_m) @ axes.T / PIXEL_M).astype(int) + tip_pixel
        square = np.indices((5, 5)).reshape(2, -1).T - 2
        pixels = np.concatenate([pixels, pixels[-1] + square])
        is_inside = ((pixels >= 0) & (pixels < PIXELS)).all(axis=1)
        rows, columns = pixels[is_inside].T
        picture[rows, columns] = TARGET_COLOR

    def _cut(
        self, tip_m: Array, row_axis: Array, column_axis: Array, tip_row: int
    ) -> NDArray[np.uint8]:
        """Return the picture of a plane through the tip, rows along one direction."""
        air_HU = -1000.0  # outside the scan
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
        values_HU = np.full((PIXELS, PIXELS), air_HU)
        ndimage.map_coordinates(
            scan.values, index, output=values_HU, order=1, cval=air_HU
        )
        low_HU, high_HU = -160.0, 240.0  # from black to white: soft tissue
        grey = np.clip((values_HU - low_HU) / (high_HU - low_HU), 0.0, 1.0)
        pixels = (255.0 * grey).astype(np.uint8)
        picture = np.repeat(pixels[:, :, None], 3, axis=2)
        axes = np.array([row_axis, column_axis])
        self._draw_path(picture, tip_m, axes, (tip_row, PIXELS // 2))
        return picture


def _name_sides(picture: NDArray[np.uint8], direction: Array) -> None:
    """Write the patient's sides at the left and the right edge of a picture.

    Args:
        picture: The picture, which is changed.
        direction: To the right of the picture, in LPS, shape (3,).
    """
    row = PIXELS // 2 - 5
    _write_side(picture, patient_side(-direction), 6, row)
    _write_side(picture, patient_side(direction), PIXELS - 6, row)


def _write_side(
    picture: NDArray[np.uint8], side: str, column: int, top_row: int
) -> None:
    """Write the letter of a side into a picture, its middle at a column."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    ImageDraw.Draw(image).text((column, top_row), side, NEEDLE_COLOR, anchor="ma")
    picture[:] = np.asarray(image)
