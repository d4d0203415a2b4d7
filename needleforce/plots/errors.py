"""What can go wrong while a chart is drawn or a page is written."""


class FiguresError(Exception):
    """Base of every error of this package."""


class MissingExtraError(FiguresError, RuntimeError):
    """Something optional is not installed."""


class ChartError(FiguresError, ValueError):
    """A chart that cannot be drawn: ragged or empty."""


class WriteError(FiguresError, OSError):
    """A file cannot be written, or a figure that a page needs cannot be read."""
