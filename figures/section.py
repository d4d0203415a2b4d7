"""A part of a page under a heading of its own."""

from base64 import b64encode
from dataclasses import dataclass
from html import escape

from figures.page_figure import PageFigure
from figures.page_table import PageTable
from figures.page_text import inline


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
