"""One HTML page that needs nothing but itself: no network, no other file, no script."""

import re
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from needleforce.plots.chart import require_matplotlib
from needleforce.plots.errors import ChartError, WriteError

# Text as HTML.


_CODE = re.compile(r"`([^`]+)`")


def inline(text: str) -> str:
    """Escape text; what stands between backticks becomes code, a line end a line break."""
    return _CODE.sub(r"<code>\1</code>", escape(text)).replace("\n", "<br>")


# A figure of a page.


MEDIA_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclass(frozen=True, slots=True, kw_only=True)
class PageFigure:
    """A figure of a page.

    Attributes:
        path: The drawing, SVG or PNG; its content goes into the page.
        alt: What it shows, for those who cannot see it.
        caption: Below it.
    """

    path: Path
    alt: str
    caption: str

    def html(self) -> str:
        """The figure, with the drawing inside.

        As an image, not as elements of the page: names inside two drawings cannot clash.

        Raises:
            WriteError: The drawing cannot be read.
        """
        try:
            content = b64encode(self.path.read_bytes()).decode()
        except OSError as error:
            raise WriteError(f"cannot read {self.path}: {error.strerror or error}") from error
        source = f"data:{MEDIA_TYPES[self.path.suffix]};base64,{content}"
        return (
            f'<figure><img src="{source}" alt="{escape(self.alt)}">'
            f"<figcaption>{inline(self.caption)}</figcaption></figure>"
        )


# A table of a page.


@dataclass(frozen=True, slots=True, kw_only=True)
class PageTable:
    """A table of a page.

    Attributes:
        caption: What it holds; stands above.
        head: Of the columns; empty texts for none.
        rows: Text of the cells, each as long as the head.
        numeric: Columns, from 0, whose cells line up on the right.
        note: A line below.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: frozenset[int] = frozenset()
    note: str = ""

    def __post_init__(self) -> None:
        """Check the rows.

        Raises:
            ChartError: A row is longer or shorter than the head.
        """
        for row in self.rows:
            if len(row) != len(self.head):
                raise ChartError(
                    f"table {self.caption!r} has a row of {len(row)} cells under {len(self.head)} "
                    "heads; give one cell per head"
                )

    def html(self) -> str:
        """The table in a box of its own, which scrolls where the screen is narrow."""
        heads = "".join(
            f"<th scope=col{self._side(i)}>{inline(text)}</th>" for i, text in enumerate(self.head)
        )
        head = f"<thead><tr>{heads}</tr></thead>" if any(self.head) else ""
        body = "\n".join(f"<tr>{self._row(row)}</tr>" for row in self.rows)
        note = f"<p class=note>{inline(self.note)}</p>" if self.note else ""
        return (
            f'<div class=scroll role=region tabindex=0 aria-label="{escape(self.caption)}">'
            f"<table><caption>{inline(self.caption)}</caption>"
            f"{head}<tbody>{body}</tbody></table></div>{note}"
        )

    def _row(self, row: tuple[str, ...]) -> str:
        return "".join(f"<td{self._side(i)}>{inline(text)}</td>" for i, text in enumerate(row))

    def _side(self, column: int) -> str:
        return " class=number" if column in self.numeric else ""


# A part of a page under a heading of its own.


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """A file that is kept inside the page and can be saved from it.

    Attributes:
        name: Of the file.
        media_type: Such as ``application/json``.
        content: Of the file.
    """

    name: str
    media_type: str
    content: bytes

    def html(self) -> str:
        """A link that saves the file."""
        data = b64encode(self.content).decode()
        name = escape(self.name)
        source = f"data:{escape(self.media_type)};base64,{data}"
        return f'<a download="{name}" href="{source}">{name}</a>'


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of a page: text, then a command, figures and tables.

    Attributes:
        heading: Above it.
        anchor: Under which it can be reached within the page.
        paragraphs: Text.
        notices: Text that must not be overlooked, such as warnings.
        command: Shown below the text, as it would be typed; none where empty.
        figures: Side by side where there is room.
        tables: Below the figures.
        attachments: Files to save.
    """

    heading: str
    anchor: str
    paragraphs: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    command: str = ""
    figures: tuple[PageFigure, ...] = ()
    tables: tuple[PageTable, ...] = ()
    attachments: tuple[Attachment, ...] = ()

    def html(self) -> str:
        """The section.

        Raises:
            WriteError: A drawing cannot be read.
        """
        parts = [f"<h2>{inline(self.heading)}</h2>"]
        parts += [f"<p>{inline(text)}</p>" for text in self.paragraphs]
        parts += [f"<p class=notice>{inline(text)}</p>" for text in self.notices]
        if self.command:
            parts.append(f"<pre tabindex=0><code>{escape(self.command)}</code></pre>")
        if self.figures:
            drawn = "\n".join(figure.html() for figure in self.figures)
            parts.append(f"<div class=figures>{drawn}</div>")
        parts += [table.html() for table in self.tables]
        if self.attachments:
            links = ", ".join(item.html() for item in self.attachments)
            parts.append(f"<p>Kept inside this page, to be saved: {links}.</p>")
        inside = "\n".join(parts)
        return f'<section id="{escape(self.anchor)}">\n{inside}\n</section>'


