"""A table of a page."""

from dataclasses import dataclass
from html import escape

from figures.errors import ChartError
from figures.page_text import inline


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
