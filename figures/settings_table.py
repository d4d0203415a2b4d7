"""The settings of a run as a table: what a reader needs to do it again."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from figures.page_table import PageTable


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
