"""The page of `needleforce plan`: table, slices along and across the path, 3-D."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from needleforce.anatomy.labels import SHOWN_VOXEL_m
from needleforce.anatomy.path_search import FoundPaths, PathLimits, SkinPath
from needleforce.cli.patient.case_files import PatientCase
from needleforce.cli.patient.plan_table import (
    HEAD,
    NOT_MEDICAL,
    describe_rejections,
    table_row,
)
from needleforce.plan_file import large_structures
from needleforce.plots import PAGE, Page, PageFigure, PageTable, Section, write_page
from needleforce.plots.plan_slices import draw_along, draw_probe_view

SCENE = "scene.html"
"""Name of the 3-D page in the folder."""


ALONG = (
    "CT in two planes that hold the path (yellow, with a bar where a layer ends and a "
    "ring at the target); outlines of the structures."
)

ACROSS = (
    "Probe's-eye view: slices across the path at depths from the skin to the target, "
    "seen along the needle, the head up. The circle must stay free of what is avoided."
)

M_TO_MM = 1e3


def write_plan_page(
    case: PatientCase,
    path: SkinPath,
    paths: FoundPaths,
    target: str,
    limits: PathLimits,
    folder: Path,
    progress: Callable[[float], None] = lambda fraction: None,
) -> None:
    """Write the page of a plan, and the 3-D page where viser is installed.

    Args:
        case: CT and labels.
        path: The path that is the plan.
        paths: All that were found.
        target: Name of the target.
        limits: What a path may be.
        folder: Folder of the page.
        progress: Called with the fraction done.
    """
    along = draw_along(case.scan, case.labels, path, folder / "along.png")
    across = draw_probe_view(
        case.scan, case.labels, path, limits.space.needed_m, folder / "probes-eye.png"
    )
    figures = (
        PageFigure(path=along, alt=ALONG, caption=ALONG),
        PageFigure(path=across, alt=ACROSS, caption=ACROSS),
    )
    in_space = "3-D view: not drawn, the extra `scene` is not installed."
    if find_spec("viser") is not None:
        _write_scene(case, path, folder / SCENE, progress)
        in_space = f"3-D view: open `{SCENE}` in the same folder."
    unchecked = (case.labels.unchecked,) if case.labels.unchecked else ()
    numbers = enumerate(paths.paths, 1)
    table = PageTable(
        caption="Paths, the best first; lengths, thicknesses and clearances in mm",
        head=HEAD,
        rows=tuple(table_row(number, one) for number, one in numbers),
        note="; ".join(describe_rejections(paths)),
    )
    sections = (
        Section(
            heading=f"Path to {target}",
            anchor="path",
            paragraphs=(in_space,),
            notices=unchecked,
            tables=(_path_table(path), table),
        ),
        Section(heading="Slices", anchor="slices", figures=figures),
    )
    page = Page(title=f"Plan: {target}", lead=(NOT_MEDICAL,), sections=sections)
    write_page(folder / PAGE, page)


def _path_table(path: SkinPath) -> PageTable:
    """Return the table of the path that is the plan."""
    rows = [
        ("entry, LPS [mm]", _describe_point(path.entry_m)),
        ("target, LPS [mm]", _describe_point(path.target_m)),
        ("length [mm]", f"{M_TO_MM * path.length_m:.1f}"),
        ("angle to the skin's normal [deg]", f"{np.degrees(path.angle_rad):.0f}"),
    ]
    rows += [
        (
            f"layer {number}: {layer.name}",
            f"{M_TO_MM * layer.entry_m:.1f} to {M_TO_MM * layer.exit_m:.1f} mm",
        )
        for number, layer in enumerate(path.layers, 1)
    ]
    rows += [
        (f"clearance of {one.name} [mm]", f"{M_TO_MM * one.distance_m:.1f}")
        for one in path.clearances
    ]
    return PageTable(
        caption="The plan; depths count from the planned entry",
        head=("what", "value"),
        rows=tuple(rows),
    )


def _describe_point(point_m: np.ndarray) -> str:
    return ", ".join(f"{coordinate:.1f}" for coordinate in M_TO_MM * point_m)


def _write_scene(
    case: PatientCase,
    path: SkinPath,
    place: Path,
    progress: Callable[[float], None],
) -> None:
    """Write structures and path as a 3-D page."""
    hiding = ("lean",)  # structures that would hide what lies in them
    from needleforce.scene import PlanScene
    from needleforce.scene.export_page import export_plan

    labels = case.labels
    names = [name for name in large_structures(labels) if name not in hiding]
    surfaces = labels.surfaces(names, progress, voxel_m=SHOWN_VOXEL_m)
    scene = PlanScene(
        surfaces=tuple(surfaces.values()),
        layers=list(path.layers),
        entry_m=path.entry_m,
        target_m=path.target_m,
        warnings=(labels.unchecked,) if labels.unchecked else (),
    )
    export_plan(scene, place)
