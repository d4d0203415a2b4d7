"""The tables of the terminal as tables of the page."""

from collections.abc import Sequence

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from figures import PageTable


def page_tables(tables: Sequence[Table]) -> tuple[PageTable, ...]:
    """The same heads and cells, without colours."""
    return tuple(_converted(table) for table in tables)


def _converted(table: Table) -> PageTable:
    columns = table.columns
    cells = [[_plain(cell) for cell in column.cells] for column in columns]
    return PageTable(
        caption=_plain(table.title),
        head=tuple(_plain(column.header) for column in columns),
        rows=tuple(zip(*cells, strict=True)),
        numeric=frozenset(k for k, column in enumerate(columns) if column.justify == "right"),
        note=_plain(table.caption),
    )


def _plain(cell: RenderableType | None) -> str:
    if cell is None:
        return ""
    return cell.plain if isinstance(cell, Text) else Text.from_markup(str(cell)).plain
