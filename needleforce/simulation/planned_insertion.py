"""From a CT to a needle whose ruptures correct the plan, simulated.

    insertion = insert(None, seed=0)
    by_plan_m, corrected_m = insertion.errors_m

A segmented torso, registered to the robot by landmarks and touches; a plan to a target
in the liver; a simulated insertion through those tissues, which lie a few millimetres
deeper than the plan says; ruptures detected from joint torques, matched with the plan.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from groundtruth import Run, Scenario, simulate
from groundtruth.layers import Layer as TissueLayer
from groundtruth.materials import ABDOMEN
from groundtruth.motion import constant_motion
from needleforce import anatomy
from needleforce.anatomy import (
    Labels,
    Layer,
    PlanMatch,
    PlanState,
    Registration,
    Structure,
)
from needleforce.scene import Moment, is_kept
from needleforce.session import InsertionSession, SessionEstimate
from needleforce.simulation.patient import Pose
from needleforce.simulation.scanned_torso import (
    FRONT,
    ScannedTorso,
    StraightPath,
    inside_body,
    plan_path,
    read_torso,
)
from urdf import Robot

TOUCHES = 100
"""Touches of the skin by which the torso is registered."""

LANDMARKS = 5
"""Landmarks by which the torso is registered first."""

SPEED_m_s = 4e-3
"""Of the insertion."""

BEYOND_m = 12e-3
"""How far the needle could go beyond the target."""


class Registrations(NamedTuple):
    """What is known of where the patient lies.

    Attributes:
        rough: By landmarks.
        fine: By touches of the skin; the same as `rough` where they cannot register.
    """

    rough: Registration
    fine: Registration


class RuptureOfPlan(NamedTuple):
    """A rupture, and the plan after it.

    Attributes:
        depth_m: Depth below the planned entry.
        plan: What plan and ruptures say together.
    """

    depth_m: float
    plan: PlanState


class FollowedInsertion(NamedTuple):
    """A session over the signals of the insertion.

    Attributes:
        depth_m: Depth of the tip below the planned entry, shape (n,).
        force_N: Force of the virtual sensor, shape (n,).
        tip_N: Force at the tip, shape (n,).
        ruptures: The ruptures, but for those that were retracted.
        stop_m: Depth at which the corrected plan has the target.
        moments: What the scene shows.
        entry_in_base_m: Where the needle meets the planned entry, shape (3,).
        axis: Direction of the needle there, in base axes, shape (3,).
    """

    depth_m: Array
    force_N: Array
    tip_N: Array
    ruptures: list[RuptureOfPlan]
    stop_m: float
    moments: list[Moment]
    entry_in_base_m: Array
    axis: Array


class PlannedInsertion(NamedTuple):
    """An insertion from CT to target.

    Attributes:
        torso: CT and labels.
        path: The planned path, with its layers.
        registrations: What is known of where the patient lies.
        placement: Where he lies.
        shift_m: By so much everything lies deeper along the needle than planned.
        robot: The simulated robot.
        followed: The session over its signals.
    """

    torso: ScannedTorso
    path: StraightPath
    registrations: Registrations
    placement: Pose
    shift_m: float
    robot: Robot
    followed: FollowedInsertion

    @property
    def errors_m(self) -> tuple[float, float]:
        """How far from the target the tip stops: by the plan alone, and corrected.

        The shift lies along the needle; the error of the registration across it stays
        in both.
        """
        target_m = self.path.target_m
        axis = self.placement.rotation @ self.path.axis
        error_m = self.registrations.fine.to_robot(target_m) - self.placement.to_robot(
            target_m
        )
        across_m = float(np.linalg.norm(error_m - (error_m @ axis) * axis))
        true_depth_m = self.path.length_m + self.shift_m
        along_m = np.array([self.path.length_m, self.followed.stop_m]) - true_depth_m
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
    torso = read_torso(folder, rng)
    path = plan_path(torso.labels, torso.target, rng)
    placement = _draw_placement(rng)
    registrations = register(torso.labels, path.entry_m, placement, rng)
    axis = placement.rotation @ path.axis
    fine = registrations.fine
    target_in_base_m = placement.to_robot(path.target_m)
    error_m = float((target_in_base_m - fine.to_robot(path.target_m)) @ axis)
    shift_m = error_m + shift_std_m * float(rng.normal())
    progress(0.2)
    run = _simulate(path, seed, lambda fraction: progress(0.2 + 0.6 * fraction))
    std_m = float(np.hypot(fine.std_along_m(axis, path.target_m), shift_std_m))
    match = PlanMatch(path.layers, std_m)
    followed = _follow_plan(run, match, shift_m, path.length_m)
    return PlannedInsertion(
        torso, path, registrations, placement, shift_m, run.robot, followed
    )


def _draw_placement(rng: np.random.Generator) -> Pose:
    """Return a patient who lies on the back in front of the robot, drawn at random."""
    angle_deg = 90.0 + 5.0 * rng.normal()
    rotation = Rotation.from_euler("x", angle_deg, degrees=True).as_matrix()
    translation_m = np.array([0.6, 0.0, 0.3]) + 0.02 * rng.normal(size=3)
    return Pose(rotation, translation_m)


def register(
    labels: Labels, entry_m: Array, placement: Pose, rng: np.random.Generator
) -> Registrations:
    """Register by landmarks, then by touches of the skin with a pointer.

    Touches lie around the entry. Where they cannot register (a torso that could spin),
    the landmarks alone do.

    Args:
        labels: The segmentation.
        entry_m: Entry in the model, shape (3,).
        placement: Where the patient lies.
        rng: Draws landmarks, touches and their errors.
    """
    body = [inside_body(labels).astype(np.uint8)]
    structures = [Structure.named("skin", 1)]
    skin = Labels.of(body, labels.grid, structures).surfaces()["skin"]
    out_m = skin.vertices_m @ FRONT
    # What lies behind cannot be reached by landmark or touch.
    front_m = skin.vertices_m[out_m > np.quantile(out_m, 0.4)]
    rough = _register_landmarks(front_m, placement, rng)
    touched_m = placement.to_robot(_touch(front_m, entry_m, rng))
    try:
        return Registrations(rough, anatomy.fit_surface(skin, touched_m, rough))
    except anatomy.RegistrationError:
        return Registrations(rough, rough)


def _register_landmarks(
    front_m: Array, placement: Pose, rng: np.random.Generator
) -> anatomy.Registration:
    """Register by landmarks far from each other.

    On a symmetric torso they may lie symmetrically, and be refused: then others are
    touched, one more than before.

    Args:
        front_m: Points of the skin that can be touched, (n, 3).
        placement: Where the patient lies.
        rng: Draws landmarks and their errors.
    """
    most = LANDMARKS + 2
    count = LANDMARKS
    while True:
        landmarks_m = front_m[_spread_indices(front_m, count, rng)]
        noise_m = 1e-3 * rng.normal(size=landmarks_m.shape)
        try:
            return anatomy.fit_landmarks(
                landmarks_m,
                placement.to_robot(landmarks_m) + noise_m,
                std_m=1.5e-3,  # more than they have: who knows his own errors
                is_std_known=True,
            )
        except anatomy.RegistrationError:
            count += 1
            if count > most:
                raise


def _touch(front_m: Array, entry_m: Array, rng: np.random.Generator) -> Array:
    """Return touched places around the entry, some of which slipped, shape (n, 3)."""
    near_m = front_m[np.linalg.norm(front_m - entry_m, axis=1) < 0.25]
    touched_m = near_m[rng.choice(len(near_m), TOUCHES)]
    touched_m = touched_m + 0.5e-3 * rng.normal(size=(TOUCHES, 3))
    has_slipped = rng.random(TOUCHES) < 0.1
    slips_m = rng.uniform(5e-3, 20e-3, (int(has_slipped.sum()), 1))
    touched_m[has_slipped] += slips_m * FRONT
    return touched_m


def _spread_indices(points_m: Array, count: int, rng: np.random.Generator) -> list[int]:
    """Return indices of points far from each other."""
    chosen = [int(rng.integers(len(points_m)))]
    distances_m = np.full(len(points_m), np.inf)
    for _ in range(count - 1):
        to_latest_m = np.linalg.norm(points_m - points_m[chosen[-1]], axis=1)
        distances_m = np.minimum(distances_m, to_latest_m)
        chosen.append(int(np.argmax(distances_m)))
    return chosen


def _tissue(layers: list[Layer]) -> tuple[TissueLayer, ...]:
    """Return layers of the simulation as thick as those of the plan.

    The last one is thicker, so that the needle can go beyond the target.
    """
    fat, muscle, liver = ABDOMEN
    kinds = {"liver": liver, "fat": fat, "cavity": fat}
    thickness_m = np.array([layer.exit_m - layer.entry_m for layer in layers])
    thickness_m[-1] += 2.0 * BEYOND_m
    return tuple(
        replace(kinds.get(layer.name, muscle), name=layer.name, thickness_m=each_m)
        for layer, each_m in zip(layers, thickness_m.tolist(), strict=True)
    )


def _simulate(path: StraightPath, seed: int, progress: Callable[[float], None]) -> Run:
    """Simulate an insertion through the layers of a plan, and beyond its end."""
    motion = constant_motion(
        speed_m_s=SPEED_m_s, depth_m=path.length_m + BEYOND_m, standoff_m=15e-3
    )
    scenario = Scenario(
        id="abdomen",
        title="the plan's tissues",
        layers=_tissue(path.layers),
        motion=motion,
    )
    return simulate(scenario, "clean", seed, progress)


def _follow_plan(
    run: Run, match: PlanMatch, shift_m: float, length_m: float
) -> FollowedInsertion:
    """Run a session over the signals of a run, its ruptures matched with the plan.

    It ends where the corrected plan has the target: there the needle would stop.

    Args:
        run: The insertion.
        match: The plan.
        shift_m: By so much everything lies deeper than planned.
        length_m: Length of the planned path.
    """
    signals = run.signals
    session = InsertionSession(run.robot)
    ruptures: list[RuptureOfPlan] = []
    moments: list[Moment] = []
    latest_s = -np.inf
    entry_m = depth_m = 0.0
    entry_in_base_m = axis = np.zeros(3)
    steps_s = np.diff(signals.t_s, prepend=signals.t_s[0])
    for number, step_s in enumerate(steps_s):
        q_rad = signals.q_rad[number]
        dq_rad_s = None if signals.dq_rad_s is None else signals.dq_rad_s[number]
        estimate = session.update(q_rad, dq_rad_s, signals.tau_Nm[number], step_s)
        if not session.tared and signals.t_s[number] > run.tare_end_s:
            session.tare()
            # The robot knows where its tip is, and where the planned entry; the tissue
            # lies deeper by what nobody knows.
            zero = session.snapshot().zero
            entry_m = -float(run.truth.depth_m[number]) - shift_m
            axis = zero.axis_in_base
            entry_in_base_m = zero.start_in_base_m + entry_m * axis
            session.follow(match, entry_in_base_m)
            continue
        if estimate.plan is None:
            continue
        if signals.t_s[number] > run.scenario.motion.insertion_end_s:
            break
        ruptures = _updated_ruptures(ruptures, estimate, entry_m)
        if is_kept(estimate, latest_s):
            latest_s = estimate.time_s
            moments.append(Moment(q_rad, estimate))
        depth_m = estimate.depth_m - entry_m
        if depth_m >= length_m + estimate.plan.offset_m:
            break
    estimates = [moment.estimate for moment in moments]
    found = [estimate.identification for estimate in estimates]
    return FollowedInsertion(
        depth_m=np.array([estimate.depth_m for estimate in estimates]) - entry_m,
        force_N=np.array([estimate.wrench.axial for estimate in estimates]),
        tip_N=np.array([one.tip_force_N for one in found]),
        ruptures=ruptures,
        stop_m=depth_m,
        moments=moments,
        entry_in_base_m=entry_in_base_m,
        axis=axis,
    )


def _updated_ruptures(
    ruptures: list[RuptureOfPlan], estimate: SessionEstimate, entry_m: float
) -> list[RuptureOfPlan]:
    """Return ruptures with the one of a sample, without the one that it retracts."""
    found = estimate.identification
    if found.retracted is not None:
        wrong_m = found.retracted.depth_m - entry_m
        ruptures = [one for one in ruptures if one.depth_m != wrong_m]
    if found.rupture is not None and estimate.plan is not None:
        depth_m = found.rupture.depth_m - entry_m
        ruptures = [*ruptures, RuptureOfPlan(depth_m, estimate.plan)]
    return ruptures
