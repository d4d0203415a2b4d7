"""What stands in the scene: the arm and its needle, structures, boundaries, ruptures.

Everything is in the robot's base; anatomy comes through a registration. Surfaces and
layers are those of `needleforce.anatomy`, or anything with the same names.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.scene.arm_shapes import load_shapes
from needleforce.scene.state_ring import SceneError
from urdf import Robot


class Color(NamedTuple):
    """A colour.

    Attributes:
        red: From 0 to 255.
        green: From 0 to 255.
        blue: From 0 to 255.
    """

    red: int
    green: int
    blue: int


def color_of(parts: Sequence[float]) -> Color:
    """Return the colour of red, green and blue from 0 to 1."""
    red, green, blue = (round(255 * part) for part in parts)
    return Color(red, green, blue)


class RingStyle(NamedTuple):
    """How a ring about the needle's line looks.

    Attributes:
        color: Of the ring.
        label_offset_m: Of its label along x: planned rings have it on one side, the
            others on the other.
    """

    color: Color
    label_offset_m: float


class Ring(NamedTuple):
    """A ring in the scene.

    Attributes:
        line: Its node.
        label: The node of its label.
    """

    line: Any
    label: Any

    def set_visible(self, is_visible: bool) -> None:
        """Show the ring with its label, or hide it."""
        self.line.visible = is_visible
        self.label.visible = is_visible

    def shift_label(self, shift_m: float) -> None:
        """Shift the label along the axis, so that it overprints no other."""
        x, y, _ = self.label.position
        self.label.position = (x, y, shift_m)

    def move(self, position_m: Array, axis: Array) -> None:
        """Move the ring to a place, about an axis."""
        self.line.position = tuple(position_m)
        self.line.wxyz = quaternion_of_axis(axis)


class NeedlePose(NamedTuple):
    """Where the needle is, in axes of the robot's base.

    Attributes:
        tip_m: Position of its tip, shape (3,).
        axis: Its direction, shape (3,).
    """

    tip_m: Array
    axis: Array


RING_RADIUS_M = 6e-3
"""Of a boundary or a rupture."""

_PLANNED_LABEL_M = -2.0 * RING_RADIUS_M
_FOUND_LABEL_M = 2.0 * RING_RADIUS_M

LABEL_GAP_M = 10e-3
"""Distance along the needle from one label to the next."""

PATH_COLOR = Color(60, 60, 60)
PLANNED = RingStyle(PATH_COLOR, _PLANNED_LABEL_M)
OBSTACLE = RingStyle(Color(170, 40, 30), _PLANNED_LABEL_M)
DETECTED = RingStyle(Color(230, 159, 0), _FOUND_LABEL_M)

EXPECTED = RingStyle(Color(0, 114, 178), _FOUND_LABEL_M)
"""Of the next boundary, moved by what the ruptures have shown."""

NEEDLE_COLOR = Color(70, 75, 90)
OFF_PLAN_COLOR = Color(230, 30, 30)
"""Of the needle while it is off the plan."""

TARGET_COLOR = Color(0, 158, 115)
NEAREST_COLOR = Color(150, 0, 120)
TRAIL_COLOR = Color(213, 94, 0)
TRAIL_WIDTH = 3.0  # pixels

CAMERA_M = np.array([0.19, -0.23, 0.11])
"""Where the camera stands at first, from the tip."""

RIGHT = np.array([0.55, 0.45, 0.0]) / np.hypot(0.55, 0.45)
"""Direction to the right of the first view, where labels stand."""

NEEDLE_LENGTH_M = 0.2

PATH_LEAD_M = 0.03
"""The planned path begins so far before the entry."""


class PlannedLine(NamedTuple):
    """A planned path in axes of the robot's base.

    Attributes:
        entry_m: Where it begins, shape (3,).
        target_m: Where it ends, shape (3,).
        axis: Its direction, shape (3,).
        length_m: From entry to target.
    """

    entry_m: Array
    target_m: Array
    axis: Array
    length_m: float


class PlanScene(NamedTuple):
    """Anatomy and plan as the viewer shows them.

    Attributes:
        surfaces: With `name`, `colour`, `vertices_m`, `triangles`, in the model.
        layers: With `name`, `exit_m`, `is_obstacle`.
        entry_m: In the model, shape (3,); None without a plan.
        target_m: In the model, shape (3,); None without a plan.
        rotation: From the model to the robot's base, shape (3, 3).
        translation_m: Of the model's origin in the robot's base, shape (3,).
        warnings: What is wrong with the plan, or could not be checked.
        scan: CT around the path, with `values` and `grid`, in the model; None for none.
        watched: Names of the structures that the needle must not come near to, by the
            numbers of their clearances.
    """

    surfaces: Sequence[Any] = ()
    layers: Sequence[Any] = ()
    entry_m: Array | None = None
    target_m: Array | None = None
    rotation: Array = np.eye(3)
    translation_m: Array = np.zeros(3)
    warnings: tuple[str, ...] = ()
    scan: Any = None
    watched: tuple[str, ...] = ()

    def to_robot(self, points_m: ArrayLike) -> Array:
        """Return points of the model in the robot's base, shape (3,) or (n, 3)."""
        return np.asarray(points_m, dtype=float) @ self.rotation.T + self.translation_m

    @property
    def path(self) -> "PlannedLine | None":
        """The planned path in the robot's base; None without entry and target.

        Raises:
            SceneError: The path has no length.
        """
        if self.entry_m is None or self.target_m is None:
            return None
        entry_m = self.to_robot(self.entry_m)
        target_m = self.to_robot(self.target_m)
        length_m = float(np.linalg.norm(target_m - entry_m))
        if not length_m > 0.0:
            raise SceneError(
                f"a plan from {self.entry_m} to {self.target_m}: expected two points"
            )
        return PlannedLine(entry_m, target_m, (target_m - entry_m) / length_m, length_m)


