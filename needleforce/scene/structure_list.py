"""The structures of a scene: each can be hidden, or made more or less see-through."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from needleforce.scene.nodes import PlanScene, color_of

FAINT_OPACITY = 0.06


def usual_opacity(name: str) -> float:
    """Return how opaque a structure is at first."""
    words = name.lower().replace("_", " ").split()
    # Such structures surround all others.
    faint = ("fat", "skin", "body", "lean", "muscle", "cavity")
    return FAINT_OPACITY if any(word in words for word in faint) else 0.25


def add_surfaces(server: Any, plan: PlanScene) -> dict[str, Any]:
    """Add the surfaces of the structures; return their nodes by name."""
    nodes: dict[str, Any] = {}
    for surface in plan.surfaces:
        nodes[surface.name] = server.scene.add_mesh_simple(
            f"/anatomy/{surface.name}",
            plan.to_robot(surface.vertices_m).astype(np.float32),
            np.asarray(surface.triangles, dtype=np.uint32),
            color=color_of(surface.colour),
            opacity=usual_opacity(surface.name),
            side="double",
        )
    return nodes


class StructureList:
    """The list beside the scene: a box and a slider for each structure.

    Args:
        server: Of the page.
        nodes: The structures by name.
    """

    def __init__(self, server: Any, nodes: dict[str, Any]) -> None:
        self.sliders: dict[str, Any] = {}
        self.boxes: dict[str, Any] = {}
        for name in sorted_names(nodes):
            self._add_line(server.gui, name, nodes[name])

    def _add_line(self, gui: Any, name: str, node: Any) -> None:
        """Add box and slider of a structure."""
        shown = name.replace("_", " ")
        box = gui.add_checkbox(shown, True)
        slider = gui.add_slider(
            "opacity", 0.0, 1.0, 0.02, usual_opacity(name), hint=shown
        )

        def show(_event: Any) -> None:
            node.visible = box.value

        def fade(_event: Any) -> None:
            node.opacity = slider.value

        box.on_update(show)
        slider.on_update(fade)
        self.boxes[name] = box
        self.sliders[name] = slider


def sorted_names(names: Iterable[str]) -> Sequence[str]:
    """Return names of structures in order, those of faint ones last."""
    return sorted(names, key=lambda name: (usual_opacity(name) == FAINT_OPACITY, name))
