"""Errors of the package."""


class FiguresError(Exception):
    """Base of every error of this package."""


class MissingExtraError(FiguresError, RuntimeError):
    """Something optional is not installed."""


class ChartError(FiguresError, ValueError):
    """A chart or table that cannot be shown: ragged, empty, or of an unknown format."""


class WriteError(FiguresError, OSError):
    """A file cannot be written, or a figure that a page needs cannot be read."""
