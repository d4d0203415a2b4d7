"""`needleforce demo abdomen`: from a CT to a needle whose ruptures correct the plan.

A segmented torso, registered to the robot by landmarks and touches; a plan to a target in the
liver; a simulated insertion through those tissues, which lie a few millimetres deeper than the plan
says; ruptures found from joint torques, matched with the plan. Simulation only.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from groundtruth import Run, Scenario, simulate
from groundtruth.layers import Layer as TissueLayer
from groundtruth.materials import ABDOMEN
from groundtruth.motion import constant_motion
from groundtruth.torso import analytic_torso
from needleforce.anatomy import (
    Grid,
    Labels,
    Layer,
    PlanMatch,
    PlanState,
    Registration,
    Structure,
    Surface,
    TouchSurface,
    fit_landmarks,
    fit_surface,
    read_labels,
    read_volume,
)
from needleforce.cli.terminal import CommandError, progress_bar, write_out
from needleforce.plots import palette
from needleforce.plots.chart import Chart, Curve, Instants, Panel, require_matplotlib
from needleforce.plots.page import (
    PAGE,
    Page,
    PageFigure,
    PageTable,
    Section,
    save_page_figure,
    write_page,
)
from needleforce.session import InsertionSession

NEVER = "Simulation only: not a medical device."
Array = NDArray[np.float64]
Progress = Callable[[float], None]

VOXEL_m = 2e-3
"""Of the analytic torso's scan."""
SHIFT_STD_m = 3e-3
"""How far the organs lie from where the CT saw them, along the needle: breathing, deformation."""
TOUCHES, TOUCH_STD_m = 100, 0.5e-3
LANDMARKS = 5
SPEED_m_s, STANDOFF_m, BEYOND_m = 4e-3, 15e-3, 12e-3
FRONT = np.array([0.0, -1.0, 0.0])
STEEPEST_deg = 35.0
LENGTHS_m = (0.05, 0.1)
LEAST_LAYER_m = 6.5e-3
"""Thinner layers are no tissue of the simulation's: they join the one before."""


class Insertion(NamedTuple):
    """What the demonstration has done."""

    labels: Labels
    entry_m: Array  # of the plan, in the model
    target_m: Array
    plan: list[Layer]
    rough: Registration  # by landmarks
    fine: Registration  # by touches
    truth: tuple[Array, Array]  # true rotation and shift from the model to the robot
    shift_m: float  # by which everything lies deeper along the needle than planned
    depth_m: Array  # of the tip below the planned entry, per row
    force_N: Array
    tip_N: Array
    states: list[tuple[float, PlanState]]  # after each rupture: its depth, what is known
    stop_m: float  # depth at which the plan, corrected, has the target

    @property
    def length_m(self) -> float:
        """From entry to target, as planned."""
        return float(np.linalg.norm(self.target_m - self.entry_m))

    @property
    def errors_m(self) -> tuple[float, float]:
        """How far from the target the tip stops along the needle: by the plan alone, corrected."""
        true = self.length_m + self.shift_m
        return abs(self.length_m - true), abs(self.stop_m - true)


def read_torso(folder: Path | None, rng: np.random.Generator) -> Labels:
    """A CT with labels from a folder, or a built-in analytic torso."""
    if folder is None:
        torso = analytic_torso(rng)
        skin = torso["fat"]
        half = np.ceil(skin.reach_m / VOXEL_m).astype(int) + 4
        grid = Grid(
            tuple((2 * half + 1).tolist()), skin.centre_m - VOXEL_m * half, VOXEL_m * np.eye(3)
        )
        structures = [Structure.named(body.name, n) for n, body in enumerate(torso.shapes, 1)]
        numbers = torso.voxels(grid.shape, grid.origin_m, grid.axes_m)
        return Labels.of([numbers], grid, structures)
    files = [*sorted(folder.glob("labels*.n*")), *sorted(folder.glob("*.seg.nrrd"))]
    scans = sorted(folder.glob("ct.n*"))
    if not files or not scans:
        raise CommandError(f"{folder}: expected ct.nii.gz (or .nrrd) and labels.nii.gz beside it")
    return read_labels(files[0]).with_body(read_volume(scans[0]))


