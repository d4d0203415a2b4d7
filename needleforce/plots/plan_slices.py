"""Slices of a CT along a path, and across it as the needle's tip sees them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy import Labels, Layer, Structure, Volume
from needleforce.plots.needle_view import NeedleView, patient_side

PIXEL_m = 7e-4
"""Size of a pixel."""

PATH_COLOUR = "#ffd400"
"""Of the needle: seen on grey by all."""

RUPTURE_COLOUR = "#56b4e9"
"""Of what was found on the way."""

M_TO_MM = 1e3


class DrawnPath(Protocol):
    """A straight path, such as a `needleforce.anatomy.path_search.SkinPath`."""

    @property
    def entry_m(self) -> Array:
        """Where it meets the skin, (3,)."""
        ...

    @property
    def target_m(self) -> Array:
        """Where it ends, (3,)."""
        ...

    @property
    def length_m(self) -> float:
        """From entry to target."""
        ...

    @property
    def layers(self) -> Sequence[Layer]:
        """What it crosses."""
        ...


class Plane(NamedTuple):
    """A plane through the patient.

    Attributes:
        rows_m: Places of the rows [m].
        columns_m: Places of the columns [m].
        values_HU: What the CT shows there.
        owners: Number of the structure at each pixel; -1 for none.
    """

    rows_m: Array
    columns_m: Array
    values_HU: Array
    owners: NDArray[np.intp]

    @property
    def extent_mm(self) -> tuple[float, ...]:
        """Left, right, bottom, top for a picture with rows downwards."""
        rows_mm = M_TO_MM * self.rows_m
        columns_mm = M_TO_MM * self.columns_m
        return (columns_mm[0], columns_mm[-1], rows_mm[-1], rows_mm[0])


def draw_along(
    scan: Volume,
    labels: Labels,
    path: DrawnPath,
    place: Path,
    *,
    ruptures_m: Sequence[float] = (),
    tip_m: float | None = None,
) -> Path:
    """Draw the two planes that hold the path into a file; return its name.

    Args:
        scan: The CT.
        labels: The segmentation.
        path: The path.
        place: The file.
        ruptures_m: Depths of ruptures below the entry.
        tip_m: Depth at which the tip rests.
    """
    import matplotlib.pyplot as plt

    axis, side, up = NeedleView.along((path.target_m - path.entry_m) / path.length_m)
    before_m = 0.025  # shown in front of the skin
    along_m = np.arange(-before_m, path.length_m + 0.05, PIXEL_m)
    across_m = np.arange(-0.08, 0.08, PIXEL_m)
    figure, panels = plt.subplots(1, 2, figsize=(6.4, 3.9), layout="constrained")
    structures: dict[str, Structure] = {}
    for axes, direction in zip(panels, (side, up), strict=True):
        plane = _cut(scan, labels, path.entry_m, axis, direction, along_m, across_m)
        structures |= _draw_plane(axes, labels, plane)
        length_mm = M_TO_MM * path.length_m
        axes.plot([0.0, 0.0], [-M_TO_MM * before_m, length_mm], color=PATH_COLOUR)
        axes.plot(0.0, length_mm, "o", mfc="none", mec=PATH_COLOUR, ms=10)
        for layer in path.layers[:-1]:
            axes.plot([-4.0, 4.0], [M_TO_MM * layer.exit_m] * 2, color=PATH_COLOUR)
        for depth_m in ruptures_m:
            axes.plot(
                [-7.0, 7.0], [M_TO_MM * depth_m] * 2, color=RUPTURE_COLOUR, lw=2.5
            )
        if tip_m is not None:
            axes.plot(0.0, M_TO_MM * tip_m, "x", color=RUPTURE_COLOUR, ms=10, mew=2)
        _name_sides(axes, direction)
        axes.set(xlabel="beside the path [mm]", ylabel="depth below the entry [mm]")
    _add_legend(figure, structures)
    figure.savefig(place, dpi=200)
    plt.close(figure)
    return place


def draw_probe_view(
    scan: Volume, labels: Labels, path: DrawnPath, needed_m: float, place: Path
) -> Path:
    """Draw slices across the path as the needle sees them; return the file's name.

    Args:
        scan: The CT.
        labels: The segmentation.
        path: The path.
        needed_m: Radius that stays clear about the path.
        place: The file.
    """
    import matplotlib.pyplot as plt
    from matplotlib.patches import Circle

    axis, side, up = NeedleView.along((path.target_m - path.entry_m) / path.length_m)
    half_m = 0.045  # half the edge of a slice
    span_m = np.arange(-half_m, half_m, PIXEL_m)
    figure, panels = plt.subplots(2, 3, figsize=(6.4, 5.4), layout="constrained")
    structures: dict[str, Structure] = {}
    depths_m = np.linspace(0.0, path.length_m, panels.size)
    for axes, depth_m in zip(panels.flat, depths_m.tolist(), strict=True):
        centre_m = path.entry_m + depth_m * axis
        # Rows run downwards in a picture, and up is to the head.
        plane = _cut(scan, labels, centre_m, -up, side, span_m, span_m)
        structures |= _draw_plane(axes, labels, plane)
        axes.add_patch(
            Circle((0.0, 0.0), M_TO_MM * needed_m, fill=False, color=PATH_COLOUR)
        )
        axes.plot(0.0, 0.0, "+", color=PATH_COLOUR)
        _name_sides(axes, side)
        axes.set(title=f"{M_TO_MM * depth_m:.0f} mm", xlabel="[mm]", ylabel="[mm]")
        for side_name, height in ((patient_side(up), 0.97), (patient_side(-up), 0.03)):
            _write_side(axes, side_name, 0.5, height)
        axes.set_ylim(M_TO_MM * half_m, -M_TO_MM * half_m)
        axes.yaxis.set_major_formatter(lambda value, _: f"{0.0 - value:.0f}")
    _add_legend(figure, structures)
    figure.savefig(place, dpi=200)
    plt.close(figure)
    return place


def _name_sides(axes: Any, direction: Array) -> None:
    """Write the patient's sides at the left and the right edge of a picture.

    Args:
        axes: The picture.
        direction: To the right of the picture, in LPS, shape (3,).
    """
    _write_side(axes, patient_side(-direction), 0.04, 0.5)
    _write_side(axes, patient_side(direction), 0.96, 0.5)


def _write_side(axes: Any, side: str, x: float, y: float) -> None:
    """Write the letter of a side at fractions of a picture's width and height."""
    axes.text(
        x,
        y,
        side,
        transform=axes.transAxes,
        color=PATH_COLOUR,
        fontweight="bold",
        ha="center",
        va="center",
    )


