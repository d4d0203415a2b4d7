"""A progress bar on stderr, if there is a terminal and the package rich."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(total: float | None, label: str) -> Iterator[Callable[[float], None]]:
    """Show progress while the block runs.

    Args:
        total: of whatever is counted; None if it is not known.
        label: what is being done.

    Yields:
        A function to be told how much more is done.
    """
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda more: None
        return
    try:
        from rich.console import Console
        from rich.progress import Progress, TimeElapsedColumn
    except ImportError:
        yield lambda more: None
        return
    columns = (*Progress.get_default_columns(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda more: bar.advance(task, more)
