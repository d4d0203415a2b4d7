"""From a CT to a needle whose ruptures correct the plan: `needleforce demo abdomen`.

A segmented torso, registered to the robot by landmarks and touches; a plan to a target
in the liver; a simulated insertion through those tissues, which lie a few millimetres
deeper than the plan says; ruptures detected from joint torques, matched with the plan.
Simulation only.
"""

from collections.abc import Iterator
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
    Surface,
)
from needleforce.cli.demos.abdomen_plan import (
    FRONT,
    ScannedTorso,
    StraightPath,
    inside_body,
    plan_path,
    read_torso,
    thick_layers,
)
from needleforce.cli.terminal import Progress
from needleforce.scene.state_ring import FIELDS, view_row
from needleforce.session import InsertionSession, SessionEstimate
from urdf import Robot

SHIFT_STD_m = 3e-3
"""How far organs lie from where the CT saw them, along the needle [m]."""

TOUCHES = 100
"""Touches of the skin by which the torso is registered."""

TOUCH_STD_m = 0.5e-3
"""Error of the touched places [m]."""

TOUCH_RADIUS_m = 0.25
"""Touches lie within this distance of the entry [m]."""

SLIP_PROBABILITY = 0.1
"""Probability that a touch slips."""

SLIP_m = (5e-3, 20e-3)
"""Least and largest distance of a slip from the skin [m]."""

LANDMARKS = 5
"""Landmarks by which the torso is registered first."""

LANDMARK_STD_m = 1e-3
"""Error of the landmarks along each axis [m]."""

LANDMARK_STATED_STD_m = 1.5e-3
"""Error of the landmarks that the registration assumes [m]."""

BACK_QUANTILE = 0.4
"""Fraction of the skin, from behind, that no landmark or touch can reach."""

SPEED_m_s = 4e-3
"""Speed of the insertion [m/s]."""

STANDOFF_m = 15e-3
"""Distance from the skin at the start [m]."""

BEYOND_m = 12e-3
"""How far the needle goes beyond the target [m]."""

ROW_TICKS = 20
"""Every so many samples become a row, beside those of events."""

PLANNED_FRACTION = 0.2
SIMULATED_FRACTION = 0.6
"""Fractions of the work that plan and simulation are."""


class Placement(NamedTuple):
    """Where the model lies in the robot's base.

    Attributes:
        rotation: From the model to the robot, shape (3, 3).
        translation_m: From the model to the robot, shape (3,) [m].
    """

    rotation: Array
    translation_m: Array

    def to_robot(self, points_m: Array) -> Array:
        """Return points of the model, shape (n, 3), in the robot's base [m]."""
        return points_m @ self.rotation.T + self.translation_m

    def point_to_robot(self, point_m: Array) -> Array:
        """Return a point of the model, shape (3,), in the robot's base [m]."""
        return self.rotation @ point_m + self.translation_m


class Registrations(NamedTuple):
    """What is known of the placement.

    Attributes:
        rough: By landmarks.
        fine: By touches of the skin; the same as `rough` where they cannot register.
    """

    rough: Registration
    fine: Registration


class RuptureOfPlan(NamedTuple):
    """A rupture, and the plan after it.

    Attributes:
        depth_m: Depth below the planned entry [m].
        plan: What plan and ruptures say together.
    """

    depth_m: float
    plan: PlanState


class FollowedInsertion(NamedTuple):
    """A session over the signals of the insertion.

    Attributes:
        depth_m: Depth of the tip below the planned entry, shape (n,) [m].
        force_N: Force of the virtual sensor, shape (n,) [N].
        tip_N: Force at the tip, shape (n,) [N].
        ruptures: The ruptures, but for those that were retracted.
        stop_m: Depth at which the corrected plan has the target [m].
        rows: Rows of the scene.
        entry_in_base_m: Where the needle meets the planned entry, shape (3,) [m].
        axis: Direction of the needle there, in base axes, shape (3,).
    """

    depth_m: Array
    force_N: Array
    tip_N: Array
    ruptures: list[RuptureOfPlan]
    stop_m: float
    rows: Array
    entry_in_base_m: Array
    axis: Array


class TargetErrors(NamedTuple):
    """How far from the target the tip stops.

    Attributes:
        by_plan_m: By the plan alone [m].
        corrected_m: By the plan that ruptures have corrected [m].
    """

    by_plan_m: float
    corrected_m: float


