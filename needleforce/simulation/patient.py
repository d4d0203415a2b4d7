"""A simulated arm over the patient of a plan: it touches him, or follows the plan.

The patient lies where the arm's needle meets the planned entry along the planned path.
He is the same one for touching and inserting: what registers him in one serves the
other.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from groundtruth import Run, Scenario, simulate
from groundtruth.arm_motion import InsertionPath, reach_pose, scenario_path
from groundtruth.errors import MotionError
from groundtruth.layers import Layer as TissueLayer
from groundtruth.materials import ABDOMEN
from groundtruth.motion import Motion, constant_motion
from needleforce.anatomy import Labels, PlanError
from needleforce.anatomy.path_layers import UNLABELLED
from needleforce.devices import ReplayArm
from urdf import NeedleTool, Robot, load_lwr

SPEED_m_s = 4e-3
"""Of the insertion."""

BEYOND_m = 10e-3
"""How far the needle goes beyond the target."""

RATE_HZ = 100.0
"""Of the touching arm's samples."""

MIN_LAYER_m = 4e-3
"""Thinner layers join the one before: membranes need room."""

TOUCHES = 40
"""Of the skin."""

SEED = 0
"""Of touches and their errors."""


class Pose(NamedTuple):
    """Where the patient lies in the robot's base.

    Attributes:
        rotation: From the CT to the base, (3, 3).
        translation_m: From the CT to the base, (3,).
    """

    rotation: Array
    translation_m: Array

    def to_robot(self, points_m: Array) -> Array:
        """Return points of the CT, (n, 3), or one of them, (3,), in the base."""
        return points_m @ self.rotation.T + self.translation_m


class PlannedLine(NamedTuple):
    """The path of a plan.

    Attributes:
        entry_m: In LPS, (3,).
        target_m: In LPS, (3,).
    """

    entry_m: Array
    target_m: Array

    @property
    def axis(self) -> Array:
        """Direction, of length one, (3,)."""
        way_m = self.target_m - self.entry_m
        return way_m / np.linalg.norm(way_m)

    def motion(self) -> Motion:
        """Return the motion of the needle along the path."""
        length_m = float(np.linalg.norm(self.target_m - self.entry_m))
        return constant_motion(
            speed_m_s=SPEED_m_s, depth_m=length_m + BEYOND_m, standoff_m=15e-3
        )


