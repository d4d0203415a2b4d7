"""One HTML page that needs nothing but itself: no network, no other file, no script."""

import re
from base64 import b64encode
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd

from needleforce.plots.drawing import printable, write_file
from needleforce.plots.errors import write_errors

PAGE = "index.html"
"""Name of the page in the folder of a report."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PageFigure:
    """A figure of a page.

    Attributes:
        path: File of an SVG or PNG, or its content; that goes into the page.
        alt: What it shows, for those who cannot see it.
        caption: Text between backticks becomes code, as everywhere on a page.
        wide: The same for wide screens and print, alone in its row.
    """

    path: Path | bytes
    alt: str
    caption: str
    wide: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PageTable:
    """A table of a page.

    Attributes:
        caption: Stands above.
        head: Heads of the columns; empty texts for none.
        rows: Cells of every row.
        numeric: Columns, from 0, whose cells line up on the right.
        note: Stands below.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: frozenset[int] = frozenset()
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of a page.

    Attributes:
        heading: Its heading.
        anchor: Its id within the page.
        paragraphs: Its text.
        notices: Text that must not be overlooked.
        figures: Its figures, side by side where there is room.
        tables: Its tables.
        legend: CSS of a sample of a colour, and what it stands for.
    """

    heading: str
    anchor: str
    paragraphs: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    figures: tuple[PageFigure, ...] = ()
    tables: tuple[PageTable, ...] = ()
    legend: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """A page.

    Attributes:
        title: Its title.
        lead: Paragraphs under the title.
        notices: Text below them that must not be overlooked.
        tables: Tables below those.
        sections: Its sections, listed above where there are at least three.
        scene: A page of its own that stands in a frame above the sections; empty for
            none.
        policy: What the page and its scene may run and fetch.
    """

    title: str
    lead: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    tables: tuple[PageTable, ...] = ()
    sections: tuple[Section, ...] = ()
    scene: str = ""
    policy: str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

    def html(self) -> str:
        """Return the whole page.

        Raises:
            WriteError: A figure cannot be read.
        """
        from jinja2 import Environment
        from markupsafe import Markup, escape

        def inline(text: str) -> Markup:
            code = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text)))
            return Markup(printable(code).replace("\n", "<br>"))

        def finalize(value: Any) -> Any:
            # What is marked is escaped and printable, or a page of its own.
            return value if isinstance(value, Markup) else printable(str(value))

        environment = Environment(autoescape=True, finalize=finalize)
        environment.filters |= {"inline": inline, "data_uri": _data_uri}
        source = (
            files("needleforce.plots").joinpath("page.html").read_text(encoding="utf-8")
        )
        return environment.from_string(source).render(page=self)


def _data_uri(picture: Path | bytes) -> str:
    """Return a picture as the address of an image.

    An image has names of its own, so those inside two drawings cannot clash.
    """
    content = picture
    if isinstance(content, Path):
        with write_errors(f"cannot read {picture}"):
            content = content.read_bytes()
    kind = "png" if content.startswith(b"\x89PNG") else "svg+xml"
    return f"data:image/{kind};base64,{b64encode(content).decode()}"


def write_page(path: str | Path, page: Page) -> Path:
    """Write a page as HTML file, whole or not at all.

    Returns:
        Its path.

    Raises:
        WriteError: The file cannot be written.
    """
    return write_file(path, page.html().encode())


def settings_table(settings: Any, caption: str) -> PageTable:
    """Return a table with a line per field of a dataclass.

    Fields of a dataclass within it are ``outer.inner``.
    """
    flat = pd.json_normalize(asdict(settings)).iloc[0]
    rows = tuple((f"`{name}`", str(value)) for name, value in flat.items())
    return PageTable(caption=caption, head=("setting", "value"), rows=rows)
