"""One HTML page that needs nothing but itself: no network, no other file, no script."""

from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path

from figures.errors import WriteError
from figures.page_text import inline
from figures.section import Section

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
