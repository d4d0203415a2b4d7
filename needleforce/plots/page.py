"""One HTML page that needs nothing but itself: no network, no other file, no script."""

import re
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from needleforce.plots import chart as charts

MEDIA_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}
PAGE = "index.html"  # in the folder of a report


@dataclass(frozen=True, slots=True, kw_only=True)
class PageFigure:
    """A figure of a page.

    Attributes:
        path: SVG or PNG; its content goes into the page.
        alt: What it shows, for those who cannot see it.
        caption: Text between backticks becomes code, as everywhere on a page.
        wide: The same for wide screens and print, alone in its row.
    """

    path: Path
    alt: str
    caption: str
    wide: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PageTable:
    """A table of a page; raises `ChartError` where a row is longer or shorter than
    the head.

    Attributes:
        caption: Stands above.
        head: Of the columns; empty texts for none.
        numeric: columns, from 0, whose cells line up on the right.
        note: Stands below.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: frozenset[int] = frozenset()
    note: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.head):
                raise charts.ChartError(
                    f"table {self.caption!r} has a row of {len(row)} cells under {len(self.head)} "
                    "heads; give one cell per head"
                )


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of a page.

    Attributes:
        anchor: Id within the page.
        notices: Text that must not be overlooked.
        command: As typed.
        figures: Side by side where there is room.
    """

    heading: str
    anchor: str
    paragraphs: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    command: str = ""
    figures: tuple[PageFigure, ...] = ()
    tables: tuple[PageTable, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """Title, paragraphs under it, and sections, listed above where there are at
    least three.
    """

    title: str
    lead: tuple[str, ...] = ()
    sections: tuple[Section, ...] = ()

    def html(self) -> str:
        """The whole page; raises `WriteError` where a figure cannot be read."""
        from jinja2 import Environment
        from markupsafe import Markup, escape

        def inline(text: str) -> Markup:
            code = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text)))
            return Markup(code.replace("\n", "<br>"))

        environment = Environment(autoescape=True)
        environment.filters |= {"inline": inline, "data_uri": _data_uri}
        source = (
            files("needleforce.plots").joinpath("page.html").read_text(encoding="utf-8")
        )
        return charts.printable(environment.from_string(source).render(page=self))


def _data_uri(path: Path) -> str:
    """As an image, not as elements of the page: names inside two drawings cannot
    clash.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise charts.WriteError(
            f"cannot read {path}: {error.strerror or error}"
        ) from error
    return f"data:{MEDIA_TYPES[path.suffix]};base64,{b64encode(content).decode()}"


def write_page(path: str | Path, page: Page) -> Path:
    """Write a page as HTML file, whole or not at all (`WriteError`), and return its
    path.
    """
    return charts.write_file(path, page.html().encode())


def save_page_figure(
    chart: charts.Chart, path: Path, *, alt: str, caption: str, is_alone: bool = False
) -> PageFigure:
    """Save a chart as a figure of a page; one that stands alone also as
    ``NAME-wide``.
    """
    wide = None
    if is_alone:
        place = path.with_stem(f"{path.stem}-wide")
        wide = charts.save_figure(replace(chart, width_in=charts.WIDE_IN), place)
    return PageFigure(
        path=charts.save_figure(chart, path), alt=alt, caption=caption, wide=wide
    )


def settings_table(settings: Any, caption: str) -> PageTable:
    """One line per field of a dataclass; of a dataclass within it ``outer.inner``."""
    return PageTable(
        caption=caption, head=("setting", "value"), rows=tuple(_rows(settings, ""))
    )


def _rows(settings: Any, prefix: str) -> Iterator[tuple[str, str]]:
    for item in fields(settings):
        value = getattr(settings, item.name)
        name = f"{prefix}{item.name}"
        if is_dataclass(value):
            yield from _rows(value, f"{name}.")
            continue
        values = (
            value
            if isinstance(value, tuple | list)
            else (value,)
            if value is not None
            else ()
        )
        texts = [
            f"{each:g}" if isinstance(each, float) else str(each) for each in values
        ]
        yield f"`{name}`", ", ".join(texts) or "none"


@contextmanager
def folder_if_filled(path: str | Path | None) -> Iterator[Path | None]:
    """Make the folder of a report (if any) before the work; if it stays empty,
    remove it after.
    """
    if path is None:
        yield None
        return
    charts.require_matplotlib("--report")
    folder = Path(path)
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise charts.WriteError(
            f"cannot write to {folder}: {error.strerror or error}"
        ) from error
    try:
        yield folder
    finally:
        with suppress(
            OSError
        ):  # one that holds something is not removed, nor those it lies in
            for each in made:
                each.rmdir()
