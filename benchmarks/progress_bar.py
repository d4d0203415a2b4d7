"""A bar while jobs run."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


@contextmanager
def progress_bar(console: Console, jobs: int) -> Iterator[Callable[[int, float], None]]:
    """Show a bar; yields what takes the index of a job and the share of it that is done.

    Nothing is drawn where there is no terminal.
    """
    shares = [0.0] * jobs
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task(f"{jobs} benchmarks", total=jobs)

        def tell(index: int, share: float) -> None:
            shares[index] = share
            bar.update(task, completed=sum(shares))

        yield tell
