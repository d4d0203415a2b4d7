"""A scene as one page that needs nothing else: film, CT, forces, ruptures, legend.

viser exports the 3-D part alone, so it stands in a frame of our own page. What lies
around it follows the time of the frame's player.
"""

import json
import math
import secrets
from base64 import b64encode
from collections.abc import Sequence
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.files import whole_file
from needleforce.plots import DrawnChart, require_matplotlib
from needleforce.scene.film import Film
from needleforce.scene.force_charts import ForceCharts
from needleforce.scene.legend import LegendLine
from needleforce.scene.page_policy import page_policy, with_nonce
from needleforce.scene.row_text import MEANINGS
from needleforce.scene.scan_slices import TITLES
from needleforce.scene.state_ring import SceneError
from needleforce.scene.title_bar import NOTE

TEMPLATE = "export_page.html"

STRIP_COLUMNS = 12
"""Pictures side by side in a strip; browsers refuse pictures of 2¹⁵ pixels."""

JPEG_QUALITY = 80
"""Per cent; a picture of the CT then takes some 4 kB."""

NONCE_BYTES = 16
"""Of randomness in what marks the page's own scripts."""

PURPOSE = "an exported scene"


class SceneWords(NamedTuple):
    """What a page says beside the picture.

    Attributes:
        title: Of the page.
        warnings: What is wrong with the plan, or could not be checked.
        legend: What marks and colours stand for.
    """

    title: str
    warnings: Sequence[str]
    legend: Sequence[LegendLine]


class SliceStrip(NamedTuple):
    """The pictures of one plane, side by side in one picture.

    Attributes:
        title: What they show.
        address: The picture as the address of an image.
        columns: Pictures side by side.
        rows: Rows of them.
    """

    title: str
    address: str
    columns: int
    rows: int


def require_export() -> None:
    """Find out before the work whether a page could be written after it.

    Raises:
        MissingExtraError: matplotlib or jinja2 is not installed.
    """
    require_matplotlib(PURPOSE)


def write_scene_page(
    path: Path,
    scene: str,
    words: SceneWords,
    film: Film | None = None,
    charts: ForceCharts | None = None,
) -> Path:
    """Write a page, whole or not at all.

    Args:
        path: The page.
        scene: The 3-D part, as viser exports it.
        words: What is said beside it.
        film: What happens in it; None for a scene that stands.
        charts: The forces of the film.

    Returns:
        Its path.

    Raises:
        MissingExtraError: As `require_export`.
        SceneError: The file cannot be written.
    """
    require_export()
    from jinja2 import Environment

    environment = Environment(autoescape=True)
    environment.filters["base64"] = lambda text: b64encode(text.encode()).decode()
    template = environment.from_string(
        files("needleforce.scene").joinpath(TEMPLATE).read_text(encoding="utf-8")
    )
    nonce = secrets.token_urlsafe(NONCE_BYTES)
    text = template.render(
        nonce=nonce,
        policy=page_policy(nonce),
        note=NOTE,
        words=words,
        scene=with_nonce(scene, nonce),
        strips=() if film is None else slice_strips(film),
        charts=charts,
        ruptures=() if film is None else film.ruptures,
        film=None if film is None else film_data(film, charts),
    )
    try:
        with whole_file(path) as file:
            file.write(text.encode())
    except OSError as error:
        raise SceneError(
            f"cannot write {path}: {error.strerror}",
            "Give a place that can be written to.",
        ) from error
    return path


def slice_strips(film: Film) -> tuple[SliceStrip, ...]:
    """Return the strip of each plane of the CT; none without a CT."""
    planes = zip(*film.slices, strict=True)
    return tuple(
        _strip(title, pictures) for title, pictures in zip(TITLES, planes, strict=False)
    )


def _strip(title: str, pictures: Sequence[NDArray[np.uint8]]) -> SliceStrip:
    """Return pictures, each of shape (n, n, 3), as one strip of rows."""
    from matplotlib.image import imsave

    rows = -(-len(pictures) // STRIP_COLUMNS)
    height, width, channels = pictures[0].shape
    strip = np.zeros((rows * height, STRIP_COLUMNS * width, channels), np.uint8)
    for number, picture in enumerate(pictures):
        row, column = divmod(number, STRIP_COLUMNS)
        top = row * height
        left = column * width
        strip[top : top + height, left : left + width] = picture
    buffer = BytesIO()
    imsave(buffer, strip, format="jpeg", pil_kwargs={"quality": JPEG_QUALITY})
    content = b64encode(buffer.getvalue()).decode()
    return SliceStrip(title, f"data:image/jpeg;base64,{content}", STRIP_COLUMNS, rows)


def film_data(film: Film, charts: ForceCharts | None) -> str:
    """Return the film as JSON, which may stand inside a script."""
    data: dict[str, Any] = {
        "frames": [frame._asdict() for frame in film.frames],
        "ruptures": [
            {
                "time_s": one.time_s,
                "until_s": one.until_s if math.isfinite(one.until_s) else None,
            }
            for one in film.ruptures
        ],
        "banners": MEANINGS,
        "columns": STRIP_COLUMNS,
        "charts": {}
        if charts is None
        else {
            "time_s": _chart_data(charts.over_time),
            "depth_mm": _chart_data(charts.over_depth),
        },
    }
    return json.dumps(data, allow_nan=False).replace("<", "\\u003c")


def _chart_data(chart: DrawnChart) -> dict[str, float]:
    """Return where values stand in a chart."""
    first, last = chart.x_limits
    return {
        "left": chart.left,
        "right": chart.right,
        "top": chart.top,
        "bottom": chart.bottom,
        "first": float(first),
        "last": float(last),
    }
