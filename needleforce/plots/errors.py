"""Errors of the package."""

from collections.abc import Iterator
from contextlib import contextmanager

from foundation.errors import NeedleforceError


class FiguresError(NeedleforceError):
    """Base of every error of this package."""

    usual_advice = "Give a figure a name that ends in .png, .svg or .pdf."


class MissingExtraError(FiguresError, RuntimeError):
    """Something optional is not installed."""

    usual_advice = "Install them: pip install 'needleforce[demo]'."


class ChartError(FiguresError, ValueError):
    """A figure of an unknown format."""


class WriteError(FiguresError, OSError):
    """A file cannot be written, or a figure that a page needs cannot be read."""

    usual_advice = "Give a place that can be written to, with room on the disk."


@contextmanager
def write_errors(fault: str) -> Iterator[None]:
    """Turn what the operating system reports into a `WriteError` about a fault."""
    try:
        yield
    except OSError as error:
        raise WriteError(f"{fault}: {error.strerror or error}") from error
