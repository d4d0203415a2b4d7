"""What stands in the scene: the arm and its needle, structures, planned boundaries,
ruptures.

Everything is in the robot's base; anatomy comes through a registration. Surfaces and
layers are those of `needleforce.anatomy`, or anything with the same names.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from needleforce.scene.state_ring import Array, SceneError
from urdf import Robot

PLANNED = (235, 235, 235)
FOUND = (255, 205, 0)
OBSTACLE = (220, 60, 40)
EXPECTED = (90, 200, 250)  # the next boundary, moved by what the ruptures have shown
CAMERA_m = np.array([0.29, -0.35, 0.16])  # from the tip, at first
RIGHT = np.array([0.55, 0.45, 0.0]) / np.hypot(0.55, 0.45)
OPACITY = 0.35
RING_m = 6e-3
NEEDLE_m = 0.2
NEEDLE_RADIUS_m = 0.8e-3


class PlanScene(NamedTuple):
    """Anatomy and plan as the viewer shows them.

    Attributes:
        surfaces: With `name`, `colour`, `vertices_m`, `triangles`, in the model.
        layers: With `name`, `exit_m`, `is_obstacle`.
        entry_m: In the model.
        rotation: From the model to the robot's base.
    """

    surfaces: Sequence[Any] = ()
    layers: Sequence[Any] = ()
    entry_m: Array | None = None
    target_m: Array | None = None
    rotation: Array = np.eye(3)
    translation_m: Array = np.zeros(3)

    def to_robot(self, points_m: ArrayLike) -> Array:
        """Points of the model in the robot's base."""
        return np.asarray(points_m, dtype=float) @ self.rotation.T + self.translation_m


EMPTY = PlanScene()  # neither anatomy nor plan


class ArmNodes:
    """The arm: its URDF's own shapes, else a line through its joints; z of its tool:
    the needle.
    """

    def __init__(
        self, server: Any, robot: Robot, urdf_path: Path | None = None
    ) -> None:
        self._data = robot.create_data()
        self._server = server
        self._robot = robot
        self._shapes: Any = None
        if urdf_path is not None:
            from viser.extras import ViserUrdf

            self._shapes = ViserUrdf(server, urdf_path, root_node_name="/arm")
            shown = self._shapes.get_actuated_joint_names()
            names = robot.joint_names
            self._order = [shown.index(name) for name in names]
            self._shown_rad = np.zeros(
                len(shown)
            )  # what the robot lacks, it holds at zero
        self._needle = server.scene.add_cylinder(
            "/needle", radius=NEEDLE_RADIUS_m, height=NEEDLE_m, color=(200, 200, 210)
        )

    def update(self, q_rad: ArrayLike) -> tuple[Array, Array]:
        """Move it; returns the tip and the needle's direction, base axes."""
        q = np.asarray(q_rad, dtype=float)
        model = self._robot.model
        data = self._data
        pin.framesForwardKinematics(model, data, q)
        pose = data.oMf[self._robot.tool_frame_id]
        tip = pose.translation.copy()
        axis = pose.rotation[:, 2].copy()
        if self._shapes is not None:
            self._shown_rad[self._order] = q
            self._shapes.update_cfg(self._shown_rad)
        else:
            places = np.array(
                [data.oMi[k].translation for k in range(model.njoints)] + [tip]
            )
            _add_lines(self._server, "/bones", places, (90, 100, 120), 6.0)
        self._needle.position = tuple(tip - 0.5 * NEEDLE_m * axis)
        self._needle.wxyz = turned_to(axis)
        return tip, axis


def turned_to(axis: Array) -> tuple[float, ...]:
    """Quaternion (w, x, y, z) that turns the z axis to a direction."""
    # x to the right of the first view, where labels stand.
    right = RIGHT if abs(axis @ RIGHT) < 0.9 else np.array([0.0, 0.0, 1.0])
    side = right - (right @ axis) * axis
    side /= np.linalg.norm(side)
    found = pin.Quaternion(np.column_stack([side, np.cross(axis, side), axis]))
    return float(found.w), float(found.x), float(found.y), float(found.z)


def add_anatomy(server: Any, plan: PlanScene) -> None:
    """Translucent structures, the planned way, and a ring with a name at every
    boundary.
    """
    for surface in plan.surfaces:
        vertices = plan.to_robot(surface.vertices_m).astype(np.float32)
        faces = np.asarray(surface.triangles, dtype=np.uint32)
        look = {"opacity": OPACITY, "side": "double"}
        look["color"] = tuple(round(255 * part) for part in surface.colour)
        server.scene.add_mesh_simple(
            f"/anatomy/{surface.name}", vertices, faces, **look
        )
    if plan.entry_m is None or plan.target_m is None:
        return
    entry = plan.to_robot(plan.entry_m)
    target = plan.to_robot(plan.target_m)
    length_m = float(np.linalg.norm(target - entry))
    if not length_m > 0.0:
        raise SceneError(
            f"a plan from {plan.entry_m} to {plan.target_m}: expected two points"
        )
    axis = (target - entry) / length_m
    _add_lines(
        server, "/plan/way", np.array([entry - 0.03 * axis, target]), PLANNED, 2.0
    )
    server.scene.add_icosphere(
        "/plan/target", 3e-3, color=(80, 220, 120), position=tuple(target)
    )
    for k, (layer, behind) in enumerate(
        zip(plan.layers[:-1], plan.layers[1:], strict=True)
    ):
        color = OBSTACLE if behind.is_obstacle else PLANNED
        name = f"/plan/boundary {k + 1}"
        add_ring(server, name, entry + layer.exit_m * axis, axis, color, behind.name)


def add_ring(
    server: Any,
    name: str,
    place: Array,
    axis: Array,
    color: tuple[int, int, int],
    text: str,
) -> list[Any]:
    """A ring about the needle's line with a label: on one side if planned, else on
    the other.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = RING_m * np.stack([np.cos(angle), np.sin(angle), np.zeros(33)], axis=1)
    line = _add_lines(server, name, ring, color, 4.0)
    line.position = tuple(place)
    line.wxyz = turned_to(axis)
    away = (2.0 if color in (FOUND, EXPECTED) else -6.0) * RING_m
    return [
        line,
        server.scene.add_label(f"{name}/label", text, position=(away, 0.0, 0.0)),
    ]


def _add_lines(
    server: Any, name: str, points: Array, color: tuple[int, ...], width: float
) -> Any:
    """A line through points, (n, 3), so many pixels wide."""
    pairs = np.stack([points[:-1], points[1:]], axis=1)
    return server.scene.add_line_segments(
        name, points=pairs, colors=color, thickness=width, thickness_units="screen"
    )
