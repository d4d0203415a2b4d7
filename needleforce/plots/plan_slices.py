"""Slices of a CT along a path, and across it as the needle's tip sees them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from foundation.arrays import Array
from needleforce.anatomy import Labels, Structure, Volume
from needleforce.anatomy.path_search import SkinPath
from needleforce.plots.needle_view import NeedleView, patient_side

PIXEL_m = 7e-4
"""Size of a pixel."""

PATH_COLOUR = "#ffd400"
"""Of the needle: seen on grey by all."""

RUPTURE_COLOUR = "#56b4e9"
"""Of what was found on the way."""

M_TO_MM = 1e3


def draw_along(
    scan: Volume,
    labels: Labels,
    path: SkinPath,
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
    length_mm = M_TO_MM * path.length_m
    figure, panels = plt.subplots(1, 2, figsize=(6.4, 3.9), layout="constrained")
    rows_m = path.entry_m + along_m[:, None] * axis
    outlined: list[Structure] = []
    for axes, direction in zip(panels, (side, up), strict=True):
        points_m = rows_m[:, None] + across_m[:, None] * direction
        outlined += _draw_plane(axes, scan, labels, points_m, along_m, across_m)
        axes.plot([0.0, 0.0], [-M_TO_MM * before_m, length_mm], color=PATH_COLOUR)
        axes.plot(0.0, length_mm, "o", mfc="none", mec=PATH_COLOUR, ms=10)
        exits_mm = [M_TO_MM * layer.exit_m for layer in path.layers[:-1]]
        axes.hlines(exits_mm, -4.0, 4.0, color=PATH_COLOUR)
        ruptures_mm = [M_TO_MM * depth_m for depth_m in ruptures_m]
        axes.hlines(ruptures_mm, -7.0, 7.0, color=RUPTURE_COLOUR, lw=2.5)
        if tip_m is not None:
            axes.plot(0.0, M_TO_MM * tip_m, "x", color=RUPTURE_COLOUR, ms=10, mew=2)
        _write_sides(axes, {(0.04, 0.5): -direction, (0.96, 0.5): direction})
        axes.set(xlabel="beside the path [mm]", ylabel="depth below the entry [mm]")
    return _save(figure, outlined, place)


def draw_probe_view(
    scan: Volume, labels: Labels, path: SkinPath, needed_m: float, place: Path
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
    span_m = np.arange(-0.045, 0.045, PIXEL_m)
    figure, panels = plt.subplots(2, 3, figsize=(6.4, 5.4), layout="constrained")
    outlined: list[Structure] = []
    depths_m = np.linspace(0.0, path.length_m, panels.size)
    for axes, depth_m in zip(panels.flat, depths_m.tolist(), strict=True):
        rows_m = path.entry_m + depth_m * axis - span_m[:, None] * up
        points_m = rows_m[:, None] + span_m[:, None] * side
        outlined += _draw_plane(axes, scan, labels, points_m, -span_m, span_m)
        free = Circle((0.0, 0.0), M_TO_MM * needed_m, fill=False, color=PATH_COLOUR)
        axes.add_patch(free)
        axes.plot(0.0, 0.0, "+", color=PATH_COLOUR)
        _write_sides(axes, {(0.04, 0.5): -side, (0.96, 0.5): side})
        _write_sides(axes, {(0.5, 0.97): up, (0.5, 0.03): -up})
        axes.set(title=f"{M_TO_MM * depth_m:.0f} mm", xlabel="[mm]", ylabel="[mm]")
    return _save(figure, outlined, place)


def _write_sides(axes: Any, directions: dict[tuple[float, float], Array]) -> None:
    """Write the patient's sides into a picture.

    Args:
        axes: The picture.
        directions: In LPS, shape (3,), by the place, as fractions of its size.
    """
    for place, direction in directions.items():
        axes.text(
            *place,
            patient_side(direction),
            transform=axes.transAxes,
            color=PATH_COLOUR,
            fontweight="bold",
            ha="center",
            va="center",
        )


def _draw_plane(
    axes: Any,
    scan: Volume,
    labels: Labels,
    points_m: Array,
    rows_m: Array,
    columns_m: Array,
) -> list[Structure]:
    """Draw a plane of the CT with the outlines of structures; return these.

    Args:
        axes: The picture.
        scan: The CT.
        labels: The segmentation.
        points_m: Of its pixels, shape (rows, columns, 3).
        rows_m: Where rows lie in the picture, shape (rows,).
        columns_m: Where columns lie in it, shape (columns,).
    """
    min_pixels = 40  # of an outline
    # The CT shows these, and they surround everything.
    plain = ("fat", "lean", "body", "skin")
    rows_mm = M_TO_MM * rows_m
    columns_mm = M_TO_MM * columns_m
    index = np.moveaxis(scan.grid.indices(points_m), -1, 0)
    air_HU = -1000.0  # outside the scan
    axes.imshow(
        ndimage.map_coordinates(scan.values, index, float, order=1, cval=air_HU),
        cmap="gray",
        vmin=-160.0,  # HU: from black to white, soft tissue
        vmax=240.0,
        extent=(*columns_mm[[0, -1]], *rows_mm[[-1, 0]]),
        aspect="equal",
    )
    index = np.moveaxis(np.rint(labels.grid.indices(points_m)).astype(int), -1, 0)
    cuts = [ndimage.map_coordinates(one, index, order=0) for one in labels.volumes]
    outlined: list[Structure] = []
    for item in labels.structures:
        inside = cuts[item.volume] == item.value
        if item.name not in plain and np.count_nonzero(inside) >= min_pixels:
            outline = {"levels": [0.5], "colors": [item.colour], "linewidths": 1.4}
            axes.contour(columns_mm, rows_mm, inside.astype(float), **outline)
            outlined.append(item)
    return outlined


def _save(figure: Any, structures: Sequence[Structure], place: Path) -> Path:
    """Name the outlined structures below the pictures; return the figure's file."""
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

    colours: dict[str, Any] = {item.name: item.colour for item in structures}
    colours["path"] = PATH_COLOUR
    figure.legend(
        handles=[
            Line2D([], [], color=colour, label=name.replace("_", " "))
            for name, colour in colours.items()
        ],
        loc="outside lower center",
        ncols=5,
        fontsize=8,
        facecolor="0.25",
        labelcolor="white",
    )
    figure.savefig(place, dpi=200)
    plt.close(figure)
    return place
