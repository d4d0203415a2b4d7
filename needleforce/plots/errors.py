"""Errors of the package."""

from foundation.errors import CodedError, ErrorCode
from foundation.extras import install_command


class FigureCode(ErrorCode):
    """Kinds of errors of figures, pages and reports."""

    LIBRARY = (
        "NF-FIGURE-LIBRARY",
        "Figures and pages need libraries that are not installed.",
        f"Install them: {install_command('demo')}.",
    )
    CHART = (
        "NF-FIGURE-CHART",
        "A chart or a table is empty or ragged, or its window is none.",
        "Give a `Curve` one y per x, a `Chart` at least one panel, a `PageTable` one "
        "cell per head.",
    )
    FORMAT = (
        "NF-FIGURE-FORMAT",
        "The ending of the file's name is none of a figure.",
        "Name it .png, .svg or .pdf.",
    )
    WRITE = (
        "NF-FIGURE-WRITE",
        "A figure, a page or a report cannot be written; what was there is unchanged.",
        "Give a place that can be written to, with room on the disk.",
    )


class FiguresError(CodedError):
    """Base of every error of this package."""

    usual_code = FigureCode.CHART


class MissingExtraError(FiguresError, RuntimeError):
    """Something optional is not installed."""

    usual_code = FigureCode.LIBRARY


class ChartError(FiguresError, ValueError):
    """A chart or table that cannot be shown: ragged, empty, or of an unknown format."""


class WriteError(FiguresError, OSError):
    """A file cannot be written, or a figure that a page needs cannot be read."""

    usual_code = FigureCode.WRITE
