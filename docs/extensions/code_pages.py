"""The page of errors, statuses and warnings, from the table of their codes."""

import re
from itertools import groupby
from operator import attrgetter
from pathlib import Path

from api_pages import write_if_changed
from sphinx.application import Sphinx

from needleforce.codes import CodeEntry, code_entries

AREAS = {
    "command": "Options and files of a command",
    "recording": "Recordings",
    "urdf": "The robot's description",
    "sensor": "The virtual force sensor",
    "identification": "Identification",
    "session": "Sessions",
    "state": "Snapshots",
    "control": "Control",
    "anatomy": "The patient and the plan",
    "device": "Devices",
    "ros": "ROS 2",
    "scene": "The scene",
    "figure": "Figures",
    "simulation": "The simulation",
    "status": "Statuses of an estimate",
    "warning": "Warnings of the virtual force sensor",
}
"""Heading of each area."""

INTRODUCTION = """# Errors, statuses and warnings

Each error has a code. Here is what each means, and what to do: in a
program that calls the library, and on the command line where that differs.
`python -m needleforce.codes CODE` prints the same.

Online estimators do not raise for a sample; they report a status, and warnings beside
it, which stand at the end of this page.
"""


def text_of(entry: CodeEntry) -> str:
    """Return an entry of the page; an option such as ``--tare`` is set as code."""
    cures = [entry.library_cure]
    if entry.command_cure != entry.library_cure:
        cures.append(f"Command line: {entry.command_cure}")
    lines = [entry.meaning, *cures]
    marked = [re.sub(r"(?<![\w`-])(--[a-z][\w-]*)", r"`\1`", line) for line in lines]
    words = "\n  ".join(f"{line}\\" for line in marked).removesuffix("\\")
    return f"`{entry.label}`\n: {words}\n"


def page() -> str:
    """Return the page."""
    text = INTRODUCTION
    by_area = sorted(code_entries(), key=lambda entry: list(AREAS).index(entry.area))
    for area, entries in groupby(by_area, key=attrgetter("area")):
        text += f"\n## {AREAS[area]}\n\n" + "\n".join(map(text_of, entries))
    return text


def write_page(app: Sphinx) -> None:
    """Write the page beside the others."""
    write_if_changed(Path(app.srcdir) / "reference" / "codes.md", page())


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before Sphinx looks for it."""
    app.connect("builder-inited", write_page)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