def _cut(
    scan: Volume,
    labels: Labels,
    centre_m: Array,
    row_axis: Array,
    column_axis: Array,
    rows_m: Array,
    columns_m: Array,
) -> Plane:
    """Return the plane through a point along two directions."""
    points_m = (
        centre_m
        + rows_m[:, None, None] * row_axis
        + columns_m[None, :, None] * column_axis
    )
    index = np.moveaxis(scan.grid.indices(points_m), -1, 0)
    air_HU = -1000.0  # outside the scan
    values_HU = np.full(index.shape[1:], air_HU)
    ndimage.map_coordinates(scan.values, index, output=values_HU, order=1, cval=air_HU)
    return Plane(rows_m, columns_m, values_HU, _owners(labels, points_m))


def _owners(labels: Labels, points_m: Array) -> NDArray[np.intp]:
    """Return the number of the smallest structure at each point; -1 for none."""
    index = np.rint(labels.grid.indices(points_m)).astype(int)
    is_valid = np.all((index >= 0) & (index < labels.grid.shape), axis=-1)
    voxels = tuple(np.moveaxis(np.where(is_valid[..., None], index, 0), -1, 0))
    owners = np.full(is_valid.shape, -1)
    order = sorted(
        range(len(labels.structures)), key=lambda n: -labels.structures[n].voxels
    )
    for number in order:
        item = labels.structures[number]
        is_inside = labels.volumes[item.volume][voxels] == item.value
        owners[is_valid & is_inside] = number
    return owners


def _draw_plane(axes: Any, labels: Labels, plane: Plane) -> dict[str, Structure]:
    """Draw a plane of the CT with the outlines of structures; return these by name."""
    axes.imshow(
        plane.values_HU,
        cmap="gray",
        vmin=-160.0,  # HU: from black to white, soft tissue
        vmax=240.0,
        extent=plane.extent_mm,
        aspect="equal",
    )
    # The CT shows these, and they surround everything.
    plain = ("fat", "lean", "body", "skin")
    min_pixels = 40  # of an outline
    drawn: dict[str, Structure] = {}
    for number, item in enumerate(labels.structures):
        is_owned = plane.owners == number
        if item.name in plain or np.count_nonzero(is_owned) < min_pixels:
            continue
        axes.contour(
            M_TO_MM * plane.columns_m,
            M_TO_MM * plane.rows_m,
            is_owned.astype(float),
            levels=[0.5],
            colors=[item.colour],
            linewidths=1.4,
        )
        drawn[item.name] = item
    return drawn


def _hex_of(item: Structure) -> str:
    """Return the colour of a structure as #rrggbb."""
    return "#" + "".join(f"{round(255 * value):02x}" for value in item.colour)


def _add_legend(figure: Any, structures: dict[str, Structure]) -> None:
    """Add the names of the outlined structures below the pictures."""
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=_hex_of(item), label=name.replace("_", " "))
        for name, item in structures.items()
    ]
    lines.append(Line2D([], [], color=PATH_COLOUR, label="path"))
    figure.legend(
        handles=lines,
        loc="outside lower center",
        ncols=5,
        fontsize=8,
        facecolor="0.25",
        labelcolor="white",
    )
