"""A bar while jobs run."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from needleforce.cli.terminal import progress


@contextmanager
def progress_bar(jobs: int) -> Iterator[Callable[[int, float], None]]:
    """Show a bar; yields what takes the index of a job and the share of it that is done.

    Nothing is drawn where there is no terminal.
    """
    shares = [0.0] * jobs
    with progress(float(jobs), f"{jobs} benchmarks") as advance:

        def tell(index: int, share: float) -> None:
            advance(share - shares[index])
            shares[index] = share

        yield tell