def inside_body(labels: Labels) -> NDArray[np.bool_]:
    """Which voxels any structure covers."""
    return np.any([volume != 0 for volume in labels.volumes], axis=0)


def plan_path(labels: Labels, organ: str, rng: np.random.Generator) -> tuple[Array, Array]:
    """Entry on the skin and a target inside an organ: the way through the most tissues.

    Of straight ways without obstacles and of `LENGTHS_m`; of as many tissues the shortest.

    Raises:
        CommandError: There is none from the front.
    """
    organ_mask, corner = labels.mask(organ), [part.start for part in labels[organ].box]
    core = ndimage.binary_erosion(organ_mask, iterations=3)
    places = labels.grid.points_m(np.argwhere(core if core.any() else organ_mask) + corner)
    body = inside_body(labels)
    best: tuple[tuple[int, float], Array, Array] | None = None
    for _ in range(200):
        target = places[rng.integers(len(places))]
        turn = np.radians(STEEPEST_deg) * rng.uniform(-1.0, 1.0, 2)
        axis = Rotation.from_euler("xz", turn).apply(FRONT)
        found = _skin_along(labels.grid, body, target, axis)
        if found is None or not LENGTHS_m[0] < found < LENGTHS_m[1]:
            continue
        entry = target + found * axis
        crossed = labels.layers_along(entry, target)
        layers = thick_layers(crossed)
        rank = -len(layers), found
        ends_inside = len(layers) > 1 and layers[-1].name == organ
        if ends_inside and not any(layer.is_obstacle for layer in crossed):
            best = (rank, entry, target) if best is None or rank < best[0] else best
    if best is None:
        raise CommandError(f"no straight way from the front into {organ!r} without bone")
    return best[1], best[2]


def _skin_along(grid: Grid, body: NDArray[np.bool_], start: Array, axis: Array) -> float | None:
    """Distance at which a ray from inside leaves the body; None where the volume ends first."""
    step = 0.5 * float(grid.spacing_m.min())
    distance = step * np.arange(1, int(0.3 / step))
    index = np.rint(grid.indices(start + distance[:, None] * axis)).astype(int)
    valid: Any = ((index >= 0) & (index < grid.shape)).all(axis=1)
    is_body = valid & body[tuple(np.where(valid[:, None], index, 0).T)]
    outside = np.flatnonzero(~is_body)
    return float(distance[outside[0]]) if len(outside) and valid[outside[0]] else None


def register(
    labels: Labels, entry_m: Array, truth: tuple[Array, Array], rng: np.random.Generator
) -> tuple[Registration, Registration]:
    """Register by landmarks and by touches of the skin around the entry, with a pointer."""
    skin = _skin(labels)
    front = skin.vertices_m[skin.vertices_m @ FRONT > np.quantile(skin.vertices_m @ FRONT, 0.4)]
    marks = front[_spread(front, LANDMARKS, rng)]
    robot = marks @ truth[0].T + truth[1] + 1e-3 * rng.normal(size=marks.shape)
    rough = fit_landmarks(marks, robot, std_m=1.5e-3, is_std_known=True)
    near = front[np.linalg.norm(front - entry_m, axis=1) < 0.25]
    touched = near[rng.choice(len(near), TOUCHES)] + TOUCH_STD_m * rng.normal(size=(TOUCHES, 3))
    slipped = rng.random(TOUCHES) < 0.1
    touched[slipped] += rng.uniform(5e-3, 20e-3, (int(slipped.sum()), 1)) * FRONT
    surface = TouchSurface(skin.vertices_m, skin.triangles)
    return rough, fit_surface(surface, touched @ truth[0].T + truth[1], rough)


