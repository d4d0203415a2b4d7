"""`needleforce demo abdomen` on a page: table, forces, needle's plane, scene."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from needleforce.anatomy import Labels, Layer, PlanState, Registration, Structure
from needleforce.cli.demos.abdomen_insertion import (
    LANDMARKS,
    TOUCHES,
    Insertion,
    insert,
)
from needleforce.cli.demos.result_page import NOT_MEDICAL, DemoResult, NamedChart
from needleforce.cli.patient.plan_slices import draw_along
from needleforce.cli.plan_file import crop_scan, large_structures
from needleforce.cli.robot import urdf_with_shapes
from needleforce.cli.shared_options import RobotOptions
from needleforce.cli.terminal import progress_bar, require_modules, write_out
from needleforce.plots import (
    PAGE,
    Chart,
    Curve,
    Instants,
    Page,
    PageFigure,
    PageTable,
    Panel,
    Section,
    palette,
    require_matplotlib,
    save_page_figure,
    whole_folder,
    write_page,
)

MODULES = ("SimpleITK", "skimage", "manifold3d", "trimesh", "mujoco")
"""Modules of extras that the demonstration needs."""

SCENE = "scene.html"
"""Name of the scene in the folder of a report."""

UP = (0.0, 0.0, 1.0)
"""Direction to the head in the model, and up in the scene."""

TITLE = "From a CT to a needle whose ruptures correct the plan"

CT_ROW = "CT"
PATH_ROW = "planned path"
OFF_ROW = "plan off by"
NO_SCENE = "3-D film: not made, the extra `scene` is not installed."

CT_CAPTION = (
    "The CT in two planes that hold the planned path (yellow, with a bar where a layer "
    "ends and a ring at the target); outlines of the structures."
)

SLICE_CAPTION = (
    "The plane of the needle through the segmentation, as planned: entry and target, "
    "planned boundaries (white), detected ruptures (cyan), and where the tip stopped "
    "(red), each moved back by the true shift."
)

M_TO_MM = 1e3


def run(
    data: Path | None, seed: int, *, folder: Path | None, picture: Path | None
) -> int:
    """Run the demonstration and print its table.

    Args:
        data: Folder with CT and labels; None for an analytic torso.
        seed: Seed of everything that is drawn at random.
        folder: Folder for a page, if any.
        picture: File for the needle's plane, if any.

    Returns:
        The exit code.

    Raises:
        CommandError: A package is missing.
    """
    if folder is not None or picture is not None:
        require_matplotlib("demo")
    require_modules("demo abdomen", MODULES)
    with progress_bar("demonstrating abdomen") as progress:
        insertion = insert(data, seed, progress)
    result = DemoResult(TITLE, _rows_of(insertion), (_force_chart(insertion),))
    result.print_table()
    with whole_folder(folder) as place:
        if place is not None:
            _write_page(insertion, result, place)
    if picture is not None:
        draw_plane(insertion, picture)
    if folder is not None:
        pages = [folder / name for name in (PAGE, SCENE) if (folder / name).exists()]
        write_out("".join(f"{page}\n" for page in pages))
    return 0


class PlannedWay(NamedTuple):
    """The planned path with its layers, for pictures.

    Attributes:
        entry_m: Where it meets the skin, shape (3,) [m].
        target_m: Where it ends, shape (3,) [m].
        length_m: From entry to target [m].
        layers: What it crosses.
    """

    entry_m: Array
    target_m: Array
    length_m: float
    layers: Sequence[Layer]


def _write_page(insertion: Insertion, result: DemoResult, folder: Path) -> None:
    """Write the page: CT and path first, then what the insertion made of the plan."""
    path = insertion.path
    way = PlannedWay(path.entry_m, path.target_m, path.length_m, insertion.layers)
    scan = draw_along(insertion.torso, way, folder / "ct.png")
    plane = draw_plane(insertion, folder / "slice.png")
    charts = tuple(
        save_page_figure(chart, folder / f"{name}.svg", alt=caption, caption=caption)
        for name, chart, caption in result.charts
    )
    rows = dict(result.rows)
    has_scene = find_spec("viser") is not None
    table = PageTable(caption="Result", head=("what", "value"), rows=result.rows)
    page = Page(
        title=result.title,
        lead=(
            f"CT: {rows[CT_ROW]}.",
            f"Planned path: {rows[PATH_ROW]}.",
            f"Plan off by {rows[OFF_ROW]}.",
            f"3-D film: open `{SCENE}` in the same folder." if has_scene else NO_SCENE,
            NOT_MEDICAL,
        ),
        sections=(
            Section(
                heading="CT and planned path",
                anchor="plan",
                figures=(PageFigure(path=scan, alt=CT_CAPTION, caption=CT_CAPTION),),
            ),
            Section(
                heading="Insertion",
                anchor="insertion",
                figures=(
                    PageFigure(path=plane, alt=SLICE_CAPTION, caption=SLICE_CAPTION),
                    *charts,
                ),
                tables=(table,),
            ),
        ),
    )
    write_page(folder / PAGE, page)
    if has_scene:
        write_scene(insertion, folder / SCENE)


def write_scene(insertion: Insertion, path: Path) -> Path:
    """Write the insertion as a film in the scene.

    The patient lies where the needle meets the planned entry.
    """
    from needleforce.scene import PlanScene, Viewer

    planned = insertion.path
    followed = insertion.followed
    alignment = Rotation.align_vectors(
        [followed.axis, UP],
        [planned.target_m - planned.entry_m, UP],
        weights=[np.inf, 1.0],
    )
    rotation = alignment[0]
    labels = insertion.torso.labels
    names = large_structures(labels)
    scene = PlanScene(
        surfaces=tuple(labels.surfaces(names).values()),
        layers=insertion.layers,
        entry_m=planned.entry_m,
        target_m=planned.target_m,
        rotation=rotation.as_matrix(),
        translation_m=followed.entry_in_base_m - rotation.apply(planned.entry_m),
        scan=crop_scan(insertion.torso.scan, planned.entry_m, planned.target_m),
    )
    shapes = urdf_with_shapes(RobotOptions())
    viewer = Viewer(insertion.robot, scene, urdf_path=shapes)
    viewer.append(followed.rows)
    try:
        return viewer.export(path)
    finally:
        viewer.stop()


def _rows_of(insertion: Insertion) -> tuple[tuple[str, str], ...]:
    """Return label and text of every line of the table."""
    path = ", ".join(
        f"{layer.name} {M_TO_MM * (layer.exit_m - layer.entry_m):.0f} mm"
        for layer in insertion.layers
    )
    rough, fine = insertion.registrations
    by_touches = "refused: the skin slides or spins on itself"
    if fine is not rough:
        by_touches = _describe_registration(insertion, fine)
    torso = insertion.torso
    errors = insertion.errors_m
    voxels = " x ".join(map(str, torso.scan.grid.shape))
    spacing_mm = ", ".join(f"{M_TO_MM * one:g}" for one in torso.scan.grid.spacing_m)
    rows = {
        CT_ROW: f"{torso.origin}: {voxels} voxels of {spacing_mm} mm",
        PATH_ROW: f"{path}; target in the {torso.target}",
        OFF_ROW: f"{M_TO_MM * errors.by_plan_m:.1f} -> "
        f"{M_TO_MM * errors.corrected_m:.1f} mm after "
        f"{len(insertion.followed.ruptures)} ruptures (tip from target)",
        f"registration by {LANDMARKS} landmarks": _describe_registration(
            insertion, rough
        ),
        f"and {TOUCHES} touches of the skin": by_touches,
    }
    for number, (depth_m, plan) in enumerate(insertion.followed.ruptures, 1):
        label = (
            f"rupture {number} at {M_TO_MM * depth_m:.1f} mm below the planned entry"
        )
        rows[label] = _describe_match(plan)
    rows["true shift along the needle"] = f"{M_TO_MM * insertion.shift_m:+.1f} mm"
    return tuple(rows.items())


def _describe_registration(insertion: Insertion, registration: Registration) -> str:
    """Return true and stated error of a registration at the target."""
    target_m = insertion.path.target_m
    true_m = insertion.placement.point_to_robot(target_m)
    error_mm = M_TO_MM * np.linalg.norm(registration.to_robot(target_m) - true_m)
    std_mm = M_TO_MM * registration.tre_m(target_m)
    return f"{error_mm:.1f} mm at the target, {std_mm:.1f} stated"


def _describe_match(plan: PlanState) -> str:
    """Return into which layer a rupture led, and by how much the plan is off."""
    match = f"into {plan.matched_name}" if plan.matched >= 0 else plan.matched_name
    offset_mm = M_TO_MM * plan.offset_m
    std_mm = M_TO_MM * plan.offset_std_m
    return (
        f"{match} ({100 * plan.matched_probability:.0f} %); all lies "
        f"{offset_mm:+.1f} ± {std_mm:.1f} mm deeper"
    )


def _force_chart(insertion: Insertion) -> NamedChart:
    """Return the chart of force and tip force over depth."""
    followed = insertion.followed
    depth_mm = M_TO_MM * followed.depth_m
    boundaries_mm = tuple(M_TO_MM * layer.exit_m for layer in insertion.layers[:-1])
    ruptures_mm = tuple(M_TO_MM * rupture.depth_m for rupture in followed.ruptures)
    force = Curve(
        style=palette.READING,
        x=depth_mm,
        y=followed.force_N,
        label="force, virtual sensor",
    )
    tip = Curve(style=palette.TIP, x=depth_mm, y=followed.tip_N, label="tip force")
    chart = Chart(
        title="Force and tip force over depth\n"
        "boundaries as planned, ruptures as detected",
        x_label="depth below the planned entry [mm]",
        panels=(Panel(y_label=palette.FORCE, curves=(force, tip)),),
        instants=(
            Instants("planned boundary", palette.COMPENSATION, boundaries_mm),
            Instants("detected rupture", palette.RUPTURE, ruptures_mm),
        ),
    )
    caption = "Force over depth: where the plan expected boundaries, where they were."
    return NamedChart("force", chart, caption)


PIXEL_M = 5e-4
"""Size of a pixel of the plane [m]."""

BEFORE_ENTRY_M = 0.03
BEHIND_TARGET_M = 0.06
BESIDE_M = 0.09
"""How far the plane reaches around the path [m]."""

MIN_NAMED_PIXELS = 800
"""A structure with fewer pixels in the plane bears no name."""


class NamePlace(NamedTuple):
    """Where the name of a structure is written in the plane.

    Attributes:
        name: Name of the structure.
        row: Row of the pixel.
        column: Column of the pixel.
    """

    name: str
    row: int
    column: int


class NeedlePlane(NamedTuple):
    """The segmentation in the plane of the needle.

    Attributes:
        along_m: Places of the rows along the needle, from the entry, shape (m,) [m].
        across_m: Places of the columns across it, shape (n,) [m].
        colors: Colours of the pixels, shape (m, n, 3).
        names: Names of the large structures, each where the structure is widest.
    """

    along_m: Array
    across_m: Array
    colors: Array
    names: list[NamePlace]


def draw_plane(insertion: Insertion, path: Path) -> Path:
    """Draw the plane of the needle into a file; return its path."""
    import matplotlib.pyplot as plt
    from matplotlib.patheffects import withStroke

    # Legible on the colour of any structure.
    outline = [withStroke(linewidth=3.0, foreground="0.15")]
    figure, axes = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
    _draw_structures(axes, cut_plane(insertion), outline)
    _draw_needle(axes, insertion, outline)
    axes.set(
        xlabel="across the needle [mm]",
        ylabel="along the needle, below the planned entry [mm]",
        title="Plan and insertion",
    )
    legend = {"facecolor": "0.3", "labelcolor": "white", "fontsize": 8, "ncols": 4}
    figure.legend(loc="outside lower center", **legend)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path


def _draw_structures(axes: Any, plane: NeedlePlane, outline: Sequence[Any]) -> None:
    """Draw the structures of a plane and their names."""
    along_mm = M_TO_MM * plane.along_m
    across_mm = M_TO_MM * plane.across_m
    extent = (across_mm[0], across_mm[-1], along_mm[-1], along_mm[0])
    axes.imshow(plane.colors, extent=extent, aspect="equal")
    for name, row, column in plane.names:
        axes.text(
            across_mm[column],
            along_mm[row],
            name.replace("_", " "),
            ha="center",
            va="center",
            color="white",
            fontsize=8,
            path_effects=outline,
        )


def _draw_needle(axes: Any, insertion: Insertion, outline: Sequence[Any]) -> None:
    """Draw needle, target, planned boundaries and ruptures, less the true shift."""
    followed = insertion.followed
    shift_m = insertion.shift_m
    tip_mm = M_TO_MM * (followed.stop_m - shift_m)
    axes.plot(
        [0.0, 0.0], [-M_TO_MM * BEFORE_ENTRY_M, tip_mm], color="0.9", linewidth=2.0
    )
    target_mm = M_TO_MM * insertion.path.length_m
    axes.plot(0.0, target_mm, "o", mfc="none", mec="white", ms=11, label="target")
    axes.plot(0.0, tip_mm, "x", color="red", ms=8, mew=2, label="tip")
    boundaries_mm = [M_TO_MM * layer.exit_m for layer in insertion.layers[:-1]]
    ruptures_mm = [
        M_TO_MM * (rupture.depth_m - shift_m) for rupture in followed.ruptures
    ]
    style = {"lw": 2.0, "path_effects": outline}
    axes.hlines(
        boundaries_mm, -8.0, 8.0, color="white", label="planned boundary", **style
    )
    axes.hlines(ruptures_mm, -5.0, 5.0, color="cyan", label="rupture", **style)


def cut_plane(insertion: Insertion) -> NeedlePlane:
    """Return the segmentation in the plane of the needle and across the body."""
    planned = insertion.path
    labels = insertion.torso.labels
    along_m = np.arange(-BEFORE_ENTRY_M, planned.length_m + BEHIND_TARGET_M, PIXEL_M)
    across_m = np.arange(-BESIDE_M, BESIDE_M, PIXEL_M)
    axis = (planned.target_m - planned.entry_m) / planned.length_m
    side = np.cross(axis, UP)
    side /= np.linalg.norm(side)
    rows_m = along_m[:, None, None] * axis
    columns_m = across_m[None, :, None] * side
    # Small structures lie above large ones.
    structures = sorted(labels.structures, key=lambda item: -item.voxels)
    owners = _owners(labels, structures, planned.entry_m + rows_m + columns_m)
    colors = np.zeros((*owners.shape, 3))
    names: list[NamePlace] = []
    for number, structure in enumerate(structures):
        is_owned = owners == number
        colors[is_owned] = structure.colour
        if np.count_nonzero(is_owned) > MIN_NAMED_PIXELS:
            names.append(_name_place(structure.name, is_owned))
    return NeedlePlane(along_m, across_m, colors, names)


def _owners(
    labels: Labels, structures: Sequence[Structure], points_m: Array
) -> np.ndarray:
    """Return the number of the last structure that covers each point; -1 for none.

    Args:
        labels: The segmentation.
        structures: Structures of it.
        points_m: Places in the model, shape (m, n, 3) [m].
    """
    index = np.rint(labels.grid.indices(points_m)).astype(int)
    is_valid: Any = ((index >= 0) & (index < labels.grid.shape)).all(axis=-1)
    voxels = tuple(np.moveaxis(np.where(is_valid[..., None], index, 0), -1, 0))
    owners = np.full(is_valid.shape, -1)
    for number, structure in enumerate(structures):
        is_inside = labels.volumes[structure.volume][voxels] == structure.value
        owners[is_valid & is_inside] = number
    return owners


def _name_place(name: str, is_owned: np.ndarray) -> NamePlace:
    """Return the pixel farthest from the edge of a structure, shape (m, n)."""
    depth: Any = distance_transform_edt(np.pad(is_owned, 1))
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return NamePlace(name, int(row) - 1, int(column) - 1)
