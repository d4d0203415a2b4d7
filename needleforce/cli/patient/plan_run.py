"""`needleforce plan`: paths from the skin to a target, and the plan of one."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy import FreeSpace, Labels, PlanError, require_clear_path
from needleforce.anatomy.clearance import describe_clearance, too_near
from needleforce.anatomy.errors import OTHER_PATH
from needleforce.anatomy.labels import DENSE
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
    PLAN_VERSION,
    CaseFiles,
    PatientCase,
    read_case,
    relative_path,
    write_plan_fields,
)
from needleforce.cli.patient.plan_page import write_plan_page
from needleforce.cli.patient.plan_table import describe_paths
from needleforce.cli.patient.structure_names import (
    require_confirmed_names,
    require_known_names,
)
from needleforce.cli.terminal import (
    CommandError,
    require_modules,
    say,
    staged_progress,
    write_out,
)
from needleforce.plan_binding import (
    MadeOf,
    path_sha256,
    record_labels,
    record_scan,
)
from needleforce.plan_file import PLAN
from needleforce.plots import PAGE, require_matplotlib, whole_folder

MODULES = ("SimpleITK", "nibabel", "skimage", "manifold3d", "trimesh", "igl")
"""Modules of extras that the command needs."""


M_PER_MM = 1e-3

POINT_m = 1e-6
"""Length of a line that stands for a point."""


class PathWish(NamedTuple):
    """What path is asked for.

    Attributes:
        target: Name of a structure, or a ``.mrk.json`` file.
        avoid: Names of structures that must stay clear beside those at risk.
        passable: Names of structures that the needle may pass.
        radius_mm: Of the needle [mm].
        margin_mm: Stays free around the needle [mm].
        max_length_mm: Of the path [mm].
        cone_deg: Largest angle to the skin's normal [degrees].
        number: Of the path that becomes the plan, from 1.
    """

    target: str
    avoid: tuple[str, ...]
    passable: tuple[str, ...]
    radius_mm: float
    margin_mm: float
    max_length_mm: float
    cone_deg: float
    number: int

    def limits(self) -> PathLimits:
        """Return the limits of the search.

        Raises:
            CommandError: One of them cannot be.
        """
        if not 0.1 <= self.radius_mm <= 5.0:
            raise CommandError(f"--radius {self.radius_mm:g}: expected 0.1 to 5 mm")
        if not 0.0 <= self.margin_mm <= 100.0:
            raise CommandError(f"--margin {self.margin_mm:g}: expected 0 to 100 mm")
        if not 1.0 <= self.max_length_mm <= 500.0:
            raise CommandError(
                f"--max-length {self.max_length_mm:g}: expected 1 to 500 mm"
            )
        if not 0.0 < self.cone_deg <= 90.0:
            raise CommandError(f"--cone {self.cone_deg:g}: expected 0 to 90 degrees")
        if self.number < 1:
            raise CommandError(f"--choose {self.number}: expected 1 or more")
        return PathLimits(
            M_PER_MM * self.max_length_mm,
            float(np.radians(self.cone_deg)),
            FreeSpace(M_PER_MM * self.radius_mm, M_PER_MM * self.margin_mm),
        )


class _Target(NamedTuple):
    """Where the needle shall go.

    Attributes:
        name: Of the target.
        place_m: The target, (3,) in LPS.
        entry_m: A point outside through which it shall come; None for any.
    """

    name: str
    place_m: Array
    entry_m: Array | None = None


def plan_paths(files: CaseFiles, wish: PathWish, folder: Path) -> int:
    """Find paths, print them, and write the plan of one of them.

    Args:
        files: CT and labels.
        wish: What path is asked for.
        folder: Folder of the plan; whole or absent.

    Returns:
        The exit code.

    Raises:
        CommandError: A limit cannot be, or the path of that number was not found.
        needleforce.anatomy.AnatomyError: The files do not belong together, or there is
            no path.
    """
    path_markup = "path.mrk.json"  # the planned path for 3D Slicer
    require_matplotlib("plan")
    require_modules("plan", MODULES)
    limits = wish.limits()
    case = read_case(files)
    avoid = names_to_avoid(case.labels, wish)
    target = _find_target(wish.target, case.labels)
    paths = _search(case.labels, target, avoid, limits)
    if wish.number > len(paths.paths):
        raise CommandError(
            f"--choose {wish.number}: only {len(paths.paths)} paths were found"
        )
    chosen = paths.paths[wish.number - 1]
    accepted = _accepted_obstacles(case.labels, wish, target)
    require_clear_path(chosen.clearances, limits.space, accepted)
    write_out(describe_paths(paths, target.name, avoid, limits, wish.number))
    if case.labels.unchecked:
        say(f"warning: {case.labels.unchecked}")
    with whole_folder(folder) as place:
        if place is not None:
            fields = _plan_fields(case, wish, target, chosen, folder, avoid)
            write_plan_fields(place / PLAN, fields)
            write_markup(
                place / path_markup,
                "Line",
                ("entry", "target"),
                np.array([chosen.entry_m, chosen.target_m]),
            )
            with staged_progress("drawing the page") as progress:
                write_plan_page(
                    case, chosen, paths, target.name, limits, place, progress
                )
    for name in (PLAN, path_markup, PAGE):
        write_out(f"{folder / name}\n")
    say(
        f"next: needleforce touch ARM --landmarks FILE -o touches.json, then "
        f"needleforce register --plan {folder / PLAN} --landmarks FILE --touches "
        "touches.json"
    )
    return 0


def _find_target(name: str, labels: Labels) -> _Target:
    """Return the target that a user names: a file, or a structure."""
    if not name.endswith(".json"):
        return _Target(name, labels.deepest_point_m(name))
    markup = read_markup(name)
    if not markup.is_line:
        return _Target(markup.names[0], markup.points_m[0])
    if len(markup.points_m) != 2:
        raise CommandError(f"{name}: a line of {len(markup.points_m)} points")
    entry_m, target_m = orient_line(labels, markup.points_m)
    return _Target("end of the line", target_m, entry_m)


def names_to_avoid(labels: Labels, wish: PathWish) -> tuple[str, ...]:
    """Return the names of the structures that must stay clear.

    Raises:
        CommandError: A bone is to be passed, or a name says nothing and nobody has said
            whether the needle may pass it.
    """
    asked = [labels[name].name for name in wish.avoid]
    passable = {labels[name].name for name in wish.passable}
    bones = [
        name for name in sorted(passable) if labels[name].is_obstacle and name != DENSE
    ]
    if bones:
        raise CommandError(
            f"--passable {', '.join(bones)}: a needle passes no bone or cartilage"
        )
    if not asked:
        require_known_names(labels)
    require_confirmed_names(labels, {wish.target, *asked, *passable})
    usual = [
        item.name
        for item in labels.structures
        if (item.is_obstacle or item.is_risk)
        and item.name != wish.target
        and item.name not in passable
        and item.name not in asked
    ]
    return (*asked, *usual)


def _accepted_obstacles(
    labels: Labels, wish: PathWish, target: _Target
) -> tuple[str, ...]:
    """Return the names of obstacles that the path may touch."""
    return tuple(
        item.name
        for item in labels.structures
        if item.is_obstacle and item.name in (target.name, *wish.passable)
    )


def _search(
    labels: Labels, target: _Target, avoid: tuple[str, ...], limits: PathLimits
) -> FoundPaths:
    """Return the paths to a target; of a line that path alone."""
    if target.entry_m is not None:
        path = judge_path(labels, target.entry_m, target.place_m, limits)
        clear_of = [name for name in avoid if not _is_in(labels, name, target.place_m)]
        _require_clear_line(labels, path, clear_of, limits.space)
        return FoundPaths((path,), Counter())
    with staged_progress("searching paths") as progress:
        return find_paths(labels, target.place_m, avoid, limits, progress)


def _is_in(labels: Labels, name: str, point_m: Array) -> bool:
    """Return whether a point lies in a structure."""
    clearances = labels.clearances(point_m, point_m + POINT_m, [name])
    return bool(clearances) and clearances[0].distance_m == 0.0


def _require_clear_line(
    labels: Labels, path: SkinPath, names: Sequence[str], space: FreeSpace
) -> None:
    """Refuse a line that comes too near to what an offered path must stay clear of.

    Raises:
        needleforce.anatomy.PlanError: It comes nearer than a path needs.
    """
    clearances = labels.clearances(path.entry_m, path.target_m, names)
    near = too_near(clearances, space)
    if near:
        raise PlanError(
            f"the line {'; '.join(map(describe_clearance, near))}: these must stay "
            f"{space} away, as from an offered path; --passable names what the "
            "needle may pass",
            OTHER_PATH,
        )


def _plan_fields(
    case: PatientCase,
    wish: PathWish,
    target: _Target,
    path: SkinPath,
    folder: Path,
    avoid: Sequence[str],
) -> Mapping[str, Any]:
    """Return what stands in the plan's file; see docs/reference/files.md."""
    files = case.files
    fields: dict[str, Any] = {
        "version": PLAN_VERSION,
        "target": target.name,
        "ct": relative_path(files.ct, folder),
        "labels": relative_path(files.labels, folder),
        "entry_m": path.entry_m,
        "target_m": path.target_m,
        "needle_radius_m": M_PER_MM * wish.radius_mm,
        "margin_m": M_PER_MM * wish.margin_mm,
        "layers": [
            {
                "name": layer.name,
                "exit_m": layer.exit_m,
                "exit_std_m": layer.exit_std_m,
                "is_obstacle": layer.is_obstacle,
            }
            for layer in path.layers
        ],
    }
    fields["made_of"] = MadeOf(
        ct=record_scan(case.scan),
        labels=record_labels(case.file_labels),
        path_sha256=path_sha256(
            path.entry_m,
            path.target_m,
            [(layer.name, layer.exit_m) for layer in path.layers],
            fields["needle_radius_m"],
            fields["margin_m"],
        ),
        avoided=tuple(avoid),
    )
    accepted = _accepted_obstacles(case.labels, wish, target)
    if accepted:
        fields["accepted_obstacles"] = accepted
    if files.structures is not None:
        fields["structures"] = _stated_names(files.structures, folder)
    if files.situs_inversus:
        fields["situs_inversus"] = True
    return fields


def _stated_names(names: Path | Mapping[str, str], folder: Path) -> Any:
    """Return names of structures, or where their file is found from a folder."""
    return relative_path(names, folder) if isinstance(names, Path) else dict(names)
