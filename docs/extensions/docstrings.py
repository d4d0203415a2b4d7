"""Docstrings as the site shows them.

Our classes describe their fields in the section ``Attributes:`` of their docstring.
Here each description goes to its field, which then stands once, with its type and its
default. Equations, which are indented, keep their lines; names in single backticks
become links.
"""

import inspect
import re
import textwrap
from functools import cache
from typing import Any

from api_pages import PACKAGES, is_record, public_names, resolve
from sphinx.application import Sphinx

SECTION = re.compile(r"^Attributes:\n((?:[ ]{4}.*\n|\n)+)", re.MULTILINE)
FIELD = re.compile(r"^(\w+)(?: \([^)]*\))?: ", re.MULTILINE)
NAME = re.compile(r"(?<![`:\w])`([A-Za-z_][\w.]*)(?:\(\))?`(?![`_])")
FIELDS = ("attribute", "property", "data")
"""Kinds of objects whose docstring has no sections."""

hidden_texts: dict[str, list[str]] = {}
"""Texts of fields while napoleon looks at them."""

HEADINGS = ("Args:", "Returns:", "Yields:", "Raises:", "Attributes:", "Note:")


def described_fields(docstring: str) -> dict[str, str]:
    """Return the description of each field in the section ``Attributes:``."""
    section = SECTION.search(docstring + "\n")
    if section is None:
        return {}
    text = textwrap.dedent(section[1])
    parts = FIELD.split(text)
    names = parts[1::2]
    descriptions = parts[2::2]
    return {
        name: " ".join(words.split())
        for name, words in zip(names, descriptions, strict=True)
    }


def description_of(path: str) -> str | None:
    """Return what a class, or a base of it, says of one of its fields."""
    owner, _, field = path.rpartition(".")
    holder = resolve(owner)
    if not isinstance(holder, type):
        return None
    for base in holder.__mro__:
        descriptions = described_fields(clean_docstring(base))
        if field in descriptions:
            return descriptions[field]
    return None


def clean_docstring(holder: type) -> str:
    """Return the docstring of a class, without the indentation of its source."""
    docstring = holder.__dict__.get("__doc__") or ""
    first, _, rest = docstring.partition("\n")
    return f"{first}\n{textwrap.dedent(rest)}"


def keep_equations(lines: list[str]) -> list[str]:
    """Mark each indented paragraph before the sections as text to be kept as it is."""
    sections = [number for number, line in enumerate(lines) if line in HEADINGS]
    end = min(sections, default=len(lines))
    result: list[str] = []
    before = "text"
    for line in lines[:end]:
        is_indented = line.startswith("    ")
        if is_indented and before == "blank after text":
            result += ["::", ""]
        if line:
            before = "equation" if is_indented else "text"
        elif before == "text":
            before = "blank after text"
        result.append(line)
    return result + lines[end:]


@cache
def homes() -> dict[str, list[str]]:
    """Return the paths under which each public name is described."""
    paths: dict[str, list[str]] = {}
    for package_name in PACKAGES:
        for item in public_names(package_name):
            if item.home == package_name:
                paths.setdefault(item.name, []).append(item.path)
    return paths


def link_names(line: str, path: str) -> str:
    """Turn names in single backticks into links, or into code where none is public.

    Args:
        line: A line of a docstring.
        path: Whose docstring; of two names that are equal its package's is meant.
    """
    package_name = path.partition(".")[0]

    def replacement(match: re.Match[str]) -> str:
        written = match[1]
        first, dot, rest = written.partition(".")
        targets = homes().get(first, [])
        near = [target for target in targets if target.startswith(f"{package_name}.")]
        if not targets:
            return f"``{written}``"
        target = (near or targets)[0]
        return f":py:obj:`{written} <{target}{dot}{rest}>`"

    return NAME.sub(replacement, line)


def process_docstring(
    app: Sphinx, kind: str, path: str, value: Any, options: Any, lines: list[str]
) -> None:
    """Change the lines of a docstring in place, before its sections are read."""
    if kind == "class":
        text = SECTION.sub("", "\n".join(lines) + "\n")
        lines[:] = text.splitlines() + variables_of(value)
    if kind in FIELDS:
        description = description_of(path)
        if description is not None:
            lines[:] = [description, ""]
        # Napoleon would take "Axial force [N]: positive" for a type and a text.
        hidden_texts[path] = [*lines]
        lines[:] = []
        return
    lines[:] = [link_names(line, path) for line in keep_equations(lines)]


def restore_fields(
    app: Sphinx, kind: str, path: str, value: Any, options: Any, lines: list[str]
) -> None:
    """Give the fields back their text, after the sections have been read."""
    if kind in FIELDS:
        text = hidden_texts.pop(path, [])
        lines[:] = [link_names(line, path) for line in keep_equations(text)]


def variables_of(holder: type) -> list[str]:
    """Return the attributes that are set in ``__init__``, as a list of their own."""
    members = {name for base in holder.__mro__ for name in vars(base)}
    for base in holder.__mro__:
        members |= set(inspect.get_annotations(base))
    fields = described_fields(clean_docstring(holder))
    inner = {name: words for name, words in fields.items() if name not in members}
    return ["", *(f":ivar {name}: {words}" for name, words in inner.items()), ""]


def hide_signature(
    app: Sphinx, kind: str, path: str, value: Any, options: Any, *texts: str | None
) -> tuple[str, str] | None:
    """Leave out the arguments of a record: they are its fields, listed below."""
    if not isinstance(value, type):
        return None
    has_fields = bool(described_fields(clean_docstring(value)))
    return ("", "") if is_record(value) and has_fields else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to autodoc, before and after napoleon, whose priority is 500."""
    app.connect("autodoc-process-docstring", process_docstring, priority=100)
    app.connect("autodoc-process-docstring", restore_fields, priority=900)
    app.connect("autodoc-process-signature", hide_signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