class Insertion(NamedTuple):
    """What the demonstration has done.

    Attributes:
        torso: CT and labels.
        path: The planned path.
        layers: The planned layers along it.
        registrations: What is known of the placement.
        placement: The true placement.
        shift_m: By so much everything lies deeper along the needle than planned [m].
        robot: The simulated robot.
        followed: The session over its signals.
    """

    torso: ScannedTorso
    path: StraightPath
    layers: list[Layer]
    registrations: Registrations
    placement: Placement
    shift_m: float
    robot: Robot
    followed: FollowedInsertion

    @property
    def errors_m(self) -> TargetErrors:
        """How far from the target the tip stops [m].

        The shift lies along the needle; the error of the registration across it stays
        in both.
        """
        path = self.path
        length_m = path.length_m
        rotation = self.placement.rotation
        axis = rotation @ (path.target_m - path.entry_m) / length_m
        error_m = self.registrations.fine.to_robot(
            path.target_m
        ) - self.placement.point_to_robot(path.target_m)
        across_m = float(np.linalg.norm(error_m - (error_m @ axis) * axis))
        true_depth_m = length_m + self.shift_m
        along_m = [length_m - true_depth_m, self.followed.stop_m - true_depth_m]
        by_plan_m, corrected_m = np.hypot(along_m, across_m).tolist()
        return TargetErrors(by_plan_m, corrected_m)


def register(
    labels: Labels, entry_m: Array, placement: Placement, rng: np.random.Generator
) -> Registrations:
    """Register by landmarks, then by touches of the skin with a pointer.

    Touches lie around the entry. Where they cannot register (a torso that could spin),
    the landmarks alone do.

    Args:
        labels: The segmentation.
        entry_m: Entry in the model, shape (3,) [m].
        placement: The true placement.
        rng: Draws landmarks, touches and their errors.
    """
    skin = _skin_of(labels)
    out_m = skin.vertices_m @ FRONT
    front_m = skin.vertices_m[out_m > np.quantile(out_m, BACK_QUANTILE)]
    landmarks_m = front_m[_spread_indices(front_m, LANDMARKS, rng)]
    noise_m = LANDMARK_STD_m * rng.normal(size=landmarks_m.shape)
    rough = anatomy.fit_landmarks(
        landmarks_m,
        placement.to_robot(landmarks_m) + noise_m,
        std_m=LANDMARK_STATED_STD_m,
        is_std_known=True,
    )
    touched_m = placement.to_robot(_touch(front_m, entry_m, rng))
    try:
        return Registrations(rough, anatomy.fit_surface(skin, touched_m, rough))
    except anatomy.RegistrationError:
        return Registrations(rough, rough)


def _skin_of(labels: Labels) -> Surface:
    """Return the surface of the body."""
    body = [inside_body(labels).astype(np.uint8)]
    structures = [Structure.named("skin", 1)]
    return Labels.of(body, labels.grid, structures).surfaces()["skin"]


def _touch(front_m: Array, entry_m: Array, rng: np.random.Generator) -> Array:
    """Return touched places around the entry, some of which slipped, shape (n, 3)."""
    near_m = front_m[np.linalg.norm(front_m - entry_m, axis=1) < TOUCH_RADIUS_m]
    touched_m = near_m[rng.choice(len(near_m), TOUCHES)]
    touched_m = touched_m + TOUCH_STD_m * rng.normal(size=(TOUCHES, 3))
    has_slipped = rng.random(TOUCHES) < SLIP_PROBABILITY
    slips_m = rng.uniform(*SLIP_m, (int(has_slipped.sum()), 1))
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


def tissue(layers: list[Layer]) -> tuple[TissueLayer, ...]:
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


def insert(
    folder: Path | None, seed: int, progress: Progress = lambda fraction: None
) -> Insertion:
    """Plan, register, insert, and let ruptures correct the plan.

    Args:
        folder: Folder with CT and labels; None for an analytic torso.
        seed: Seed of everything that is drawn at random.
        progress: Takes the fraction of the work that is done.
    """
    rng = np.random.default_rng(seed)
    torso = read_torso(folder, rng)
    labels = torso.labels
    path = plan_path(labels, torso.target, rng)
    layers = thick_layers(labels.layers_along(path.entry_m, path.target_m))
    placement = _draw_placement(rng)
    registrations = register(labels, path.entry_m, placement, rng)
    axis = placement.rotation @ path.axis
    fine = registrations.fine
    target_in_base_m = placement.point_to_robot(path.target_m)
    error_m = float((target_in_base_m - fine.to_robot(path.target_m)) @ axis)
    shift_m = error_m + SHIFT_STD_m * float(rng.normal())
    progress(PLANNED_FRACTION)
    run = _simulate(layers, path.length_m, seed, progress)
    std_m = float(np.hypot(fine.std_along_m(axis, path.target_m), SHIFT_STD_m))
    followed = _follow_plan(run, PlanMatch(layers, std_m), shift_m, path.length_m)
    return Insertion(
        torso, path, layers, registrations, placement, shift_m, run.robot, followed
    )


def _draw_placement(rng: np.random.Generator) -> Placement:
    """Return a patient who lies on the back in front of the robot, drawn at random."""
    angle_deg = 90.0 + 5.0 * rng.normal()
    rotation = Rotation.from_euler("x", angle_deg, degrees=True).as_matrix()
    translation_m = np.array([0.6, 0.0, 0.3]) + 0.02 * rng.normal(size=3)
    return Placement(rotation, translation_m)


