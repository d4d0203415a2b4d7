"""`needleforce plan`: paths from the skin to a target, and the plan of one."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from foundation.arrays import Array
from needleforce import plots
from needleforce.anatomy import (
    FreeSpace,
    Labels,
    PlanError,
    clearance,
    path_search,
    require_clear_path,
)
from needleforce.anatomy.errors import OTHER_PATH
from needleforce.anatomy.labels import DENSE, SHOWN_VOXEL_m
from needleforce.anatomy.markups import read_markup, write_markup
from needleforce.anatomy.path_search import PathLimits, SkinPath
from needleforce.anatomy.volume import is_known
from needleforce.cli.options import PathOptions, PointOptions
from needleforce.cli.patient import case_files
from needleforce.cli.patient.plan_page import write_plan_page
from needleforce.cli.terminal import (
    CommandError,
    progress_bar,
    require_modules,
    say,
    table_text,
    warn,
    write_out,
)
from needleforce.plan_file import (
    PLAN,
    PLAN_VERSION,
    MadeOf,
    hash_sources,
    large_structures,
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


def plan_paths(
    ct: Path,
    labels_file: Path,
    target_name: str,
    *,
    points: PointOptions,
    structures_text: str | None,
    situs_inversus: bool,
    avoid: Sequence[str],
    passable: Sequence[str],
    limits: PathOptions,
    choice: int,
    folder: Path,
) -> int:
    """Find paths, print them, and write the plan of one of them.

    Args:
        ct: The CT.
        labels_file: Its segmentation.
        target_name: The target: a structure, or a file with points or a line.
        points: What a file of points may leave unsaid.
        structures_text: What structures are that the segmentation does not name.
        situs_inversus: Whether liver and spleen are exchanged.
        avoid: Structures that must stay clear, beside the usual ones.
        passable: Structures that the needle may pass.
        limits: What a path may be.
        choice: Number of the path that becomes the plan.
        folder: Folder of the plan; whole or absent.

    Returns:
        The exit code.

    Raises:
        CommandError: The path of that number was not found, or a name is not known.
        needleforce.anatomy.AnatomyError: The files do not belong together, or there is
            no path.
    """
    plots.require_matplotlib("plan")
    require_modules("plan", case_files.MODULES)
    space = FreeSpace(limits.radius / M_TO_MM, limits.margin / M_TO_MM)
    path_limits = PathLimits(
        limits.max_length / M_TO_MM, np.radians(limits.cone).item(), space
    )
    structures = case_files.parse_structures(structures_text)
    case = case_files.read_case(
        ct, labels_file, structures, situs_inversus=situs_inversus
    )
    labels = case.labels
    avoided = _names_to_avoid(labels, target_name, avoid, passable)
    target, points_m = _find_target(target_name, labels, points)
    paths = _find_paths(labels, points_m, avoided, path_limits)
    if choice > len(paths):
        raise CommandError(f"--choose {choice}: only {len(paths)} paths were found")
    chosen = paths[choice - 1]
    accepted = [
        item.name
        for item in labels.structures
        if item.is_obstacle and item.name in (target, *passable)
    ]
    require_clear_path(chosen.clearances, space, accepted)
    rows = pd.DataFrame([_row(n, path) for n, path in enumerate(paths, 1)])
    notes = [
        f"target {target}; at most {limits.max_length:g} mm long and {limits.cone:.0f} "
        f"degrees from the skin's normal; {M_TO_MM * space.needed_m:.1f} mm from the "
        "needle's centre line stay clear of "
        f"{', '.join(avoided) or 'nothing: no structure is at risk by its name'}"
        "; lengths, thicknesses and clearances in mm",
        f"path {choice} is the plan. {case_files.NOT_MEDICAL}",
    ]
    write_out("\n".join([table_text(rows, str.ljust), *notes, ""]))
    warn(filter(None, (labels.unchecked,)))
    ends_m = np.array([chosen.entry_m, chosen.target_m])
    digest = hash_sources(case.scan, case.file_labels, ends_m, chosen.layers, space)
    names = ("name", "exit_m", "exit_std_m", "is_obstacle")
    fields = {
        "version": PLAN_VERSION,
        "target": target,
        "ct": case_files.relative_path(ct, folder),
        "labels": case_files.relative_path(labels_file, folder),
        "structures": case_files.relative_path(structures, folder)
        if isinstance(structures, Path)
        else structures or {},
        "situs_inversus": situs_inversus,
        "entry_m": chosen.entry_m,
        "target_m": chosen.target_m,
        "needle_radius_m": space.needle_radius_m,
        "margin_m": space.margin_m,
        "accepted_obstacles": accepted,
        "layers": [
            {name: getattr(layer, name) for name in names} for layer in chosen.layers
        ],
        "made_of": MadeOf(sha256=digest, avoided=avoided),
    }
    table = plots.PageTable(
        caption="Paths, the best first; lengths, thicknesses, clearances in mm",
        head=tuple(rows.columns),
        rows=tuple(rows.itertuples(index=False, name=None)),
        note=notes[0],
    )
    with plots.whole_folder(folder) as draft:
        if draft is not None:
            case_files.write_plan_fields(draft / PLAN, fields)
            write_markup(draft / MARKUP, "Line", ("entry", "target"), ends_m)
            _write_page(case, chosen, target, table, space.needed_m, draft)
    for file in (PLAN, MARKUP, plots.PAGE):
        write_out(f"{folder / file}\n")
    say(
        f"next: needleforce touch ARM --landmarks FILE -o touches.json, then "
        f"needleforce register --plan {folder / PLAN} --landmarks FILE --touches "
        "touches.json"
    )
    return 0


def _find_target(name: str, labels: Labels, points: PointOptions) -> tuple[str, Array]:
    """Return the name of the target and its place, (1, 3), or the ends of a line.

    Args:
        name: A file with points or a line, or a structure.
        labels: The segmentation.
        points: What a file of points may leave unsaid.
    """
    suffixes = (".json", ".fcsv", ".csv", ".tsv", ".txt")  # of what `read_points` reads
    if Path(name).suffix.lower() not in suffixes:
        return name, np.array([labels.deepest_point_m(name)])
    markup = read_markup(name, points.unit, points.frame)
    if not markup.is_line:
        return markup.names[0], markup.points_m[:1]
    if len(markup.points_m) != 2:
        raise CommandError(f"{name}: a line of {len(markup.points_m)} points")
    return "end of the line", markup.points_m


def _find_paths(
    labels: Labels, points_m: Array, avoid: Sequence[str], limits: PathLimits
) -> Sequence[SkinPath]:
    """Return paths to the target, or the one of a line.

    Args:
        labels: The segmentation.
        points_m: The target, shape (1, 3), or the ends of a line, (2, 3).
        avoid: Names of the structures that must stay clear.
        limits: What a path may be.

    Raises:
        needleforce.anatomy.PlanError: There is no path, or the line comes nearer to
            a structure than an offered path may.
    """
    if len(points_m) == 1:
        with progress_bar("searching paths") as progress:
            return path_search.find_paths(labels, points_m[0], avoid, limits, progress)
    path = path_search.judge_line(labels, points_m, limits)
    point_m = 1e-6  # length of a line that stands for a point
    at_target = labels.clearances(path.target_m, path.target_m + point_m, avoid)
    around_target = {one.name for one in at_target if one.distance_m == 0.0}
    names = [name for name in avoid if name not in around_target]
    clearances = labels.clearances(path.entry_m, path.target_m, names)
    near = clearance.too_near(clearances, limits.space)
    if near:
        raise PlanError(
            f"the line {'; '.join(map(clearance.describe_clearance, near))}: these "
            f"must stay {limits.space} away, as from an offered path; --passable names "
            "what the needle may pass",
            OTHER_PATH,
        )
    return (path,)


def _names_to_avoid(
    labels: Labels, target: str, avoid: Sequence[str], passable: Sequence[str]
) -> tuple[str, ...]:
    """Return the names of the structures that must stay clear.

    Where none is asked for, one at least must be known as an obstacle or at risk.

    Raises:
        CommandError: A bone is to be passed, or a name says nothing and nobody has said
            whether the needle may pass it.
    """
    asked = [labels[name].name for name in avoid]
    passed = {labels[name].name for name in passable}
    bones = [name for name in passed if labels[name].is_obstacle and name != DENSE]
    if bones:
        raise CommandError(
            f"--passable {', '.join(bones)}: a needle passes no bone or cartilage"
        )
    said = {target, *asked, *passed}
    items = labels.structures
    usual = [item.name for item in items if item.is_obstacle or item.is_risk]
    unknown = [
        item.name
        for item in items
        if item.name not in {*usual, *said} and not is_known(item.anatomy)
    ]
    if not (usual or asked):
        unknown = unknown or [item.name for item in items]
    if unknown:
        raise CommandError(
            f"names that do not say what they are: {', '.join(unknown)}; expected for "
            "each --avoid NAME (must stay clear), --passable NAME (the needle may pass "
            f"it) or --structures {unknown[0]}=KIND, of {case_files.KINDS}"
        )
    return (*asked, *(name for name in usual if name not in said))


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
    case: case_files.PatientCase,
    path: SkinPath,
    target: str,
    table: plots.PageTable,
    needed_m: float,
    folder: Path,
) -> None:
    """Write the page of a plan."""
    labels = case.labels
    along = draw_along(case.scan, labels, path, folder / "along.png")
    place = folder / "probes-eye.png"
    across = draw_probe_view(case.scan, labels, path, needed_m, place)
    write_plan_page(
        folder,
        f"Plan: {target}",
        case_files.NOT_MEDICAL,
        table,
        {ALONG: along, ACROSS: across},
        partial(_write_scene, labels, path),
        paragraphs=[
            f"{name}, LPS: {(M_TO_MM * place_m).round(1)} mm"
            for name, place_m in (("Entry", path.entry_m), ("Target", path.target_m))
        ],
        notices=[*filter(None, (labels.unchecked,))],
    )


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
        warnings=tuple(filter(None, (labels.unchecked,))),
    )
    export_plan(scene, place)
