"""`needleforce plan`: paths from the skin to a target, and the plan of one."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from foundation.arrays import Array
from needleforce.anatomy import FreeSpace, Labels, PlanError, require_clear_path
from needleforce.anatomy.clearance import describe_clearance, too_near
from needleforce.anatomy.errors import OTHER_PATH
from needleforce.anatomy.labels import DENSE, SHOWN_VOXEL_m
from needleforce.anatomy.markups import read_markup, write_markup
from needleforce.anatomy.path_search import (
    PathLimits,
    SkinPath,
    find_paths,
    judge_line,
)
from needleforce.cli.patient.case_files import (
    MODULES,
    NOT_MEDICAL,
    PLAN_VERSION,
    PatientCase,
    StructureNames,
    parse_structures,
    read_case,
    relative_path,
    require_known_names,
    write_plan_fields,
)
from needleforce.cli.patient.options import CaseOptions, LimitOptions
from needleforce.cli.terminal import (
    CommandError,
    progress_bar,
    require_modules,
    say,
    table_text,
    warn,
    write_out,
)
from needleforce.plan_file import PLAN, MadeOf, hash_sources, large_structures
from needleforce.plots import (
    PAGE,
    Page,
    PageFigure,
    PageTable,
    Section,
    require_matplotlib,
    whole_folder,
    write_page,
)
from needleforce.plots.plan_slices import draw_along, draw_probe_view

MARKUP = "path.mrk.json"
"""The planned path for 3D Slicer, in the plan's folder."""

ALONG = (
    "CT in two planes that hold the path (yellow, with a bar where a layer ends and a "
    "ring at the target); outlines of the structures."
)

ACROSS = (
    "Probe's-eye view: slices across the path at depths from the skin to the target, "
    "seen along the needle, the head up. The circle must stay free of what is avoided."
)

M_TO_MM = 1e3


def plan_paths(files: CaseOptions, wish: LimitOptions, folder: Path) -> int:
    """Find paths, print them, and write the plan of one of them.

    Args:
        files: CT and labels, and the target: a structure, or a ``.mrk.json`` file.
        wish: What path is asked for.
        folder: Folder of the plan; whole or absent.

    Returns:
        The exit code.

    Raises:
        CommandError: A limit cannot be, or the path of that number was not found.
        needleforce.anatomy.AnatomyError: The files do not belong together, or there is
            no path.
    """
    require_matplotlib("plan")
    require_modules("plan", MODULES)
    limits = _checked_limits(wish)
    structures = parse_structures(files.structures)
    case = read_case(
        files.ct, files.labels, structures, situs_inversus=files.situs_inversus
    )
    labels = case.labels
    avoid = _names_to_avoid(labels, files.target, wish)
    target, points_m = _find_target(files.target, labels)
    if len(points_m) == 1:
        with progress_bar("searching paths") as progress:
            paths = find_paths(labels, points_m[0], avoid, limits, progress)
    else:
        path = judge_line(labels, points_m, limits)
        _require_clear_line(labels, path, avoid, limits.space)
        paths = (path,)
    if wish.choose > len(paths):
        raise CommandError(
            f"--choose {wish.choose}: only {len(paths)} paths were found"
        )
    chosen = paths[wish.choose - 1]
    accepted = [
        item.name
        for item in labels.structures
        if item.is_obstacle and item.name in (target, *wish.passable)
    ]
    require_clear_path(chosen.clearances, limits.space, accepted)
    rows = pd.DataFrame([_row(n, path) for n, path in enumerate(paths, 1)])
    notes = [
        f"target {target}; at most {M_TO_MM * limits.max_length_m:g} mm long and "
        f"{np.degrees(limits.max_angle_rad):.0f} degrees from the skin's normal; "
        f"{M_TO_MM * limits.space.needed_m:.1f} mm from the needle's centre line stay "
        f"clear of {', '.join(avoid) or 'nothing: no structure is at risk by its name'}"
        "; lengths, thicknesses and clearances in mm",
        f"path {wish.choose} is the plan. {NOT_MEDICAL}",
    ]
    write_out("\n".join([table_text(rows, str.ljust), *notes, ""]))
    warn(_unchecked(labels))
    with whole_folder(folder) as draft:
        if draft is not None:
            fields = _plan_fields(case, limits.space, chosen, avoid)
            fields |= {"target": target, **_file_fields(files, structures, folder)}
            if accepted:
                fields["accepted_obstacles"] = accepted
            write_plan_fields(draft / PLAN, fields)
            ends_m = np.array([chosen.entry_m, chosen.target_m])
            write_markup(draft / MARKUP, "Line", ("entry", "target"), ends_m)
            table = PageTable(
                caption="Paths, the best first; lengths, thicknesses, clearances in mm",
                head=tuple(rows.columns),
                rows=tuple(rows.itertuples(index=False, name=None)),
                note=notes[0],
            )
            _write_page(case, chosen, target, table, limits.space.needed_m, draft)
    for file in (PLAN, MARKUP, PAGE):
        write_out(f"{folder / file}\n")
    say(
        f"next: needleforce touch ARM --landmarks FILE -o touches.json, then "
        f"needleforce register --plan {folder / PLAN} --landmarks FILE --touches "
        "touches.json"
    )
    return 0


