"""A plan without an arm as one 3-D page."""

from pathlib import Path

import numpy as np

from needleforce.scene import nodes
from needleforce.scene.export_page import write_scene_page
from needleforce.scene.guarded_server import PageAccess, open_server, stop_server
from needleforce.scene.legend import legend_lines
from needleforce.scene.structure_list import add_surfaces


def export_plan(plan: nodes.PlanScene, path: Path) -> Path:
    """Write structures and path of a plan as one page that needs nothing else.

    Args:
        plan: Anatomy and plan, with entry and target.
        path: The page.

    Returns:
        Its path.
    """
    host = "127.0.0.1"
    # The system chooses a free port.
    server = open_server(host, 0, "needleforce plan", PageAccess.of_host(host))
    try:
        server.scene.set_up_direction("+z")
        add_surfaces(server, plan)
        nodes.add_path(server, plan)
        planned = plan.path
        if planned is not None:
            camera = server.initial_camera
            camera.look_at = tuple(planned.target_m)
            # Behind the entry and a little to the head.
            camera.position = tuple(
                planned.target_m - 0.45 * planned.axis + np.array([0.0, 0.0, 0.15])
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
