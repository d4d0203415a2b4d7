"""Where tables go, and how they say that a target is met."""

from rich.console import Console

LEAST_WIDTH = 140
"""Of a table that goes into a file or a pipe."""


def new_console() -> Console:
    """A console as wide as the terminal, or wide enough for every table where there is none."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, LEAST_WIDTH)
    return console


def met_mark(is_met: bool) -> str:
    """A target's last cell."""
    return "[green]met[/green]" if is_met else "[red]missed[/red]"