EMPTY = PlanScene()
"""Neither anatomy nor plan."""


class ArmNodes:
    """The arm and its needle, which is the z axis of its tool.

    Args:
        server: Of the page.
        robot: The arm.
        urdf_path: The description with the arm's own shapes; without one a line through
            its joints is drawn.

    Attributes:
        unread_meshes: Names of meshes that cannot be read; the arm is shown without.
    """

    def __init__(
        self, server: Any, robot: Robot, urdf_path: Path | None = None
    ) -> None:
        self._data = robot.create_data()
        self._server = server
        self._robot = robot
        self._shapes: Any = None
        self.unread_meshes: tuple[str, ...] = ()
        if urdf_path is not None:
            from viser.extras import ViserUrdf

            shapes = load_shapes(urdf_path)
            self.unread_meshes = shapes.unread
            self._shapes = ViserUrdf(server, shapes.urdf, root_node_name="/arm")
            shown_names = self._shapes.get_actuated_joint_names()
            self._shown_joints = [shown_names.index(name) for name in robot.joint_names]
            # What the robot lacks, it holds at zero.
            self._shown_rad = np.zeros(len(shown_names))

        self._needle = server.scene.add_cylinder(
            "/needle",
            radius=0.8e-3,  # metres
            height=NEEDLE_LENGTH_M,
            color=NEEDLE_COLOR,
            visible=False,  # until it is known where it is
        )

    def show_off_plan(self, is_off_plan: bool) -> None:
        """Show the needle in the colour of a needle on the plan, or off it."""
        self._needle.color = OFF_PLAN_COLOR if is_off_plan else NEEDLE_COLOR

    def needle_at(self, q_rad: ArrayLike) -> NeedlePose:
        """Return where the needle is at joint positions, shape (n,)."""
        q = np.asarray(q_rad, dtype=float)
        pin.framesForwardKinematics(self._robot.model, self._data, q)
        pose = self._data.oMf[self._robot.tool_frame_id]
        return NeedlePose(pose.translation.copy(), pose.rotation[:, 2].copy())

    def update(self, q_rad: ArrayLike) -> NeedlePose:
        """Move the arm to joint positions, shape (n,); return where the needle is."""
        q = np.asarray(q_rad, dtype=float)
        needle = self.needle_at(q)
        tip_m = needle.tip_m
        axis = needle.axis
        data = self._data
        if self._shapes is not None:
            self._shown_rad[self._shown_joints] = q
            self._shapes.update_cfg(self._shown_rad)
        else:
            joints = range(self._robot.model.njoints)
            points_m = [data.oMi[joint].translation for joint in joints]
            bones = np.array([*points_m, tip_m])
            add_lines(self._server, "/bones", bones, Color(90, 100, 120), 6.0)

        self._needle.visible = True
        self._needle.position = tuple(tip_m - 0.5 * NEEDLE_LENGTH_M * axis)
        self._needle.wxyz = quaternion_of_axis(axis)
        return needle