def insert_into_patient(
    plan: Mapping[str, Any],
    seed: int = SEED,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Run:
    """Simulate the insertion along the path of a plan, through its layers.

    Args:
        plan: Fields of a plan's file: ``entry_m``, ``target_m``, ``layers``.
        seed: Of what the arm's sensors add.
        progress: Takes the fraction of the work that is done.

    Raises:
        PlanError: It has no path, or no layers.
    """
    line = _line_of(plan)
    scenario = Scenario(
        id="patient",
        title="the plan's layers",
        layers=_tissue(plan.get("layers") or ()),
        motion=line.motion(),
    )
    return simulate(scenario, "clean", seed, progress)


def touch_patient(
    plan: Mapping[str, Any], labels: Labels, landmarks_m: Array
) -> ReplayArm:
    """Return a simulated arm that touches landmarks, then the skin about the entry.

    Args:
        plan: Fields of a plan's file: ``entry_m``, ``target_m``.
        labels: Segmentation of the patient.
        landmarks_m: Points of the CT in LPS, shape (n, 3); there may be none.

    Raises:
        PlanError: The plan has no path, or a landmark is out of the arm's reach.
    """
    rng = np.random.default_rng(SEED)
    line = _line_of(plan)
    robot = load_lwr(payload=NeedleTool())
    path = arm_path(robot, line)
    skin_m = draw_skin_points(labels, line, rng)
    points_m = np.concatenate([landmarks_m.reshape(-1, 3), skin_m])
    error_m = 0.3e-3  # along each axis: skin gives way, landmarks are blunt
    places_m = lay_patient(path, line).to_robot(points_m)
    places_m = places_m + error_m * rng.normal(size=places_m.shape)
    return _touching_arm(robot, path.posture_rad(0.0), path.start, places_m)


def arm_path(robot: Robot, line: PlannedLine) -> InsertionPath:
    """Return how the arm moves its needle along a planned path."""
    scenario = Scenario(id="patient", title="", layers=(), motion=line.motion())
    return scenario_path(robot, scenario)


def _line_of(plan: Mapping[str, Any]) -> PlannedLine:
    """Return the path of a plan."""
    if "entry_m" not in plan or "target_m" not in plan:
        raise PlanError(
            "the plan has no entry_m and target_m: expected a plan that `needleforce "
            "plan` wrote"
        )
    return PlannedLine(np.array(plan["entry_m"]), np.array(plan["target_m"]))


def lay_patient(path: InsertionPath, line: PlannedLine, shift_m: float = 0.0) -> Pose:
    """Return the place of the patient: the needle meets the entry along the path.

    The head points away from the base, as far as it can.

    Args:
        path: How the arm moves its needle.
        line: The planned path.
        shift_m: By so much the tissue lies deeper along the needle than the CT says.
    """
    axis = path.start.rotation[:, 2]
    alignment = Rotation.align_vectors(
        [axis, [1.0, 0.0, 0.0]],
        [line.axis, [0.0, 0.0, 1.0]],
        weights=[np.inf, 1.0],
    )
    rotation = alignment[0].as_matrix()
    standoff_m = -line.motion().start_m - shift_m
    entry_m = path.start.translation + standoff_m * axis
    return Pose(rotation, entry_m - rotation @ line.entry_m)


def draw_skin_points(
    labels: Labels, line: PlannedLine, rng: np.random.Generator
) -> Array:
    """Return points of the skin about the entry that the needle can touch, (n, 3)."""
    radius_m = 0.11  # of the skin that is touched, about the entry
    front_cosine = 0.35  # a flatter skin is not touched
    skin = labels.skin()
    normals = np.asarray(skin.mesh.vertex_normals)
    is_near = np.linalg.norm(skin.vertices_m - line.entry_m, axis=1) < radius_m
    is_steep = normals @ -line.axis > front_cosine
    points_m = skin.vertices_m[is_near & is_steep]
    return points_m[rng.choice(len(points_m), TOUCHES)]


def _touching_arm(
    robot: Robot, start_rad: Array, start: pin.SE3, places_m: Array
) -> ReplayArm:
    """Return the joint signals of an arm that touches places with its needle."""
    move_s = 0.7  # to the next place, down, and up
    rest_s = 1.2  # in contact
    lift_m = 0.02  # between two touches
    touch_N = 1.5  # along the needle in contact
    axis = start.rotation[:, 2]
    posture = start_rad
    q_rad: list[Array] = []
    force_N: list[Array] = []
    move = _smooth(round(move_s * RATE_HZ))
    rest = round(rest_s * RATE_HZ)
    for place_m in places_m:
        above = _reach(robot, posture, pin.SE3(start.rotation, place_m - lift_m * axis))
        down = _reach(robot, above, pin.SE3(start.rotation, place_m))
        q_rad += [
            posture + move * (above - posture),
            above + move * (down - above),
            np.tile(down, (rest, 1)),
            down + move * (above - down),
        ]
        force_N += [
            np.zeros(2 * len(move)),
            np.full(rest, touch_N),
            np.zeros(len(move)),
        ]
        posture = above
    return _signals(robot, np.concatenate(q_rad), np.concatenate(force_N))


def _smooth(count: int) -> Array:
    """Return a course from 0 to 1 with rest at both ends, (count, 1)."""
    time = np.linspace(0.0, 1.0, count)[:, None]
    return 10.0 * time**3 - 15.0 * time**4 + 6.0 * time**5


def _reach(robot: Robot, posture_rad: Array, place: pin.SE3) -> Array:
    """Return a posture with the tool at a place, found from one close by.

    Raises:
        PlanError: It is out of reach.
    """
    try:
        return reach_pose(robot, posture_rad, place, tolerance=1e-6, max_step_rad=0.2)
    except MotionError as error:
        raise PlanError(
            f"the simulated arm does not reach {np.round(1e3 * place.translation)} mm: "
            "landmarks must lie within some 20 cm of the entry"
        ) from error


def _signals(robot: Robot, q_rad: Array, force_N: Array) -> ReplayArm:
    """Return what an ideal arm measures on a motion, pushed back along its needle.

    Args:
        robot: The arm.
        q_rad: Joint positions, (n, 7).
        force_N: Force against the needle, (n,).
    """
    dt_s = 1.0 / RATE_HZ
    dq_rad_s = np.gradient(q_rad, dt_s, axis=0)
    ddq_rad_s2 = np.gradient(dq_rad_s, dt_s, axis=0)
    data = robot.create_data()
    tau_Nm = np.empty_like(q_rad)
    for tick, (q, dq, ddq) in enumerate(zip(q_rad, dq_rad_s, ddq_rad_s2, strict=True)):
        torque_Nm = pin.rnea(robot.model, data, q, dq, ddq)
        jacobian = pin.computeFrameJacobian(
            robot.model, data, q, robot.tool_frame_id, pin.LOCAL
        )
        # The tissue pushes the tool back along its z axis; the motors hold against it.
        tau_Nm[tick] = torque_Nm + force_N[tick] * jacobian[2]
    return ReplayArm(np.full(len(q_rad), dt_s), q_rad, dq_rad_s, tau_Nm, robot)


def _tissue(layers: Iterable[Mapping[str, Any]]) -> tuple[TissueLayer, ...]:
    """Return layers of the simulation as thick as those of a plan.

    The last one is thicker, so that the needle can go beyond the target.
    """
    fat, muscle, liver = ABDOMEN
    kinds = {"liver": liver, "lesion": liver, "fat": fat, UNLABELLED: fat}
    tissue: list[TissueLayer] = []
    depth_m = 0.0
    for layer in layers:
        thickness_m = float(layer["exit_m"]) - depth_m
        depth_m = float(layer["exit_m"])
        kind = kinds.get(layer["name"], muscle)
        if tissue and (thickness_m < MIN_LAYER_m or tissue[-1].name == layer["name"]):
            tissue[-1] = replace(
                tissue[-1], thickness_m=tissue[-1].thickness_m + thickness_m
            )
        else:
            tissue.append(replace(kind, name=layer["name"], thickness_m=thickness_m))
    if not tissue:
        raise PlanError("the plan has no layers")
    tissue[-1] = replace(
        tissue[-1], thickness_m=tissue[-1].thickness_m + 2.0 * BEYOND_m
    )
    return tuple(tissue)
