"""A scene as one page that needs nothing else: film, ruptures, warnings, legend.

viser records the 3-D part alone, which plays by itself, so it stands in a frame of a
page like all others.
"""

import secrets
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from needleforce.plots import Page, Section, WriteError, write_page
from needleforce.scene import nodes
from needleforce.scene.moment import SceneError
from needleforce.scene.words import NOTE


def write_scene_page(
    path: Path,
    scene: str,
    plan: nodes.PlanScene,
    ruptures: Sequence[str] | None = None,
) -> Path:
    """Write a page, whole or not at all.

    Args:
        path: The page.
        scene: The 3-D part, as viser exports it.
        plan: Anatomy and plan.
        ruptures: Those of an insertion in words; None of a plan alone.

    Raises:
        SceneError: The file cannot be written.
    """
    # viser's own scripts have a nonce and run; what came in by a name has none. Its
    # WebAssembly builds functions from text.
    nonce = secrets.token_urlsafe(16)
    loader = 'document.createElement("script");'
    marked = scene.replace("<script", f'<script nonce="{nonce}"')
    marked = marked.replace(loader, f'{loader}e.nonce="{nonce}";')
    policy = (
        f"default-src 'none'; script-src 'nonce-{nonce}' 'unsafe-eval'; "
        "worker-src blob: data:; connect-src blob: data:; img-src blob: data:; "
        "font-src data:; style-src 'unsafe-inline'"
    )
    square = "display:inline-block;width:1em;height:.8em;margin-right:.6em;background:"
    legend = tuple(
        (f"{square}{color}", text)
        for color, text in nodes.legend_of(plan, has_needle=ruptures is not None)
    )
    sections = [Section(heading="What is what", anchor="legend", legend=legend)]
    if ruptures is not None:
        said = tuple(ruptures) or ("None was detected.",)
        found = Section(heading="Ruptures", anchor="ruptures", paragraphs=said)
        sections.insert(0, found)
    page = Page(
        title="needleforce",
        lead=(NOTE,),
        notices=tuple(f"Warning: {warning}" for warning in plan.warnings),
        policy=policy,
        scene=marked,
        sections=tuple(sections),
    )
    try:
        return write_page(path, page)
    except WriteError as error:
        raise SceneError(str(error), "Give a place that can be written to.") from error


def export_plan(plan: nodes.PlanScene, path: Path) -> Path:
    """Write structures and path of a plan, without an arm, as one page.

    Args:
        plan: Anatomy and plan, with entry and target.
        path: The page.
    """
    from needleforce.scene.viewer import open_server, stop_server

    server = open_server(0, "needleforce plan")
    try:
        nodes.add_plan(server, plan)
        planned = plan.path
        if planned is not None:
            camera = server.initial_camera
            camera.look_at = planned.target_m
            # Behind the entry and a little to the head.
            above_m = np.array([0.0, 0.0, 0.15])
            camera.position = planned.target_m - 0.45 * planned.axis + above_m
        scene = server.get_scene_serializer().as_html()
    finally:
        stop_server(server)
    return write_scene_page(path, scene, plan)
