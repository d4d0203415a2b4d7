"""What stands in the scene: the arm and its needle, structures, planned boundaries, ruptures.

Everything is in the robot's base; anatomy comes through a registration. Surfaces and layers are
those of `needleforce.anatomy`, or anything with the same names.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from urdf import Robot

Array = NDArray[np.float64]

PLANNED, FOUND, OBSTACLE = (235, 235, 235), (255, 205, 0), (220, 60, 40)
OPACITY = 0.35
RING_m = 6e-3
NEEDLE_m, NEEDLE_RADIUS_m = 0.2, 0.8e-3


class PlanScene(NamedTuple):
    """Anatomy and plan as the viewer shows them."""

    surfaces: Sequence[Any] = ()  # with `name`, `colour`, `vertices_m`, `triangles`, in the model
    layers: Sequence[Any] = ()  # with `name`, `exit_m`, `is_obstacle`
    entry_m: Array | None = None  # in the model
    target_m: Array | None = None
    rotation: Array = np.eye(3)  # from the model to the robot's base
    translation_m: Array = np.zeros(3)

    def to_robot(self, points_m: ArrayLike) -> Array:
        """Points of the model in the robot's base."""
        return np.asarray(points_m, dtype=float) @ self.rotation.T + self.translation_m


EMPTY = PlanScene()
"""Neither anatomy nor plan."""


class ArmNodes:
    """The arm: its URDF's own shapes where the file is known, else a line through its joints.

    Args:
        server: The viser server.
        robot: The arm with its tool; z of its tool frame is the needle.
        urdf_path: Its description; None to draw joints only.
    """

    def __init__(self, server: Any, robot: Robot, urdf_path: Path | None = None) -> None:
        self._server, self._robot, self._data = server, robot, robot.create_data()
        self._shapes: Any = None
        self._order: list[int] = []
        if urdf_path is not None:
            from viser.extras import ViserUrdf

            self._shapes = ViserUrdf(server, urdf_path, root_node_name="/arm")
            names = list(robot.joint_names)
            self._order = [names.index(n) for n in self._shapes.get_actuated_joint_names()]
        self._needle = server.scene.add_cylinder(
            "/needle", radius=NEEDLE_RADIUS_m, height=NEEDLE_m, color=(200, 200, 210)
        )
        self._bones: Any = None

    def update(self, q_rad: ArrayLike) -> tuple[Array, Array]:
        """Move it; returns the tip and the needle's direction, base axes."""
        q = np.asarray(q_rad, dtype=float)
        model, data = self._robot.model, self._data
        pin.framesForwardKinematics(model, data, q)
        pose = data.oMf[self._robot.tool_frame_id]
        tip, axis = pose.translation.copy(), pose.rotation[:, 2].copy()
        if self._shapes is not None:
            self._shapes.update_cfg(q[self._order])
        else:
            places = np.array([data.oMi[k].translation for k in range(model.njoints)] + [tip])
            self._bones = self._server.scene.add_line_segments(
                "/bones",
                points=np.stack([places[:-1], places[1:]], axis=1),
                colors=(90, 100, 120),
                thickness=6.0,
                thickness_units="screen",
            )
        self._needle.position = tuple(tip - 0.5 * NEEDLE_m * axis)
        self._needle.wxyz = turned_to(axis)
        return tip, axis


def turned_to(axis: Array) -> tuple[float, ...]:
    """Quaternion (w, x, y, z) that turns the z axis to a direction."""
    found = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis)
    return float(found.w), float(found.x), float(found.y), float(found.z)


def add_anatomy(server: Any, plan: PlanScene) -> list[Any]:
    """Translucent structures, the planned way, and a ring with a name at every boundary."""
    handles = []
    for surface in plan.surfaces:
        color = tuple(round(255 * part) for part in surface.colour)
        handles.append(
            server.scene.add_mesh_simple(
                f"/anatomy/{surface.name}",
                plan.to_robot(surface.vertices_m).astype(np.float32),
                np.asarray(surface.triangles, dtype=np.uint32),
                color=color,
                opacity=OPACITY,
                side="double",
            )
        )
    if plan.entry_m is None or plan.target_m is None:
        return handles
    entry, target = plan.to_robot(plan.entry_m), plan.to_robot(plan.target_m)
    axis = (target - entry) / np.linalg.norm(target - entry)
    way = np.array([[entry - 0.03 * axis, target]])
    server.scene.add_line_segments(
        "/plan/way", points=way, colors=PLANNED, thickness=2.0, thickness_units="screen"
    )
    server.scene.add_icosphere("/plan/target", 3e-3, color=(80, 220, 120), position=tuple(target))
    for k, (layer, behind) in enumerate(zip(plan.layers[:-1], plan.layers[1:], strict=True)):
        color = OBSTACLE if behind.is_obstacle else PLANNED
        name = f"/plan/boundary {k + 1}"
        add_ring(server, name, entry + layer.exit_m * axis, axis, color, behind.name)
    return handles


def add_ring(
    server: Any, name: str, place: Array, axis: Array, color: tuple[int, int, int], text: str
) -> list[Any]:
    """A ring about the needle's line with a label: on one side if found, else on the other."""
    side = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle = np.linspace(0.0, 2.0 * np.pi, 33)[:, None]
    ring = place + RING_m * (np.cos(angle) * side + np.sin(angle) * np.cross(axis, side))
    points = np.stack([ring[:-1], ring[1:]], axis=1)
    line = server.scene.add_line_segments(
        name, points=points, colors=color, thickness=4.0, thickness_units="screen"
    )
    away = (2.0 if color == FOUND else -6.0) * RING_m
    label = server.scene.add_label(f"{name}/label", text, position=tuple(place + away * side))
    return [line, label]