def _skin(labels: Labels) -> Surface:
    volume = inside_body(labels).astype(np.uint8)
    return Labels.of([volume], labels.grid, [Structure.named("skin", 1)]).surfaces()["skin"]


def _spread(points: Array, count: int, rng: np.random.Generator) -> list[int]:
    """Indices of points far from each other."""
    chosen = [int(rng.integers(len(points)))]
    far = np.full(len(points), np.inf)
    for _ in range(count - 1):
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(far)))
    return chosen


def thick_layers(layers: list[Layer]) -> list[Layer]:
    """The same without layers thinner than `LEAST_LAYER_m`, and without gaps."""
    found: list[Layer] = []
    for layer in layers:
        is_thin = layer.exit_m - layer.entry_m < LEAST_LAYER_m
        if found and (is_thin or layer.name == found[-1].name):
            found[-1] = replace(found[-1], exit_m=layer.exit_m, exit_std_m=layer.exit_std_m)
        elif not is_thin:
            start = {"entry_m": 0.0, "entry_std_m": 0.0} if not found else {}
            found.append(replace(layer, **start))
    return found


def tissue(plan: list[Layer]) -> tuple[TissueLayer, ...]:
    """Layers of the simulation as thick as those of the plan, and one behind the target."""
    kinds = {layer.name: layer for layer in ABDOMEN}
    layers = [
        replace(
            kinds.get(layer.name, kinds["fat"]),
            name=layer.name,
            thickness_m=layer.exit_m - layer.entry_m,
        )
        for layer in plan
    ]
    return (*layers[:-1], replace(layers[-1], thickness_m=layers[-1].thickness_m + 2.0 * BEYOND_m))


def insert(folder: Path | None, seed: int, progress: Progress = lambda fraction: None) -> Insertion:
    """Plan, register, insert, and let ruptures correct the plan."""
    rng = np.random.default_rng(seed)
    labels = read_torso(folder, rng)
    entry, target = plan_path(labels, "liver", rng)
    plan = thick_layers(labels.layers_along(entry, target))
    truth = (
        Rotation.from_euler("x", 90.0 + 5.0 * rng.normal(), degrees=True).as_matrix(),
        (np.array([0.6, 0.0, 0.3]) + 0.02 * rng.normal(size=3)),
    )
    rough, fine = register(labels, entry, truth, rng)
    axis = truth[0] @ ((target - entry) / np.linalg.norm(target - entry))
    wrong = float((truth[0] @ target + truth[1] - fine.to_robot(target)) @ axis)
    shift = wrong + SHIFT_STD_m * float(rng.normal())
    progress(0.2)
    layers = tissue(plan)
    length = float(np.linalg.norm(target - entry))
    motion = constant_motion(speed_m_s=SPEED_m_s, depth_m=length + BEYOND_m, standoff_m=STANDOFF_m)
    scenario = Scenario(id="abdomen", title="the plan's tissues", layers=layers, motion=motion)
    run = simulate(scenario, "clean", seed, lambda part: progress(0.2 + 0.6 * part))
    std = float(np.hypot(fine.std_along_m(axis, target), SHIFT_STD_m))
    none = np.empty(0)
    made = Insertion(
        *(labels, entry, target, plan, rough, fine, truth, shift), none, none, none, [], 0.0
    )
    return _followed(run, made, std)


