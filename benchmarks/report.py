"""A folder to show: tables, pictures and the numbers."""

from collections.abc import Sequence
from html import escape
from io import StringIO
from pathlib import Path

from rich.console import Console

from benchmarks.errors import ResultsError
from benchmarks.results_file import write_results
from benchmarks.row import Row
from benchmarks.run_tables import run_tables
from benchmarks.screen import LEAST_WIDTH

PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<title>needleforce benchmarks</title>
<style>
body {{ font-family: sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; }}
pre {{ font-size: 12px; line-height: 1.2; overflow-x: auto; }}
img {{ width: 100%; border: 1px solid #ddd; }}
</style>
<h1>needleforce benchmarks</h1>
<p>The numbers are in <a href="results.json">results.json</a>.</p>
{tables}
{pictures}
</html>
"""


def write_report(folder: Path, rows: Sequence[Row], pictures: Sequence[Path]) -> Path:
    """Write ``index.html`` and ``results.json`` beside the pictures.

    Args:
        folder: Exists, and holds the pictures.
        rows: The numbers.
        pictures: In the order in which they are shown.

    Returns:
        The page.

    Raises:
        ResultsError: The folder cannot be written to.
    """
    write_results(folder / "results.json", rows)
    figures = "\n".join(
        f'<h2>{escape(path.stem)}</h2>\n<img src="{escape(path.name)}" alt="{escape(path.stem)}">'
        for path in pictures
    )
    page = PAGE.format(tables=_tables(rows), pictures=figures)
    index = folder / "index.html"
    try:
        index.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"cannot write {index}: {error.strerror}") from error
    return index


def _tables(rows: Sequence[Row]) -> str:
    console = Console(record=True, file=StringIO(), width=LEAST_WIDTH, force_terminal=True)
    for table in run_tables(rows):
        console.print(table)
    return console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
