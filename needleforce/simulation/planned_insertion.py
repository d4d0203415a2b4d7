"""From a CT to a needle whose ruptures correct the plan, simulated.

    insertion = insert(None, seed=0)
    by_plan_m, corrected_m = insertion.errors_m

A segmented torso, registered to the robot by landmarks and touches; a plan to a target
in the liver; a simulated insertion through those tissues, which lie a few millimetres
deeper than the plan says; ruptures detected from joint torques, matched with the plan.
"""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from scipy.spatial import distance_matrix

from groundtruth import Run
from needleforce.anatomy import (
    Labels,
    PlanMatch,
    PlanState,
    Registration,
    Volume,
    VolumeError,
    fit_landmarks,
    fit_surface,
    read_labels,
    read_volume,
)
from needleforce.anatomy.path_search import SkinPath, find_paths
from needleforce.needle_on_plan import PlannedPath
from needleforce.scene import Moment, is_kept
from needleforce.session import InsertionSession
from needleforce.simulation.patient import (
    MIN_LAYER_m,
    PlannedLine,
    Pose,
    arm_path,
    draw_skin_points,
    insert_into_patient,
    lay_patient,
)
from needleforce.simulation.torso_case import write_torso_case
from urdf import NeedleTool, Robot, load_lwr

LANDMARKS = 7
"""Landmarks by which the torso is registered first."""

ORGAN = "liver"
"""Structure in which the target lies where there is no lesion."""


class ScannedTorso(NamedTuple):
    """CT and labels of the demonstration.

    Attributes:
        scan: The CT.
        labels: The segmentation.
        origin: Where they come from, in words.
        target: Name of the structure in which the target lies.
    """

    scan: Volume
    labels: Labels
    origin: str
    target: str


class RuptureOfPlan(NamedTuple):
    """A rupture, and the plan after it.

    Attributes:
        depth_m: Depth below the planned entry.
        plan: What plan and ruptures say together.
    """

    depth_m: float
    plan: PlanState


class PlannedInsertion(NamedTuple):
    """An insertion from CT to target.

    Attributes:
        torso: CT and labels.
        path: The planned path, with its layers.
        rough: Registration by landmarks.
        fine: Registration by touches of the skin.
        placement: Where the patient lies.
        shift_m: By so much everything lies deeper along the needle than planned.
        robot: The simulated robot.
        ruptures: The ruptures, but for those that were retracted.
        stop_m: Depth at which the corrected plan has the target.
        moments: What the scene shows.
    """

    torso: ScannedTorso
    path: SkinPath
    rough: Registration
    fine: Registration
    placement: Pose
    shift_m: float
    robot: Robot
    ruptures: list[RuptureOfPlan]
    stop_m: float
    moments: list[Moment]

    @property
    def errors_m(self) -> tuple[float, float]:
        """How far from the target the tip stops: by the plan alone, and corrected.

        The shift lies along the needle; the error of the registration across it stays
        in both.
        """
        target_m = self.path.target_m
        way_m = self.placement.to_robot(target_m) - self.placement.to_robot(
            self.path.entry_m
        )
        axis = way_m / self.path.length_m
        error_m = self.fine.to_robot(target_m) - self.placement.to_robot(target_m)
        across_m = float(np.linalg.norm(error_m - (error_m @ axis) * axis))
        true_depth_m = self.path.length_m + self.shift_m
        along_m = np.array([self.path.length_m, self.stop_m]) - true_depth_m
        by_plan_m, corrected_m = np.hypot(along_m, across_m).tolist()
        return by_plan_m, corrected_m


def insert(
    folder: Path | None,
    seed: int,
    progress: Callable[[float], None] = lambda fraction: None,
) -> PlannedInsertion:
    """Plan, register, insert, and let ruptures correct the plan.

    Args:
        folder: Folder with CT and labels; None for an analytic torso.
        seed: Seed of everything that is drawn at random.
        progress: Takes the fraction of the work that is done.

    Raises:
        needleforce.anatomy.AnatomyError: CT or labels cannot be read, or no straight
            path leads to the target.
    """
    # How far organs lie from where the CT saw them, along the needle
    shift_std_m = 3e-3
    rng = np.random.default_rng(seed)
    torso = read_torso(folder, seed)
    labels = torso.labels
    risks = [
        item.name
        for item in labels.structures
        if (item.is_obstacle or item.is_risk) and item.name != torso.target
    ]
    target_m = labels.deepest_point_m(torso.target)
    path = find_paths(labels, target_m, risks)[0]
    progress(0.2)
    line = PlannedLine(path.entry_m, path.target_m)
    tissue_shift_m = shift_std_m * float(rng.normal())
    robot = load_lwr(payload=NeedleTool())
    placement = lay_patient(arm_path(robot, line), line, tissue_shift_m)
    rough, fine = register(labels, line, placement, rng)
    # A lesion has no capsule, as the liver has: it is simulated as other tissue.
    kinds: dict[str, str] = {} if torso.target == ORGAN else {torso.target: "muscle"}
    plan = {
        "entry_m": path.entry_m,
        "target_m": path.target_m,
        "layers": [
            {"name": kinds.get(one.name, one.name), "exit_m": one.exit_m}
            for one in path.layers
        ],
    }
    run = insert_into_patient(plan, seed, lambda done: progress(0.2 + 0.6 * done))
    planned = PlannedPath.of_registration(fine, path.entry_m, path.target_m)
    std_m = np.hypot(fine.std_along_m(planned.axis, path.target_m), shift_std_m)
    error_m = placement.to_robot(path.target_m) - planned.target_m
    session = InsertionSession(run.robot)
    # Thinner ones join the layer before in the simulation.
    layers = [one for one in path.layers if one.exit_m - one.entry_m >= MIN_LAYER_m]
    session.follow(PlanMatch(layers, float(std_m)), path=planned)
    moments: list[Moment] = []
    ruptures = _insert_to_target(run, session, path.length_m, moments)
    return PlannedInsertion(
        torso=torso,
        path=path,
        rough=rough,
        fine=fine,
        placement=placement,
        shift_m=tissue_shift_m + float(error_m @ planned.axis),
        robot=robot,
        ruptures=ruptures,
        stop_m=moments[-1].estimate.depth_in_tissue_m or 0.0,
        moments=moments,
    )