def _followed(run: Run, made: Insertion, offset_std_m: float) -> Insertion:
    """The session over the run's signals, its ruptures matched with the plan."""
    signals, true = run.signals, run.truth
    session, match = InsertionSession(run.robot), PlanMatch(made.plan, offset_std_m)
    velocity = signals.dq_rad_s if signals.dq_rad_s is not None else [None] * len(signals.t_s)
    rows, states, entry_m, last_s, stop = [], [], 0.0, signals.t_s[0], None
    for k, (t_s, q, dq, tau) in enumerate(
        zip(signals.t_s, signals.q_rad, velocity, signals.tau_Nm, strict=True)
    ):
        now = session.update(q, dq, tau, t_s - last_s)
        last_s = t_s
        if not session.tared and t_s > run.tare_end_s:
            session.tare()
            # The robot knows where its tip is, and where the planned entry; the tissue lies deeper
            # by what nobody knows.
            entry_m = -float(true.depth_m[k]) - made.shift_m
            start_m, axis = session.snapshot().zero
            session.follow(match, start_m + entry_m * axis)
            continue
        if now.plan is None or t_s > run.scenario.motion.insertion_end_s:
            continue
        depth, found = now.depth_m - entry_m, now.identification
        if k % 20 == 0:
            rows.append((depth, now.wrench.axial, found.tip_force_N))
        if found.rupture is not None:
            states.append((found.rupture.depth_m - entry_m, now.plan))
        if found.retracted is not None:
            wrong_m = found.retracted.depth_m - entry_m
            states = [one for one in states if one[0] != wrong_m]
        if stop is None and depth >= made.length_m + now.plan.offset_m:
            stop = depth
    depth, force, tip = np.array(rows).T
    return made._replace(
        depth_m=depth,
        force_N=force,
        tip_N=tip,
        states=states,
        stop_m=depth[-1] if stop is None else stop,
    )


# What is shown.


def run(folder: Path | None, picture: Path | None, data: Path | None, seed: int) -> int:
    """Do it, print a table, and write a page or its first picture; return the exit code."""
    if folder is not None or picture is not None:
        require_matplotlib("demo")
    with progress_bar("demonstrating abdomen") as progress:
        made = insert(data, seed, progress)
    rows = _rows(made)
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:<{width}}  {value}" for name, value in rows]
    title = "From a CT to a needle whose ruptures correct the plan"
    write_out("\n".join((title, *lines, NEVER, "")))
    if picture is not None:
        draw_slice(made, picture)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        figures = [
            PageFigure(path=draw_slice(made, folder / "slice.png"), alt=SLICE, caption=SLICE)
        ]
        for name, chart, caption in _charts(made):
            place = folder / f"{name}.svg"
            figures.append(save_page_figure(chart, place, alt=caption, caption=caption))
        table = PageTable(caption="Result", head=("what", "value"), rows=rows)
        section = Section(heading=title, anchor="abdomen", figures=tuple(figures), tables=(table,))
        page = Page(title="needleforce demo abdomen", lead=(NEVER,), sections=(section,))
        write_out(f"{write_page(folder / PAGE, page)}\n")
    return 0


LEAST_NAMED = 800
"""Pixels from which on a structure's name is written."""
SLICE = (
    "The plane of the needle through the segmentation, as planned: entry and target, planned "
    "boundaries (white), detected ruptures (yellow), and where the tip stopped (red), each moved "
    "back by the true shift."
)


def _rows(made: Insertion) -> tuple[tuple[str, str], ...]:
    by_plan, corrected = (f"{1e3 * error:.1f} mm" for error in made.errors_m)
    true = made.truth[0] @ made.target_m + made.truth[1]
    errors = [
        1e3 * np.linalg.norm(r.to_robot(made.target_m) - true) for r in (made.rough, made.fine)
    ]
    stated = [1e3 * r.tre_m(made.target_m) for r in (made.rough, made.fine)]
    path = ", ".join(f"{p.name} {1e3 * (p.exit_m - p.entry_m):.0f} mm" for p in made.plan)
    rows = [
        ("planned path", path),
        (
            f"registration by {LANDMARKS} landmarks",
            f"{errors[0]:.1f} mm at the target, {stated[0]:.1f} stated",
        ),
        (
            f"and {TOUCHES} touches of the skin",
            f"{errors[1]:.1f} mm at the target, {stated[1]:.1f} stated",
        ),
    ]
    for k, (depth, state) in enumerate(made.states, 1):
        where = f"into {state.matched_name}" if state.matched >= 0 else state.matched_name
        rows.append(
            (
                f"rupture {k} at {1e3 * depth:.1f} mm",
                f"{where} ({100 * state.matched_probability:.0f} %); all lies "
                f"{1e3 * state.offset_m:+.1f} ± {1e3 * state.offset_std_m:.1f} mm deeper",
            )
        )
    rows += [
        ("true shift along the needle", f"{1e3 * made.shift_m:+.1f} mm"),
        ("tip from the target, by the plan alone", by_plan),
        ("tip from the target, corrected by force", corrected),
    ]
    return tuple(rows)