def label_shifts_m(depths_m: Sequence[float]) -> list[float]:
    """Return how far labels at depths are shifted so that none overprints another.

    The deepest stays; those before it move towards the entry as far as they must.

    Args:
        depths_m: Along the needle, in rising order.
    """
    shifts_m: list[float] = []
    limit_m = np.inf
    for depth_m in reversed(depths_m):
        place_m = min(depth_m, limit_m)
        limit_m = place_m - LABEL_GAP_M
        shifts_m.append(place_m - depth_m)
    return shifts_m[::-1]


def free_shift_m(depth_m: float, taken_m: Sequence[float]) -> float:
    """Return how far a label at a depth is shifted inwards to overprint no other.

    Args:
        depth_m: Along the needle.
        taken_m: Depths of the other labels.
    """
    place_m = depth_m
    for other_m in sorted(taken_m):
        if abs(other_m - place_m) < LABEL_GAP_M:
            place_m = other_m + LABEL_GAP_M
    return place_m - depth_m


def rotation_of_axis(axis: Array) -> Array:
    """Return the rotation that turns the z axis to a direction, shape (3, 3).

    x is turned to the right of the first view, as far as it can be.
    """
    # An axis along that direction has its labels along z instead.
    is_along_right = abs(axis @ RIGHT) >= 0.9
    right = np.array([0.0, 0.0, 1.0]) if is_along_right else RIGHT
    side = right - (right @ axis) * axis
    side /= np.linalg.norm(side)
    return np.column_stack([side, np.cross(axis, side), axis])


def quaternion_of_axis(axis: Array) -> tuple[float, ...]:
    """Return the quaternion (w, x, y, z) of `rotation_of_axis`."""
    quaternion = pin.Quaternion(rotation_of_axis(axis))
    return (
        float(quaternion.w),
        float(quaternion.x),
        float(quaternion.y),
        float(quaternion.z),
    )


def add_path(server: Any, plan: PlanScene) -> None:
    """Add the planned path, its target, and a ring with a name at every boundary.

    Raises:
        SceneError: The plan has no length.
    """
    path = plan.path
    if path is None:
        return
    entry_m, target_m, axis, _ = path
    line = np.array([entry_m - PATH_LEAD_M * axis, target_m])
    add_lines(server, "/plan/way", line, PATH_COLOR, 2.0)
    server.scene.add_icosphere(
        "/plan/target", 3e-3, color=TARGET_COLOR, position=tuple(target_m)
    )
    exits_m = [layer.exit_m for layer in plan.layers[:-1]]
    shifts_m = label_shifts_m(exits_m)
    for number, layer in enumerate(plan.layers[:-1], 1):
        next_layer = plan.layers[number]
        text = next_layer.name.replace("_", " ")
        if next_layer.is_obstacle:
            text += " (obstacle)"  # not by its colour alone
        ring = add_ring(
            server,
            f"/plan/boundary {number}",
            NeedlePose(entry_m + layer.exit_m * axis, axis),
            OBSTACLE if next_layer.is_obstacle else PLANNED,
            text,
        )
        ring.shift_label(shifts_m[number - 1])


def add_ring(
    server: Any, name: str, pose: NeedlePose, style: RingStyle, text: str
) -> Ring:
    """Add a ring about the needle's line with a label.

    Args:
        server: Of the page.
        name: Of its node.
        pose: Where the ring is, and about which axis.
        style: How it looks.
        text: Of the label.
    """
    angle_rad = np.linspace(0.0, 2.0 * np.pi, 33)
    circle = [np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)]
    points_m = RING_RADIUS_M * np.stack(circle, axis=1)
    line = add_lines(server, name, points_m, style.color, 4.0)
    label = server.scene.add_label(
        f"{name}/label",
        text,
        position=(style.label_offset_m, 0.0, 0.0),
        font_size_mode="scene",
        font_scene_height=6e-3,  # metres
        anchor="center-right" if style.label_offset_m < 0.0 else "center-left",
    )
    ring = Ring(line, label)
    ring.move(pose.tip_m, pose.axis)
    return ring


def add_lines(
    server: Any, name: str, points_m: Array, color: Color, width: float
) -> Any:
    """Add a line through points, shape (n, 3), so many pixels wide."""
    segments = np.stack([points_m[:-1], points_m[1:]], axis=1)
    return server.scene.add_line_segments(
        name, points=segments, colors=color, thickness=width, thickness_units="screen"
    )