def _unchecked(labels: Labels) -> tuple[str, ...]:
    """Return what could not be checked of the segmentation, if anything."""
    return (labels.unchecked,) if labels.unchecked else ()


def _checked_limits(wish: LimitOptions) -> PathLimits:
    """Return the limits of the search.

    Raises:
        CommandError: One of them cannot be.
    """
    for option, value, low, high in (
        ("--radius", wish.radius, 0.1, 5.0),
        ("--margin", wish.margin, 0.0, 100.0),
        ("--max-length", wish.max_length, 1.0, 500.0),
        ("--cone", wish.cone, 0.1, 90.0),
        ("--choose", wish.choose, 1, 1000),
    ):
        if not low <= value <= high:
            raise CommandError(f"{option} {value:g}: expected {low:g} to {high:g}")
    return PathLimits(
        wish.max_length / M_TO_MM,
        float(np.radians(wish.cone)),
        FreeSpace(wish.radius / M_TO_MM, wish.margin / M_TO_MM),
    )


def _find_target(name: str, labels: Labels) -> tuple[str, Array]:
    """Return the name of the target and its place, (1, 3), or the ends of a line.

    Args:
        name: A file with points or a line, or a structure.
        labels: The segmentation.
    """
    if not name.endswith(".json"):
        return name, labels.deepest_point_m(name)[None]
    markup = read_markup(name)
    if not markup.is_line:
        return markup.names[0], markup.points_m[:1]
    if len(markup.points_m) != 2:
        raise CommandError(f"{name}: a line of {len(markup.points_m)} points")
    return "end of the line", markup.points_m


def _names_to_avoid(labels: Labels, target: str, wish: LimitOptions) -> tuple[str, ...]:
    """Return the names of the structures that must stay clear.

    Raises:
        CommandError: A bone is to be passed, or a name says nothing and nobody has said
            whether the needle may pass it.
    """
    asked = [labels[name].name for name in wish.avoid]
    passable = {labels[name].name for name in wish.passable}
    bones = [name for name in passable if labels[name].is_obstacle and name != DENSE]
    if bones:
        raise CommandError(
            f"--passable {', '.join(bones)}: a needle passes no bone or cartilage"
        )
    require_known_names(labels, {target, *asked, *passable}, has_asked=bool(asked))
    usual = [
        item.name
        for item in labels.structures
        if (item.is_obstacle or item.is_risk)
        and item.name not in {target, *passable, *asked}
    ]
    return (*asked, *usual)


def _require_clear_line(
    labels: Labels, path: SkinPath, avoid: Sequence[str], space: FreeSpace
) -> None:
    """Refuse a line that comes too near to what an offered path must stay clear of.

    Raises:
        needleforce.anatomy.PlanError: It comes nearer than a path needs.
    """
    point_m = 1e-6  # length of a line that stands for a point
    at_target = labels.clearances(path.target_m, path.target_m + point_m, avoid)
    around_target = {one.name for one in at_target if one.distance_m == 0.0}
    names = [name for name in avoid if name not in around_target]
    near = too_near(labels.clearances(path.entry_m, path.target_m, names), space)
    if near:
        raise PlanError(
            f"the line {'; '.join(map(describe_clearance, near))}: these must stay "
            f"{space} away, as from an offered path; --passable names what the "
            "needle may pass",
            OTHER_PATH,
        )


