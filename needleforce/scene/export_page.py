"""A scene as one page that needs nothing else: film, forces, CT, ruptures, legend.

viser records the 3-D part alone, which plays by itself, so it stands in a frame of a
page like all others.
"""

import math
import secrets
from collections.abc import Sequence
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.plots import (
    Page,
    PageFigure,
    PageTable,
    Section,
    WriteError,
    require_matplotlib,
    write_page,
)
from needleforce.scene import nodes
from needleforce.scene.force_plots import CURVES, force_table, places_of
from needleforce.scene.moment import Moment, SceneError
from needleforce.scene.scan_slices import TITLES
from needleforce.scene.words import MEANINGS, NOTE, find_banner

if TYPE_CHECKING:
    from needleforce.scene.viewer import Mark


def write_scene_page(
    path: Path,
    scene: str,
    plan: nodes.PlanScene,
    *,
    warnings: Sequence[str] = (),
    card: str = "",
    sections: Sequence[Section] = (),
    has_needle: bool = False,
) -> Path:
    """Write a page, whole or not at all.

    Args:
        path: The page.
        scene: The 3-D part, as viser exports it.
        plan: Anatomy and plan.
        warnings: What is wrong beside the plan's own warnings.
        card: The clinician's view where the needle was deepest, as HTML.
        sections: What is said below the scene.
        has_needle: Whether an insertion is shown.

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
        for color, text in nodes.legend_of(plan, has_needle=has_needle)
    )
    words = Section(heading="What is what", anchor="legend", legend=legend)
    page = Page(
        title="needleforce",
        lead=(NOTE,),
        notices=tuple(f"Warning: {one}" for one in (*plan.warnings, *warnings)),
        policy=policy,
        scene=marked,
        card=card,
        sections=(*sections, words),
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


def write_insertion_page(
    path: Path,
    scene: str,
    plan: nodes.PlanScene,
    moments: Sequence[Moment],
    marks: Sequence["Mark"],
    *,
    card: str,
    pictures: Sequence[NDArray[np.uint8]],
) -> Path:
    """Write an insertion.

    Args:
        path: The page.
        scene: The film.
        plan: Anatomy and plan.
        moments: At least one.
        marks: The ruptures.
        card: The clinician's view where the needle was deepest.
        pictures: The CT there; none without a CT.

    Raises:
        SceneError: The file cannot be written.
        MissingExtraError: matplotlib or jinja2 is not installed.
    """
    require_matplotlib("an exported scene")
    start_s = moments[0].estimate.time_s
    rows = tuple(
        (f"{mark.time_s - start_s:.1f}", _describe_mark(mark, start_s))
        for mark in marks
    )
    table = PageTable(
        caption="Detected ruptures", head=("time in the film [s]", "what"), rows=rows
    )
    ruptures = Section(
        heading="Ruptures",
        anchor="ruptures",
        paragraphs=() if rows else ("None was detected.",),
        tables=(table,) if rows else (),
    )
    sections = [ruptures, _force_section(moments, [mark.time_s for mark in marks])]
    if len(pictures):
        figures = tuple(
            PageFigure(path=_png_of(picture), alt=title, caption=title)
            for title, picture in zip(TITLES, pictures, strict=True)
        )
        heading = "CT at the needle, where it was deepest"
        sections.append(Section(heading=heading, anchor="ct", figures=figures))
    return write_scene_page(
        path,
        scene,
        plan,
        warnings=_describe_banners(moments),
        card=card,
        sections=sections,
        has_needle=True,
    )


def _describe_mark(mark: "Mark", start_s: float) -> str:
    """Return a rupture, and when it was retracted."""
    if math.isinf(mark.until_s):
        return mark.text
    return f"{mark.text}; retracted at {mark.until_s - start_s:.1f} s"


def _describe_banners(moments: Sequence[Moment]) -> list[str]:
    """Return when verdicts were shown large, such as that the needle is off plan."""
    start_s = moments[0].estimate.time_s
    texts: list[str] = []
    for banner, group in groupby(moments, key=lambda moment: find_banner(moment[1])):
        times_s = [estimate.time_s - start_s for _, estimate in group]
        if banner:
            texts.append(
                f"{banner.upper()} from {times_s[0]:.1f} to {times_s[-1]:.1f} s of the "
                f"film: {MEANINGS[banner]}"
            )
    return texts


def _png_of(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture as PNG."""
    from PIL import Image

    buffer = BytesIO()
    Image.fromarray(picture).save(buffer, "png")
    return buffer.getvalue()


def _force_section(moments: Sequence[Moment], events_s: Sequence[float]) -> Section:
    """Return the forces of moments over time and over depth.

    Args:
        moments: At least one.
        events_s: When ruptures were detected.
    """
    table = force_table(moments)
    figures = tuple(
        PageFigure(
            path=_draw_forces(label, places, rows, events_s),
            alt=f"Axial force, tip force and enhanced force over {label}",
            caption=f"Forces over {label}; bands: two standard deviations; marks: "
            "detected ruptures.",
        )
        for label, (places, rows) in places_of(table).items()
    )
    return Section(heading="Forces", anchor="forces", figures=figures)


def _draw_forces(
    label: str, places: Array, rows: Array, events_s: Sequence[float]
) -> bytes:
    """Return a drawing of all forces of rows over places of an axis, as SVG."""
    from matplotlib.figure import Figure

    figure = Figure((4.4, 3.0), layout="constrained")
    axes = figure.subplots()
    for name, color, dash, column in CURVES:
        force_N = rows[:, column]
        axes.plot(places, force_N, dash, color=color, label=f"{name} [N]")
        if column < CURVES[-1][3]:
            band_N = 2.0 * rows[:, column + 1]
            axes.fill_between(
                places, force_N - band_N, force_N + band_N, color=color, alpha=0.2
            )
    indices = np.searchsorted(rows[:, 0], events_s)
    marked = places[indices[indices < len(places)]]
    bottom = axes.get_ylim()[0]
    axes.plot(marked, np.full(len(marked), bottom), "k|", markersize=12)
    axes.set(xlabel=label, ylabel="force [N]")
    figure.legend(loc="outside lower left", ncols=3, fontsize=8)
    buffer = BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
