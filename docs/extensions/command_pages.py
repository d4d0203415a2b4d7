"""The pages of the commands, from their parsers."""

import re
from pathlib import Path
from typing import NamedTuple

from api_pages import write_if_changed
from cyclopts import App
from sphinx.application import Sphinx

import benchmarks.cli
import needleforce.cli


class CommandPage(NamedTuple):
    """A page of a command.

    Attributes:
        name: Name of the page.
        title: Its title.
        app: The command.
        words: How its examples begin.
    """

    name: str
    title: str
    app: App
    words: str


PAGES = (
    CommandPage("command-line", "Command line", needleforce.cli.app, "needleforce"),
    CommandPage(
        "benchmarks",
        "Command line of the benchmarks",
        benchmarks.cli.app,
        "python -m benchmarks",
    ),
)

INTRODUCTION = re.compile(r"\A# .*?(?=^## (?!Table of Contents))", re.DOTALL | re.M)
COMPLETION = re.compile(
    r"^## needleforce --install-completion.*?(?=^## )", re.DOTALL | re.M
)

OUR_CALL = re.compile(r"(?<=\w) -m sphinx\b")
"""How this build was called, which the parser takes for a part of the usage."""


def text_of(page: CommandPage) -> str:
    """Return the page: what each command does, then its options, by group."""
    help_text = page.app.generate_docs(output_format="markdown", usage_name=page.words)
    help_text = OUR_CALL.sub("", help_text)
    commands = COMPLETION.sub("", INTRODUCTION.sub("", help_text))
    # A line just above a fence is the usage, and stands in a block already.
    examples = re.compile(rf"^({re.escape(page.words)} .*)$(?!\n```)", re.M)
    commands = examples.sub(r"```sh\n\1\n```", commands)
    return f"# {page.title}\n\n{page.app.help}\n\n{commands}"


def write_pages(app: Sphinx) -> None:
    """Write the pages beside the others."""
    folder = Path(app.srcdir) / "reference"
    for page in PAGES:
        write_if_changed(folder / f"{page.name}.md", text_of(page))


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for them."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
