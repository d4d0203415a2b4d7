"""What stands in the scene: the arm and its needle, structures, boundaries, ruptures.

Everything is in the robot's base; anatomy comes through a registration. Surfaces and
layers are those of `needleforce.anatomy`, or anything with the same names.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from foundation.arrays import Array
from needleforce.needle_on_plan import PlannedPath
from needleforce.scene.moment import SceneError
from needleforce.scene.words import shown_name
from urdf import Robot

Color = tuple[int, int, int]
"""Red, green and blue from 0 to 255."""

PATH_COLOR: Color = (60, 60, 60)
OBSTACLE_COLOR: Color = (170, 40, 30)
RUPTURE_COLOR: Color = (230, 159, 0)
EXPECTED_COLOR: Color = (0, 114, 178)
NEEDLE_COLOR: Color = (70, 75, 90)
WARNING_COLOR: Color = (230, 30, 30)
TARGET_COLOR: Color = (0, 158, 115)
NEAREST_COLOR: Color = (150, 0, 120)
FORCE_COLOR: Color = (213, 94, 0)
STD_COLOR: Color = (120, 120, 120)

NEEDLE = "/needle"
"""Frame at the tip of the needle, z along it; what moves with it stands below."""

NEEDLE_LENGTH_m = 0.2

PATH_LEAD_m = 0.03
"""The planned path begins so far before the entry."""


class NeedlePose(NamedTuple):
    """Where the needle is, in axes of the robot's base.

    Attributes:
        tip_m: Position of its tip, shape (3,).
        axis: Its direction, shape (3,).
    """

    tip_m: Array
    axis: Array


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
        watched: Names of the structures that the needle must not come near to.
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
    def path(self) -> PlannedPath | None:
        """The planned path in the robot's base; None without entry and target.

        How well it is known is the session's to say.

        Raises:
            SceneError: The path has no length.
        """
        if self.entry_m is None or self.target_m is None:
            return None
        ends_m = self.to_robot([self.entry_m, self.target_m])
        path = PlannedPath.of_std(*ends_m, std_m=0.0)
        if not path.length_m > 0.0:
            raise SceneError(f"entry and target are {ends_m}; expected two points")
        return path


EMPTY = PlanScene()


class ArmNodes:
    """The arm with its needle; without shapes it is a line through its joints.

    Args:
        server: Of the page.
        robot: The arm.
        urdf_path: Its description, for its shapes.

    Attributes:
        unread_shapes: Why its shapes cannot be read; it is shown as a line then.
    """

    def __init__(self, server: Any, robot: Robot, urdf_path: Path | None) -> None:
        self._robot = robot
        self._data = robot.create_data()
        self._server = server
        self._shapes: Any = None
        self.unread_shapes = ""
        if urdf_path is not None:
            import yourdfpy
            from viser.extras import ViserUrdf

            find = partial(yourdfpy.filename_handler_magic, dir=urdf_path.parent)
            try:
                description = yourdfpy.URDF.load(urdf_path, filename_handler=find)
            except Exception as error:  # whatever a reader of meshes raises
                self.unread_shapes = str(error) or type(error).__name__
            else:
                self._shapes = ViserUrdf(server, description)
                names = self._shapes.get_actuated_joint_names()
                # What the description moves and the robot lacks, it holds at zero.
                self._shown_rad = np.zeros(len(names))
                self._shown_joints = [names.index(name) for name in robot.joint_names]
        self.frame = server.scene.add_frame(
            NEEDLE,
            show_axes=False,
            visible=False,  # until it is known where it is
        )
        self.needle = server.scene.add_cylinder(
            f"{NEEDLE}/shaft",
            radius=0.8e-3,  # metres
            height=NEEDLE_LENGTH_m,
            color=NEEDLE_COLOR,
            position=(0.0, 0.0, -0.5 * NEEDLE_LENGTH_m),
        )

    def find_needle(self, q_rad: ArrayLike) -> NeedlePose:
        """Return where the needle is at joint positions, shape (n,)."""
        q = np.asarray(q_rad, dtype=float)
        pin.framesForwardKinematics(self._robot.model, self._data, q)
        pose = self._data.oMf[self._robot.tool_frame_id]
        return NeedlePose(pose.translation.copy(), pose.rotation[:, 2].copy())

    def update(self, q_rad: ArrayLike) -> NeedlePose:
        """Move the arm to joint positions, shape (n,); return where the needle is."""
        needle = self.find_needle(q_rad)
        if self._shapes is not None:
            self._shown_rad[self._shown_joints] = q_rad
            self._shapes.update_cfg(self._shown_rad)
        else:
            joints_m = [joint.translation for joint in self._data.oMi]
            points_m = np.array([*joints_m, needle.tip_m])
            add_line(self._server, "/bones", points_m, (90, 100, 120), 6.0)
        self.frame.visible = True
        self.frame.position = needle.tip_m
        self.frame.wxyz = quaternion_along(needle.axis)
        return needle


def quaternion_along(axis: Array) -> Array:
    """Return the quaternion (w, x, y, z) that turns z to a direction, shape (4,).

    x is turned to the right of the first view, as far as it can be.
    """
    right = np.array([0.77, 0.63, 0.0])
    # An axis along that direction has its labels along z instead.
    side = np.array([0.0, 0.0, 1.0]) if abs(axis @ right) >= 0.9 else right
    alignment = Rotation.align_vectors(
        [axis, side], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], weights=[np.inf, 1.0]
    )
    return alignment[0].as_quat(scalar_first=True)


def add_line(server: Any, name: str, points_m: Array, color: Color, px: float) -> Any:
    """Add a line through points, shape (n, 3), so many pixels wide."""
    return server.scene.add_line_segments(
        name,
        points=segments_of(points_m),
        colors=color,
        thickness=px,
        thickness_units="screen",
    )


def segments_of(points_m: Array) -> NDArray[np.float32]:
    """Return the pieces of a line through points, shape (n, 3), as (n - 1, 2, 3)."""
    return np.stack([points_m[:-1], points_m[1:]], axis=1).astype(np.float32)


class Ring:
    """A ring about the needle's line with a label.

    Args:
        server: Of the page.
        name: Of its node.
        color: Of the ring.
        text: Of the label.
        side: On which the label stands: -1 for planned ones, 1 for the others.
    """

    def __init__(
        self, server: Any, name: str, color: Color, text: str, side: float = 1.0
    ) -> None:
        radius_m = 6e-3
        angle_rad = np.linspace(0.0, 2.0 * np.pi, 33)
        circle = np.stack([np.cos(angle_rad), np.sin(angle_rad), 0.0 * angle_rad], 1)
        self.line = add_line(server, name, radius_m * circle, color, 4.0)
        self.label = server.scene.add_label(
            f"{name}/label",
            text,
            position=(2.0 * side * radius_m, 0.0, 0.0),
            font_size_mode="scene",
            font_scene_height=radius_m,
            anchor="center-right" if side < 0.0 else "center-left",
        )

    def move(self, position_m: Array, axis: Array) -> None:
        """Move the ring to a place, about an axis."""
        self.line.position = position_m
        self.line.wxyz = quaternion_along(axis)

    def show(self, is_visible: bool) -> None:
        """Show the ring with its label, or hide it."""
        self.line.visible = is_visible
        self.label.visible = is_visible


class ForceArrow:
    """The tip force as an arrow beside the needle, with a bar of its deviation.

    Args:
        server: Of the page.
    """

    def __init__(self, server: Any) -> None:
        line_m = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 5e-3]])
        self.arrow = server.scene.add_arrows(
            f"{NEEDLE}/force",
            segments_of(line_m),
            FORCE_COLOR,
            shaft_radius=1.2e-3,
            head_radius=3e-3,
            head_length=5e-3,
        )
        self.bar = add_line(server, f"{NEEDLE}/std", line_m, STD_COLOR, 5.0)

    def draw(self, identification: Any, is_valid: bool) -> None:
        """Draw the tip force of a tick where it is valid and long enough."""
        min_N = 0.02  # a shorter arrow is shorter than its head is wide
        force_N = identification.tip_force_N
        is_shown = is_valid and abs(force_N) >= min_N
        self.arrow.visible = is_shown
        self.bar.visible = is_shown
        if is_shown:
            m_per_N = -25e-3  # tissue pushes the tip back
            tip_m = m_per_N * force_N
            std_m = m_per_N * 2.0 * (identification.tip_force_std_N or 0.0)
            self.arrow.points = segments_of(
                np.array([[6e-3, 0.0, 0.0], [6e-3, 0.0, tip_m]])
            )
            self.bar.points = segments_of(
                np.array([[9e-3, 0.0, tip_m - std_m], [9e-3, 0.0, tip_m + std_m]])
            )


def add_plan(server: Any, plan: PlanScene) -> None:
    """Add structures, planned path, target, and a ring at every boundary.

    Raises:
        SceneError: The plan has no length.
    """
    server.scene.set_up_direction("+z")
    for surface in plan.surfaces:
        server.scene.add_mesh_simple(
            f"/anatomy/{surface.name}",
            plan.to_robot(surface.vertices_m).astype(np.float32),
            np.asarray(surface.triangles, dtype=np.uint32),
            color=color_of(surface.colour),
            opacity=usual_opacity(surface.name),
            side="double",
        )
    path = plan.path
    if path is None:
        return
    line_m = np.array([path.entry_m - PATH_LEAD_m * path.axis, path.target_m])
    add_line(server, "/plan/path", line_m, PATH_COLOR, 2.0)
    server.scene.add_icosphere(
        "/plan/target", 3e-3, color=TARGET_COLOR, position=path.target_m
    )
    for number, (above, layer) in enumerate(pairwise(plan.layers), 1):
        color = OBSTACLE_COLOR if layer.is_obstacle else PATH_COLOR
        # Not by its colour alone.
        remark = " (obstacle)" if layer.is_obstacle else ""
        text = f"{shown_name(layer.name)}{remark}"
        ring = Ring(server, f"/plan/boundary {number}", color, text, -1.0)
        ring.move(path.entry_m + above.exit_m * path.axis, path.axis)


def color_of(parts: Sequence[float]) -> Color:
    """Return the colour of red, green and blue from 0 to 1."""
    red, green, blue = (round(255 * part) for part in parts)
    return red, green, blue


def usual_opacity(name: str) -> float:
    """Return how opaque a structure is at first; what surrounds all others is faint."""
    words = shown_name(name.lower()).split()
    faint = ("fat", "skin", "body", "lean", "muscle", "cavity")
    return 0.06 if any(word in words for word in faint) else 0.25


def legend_of(plan: PlanScene, *, has_needle: bool = True) -> Iterator[tuple[str, str]]:
    """Yield the colours of a scene as ``#rrggbb``, each with what it stands for."""
    colors: list[tuple[Color, str]] = []
    if has_needle:
        colors += [
            (NEEDLE_COLOR, "needle (red: a warning stands above)"),
            (FORCE_COLOR, "arrow: force of the tissue on the tip"),
            (STD_COLOR, "bar beside the arrow: ± two standard deviations"),
            (RUPTURE_COLOR, "rupture detected"),
        ]
    if plan.path is not None:
        colors += [
            (PATH_COLOR, "planned path; rings: planned boundaries"),
            (OBSTACLE_COLOR, "planned boundary of an obstacle"),
            (TARGET_COLOR, "target"),
        ]
    if has_needle and plan.path is not None:
        colors += [
            (EXPECTED_COLOR, "next boundary, as the ruptures moved it"),
            (NEAREST_COLOR, "line to the nearest structure at risk"),
        ]
    colors += sorted(
        ((color_of(one.colour), shown_name(one.name)) for one in plan.surfaces),
        key=lambda entry: entry[1],
    )
    for color, text in colors:
        yield "#{:02x}{:02x}{:02x}".format(*color), text
