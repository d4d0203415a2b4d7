"""`needleforce demo abdomen`: from a CT to its target, as a table and as a page."""

from functools import partial
from pathlib import Path

import numpy as np

from needleforce import plots
from needleforce.anatomy import Registration
from needleforce.cli.demos.insertion import NOT_MEDICAL
from needleforce.cli.options import RobotOptions
from needleforce.cli.patient.plan_page import write_plan_page
from needleforce.cli.robot import urdf_with_shapes
from needleforce.cli.terminal import (
    aligned,
    progress_bar,
    require_modules,
    write_out,
)
from needleforce.plan_file import crop_scan, large_structures
from needleforce.plots.plan_slices import draw_along
from needleforce.simulation.patient import TOUCHES
from needleforce.simulation.planned_insertion import (
    LANDMARKS,
    PlannedInsertion,
    insert,
)

TITLE = "From a CT to a needle whose ruptures correct the plan"

CAPTION = (
    "The CT in two planes that hold the planned path (yellow, with a bar where a layer "
    "ends and a ring at the target); outlines of the structures. Blue: the detected "
    "ruptures, and a cross where the tip stopped, moved back by the true shift."
)

M_TO_MM = 1e3


def run(data: Path | None, seed: int, folder: Path | None) -> int:
    """Run the demonstration and print its table.

    Args:
        data: Folder with CT and labels; None for an analytic torso.
        seed: Seed of everything that is drawn at random.
        folder: Folder for a page, if any.

    Returns:
        The exit code.

    Raises:
        CommandError: A package is missing.
    """
    modules = ("SimpleITK", "skimage", "manifold3d", "trimesh", "mujoco")
    require_modules("demo abdomen", modules)
    with plots.whole_folder(folder) as draft:
        with progress_bar("demonstrating abdomen") as progress:
            insertion = insert(data, seed, progress)
        rows = _rows_of(insertion)
        write_out(f"{TITLE}\n{aligned(rows.items())}{NOT_MEDICAL}\n")
        if draft is not None:
            _write_page(insertion, rows, draft)
    if folder is not None:
        write_out(f"{folder / plots.PAGE}\n")
    return 0


def _write_page(
    insertion: PlannedInsertion, rows: dict[str, str], folder: Path
) -> None:
    """Write the page: CT and path, what the insertion made of the plan, the film."""
    picture = draw_along(
        insertion.torso.scan,
        insertion.torso.labels,
        insertion.path,
        folder / "ct.png",
        ruptures_m=[one.depth_m - insertion.shift_m for one in insertion.ruptures],
        tip_m=insertion.stop_m - insertion.shift_m,
    )
    table = plots.PageTable(
        caption="Result", head=("what", "value"), rows=tuple(rows.items())
    )
    write_plan_page(
        folder,
        TITLE,
        NOT_MEDICAL,
        table,
        {CAPTION: picture},
        partial(write_scene, insertion),
    )


def write_scene(insertion: PlannedInsertion, path: Path) -> Path:
    """Write the insertion as a film in the scene."""
    from needleforce.scene import PlanScene, Viewer

    planned = insertion.path
    labels = insertion.torso.labels
    scene = PlanScene(
        surfaces=tuple(labels.surfaces(large_structures(labels)).values()),
        layers=planned.layers,
        entry_m=planned.entry_m,
        target_m=planned.target_m,
        rotation=insertion.placement.rotation,
        translation_m=insertion.placement.translation_m,
        scan=crop_scan(insertion.torso.scan, planned.entry_m, planned.target_m),
    )
    viewer = Viewer(insertion.robot, scene, urdf_path=urdf_with_shapes(RobotOptions()))
    viewer.append(insertion.moments)
    try:
        return viewer.export(path)
    finally:
        viewer.stop()


def _rows_of(insertion: PlannedInsertion) -> dict[str, str]:
    """Return the text of every line of the table, by its label."""
    torso = insertion.torso
    voxels = " x ".join(map(str, torso.scan.grid.shape))
    spacing_mm = ", ".join(f"{M_TO_MM * one:g}" for one in torso.scan.grid.spacing_m)
    path = ", ".join(
        f"{layer.name} {M_TO_MM * (layer.exit_m - layer.entry_m):.0f} mm"
        for layer in insertion.path.layers
    )
    by_plan_mm, corrected_mm = (M_TO_MM * error_m for error_m in insertion.errors_m)
    ruptures = insertion.ruptures
    rows = {
        "CT": f"{torso.origin}: {voxels} voxels of {spacing_mm} mm",
        "planned path": f"{path}; target in the {torso.target}",
        "plan off by": f"{by_plan_mm:.1f} -> {corrected_mm:.1f} mm after "
        f"{len(ruptures)} ruptures (tip from target)",
        f"registration by {LANDMARKS} landmarks": _describe_registration(
            insertion, insertion.rough
        ),
        f"and {TOUCHES} touches of the skin": _describe_registration(
            insertion, insertion.fine
        ),
    }
    for number, (depth_m, plan) in enumerate(ruptures, 1):
        place = f"{M_TO_MM * depth_m:.1f} mm below the planned entry"
        into = f"into {plan.matched_name}" if plan.matched >= 0 else plan.matched_name
        rows[f"rupture {number} at {place}"] = (
            f"{into} ({100 * plan.matched_probability:.0f} %); all lies "
            f"{M_TO_MM * plan.offset_m:+.1f} ± {M_TO_MM * plan.offset_std_m:.1f} mm "
            "deeper"
        )
    rows["true shift along the needle"] = f"{M_TO_MM * insertion.shift_m:+.1f} mm"
    return rows


def _describe_registration(
    insertion: PlannedInsertion, registration: Registration
) -> str:
    """Return true and stated error of a registration at the target."""
    target_m = insertion.path.target_m
    true_m = insertion.placement.to_robot(target_m)
    error_mm = M_TO_MM * np.linalg.norm(registration.to_robot(target_m) - true_m)
    std_mm = M_TO_MM * registration.tre_m(target_m)
    return f"{error_mm:.1f} mm at the target, {std_mm:.1f} stated"