def read_torso(folder: Path | None, seed: int) -> ScannedTorso:
    """Return a CT with labels from a folder, or of an analytic torso.

    Args:
        folder: Holds them, or a folder that does; None for the analytic torso.
        seed: Of the noise in the analytic torso's CT.

    Raises:
        VolumeError: The folder has no CT, or no labels beside it.
    """
    if folder is None:
        with TemporaryDirectory() as made:
            write_torso_case(Path(made), seed)
            return read_torso(Path(made), seed)._replace(origin="analytic torso")
    scans = [*sorted(folder.glob("ct.n*")), *sorted(folder.glob("*/ct.n*"))]
    beside = scans[0].parent if scans else folder
    files = [*sorted(beside.glob("labels*.n*")), *sorted(beside.glob("*.seg.nrrd"))]
    if not files or not scans:
        raise VolumeError(
            f"{folder}: expected ct.nii.gz (or .nrrd) and labels.nii.gz beside it, "
            "there or one folder down"
        )
    names = beside / "labels.json"
    scan = read_volume(scans[0])
    labels = read_labels(files[0], names if names.exists() else None)
    targets = [
        item.name
        for item in labels.structures
        if any(word in item.name.lower() for word in ("lesion", "tumor", "tumour"))
    ]
    labels = labels.with_body(scan, fat=True).with_dense(scan)
    origin = f"{scans[0].name} of {folder}"
    return ScannedTorso(scan, labels, origin, next(iter(targets), ORGAN))


def register(
    labels: Labels, line: PlannedLine, placement: Pose, rng: np.random.Generator
) -> tuple[Registration, Registration]:
    """Register by landmarks far from each other, then by touches about the entry.

    Args:
        labels: The segmentation.
        line: The planned path.
        placement: Where the patient lies.
        rng: Draws landmarks, touches and their errors.
    """
    skin = labels.skin()
    out_m = skin.vertices_m @ -line.axis
    # What lies behind cannot be reached by a landmark.
    front_m = skin.vertices_m[out_m > np.quantile(out_m, 0.4)]
    chosen = [int(rng.integers(len(front_m)))]
    for _ in range(LANDMARKS - 1):
        distances_m = distance_matrix(front_m, front_m[chosen]).min(axis=1)
        chosen.append(int(np.argmax(distances_m)))
    landmarks_m = front_m[chosen]
    touched_m = draw_skin_points(labels, line, rng)
    landmark_errors_m = 1e-3 * rng.normal(size=landmarks_m.shape)
    touch_errors_m = 0.5e-3 * rng.normal(size=touched_m.shape)
    rough = fit_landmarks(
        landmarks_m,
        placement.to_robot(landmarks_m) + landmark_errors_m,
        std_m=1.5e-3,  # more than they have: who knows his own errors
        is_std_known=True,
    )
    touches_m = placement.to_robot(touched_m) + touch_errors_m
    return rough, fit_surface(skin, touches_m, rough)


def _insert_to_target(
    run: Run, session: InsertionSession, length_m: float, moments: list[Moment]
) -> list[RuptureOfPlan]:
    """Run a session until the corrected plan has the target; return its ruptures.

    Args:
        run: The insertion.
        session: Follows the plan.
        length_m: Length of the planned path.
        moments: Takes what the scene shows; the last one is where the needle stops.
    """
    signals = run.signals
    ruptures: dict[float, RuptureOfPlan] = {}
    latest_s = -np.inf
    steps_s = np.diff(signals.t_s, prepend=signals.t_s[0]).tolist()
    for number, step_s in enumerate(steps_s):
        q_rad = signals.q_rad[number]
        dq_rad_s = None if signals.dq_rad_s is None else signals.dq_rad_s[number]
        if not session.tared and signals.t_s[number] > run.tare_end_s:
            session.tare()
        estimate = session.update(q_rad, dq_rad_s, signals.tau_Nm[number], step_s)
        if estimate.plan is None or estimate.deviation is None:
            continue
        found = estimate.identification
        depth_m = estimate.deviation.depth_m
        if found.retracted is not None:
            ruptures.pop(found.retracted.alarm_s, None)
        if found.rupture is not None:
            rupture_m = found.rupture.depth_m - estimate.depth_m + depth_m
            ruptures[found.rupture.alarm_s] = RuptureOfPlan(rupture_m, estimate.plan)
        is_over = signals.t_s[number] > run.scenario.motion.insertion_end_s
        has_arrived = depth_m >= length_m + estimate.plan.offset_m
        if is_over or has_arrived or is_kept(estimate, latest_s):
            latest_s = estimate.time_s
            moments.append(Moment(q_rad, estimate))
        if is_over or has_arrived:
            break
    return list(ruptures.values())