# The policy forbids every resource but what stands in the page itself.
_FRAME = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>
{style}</style>
</head>
<body>
<header>
<h1>{title}</h1>
{lead}
</header>
{contents}<main>
{sections}
</main>
</body>
</html>
"""
LEAST_CONTENTS = 3
"""Sections from which on a list of them helps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """What a page holds.

    Attributes:
        title: In the window and above all.
        lead: Paragraphs under the title.
        sections: In order.
    """

    title: str
    lead: tuple[str, ...] = ()
    sections: tuple[Section, ...] = ()

    def html(self) -> str:
        """The whole page.

        Raises:
            WriteError: A drawing cannot be read.
        """
        return _FRAME.format(
            title=escape(self.title),
            style=files("figures").joinpath("page.css").read_text(encoding="utf-8"),
            lead="\n".join(f"<p>{inline(text)}</p>" for text in self.lead),
            contents=self._contents(),
            sections="\n".join(section.html() for section in self.sections),
        )

    def _contents(self) -> str:
        if len(self.sections) < LEAST_CONTENTS:
            return ""
        links = "\n".join(
            f'<li><a href="#{escape(item.anchor)}">{inline(item.heading)}</a></li>'
            for item in self.sections
        )
        return f'<nav aria-label="Contents"><ul>\n{links}\n</ul></nav>\n'


def write_page(path: str | Path, page: Page) -> Path:
    """Write a page.

    Args:
        path: Of the HTML file.
        page: What it holds.

    Returns:
        The file.

    Raises:
        WriteError: The file cannot be written, or a drawing cannot be read.
    """
    place, content = Path(path), page.html()
    try:
        place.write_text(content, encoding="utf-8")
    except OSError as error:
        raise WriteError(f"cannot write {place}: {error.strerror or error}") from error
    return place


# The settings of a run as a table: what a reader needs to do it again.


def settings_table(settings: Any, caption: str) -> PageTable:
    """One line per field of a dataclass; of a dataclass within it ``outer.inner``.

    Args:
        settings: The dataclass.
        caption: Of the table.
    """
    return PageTable(caption=caption, head=("setting", "value"), rows=tuple(_rows(settings, "")))


def _rows(settings: Any, prefix: str) -> Iterator[tuple[str, str]]:
    for item in fields(settings):
        value, name = getattr(settings, item.name), f"{prefix}{item.name}"
        if is_dataclass(value):
            yield from _rows(value, f"{name}.")
        else:
            yield f"`{name}`", _text(value)


def _text(value: Any) -> str:
    if value is None or value == ():
        return "none"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple | list):
        return ", ".join(map(_text, value))
    return str(value)


# The folder of a report, made before the work that fills it.


PAGE = "index.html"
"""Name of the page in it."""


def report_folder(path: str | Path) -> Path:
    """Make sure that a report can be written before minutes of work, not after.

    Args:
        path: Of the folder; it is made if there is none.

    Returns:
        The folder.

    Raises:
        MissingExtraError: matplotlib is not installed.
        WriteError: The folder cannot be made.
    """
    require_matplotlib("--report")
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(f"cannot write to {folder}: {error.strerror or error}") from error
    return folder


@contextmanager
def folder_if_filled(path: str | Path | None) -> Iterator[Path | None]:
    """`report_folder` for as long as the work takes; an empty one that it made is removed again.

    So an interrupt, or a mistake that ends the work at once, leaves nothing behind.

    Args:
        path: Of the folder; None where no report is wanted.

    Yields:
        The folder, if any.

    Raises:
        MissingExtraError: matplotlib is not installed.
        WriteError: The folder cannot be made.
    """
    if path is None:
        yield None
        return
    folder = Path(path)
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    report_folder(folder)
    try:
        yield folder
    finally:
        with suppress(OSError):  # one that holds something is not removed, nor those it lies in
            for each in made:
                each.rmdir()
