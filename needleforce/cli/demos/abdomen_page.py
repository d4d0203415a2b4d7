"""`needleforce demo abdomen` on a page: table, forces, the needle's plane, the
scene.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from needleforce.cli.demos.abdomen_insertion import (
    LANDMARKS,
    TOUCHES,
    Insertion,
    insert,
)
from needleforce.cli.demos.result_page import DemoResult
from needleforce.cli.plan_file import LEAST_VOXELS
from needleforce.cli.robot import urdf_with_shapes
from needleforce.cli.shared_options import RobotOptions
from needleforce.cli.terminal import CommandError, progress_bar, write_out
from needleforce.plots import (
    Chart,
    Curve,
    Instants,
    PageFigure,
    Panel,
    palette,
    require_matplotlib,
)

NEEDED = {"SimpleITK": "SimpleITK", "skimage": "scikit-image"}
NEEDED |= {name: name for name in ("manifold3d", "trimesh", "mujoco")}
"""Modules, all of extras, and the packages that bring them."""


def run(
    data: Path | None, seed: int, *, folder: Path | None, picture: Path | None
) -> int:
    """Do it, print a table, and write a page or its first picture; return the exit
    code.
    """
    if folder is not None or picture is not None:
        require_matplotlib("demo")
    for name, package in NEEDED.items():
        if find_spec(name) is None:
            raise CommandError(f"demo abdomen needs {package}; pip install {package}")
    with progress_bar("demonstrating abdomen") as progress:
        made = insert(data, seed, progress)

    def drawn(folder: Path) -> list[PageFigure]:
        plane = draw_slice(made, folder / "slice.png")
        return [PageFigure(path=plane, alt=SLICE, caption=SLICE)]

    title = "From a CT to a needle whose ruptures correct the plan"
    DemoResult(title, _rows(made), _charts(made)).write("abdomen", folder, drawn)
    if picture is not None:
        draw_slice(made, picture)
    if folder is not None and find_spec("viser") is not None:
        write_out(f"{write_scene(made, folder / 'scene.html')}\n")
    return 0


def write_scene(made: Insertion, path: Path) -> Path:
    """Write the insertion as a film in the scene; the patient lies where the needle
    meets it.
    """
    from needleforce.scene import PlanScene, Viewer

    way = made.target_m - made.entry_m
    up = [0.0, 0.0, 1.0]
    turn = Rotation.align_vectors([made.axis, up], [way, up], weights=[np.inf, 1.0])[0]
    large = [
        item.name for item in made.labels.structures if item.voxels >= LEAST_VOXELS
    ]
    names = [name for name in large if name != "lean"]  # it would hide what lies in it
    surfaces = tuple(made.labels.surfaces(names).values())
    shift = made.entry_in_base_m - turn.apply(made.entry_m)
    scene = PlanScene(
        surfaces, made.plan, made.entry_m, made.target_m, turn.as_matrix(), shift
    )
    viewer = Viewer(made.robot, scene, urdf_path=urdf_with_shapes(RobotOptions()))
    viewer.append(made.rows)
    try:
        return viewer.export(path)
    finally:
        viewer.stop()


LEAST_NAMED = 800  # Pixels from which on a structure's name is written


SLICE = (
    "The plane of the needle through the segmentation, as planned: entry and target, planned "
    "boundaries (white), detected ruptures (cyan), and where the tip stopped (red), each moved "
    "back by the true shift."
)


def _rows(made: Insertion) -> tuple[tuple[str, str], ...]:
    by_plan, corrected = (f"{1e3 * error:.1f} mm" for error in made.errors_m)
    true = made.truth[0] @ made.target_m + made.truth[1]
    path = ", ".join(
        f"{p.name} {1e3 * (p.exit_m - p.entry_m):.0f} mm" for p in made.plan
    )
    ways = []
    for each in (made.rough, made.fine):
        error = np.linalg.norm(each.to_robot(made.target_m) - true)
        std = each.tre_m(made.target_m)
        ways.append(f"{1e3 * error:.1f} mm at the target, {1e3 * std:.1f} stated")
    if made.fine is made.rough:
        ways[1] = "refused: the skin slides or spins on itself"
    rows = {"planned path": path, f"registration by {LANDMARKS} landmarks": ways[0]}
    rows[f"and {TOUCHES} touches of the skin"] = ways[1]
    for k, (depth, state) in enumerate(made.states, 1):
        where = (
            f"into {state.matched_name}" if state.matched >= 0 else state.matched_name
        )
        rows[f"rupture {k} at {1e3 * depth:.1f} mm"] = (
            f"{where} ({100 * state.matched_probability:.0f} %); all lies "
            f"{1e3 * state.offset_m:+.1f} ± {1e3 * state.offset_std_m:.1f} mm deeper"
        )
    rows["true shift along the needle"] = f"{1e3 * made.shift_m:+.1f} mm"
    rows["tip from the target, by the plan alone"] = by_plan
    rows["tip from the target, corrected by force"] = corrected
    return tuple(rows.items())


def _charts(made: Insertion) -> tuple[tuple[str, Chart, str], ...]:
    x = 1e3 * made.depth_m
    planned = tuple(1e3 * layer.exit_m for layer in made.plan[:-1])
    found = tuple(1e3 * depth for depth, _ in made.states)
    marks = (
        Instants(label="planned boundary", style=palette.COMPENSATION, places=planned),
        Instants(label="detected rupture", style=palette.RUPTURE, places=found),
    )
    forces = (
        Curve(
            style=palette.READING, x=x, y=made.force_N, label="force, virtual sensor"
        ),
        Curve(style=palette.TIP, x=x, y=made.tip_N, label="tip force"),
    )
    chart = Chart(
        title="Force and tip force over depth\nboundaries as planned, ruptures as detected",
        x_label="depth below the planned entry [mm]",
        panels=(Panel(y_label=palette.FORCE, curves=forces),),
        instants=marks,
    )
    caption = "Force over depth: where the plan expected boundaries, where they were."
    return (("force", chart, caption),)


def draw_slice(made: Insertion, path: Path) -> Path:
    """Draw the plane of the needle into a file."""
    import matplotlib.pyplot as plt
    from matplotlib.patheffects import withStroke

    outline = [
        withStroke(linewidth=3.0, foreground="0.15")
    ]  # legible on any structure's colour
    along = np.arange(-0.03, made.length_m + 0.06, 5e-4)
    across = np.arange(-0.09, 0.09, 5e-4)
    colors, names = _section(made, along, across)
    figure, plane = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
    extent = (1e3 * across[0], 1e3 * across[-1], 1e3 * along[-1], 1e3 * along[0])
    plane.imshow(colors, extent=extent, aspect="equal")
    for name, row, column in names:
        place = (1e3 * across[column], 1e3 * along[row])
        style = {"color": "white", "fontsize": 8, "path_effects": outline}
        plane.text(*place, name.replace("_", " "), ha="center", va="center", **style)
    tip = made.stop_m - made.shift_m
    plane.plot([0.0, 0.0], [-30.0, 1e3 * tip], color="0.9", linewidth=2.0)
    plane.plot(
        0.0, 1e3 * made.length_m, "o", mfc="none", mec="white", ms=11, label="target"
    )
    plane.plot(0.0, 1e3 * tip, "x", color="red", ms=8, mew=2, label="tip")
    planned_mm = [1e3 * layer.exit_m for layer in made.plan[:-1]]
    found_mm = [1e3 * (depth - made.shift_m) for depth, _ in made.states]
    lines = (
        (planned_mm, 8.0, "white", "planned boundary"),
        (found_mm, 5.0, "cyan", "rupture"),
    )
    for places_mm, half_mm, color, label in lines:
        style = {"color": color, "lw": 2.0, "label": label, "path_effects": outline}
        plane.hlines(places_mm, -half_mm, half_mm, **style)
    plane.set(
        xlabel="across the needle [mm]",
        ylabel="along the needle [mm]",
        title="Plan and insertion",
    )
    legend = {"facecolor": "0.3", "labelcolor": "white", "fontsize": 8, "ncols": 4}
    figure.legend(loc="outside lower center", **legend)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path


def _section(
    made: Insertion, along: Any, across: Any
) -> tuple[Any, list[tuple[str, int, int]]]:
    """Colours in the needle's plane, and each large structure's name where it is
    widest.
    """
    axis = (made.target_m - made.entry_m) / made.length_m
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    places = made.entry_m + along[:, None, None] * axis + across[None, :, None] * side
    index = np.rint(made.labels.grid.indices(places)).astype(int)
    valid: Any = ((index >= 0) & (index < made.labels.grid.shape)).all(axis=-1)
    at = tuple(np.moveaxis(np.where(valid[..., None], index, 0), -1, 0))
    ordered = sorted(made.labels.structures, key=lambda item: -item.voxels)
    owner = np.full(valid.shape, -1)
    colors = np.zeros((*valid.shape, 3))
    names = []
    for k, structure in enumerate(ordered):
        owner[
            valid & (made.labels.volumes[structure.volume][at] == structure.value)
        ] = k
    for k, structure in enumerate(ordered):
        inside = owner == k
        colors[inside] = structure.colour
        if np.count_nonzero(inside) > LEAST_NAMED:
            depth: Any = distance_transform_edt(np.pad(inside, 1))
            row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
            names.append((structure.name, int(row) - 1, int(column) - 1))
    return colors, names
