"""A part of a job that reports its own progress."""

from benchmarks.job import Progress


def progress_part(progress: Progress, start: float, end: float) -> Progress:
    """Progress of a part, 0 to 1, as progress of the whole from start to end."""

    def tell(share: float) -> None:
        progress(start + (end - start) * share)

    return tell
