"""A scene as one page that needs nothing else: film, forces, CT, ruptures, legend.

viser exports the 3-D part alone, which plays by itself, so it stands in a frame of a
page like all others.
"""

import math
import secrets
from collections.abc import Iterable, Sequence
from io import BytesIO
from itertools import groupby
from pathlib import Path

import numpy as np

from foundation.arrays import Array
from needleforce.plots import (
    Chart,
    Curve,
    Instants,
    LineStyle,
    Page,
    PageFigure,
    PageTable,
    Panel,
    Section,
    WriteError,
    draw_svg,
    palette,
    write_page,
)
from needleforce.scene.force_plots import (
    COLUMN,
    CURVES,
    FORCE_LABEL,
    M_TO_MM,
    TIME_LABEL,
    ForceCurve,
    deepest_rows,
    shown_rows,
)
from needleforce.scene.legend import LegendLine, sample_style
from needleforce.scene.page_policy import page_policy, with_nonce
from needleforce.scene.row_text import MEANINGS
from needleforce.scene.scan_slices import TITLES, SlicePictures
from needleforce.scene.state_ring import SceneError
from needleforce.scene.title_bar import NOTE

MIN_FILM_s = 0.05
"""A film lasts at least so long."""


def film_times_s(times_s: Array, events_s: Iterable[float], count: int) -> Array:
    """Return when the pictures of a film are taken, shape (n,) [s].

    Args:
        times_s: Of the rows, shape (m,).
        events_s: Of ruptures, each of which gets a picture of its own.
        count: Pictures beside those of ruptures.
    """
    start_s = float(times_s[0])
    end_s = max(float(times_s[-1]), start_s + MIN_FILM_s)
    regular_s = np.linspace(start_s, end_s, max(count, 2))
    shown_s = np.unique(np.concatenate([regular_s, np.array([*events_s])]))
    # Pictures closer in time than a millisecond are one.
    return shown_s[np.diff(shown_s, prepend=-np.inf) >= 1e-3]


def write_scene_page(
    path: Path,
    scene: str,
    title: str,
    *,
    warnings: Sequence[str],
    legend: Sequence[LegendLine],
    card: str = "",
    sections: Sequence[Section] = (),
) -> Path:
    """Write a page, whole or not at all.

    Args:
        path: The page.
        scene: The 3-D part, as viser exports it.
        title: Of the page.
        warnings: What is wrong, or could not be checked.
        legend: What marks and colours stand for.
        card: The clinician's view where the needle was deepest, as HTML.
        sections: What is said below the scene.

    Returns:
        Its path.

    Raises:
        SceneError: The file cannot be written.
    """
    nonce = secrets.token_urlsafe(16)
    lines = tuple((sample_style(line), line.text) for line in legend)
    words = Section(heading="What is what", anchor="legend", legend=lines)
    page = Page(
        title=title,
        lead=(NOTE,),
        notices=tuple(f"Warning: {warning}" for warning in warnings),
        policy=page_policy(nonce),
        scene=with_nonce(scene, nonce),
        card=card,
        sections=(*sections, words),
    )
    try:
        return write_page(path, page)
    except WriteError as error:
        raise SceneError(str(error), "Give a place that can be written to.") from error


def describe_banners(times_s: Array, banners: Iterable[str]) -> list[str]:
    """Return in words when what was shown large, such as that the needle is off plan.

    Args:
        times_s: When each was shown, shape (n,), from the start of the film.
        banners: What was shown; empty for nothing.
    """
    texts: list[str] = []
    shown = zip(times_s.tolist(), banners, strict=True)
    for banner, moments in groupby(shown, key=lambda moment: moment[1]):
        start_s, *_, end_s = [time_s for time_s, _ in moments] * 2
        if banner:
            texts.append(
                f"{banner} from {start_s:.1f} to {end_s:.1f} s of the film: "
                f"{MEANINGS[banner]}"
            )
    return texts


