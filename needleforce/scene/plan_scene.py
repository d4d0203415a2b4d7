"""A plan without an arm as one 3-D page."""

from pathlib import Path

import numpy as np

from needleforce.scene import nodes
from needleforce.scene.export_page import write_scene_page
from needleforce.scene.guarded_server import PageAccess, open_server, stop_server
from needleforce.scene.legend import legend_lines
from needleforce.scene.structure_list import add_surfaces

CAMERA_DISTANCE_M = 0.45
"""From the target, behind the entry and a little to the head."""

HOST = "127.0.0.1"
ANY_PORT = 0
"""The system chooses a free one."""


def export_plan(plan: nodes.PlanScene, path: Path) -> Path:
    """Write structures and path of a plan as one page that needs nothing else.

    Args:
        plan: Anatomy and plan, with entry and target.
        path: The page.

    Returns:
        Its path.
    """
    access = PageAccess.of_host(HOST)
    server = open_server(HOST, ANY_PORT, "needleforce plan", access)
    try:
        server.scene.set_up_direction("+z")
        add_surfaces(server, plan)
        nodes.add_path(server, plan)
        if plan.entry_m is not None and plan.target_m is not None:
            entry_m = plan.to_robot(plan.entry_m)
            target_m = plan.to_robot(plan.target_m)
            outward = (entry_m - target_m) / np.linalg.norm(entry_m - target_m)
            camera = server.initial_camera
            camera.look_at = tuple(target_m)
            camera.position = tuple(
                target_m + CAMERA_DISTANCE_M * outward + np.array([0.0, 0.0, 0.15])
            )
        page = server.get_scene_serializer().as_html()
    finally:
        stop_server(server)
    return write_scene_page(
        path,
        page,
        "needleforce: plan",
        warnings=plan.warnings,
        legend=legend_lines(plan, has_needle=False),
    )
