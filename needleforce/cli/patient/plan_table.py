"""The table of `needleforce plan`."""

from collections.abc import Iterable, Sequence

import numpy as np

from needleforce.anatomy import Clearance, Layer
from needleforce.anatomy.path_search import FoundPaths, PathLimits, SkinPath

SHOWN_CLEARANCES = 4
"""Nearest structures that a row names."""

HEAD = ("path", "length", "to skin", "nearest structures", "layers")

M_TO_MM = 1e3

NOT_MEDICAL = "Research only: not a medical device."


def describe_paths(
    paths: FoundPaths,
    target: str,
    avoid: Sequence[str],
    limits: PathLimits,
    chosen: int,
) -> str:
    """Return the table in words, a line for each path and those of the search.

    Args:
        paths: What was found.
        target: Name of the target.
        avoid: Names of the structures that stay clear.
        limits: What a path may be.
        chosen: Number of the path that becomes the plan.
    """
    rows = [HEAD, *(table_row(n, path) for n, path in enumerate(paths.paths, 1))]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        for row in rows
    ]
    lines += ["", describe_limits(target, avoid, limits), *describe_rejections(paths)]
    lines += [f"path {chosen} is the plan. {NOT_MEDICAL}"]
    return "".join(f"{line.rstrip()}\n" for line in lines)


def table_row(number: int, path: SkinPath) -> tuple[str, ...]:
    """Return number, length, angle, clearances and layers of a path in words."""
    return (
        str(number),
        f"{M_TO_MM * path.length_m:.0f} mm",
        f"{np.degrees(path.angle_rad):.0f} deg",
        describe_clearances(path.clearances[:SHOWN_CLEARANCES]),
        describe_layers(path.layers),
    )


def describe_layers(layers: Iterable[Layer]) -> str:
    """Return the layers with their thickness in whole millimetres in words."""
    texts: list[str] = []
    for layer in layers:
        thickness_mm = M_TO_MM * (layer.exit_m - layer.entry_m)
        text = f"{thickness_mm:.0f}" if thickness_mm >= 0.5 else "<1"
        texts.append(f"{layer.name} {text}")
    return ", ".join(texts)


def describe_clearances(clearances: Iterable[Clearance]) -> str:
    """Return distances from structures in words."""
    texts = [f"{one.name} {M_TO_MM * one.distance_m:.0f}" for one in clearances]
    return ", ".join(texts) or "none within 100 mm"


def describe_limits(target: str, avoid: Sequence[str], limits: PathLimits) -> str:
    """Return in words what was asked for."""
    return (
        f"target {target}; at most {M_TO_MM * limits.max_length_m:g} mm long and "
        f"{np.degrees(limits.max_angle_rad):.0f} degrees from the skin's normal; "
        f"{M_TO_MM * limits.space.needed_m:.1f} mm from the needle's centre line stay "
        f"clear of {', '.join(avoid) or 'nothing: no structure is at risk by its name'}"
        "; lengths, thicknesses and clearances in mm"
    )


def describe_rejections(paths: FoundPaths) -> list[str]:
    """Return in words how many directions were left out, and why."""
    reasons = [
        f"{count} {reason}" for reason, count in paths.rejected.most_common() if count
    ]
    return [f"left out: {', '.join(reasons)}"] if reasons else []