def _charts(made: Insertion) -> tuple[tuple[str, Chart, str], ...]:
    x = 1e3 * made.depth_m
    planned = tuple(1e3 * layer.exit_m for layer in made.plan[:-1])
    found = tuple(1e3 * depth for depth, _ in made.states)
    marks = (
        Instants(label="planned boundary", style=palette.COMPENSATION, places=planned),
        Instants(label="detected rupture", style=palette.RUPTURE, places=found),
    )
    forces = (
        Curve(style=palette.READING, x=x, y=made.force_N, label="force, virtual sensor"),
        Curve(style=palette.TIP, x=x, y=made.tip_N, label="tip force"),
    )
    chart = Chart(
        title="Force and tip force over depth\nboundaries as planned, ruptures as detected",
        x_label="depth below the planned entry [mm]",
        panels=(Panel(y_label=palette.FORCE, curves=forces),),
        instants=marks,
    )
    return (
        ("force", chart, "Force over depth: where the plan expected boundaries, where they were."),
    )


def draw_slice(made: Insertion, path: Path) -> Path:
    """Draw the plane of the needle into a file."""
    import matplotlib.pyplot as plt

    axis = (made.target_m - made.entry_m) / made.length_m
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    along, across = np.arange(-0.03, made.length_m + 0.06, 5e-4), np.arange(-0.09, 0.09, 5e-4)
    places = made.entry_m + along[:, None, None] * axis + across[None, :, None] * side
    index = np.rint(made.labels.grid.indices(places)).astype(int)
    valid: Any = ((index >= 0) & (index < made.labels.grid.shape)).all(axis=-1)
    at = tuple(np.moveaxis(np.where(valid[..., None], index, 0), -1, 0))
    colors = np.zeros((*valid.shape, 3))
    figure, plane = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
    for structure in sorted(made.labels.structures, key=lambda item: -item.voxels):
        inside = valid & (made.labels.volumes[structure.volume][at] == structure.value)
        colors[inside] = structure.colour
        if np.count_nonzero(inside) > LEAST_NAMED:
            rows, columns = np.nonzero(inside)
            row, column = 1e3 * np.median(along[rows]), 1e3 * np.median(across[columns])
            plane.text(column, row, structure.name, color="white", ha="center", fontsize=8)
    extent = (1e3 * across[0], 1e3 * across[-1], 1e3 * along[-1], 1e3 * along[0])
    plane.imshow(colors, extent=extent, aspect="equal")
    tip = made.stop_m - made.shift_m
    plane.plot([0.0, 0.0], [-30.0, 1e3 * tip], color="0.9", linewidth=2.0)
    plane.plot(0.0, 1e3 * made.length_m, "o", mfc="none", mec="white", ms=11, label="target")
    plane.plot(0.0, 1e3 * tip, "x", color="red", ms=8, mew=2, label="tip")
    for layer in made.plan[:-1]:
        plane.plot([-8.0, 8.0], [1e3 * layer.exit_m] * 2, color="white", linewidth=1.0)
    for depth, _ in made.states:
        plane.plot([-5.0, 5.0], [1e3 * (depth - made.shift_m)] * 2, color="yellow", linewidth=2.0)
    plane.set(
        xlabel="across the needle [mm]", ylabel="along the needle [mm]", title="Plan and insertion"
    )
    plane.legend(loc="lower right", fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path