def _simulate(
    layers: list[Layer], length_m: float, seed: int, progress: Progress
) -> Run:
    """Simulate an insertion through the layers of a plan, and beyond its end."""
    motion = constant_motion(
        speed_m_s=SPEED_m_s, depth_m=length_m + BEYOND_m, standoff_m=STANDOFF_m
    )
    scenario = Scenario(
        id="abdomen",
        title="the plan's tissues",
        layers=tissue(layers),
        motion=motion,
    )

    def report(fraction: float) -> None:
        progress(PLANNED_FRACTION + SIMULATED_FRACTION * fraction)

    return simulate(scenario, "clean", seed, report)


class _FollowedSample(NamedTuple):
    """A sample at which the session follows the plan.

    Attributes:
        number: Number of the sample in the run.
        q_rad: Joint positions [rad].
        estimate: What the session estimates.
    """

    number: int
    q_rad: Array
    estimate: SessionEstimate

    @property
    def has_event(self) -> bool:
        """Whether a rupture was detected or retracted."""
        identification = self.estimate.identification
        return (
            identification.rupture is not None or identification.retracted is not None
        )


class _Follower:
    """A session that follows the plan over the signals of a run."""

    def __init__(self, run: Run, match: PlanMatch, shift_m: float) -> None:
        self.session = InsertionSession(run.robot)
        self.ruptures: list[RuptureOfPlan] = []
        self.entry_m = 0.0
        self.entry_in_base_m = np.zeros(3)
        self.axis = np.zeros(3)
        self._run = run
        self._match = match
        self._shift_m = shift_m

    def samples(self) -> Iterator[_FollowedSample]:
        """Run the session; yield the samples of the insertion after the tare."""
        signals = self._run.signals
        velocities = signals.dq_rad_s
        if velocities is None:
            velocities = [None] * len(signals.t_s)
        steps_s = np.diff(signals.t_s, prepend=signals.t_s[0])
        rows = zip(signals.q_rad, velocities, signals.tau_Nm, steps_s, strict=True)
        for number, (q_rad, dq_rad_s, tau_Nm, step_s) in enumerate(rows):
            t_s = signals.t_s[number]
            estimate = self.session.update(q_rad, dq_rad_s, tau_Nm, step_s)
            if not self.session.tared and t_s > self._run.tare_end_s:
                self._tare(float(self._run.truth.depth_m[number]))
            elif estimate.plan is not None and t_s <= self._insertion_end_s:
                self._note_rupture(estimate)
                yield _FollowedSample(number, q_rad, estimate)

    @property
    def _insertion_end_s(self) -> float:
        return self._run.scenario.motion.insertion_end_s

    def _tare(self, true_depth_m: float) -> None:
        """Tare, and follow the plan from there.

        The robot knows where its tip is, and where the planned entry; the tissue lies
        deeper by what nobody knows.
        """
        self.session.tare()
        zero = self.session.snapshot().zero
        self.entry_m = -true_depth_m - self._shift_m
        self.axis = zero.axis_in_base
        self.entry_in_base_m = zero.start_in_base_m + self.entry_m * self.axis
        self.session.follow(self._match, self.entry_in_base_m)

    def _note_rupture(self, estimate: SessionEstimate) -> None:
        """Keep a rupture, or remove one that was retracted."""
        identification = estimate.identification
        if identification.rupture is not None and estimate.plan is not None:
            depth_m = identification.rupture.depth_m - self.entry_m
            self.ruptures.append(RuptureOfPlan(depth_m, estimate.plan))
        if identification.retracted is not None:
            depth_m = identification.retracted.depth_m - self.entry_m
            self.ruptures = [
                rupture for rupture in self.ruptures if rupture.depth_m != depth_m
            ]


def _follow_plan(
    run: Run, match: PlanMatch, shift_m: float, length_m: float
) -> FollowedInsertion:
    """Run a session over the signals of a run, its ruptures matched with the plan.

    It ends where the corrected plan has the target: there the needle would stop.

    Args:
        run: The insertion.
        match: The plan.
        shift_m: By so much everything lies deeper than planned [m].
        length_m: Length of the planned path [m].
    """
    follower = _Follower(run, match, shift_m)
    rows: list[tuple[float, ...]] = []
    stop_m: float | None = None
    for sample in follower.samples():
        estimate = sample.estimate
        if sample.number % ROW_TICKS == 0 or sample.has_event:
            rows.append(view_row(estimate, sample.q_rad))
        depth_m = estimate.depth_m - follower.entry_m
        offset_m = estimate.plan.offset_m if estimate.plan is not None else 0.0
        if depth_m >= length_m + offset_m:
            stop_m = depth_m
            break
    table = np.array(rows)
    depths_m = table[:, FIELDS.index("depth_m")] - follower.entry_m
    return FollowedInsertion(
        depth_m=depths_m,
        force_N=table[:, FIELDS.index("force_N")],
        tip_N=table[:, FIELDS.index("tip_N")],
        ruptures=follower.ruptures,
        stop_m=depths_m[-1] if stop_m is None else stop_m,
        rows=table,
        entry_in_base_m=follower.entry_in_base_m,
        axis=follower.axis,
    )
