"""`needleforce plan`: paths from the skin to a target, and the plan of one."""

from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy import FreeSpace, Labels, PlanError, require_clear_path
from needleforce.anatomy.clearance import describe_clearance, too_near
from needleforce.anatomy.errors import OTHER_PATH
from needleforce.anatomy.labels import DENSE, SHOWN_VOXEL_m
from needleforce.anatomy.markups import read_markup, write_markup
from needleforce.anatomy.path_search import (
    FoundPaths,
    PathLimits,
    SkinPath,
    find_paths,
    judge_path,
    orient_line,
)
from needleforce.cli.patient.case_files import (
    MODULES,
    NOT_MEDICAL,
    PLAN_VERSION,
    CaseFiles,
    PatientCase,
    read_case,
    relative_path,
    write_plan_fields,
)
from needleforce.cli.patient.structure_names import require_known_names
from needleforce.cli.terminal import (
    CommandError,
    require_modules,
    say,
    staged_progress,
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

if TYPE_CHECKING:
    from needleforce.cli.plan import LimitOptions

MARKUP = "path.mrk.json"
"""The planned path for 3D Slicer, in the plan's folder."""

HEAD = ("path", "length", "to skin", "nearest structures", "layers")

ALONG = (
    "CT in two planes that hold the path (yellow, with a bar where a layer ends and a "
    "ring at the target); outlines of the structures."
)

ACROSS = (
    "Probe's-eye view: slices across the path at depths from the skin to the target, "
    "seen along the needle, the head up. The circle must stay free of what is avoided."
)

M_TO_MM = 1e3


def plan_paths(
    files: CaseFiles, target: str, wish: "LimitOptions", folder: Path
) -> int:
    """Find paths, print them, and write the plan of one of them.

    Args:
        files: CT and labels.
        target: Name of a structure, or a ``.mrk.json`` file.
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
    case = read_case(files)
    labels = case.labels
    avoid = _names_to_avoid(labels, target, wish)
    name, target_m, entry_m = _find_target(target, labels)
    if entry_m is None:
        with staged_progress("searching paths") as progress:
            paths = find_paths(labels, target_m, avoid, limits, progress)
    else:
        path = judge_path(labels, entry_m, target_m, limits)
        _require_clear_line(labels, path, avoid, limits.space)
        paths = FoundPaths((path,), Counter())
    if wish.choose > len(paths.paths):
        raise CommandError(
            f"--choose {wish.choose}: only {len(paths.paths)} paths were found"
        )
    chosen = paths.paths[wish.choose - 1]
    accepted = [
        item.name
        for item in labels.structures
        if item.is_obstacle and item.name in (name, *wish.passable)
    ]
    require_clear_path(chosen.clearances, limits.space, accepted)
    write_out(_table(paths, name, avoid, limits, wish.choose))
    if labels.unchecked:
        say(f"warning: {labels.unchecked}")
    with whole_folder(folder) as place:
        if place is not None:
            fields = _plan_fields(case, limits.space, name, chosen, folder, avoid)
            if accepted:
                fields["accepted_obstacles"] = accepted
            write_plan_fields(place / PLAN, fields)
            ends_m = np.array([chosen.entry_m, chosen.target_m])
            write_markup(place / MARKUP, "Line", ("entry", "target"), ends_m)
            _write_page(case, chosen, paths, name, limits, place)
    for file in (PLAN, MARKUP, PAGE):
        write_out(f"{folder / file}\n")
    say(
        f"next: needleforce touch ARM --landmarks FILE -o touches.json, then "
        f"needleforce register --plan {folder / PLAN} --landmarks FILE --touches "
        "touches.json"
    )
    return 0


def _checked_limits(wish: "LimitOptions") -> PathLimits:
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


def _find_target(name: str, labels: Labels) -> tuple[str, Array, Array | None]:
    """Return name and place of the target, and a point outside on the way to it.

    Args:
        name: A file with points or a line, or a structure.
        labels: The segmentation.
    """
    if not name.endswith(".json"):
        return name, labels.deepest_point_m(name), None
    markup = read_markup(name)
    if not markup.is_line:
        return markup.names[0], markup.points_m[0], None
    if len(markup.points_m) != 2:
        raise CommandError(f"{name}: a line of {len(markup.points_m)} points")
    entry_m, target_m = orient_line(labels, markup.points_m)
    return "end of the line", target_m, entry_m


def _names_to_avoid(
    labels: Labels, target: str, wish: "LimitOptions"
) -> tuple[str, ...]:
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
    case: PatientCase,
    space: FreeSpace,
    target: str,
    path: SkinPath,
    folder: Path,
    avoid: Sequence[str],
) -> dict[str, Any]:
    """Return what stands in the plan's file; see docs/reference/files.md."""
    files = case.files
    fields: dict[str, Any] = {
        "version": PLAN_VERSION,
        "target": target,
        "ct": relative_path(files.ct, folder),
        "labels": relative_path(files.labels, folder),
        "entry_m": path.entry_m,
        "target_m": path.target_m,
        "needle_radius_m": space.needle_radius_m,
        "margin_m": space.margin_m,
        "layers": [
            {
                "name": layer.name,
                "exit_m": layer.exit_m,
                "exit_std_m": layer.exit_std_m,
                "is_obstacle": layer.is_obstacle,
            }
            for layer in path.layers
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
    if isinstance(files.structures, Mapping):
        fields["structures"] = dict(files.structures)
    elif files.structures is not None:
        fields["structures"] = relative_path(files.structures, folder)
    if files.situs_inversus:
        fields["situs_inversus"] = True
    return fields


def _row(number: int, path: SkinPath) -> tuple[str, ...]:
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
    return (
        str(number),
        f"{M_TO_MM * path.length_m:.0f} mm",
        f"{np.degrees(path.angle_rad):.0f} deg",
        ", ".join(near) or "none within 100 mm",
        ", ".join(layers),
    )


def _left_out(paths: FoundPaths) -> str:
    """Return in words how many directions were left out, and why."""
    counts = paths.rejected.most_common()
    reasons = [f"{count} {reason}" for reason, count in counts if count]
    return f"left out: {', '.join(reasons) or 'none'}"


def _table(
    paths: FoundPaths,
    target: str,
    avoid: Sequence[str],
    limits: PathLimits,
    chosen: int,
) -> str:
    """Return a line for each path, and those of the search, in words."""
    rows = [HEAD, *(_row(n, path) for n, path in enumerate(paths.paths, 1))]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        for row in rows
    ]
    lines += [
        "",
        f"target {target}; at most {M_TO_MM * limits.max_length_m:g} mm long and "
        f"{np.degrees(limits.max_angle_rad):.0f} degrees from the skin's normal; "
        f"{M_TO_MM * limits.space.needed_m:.1f} mm from the needle's centre line stay "
        f"clear of {', '.join(avoid) or 'nothing: no structure is at risk by its name'}"
        "; lengths, thicknesses and clearances in mm",
        _left_out(paths),
        f"path {chosen} is the plan. {NOT_MEDICAL}",
    ]
    return "".join(f"{line.rstrip()}\n" for line in lines)


def _write_page(
    case: PatientCase,
    path: SkinPath,
    paths: FoundPaths,
    target: str,
    limits: PathLimits,
    folder: Path,
) -> None:
    """Write the page of a plan, and the 3-D page where viser is installed."""
    along = draw_along(case.scan, case.labels, path, folder / "along.png")
    needed_m = limits.space.needed_m
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
    table = PageTable(
        caption="Paths, the best first; lengths, thicknesses and clearances in mm",
        head=HEAD,
        rows=tuple(_row(number, one) for number, one in enumerate(paths.paths, 1)),
        note=_left_out(paths),
    )
    unchecked = case.labels.unchecked
    sections = (
        Section(
            heading=f"Path to {target}",
            anchor="path",
            paragraphs=(in_space,),
            notices=(unchecked,) if unchecked else (),
            tables=(_path_table(path), table),
        ),
        Section(heading="Slices", anchor="slices", figures=figures),
    )
    page = Page(title=f"Plan: {target}", lead=(NOT_MEDICAL,), sections=sections)
    write_page(folder / PAGE, page)


def _path_table(path: SkinPath) -> PageTable:
    """Return the table of the path that is the plan."""
    ends = [
        ", ".join(f"{coordinate:.1f}" for coordinate in M_TO_MM * point_m)
        for point_m in (path.entry_m, path.target_m)
    ]
    rows = [
        ("entry, LPS [mm]", ends[0]),
        ("target, LPS [mm]", ends[1]),
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


def _write_scene(labels: Labels, path: SkinPath, place: Path) -> None:
    """Write structures and path as a 3-D page."""
    from needleforce.scene import PlanScene
    from needleforce.scene.export_page import export_plan

    # Lean tissue would hide what lies in it.
    names = [name for name in large_structures(labels) if name != "lean"]
    with staged_progress("drawing the page") as progress:
        surfaces = labels.surfaces(names, progress, voxel_m=SHOWN_VOXEL_m)
    scene = PlanScene(
        surfaces=tuple(surfaces.values()),
        layers=list(path.layers),
        entry_m=path.entry_m,
        target_m=path.target_m,
        warnings=(labels.unchecked,) if labels.unchecked else (),
    )
    export_plan(scene, place)
