"""`needleforce demo`: the needle moved in closed loop on the simulated arm, as a table
and a page.

from needleforce.cli.terminal import Progress
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
from needleforce.cli.terminal import CommandError, Progress, progress_bar


def run(kind: str, *, folder: Path | None, picture: Path | None) -> int:
    """Run a demonstration, print its table, and write page and first figure."""
    if folder is not None or picture is not None:
        plots.require_matplotlib("demo")
    if kind not in DEMOS:
        raise CommandError(f"no demonstration {kind!r}; known: {', '.join(DEMOS)}")
    with progress_bar(f"demonstrating {kind}") as progress:
        shown = DEMOS[kind](progress)
    shown.write(kind, folder)
    if picture is not None:
        plots.save_figure(shown.charts[0][1], picture)
    return 0


DEMOS: dict[str, Callable[[Progress], DemoResult]] = {
    "guidance": guide_by_hand,
    "teleop": teleoperate_needle,
    "autonomous": stop_after_rupture,
    "rcm": turn_about_entry,
}