def rupture_section(ruptures: Iterable[tuple[float, float, str]]) -> Section:
    """Return what was detected.

    Args:
        ruptures: When each was detected and when that was retracted, from the start of
            the film [s], infinite for one that stands; its depth and what it was.
    """
    rows = tuple(
        (
            f"{time_s:.1f}",
            text if math.isinf(until_s) else f"{text}; retracted at {until_s:.1f} s",
        )
        for time_s, until_s, text in ruptures
    )
    table = PageTable(
        caption="Detected ruptures", head=("time in the film [s]", "what"), rows=rows
    )
    return Section(
        heading="Ruptures",
        anchor="ruptures",
        paragraphs=() if rows else ("None was detected.",),
        tables=(table,) if rows else (),
    )


def slice_section(pictures: SlicePictures) -> Section:
    """Return the CT at the needle."""
    from matplotlib.image import imsave

    figures: list[PageFigure] = []
    for title, picture in zip(TITLES, pictures, strict=True):
        buffer = BytesIO()
        imsave(buffer, picture, format="png")
        figures.append(PageFigure(path=buffer.getvalue(), alt=title, caption=title))
    return Section(
        heading="CT at the needle, where it was deepest",
        anchor="ct",
        figures=tuple(figures),
    )


def force_section(
    rows: Array, zero_m: float, zero_name: str, events_s: Sequence[float]
) -> Section:
    """Return the forces of rows, shape (n, k), over time and over depth.

    Args:
        rows: See `view_row`.
        zero_m: Depth from which shown depths count.
        zero_name: Of that depth, such as ``below first contact``.
        events_s: When ruptures were detected [s].
    """
    start_s = rows[0, COLUMN["time_s"]]
    rows = shown_rows(rows)
    deepest = deepest_rows(rows)
    times_s = rows[:, COLUMN["time_s"]] - start_s
    depths_mm = M_TO_MM * (deepest[:, COLUMN["depth_m"]] - zero_m)
    numbers = np.searchsorted(deepest[:, COLUMN["time_s"]], np.array(events_s))
    events_mm = depths_mm[np.clip(numbers, 0, max(len(depths_mm) - 1, 0))]
    shown_s = (np.array(events_s) - start_s).tolist()
    charts = {
        "time in the film": _chart(TIME_LABEL, rows, times_s, shown_s),
        "depth": _chart(
            f"depth {zero_name} [mm]", deepest, depths_mm, events_mm.tolist()
        ),
    }
    figures = tuple(
        PageFigure(
            path=draw_svg(chart),
            alt=f"Axial force, tip force and enhanced force over {axis}",
            caption=f"Forces over {axis}; bands: two standard deviations.",
        )
        for axis, chart in charts.items()
    )
    return Section(heading="Forces", anchor="forces", figures=figures)


def _chart(x_label: str, rows: Array, x: Array, events: Sequence[float]) -> Chart:
    """Return a chart of all forces of rows over places of an axis, shape (n,)."""
    ruptures = LineStyle(color=palette.ORANGE, marker="|", width_pt=2.0, size_pt=11.0)
    return Chart(
        title="Forces",
        x_label=x_label,
        panels=(
            Panel(
                y_label=FORCE_LABEL,
                curves=tuple(_curve(curve, rows, x) for curve in CURVES),
            ),
        ),
        instants=(Instants("rupture", ruptures, tuple(events)),),
        height_in=2.6,
    )


def _curve(curve: ForceCurve, rows: Array, x: Array) -> Curve:
    """Return one force of rows with its band."""
    std_N = rows[:, COLUMN[curve.std_field]] if curve.std_field else None
    dash = (0.0, curve.dash) if curve.dash else "-"
    return Curve(
        style=LineStyle(color=curve.hex_color, dash=dash),
        x=x,
        y=rows[:, COLUMN[curve.field]],
        label=f"{curve.name} [N]",
        std=std_N,
    )
