"""A name with a level, a sentence and values, as diagnostics of ROS have them."""

from typing import NamedTuple

OK = 0
WARNING = 1
ERROR = 2


class NamedReport(NamedTuple):
    """A name with a level, a sentence and values: a `diagnostic_msgs/DiagnosticStatus`.

    Attributes:
        name: What it is about.
        level: `OK`, `WARNING` or `ERROR`.
        message: One sentence.
        values: Text by name.
    """

    name: str
    level: int
    message: str
    values: dict[str, str]


def format_value(value: float) -> str:
    """Return a number as text that reads back; true and false for a switch."""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int) else f"{value:.9g}"
