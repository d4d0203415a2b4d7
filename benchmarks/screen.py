"""Where tables go."""

from rich.console import Console

LEAST_WIDTH = 140
"""Of a table that goes into a file or a pipe."""


def new_console() -> Console:
    """A console as wide as the terminal, or wide enough for every table where there is none."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, LEAST_WIDTH)
    return console