def _plan_fields(
    case: PatientCase, space: FreeSpace, path: SkinPath, avoid: Sequence[str]
) -> dict[str, Any]:
    """Return what the plan's file says of the path; see docs/reference/files.md."""
    names = ("name", "exit_m", "exit_std_m", "is_obstacle")
    return {
        "version": PLAN_VERSION,
        "entry_m": path.entry_m,
        "target_m": path.target_m,
        "needle_radius_m": space.needle_radius_m,
        "margin_m": space.margin_m,
        "layers": [
            {name: getattr(layer, name) for name in names} for layer in path.layers
        ],
        "made_of": MadeOf(
            sha256=hash_sources(
                case.scan,
                case.file_labels,
                np.array([path.entry_m, path.target_m]),
                path.layers,
                space,
            ),
            avoided=tuple(avoid),
        ),
    }


def _file_fields(
    files: CaseOptions, structures: StructureNames, folder: Path
) -> dict[str, Any]:
    """Return what the plan's file says of the files that it was made of."""
    fields: dict[str, Any] = {
        "ct": relative_path(files.ct, folder),
        "labels": relative_path(files.labels, folder),
    }
    if isinstance(structures, Path):
        fields["structures"] = relative_path(structures, folder)
    elif structures is not None:
        fields["structures"] = structures
    if files.situs_inversus:
        fields["situs_inversus"] = True
    return fields


def _row(number: int, path: SkinPath) -> dict[str, str]:
    """Return number, length, angle, clearances and layers of a path in words."""
    shown_clearances = 4  # nearest structures that a row names
    near = [
        f"{one.name} {M_TO_MM * one.distance_m:.0f}"
        for one in path.clearances[:shown_clearances]
    ]
    layers = [
        f"{layer.name} {M_TO_MM * (layer.exit_m - layer.entry_m):.0f}"
        for layer in path.layers
    ]
    return {
        "path": str(number),
        "length": f"{M_TO_MM * path.length_m:.0f} mm",
        "to skin": f"{np.degrees(path.angle_rad):.0f} deg",
        "nearest structures": ", ".join(near) or "none within 100 mm",
        "layers": ", ".join(layers),
    }


def _write_page(
    case: PatientCase,
    path: SkinPath,
    target: str,
    table: PageTable,
    needed_m: float,
    folder: Path,
) -> None:
    """Write the page of a plan, and the 3-D page where viser is installed."""
    along = draw_along(case.scan, case.labels, path, folder / "along.png")
    across = draw_probe_view(
        case.scan, case.labels, path, needed_m, folder / "probes-eye.png"
    )
    figures = (
        PageFigure(path=along, alt=ALONG, caption=ALONG),
        PageFigure(path=across, alt=ACROSS, caption=ACROSS),
    )
    in_space = "3-D view: not drawn, the extra `scene` is not installed."
    if find_spec("viser") is not None:
        _write_scene(case.labels, path, folder / "scene.html")
        in_space = "3-D view: open `scene.html` in the same folder."
    places_mm = {"Entry": M_TO_MM * path.entry_m, "Target": M_TO_MM * path.target_m}
    ends = [
        f"{name}, LPS: {place_mm.round(1)} mm" for name, place_mm in places_mm.items()
    ]
    sections = (
        Section(
            heading=f"Path to {target}",
            anchor="path",
            paragraphs=(*ends, in_space),
            notices=_unchecked(case.labels),
            tables=(table,),
        ),
        Section(heading="Slices", anchor="slices", figures=figures),
    )
    page = Page(title=f"Plan: {target}", lead=(NOT_MEDICAL,), sections=sections)
    write_page(folder / PAGE, page)


def _write_scene(labels: Labels, path: SkinPath, place: Path) -> None:
    """Write structures and path as a 3-D page."""
    from needleforce.scene import PlanScene
    from needleforce.scene.export_page import export_plan

    # Lean tissue would hide what lies in it.
    names = [name for name in large_structures(labels) if name != "lean"]
    with progress_bar("drawing the page") as progress:
        surfaces = labels.surfaces(names, progress, voxel_m=SHOWN_VOXEL_m)
    scene = PlanScene(
        surfaces=tuple(surfaces.values()),
        layers=list(path.layers),
        entry_m=path.entry_m,
        target_m=path.target_m,
        warnings=_unchecked(labels),
    )
    export_plan(scene, place)
