"""`needleforce demo`: the needle moved in closed loop on the simulated arm.

Simulation only; nothing here is a medical device or claimed of one.
"""

from collections.abc import Callable
from pathlib import Path

from needleforce import plots
from needleforce.cli.demos.autonomous import stop_after_rupture
from needleforce.cli.demos.guidance import guide_by_hand
from needleforce.cli.demos.remote_centre import turn_about_entry
from needleforce.cli.demos.result_page import DemoResult
from needleforce.cli.demos.teleoperation import teleoperate_needle
from needleforce.cli.terminal import CommandError, Progress, progress_bar, write_out

DEMOS: dict[str, Callable[[Progress], DemoResult]] = {
    "guidance": guide_by_hand,
    "teleop": teleoperate_needle,
    "autonomous": stop_after_rupture,
    "rcm": turn_about_entry,
}
"""The demonstrations, by name."""


def run(kind: str, *, folder: Path | None, picture: Path | None) -> int:
    """Run a demonstration and print its table.

    Args:
        kind: One of `DEMOS`.
        folder: Folder for a page, if any.
        picture: File for the first chart, if any.

    Returns:
        The exit code.

    Raises:
        CommandError: There is no such demonstration.
    """
    if folder is not None or picture is not None:
        plots.require_matplotlib("demo")
    if kind not in DEMOS:
        raise CommandError(f"no demonstration {kind!r}; known: {', '.join(DEMOS)}")
    with progress_bar(f"demonstrating {kind}") as progress:
        result = DEMOS[kind](progress)
    result.print_table()
    with plots.whole_folder(folder) as place:
        if place is not None:
            result.write_page(kind, place)
    if folder is not None:
        write_out(f"{folder / plots.PAGE}\n")
    if picture is not None:
        plots.save_figure(result.charts[0].chart, picture)
    return 0
