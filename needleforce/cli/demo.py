"""The command `needleforce demo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, MACHINE, app
from needleforce.cli.terminal import CommandError, require_modules, say

ANNOUNCEMENT = (
    "A simulated arm pushes a needle through three gels; the force at its tip is "
    "estimated from joint torques alone. Takes about 40 s, the first time a minute."
)
"""What the insertion does and how long it takes, said before anything is compiled."""

DEFAULT_FOLDER = Path("demo")
"""Folder of the insertion's page."""

MODULES = ("mujoco", "matplotlib", "jinja2")
"""Modules of extras that the insertion needs."""


@Parameter(name="*", group=LIVE_OUTPUT)
@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Where a demonstration goes, and what it begins with.

    Attributes:
        report: Folder for a page (insertion: demo; others: no page).
        figure: First figure of that page: .png, .svg or .pdf.
        data: For abdomen: folder with ct.nii.gz and labels.nii.gz; else an analytic
            torso.
        seed: For insertion and abdomen (default: 0).
    """

    report: Annotated[Path | None, Parameter(metavar="DIR")] = None
    figure: Annotated[
        Path | None, Parameter(name=("--figure", "--png"), metavar="FILE")
    ] = None
    data: Annotated[Path | None, Parameter(metavar="DIR", group=LOG)] = None
    seed: Annotated[int, Parameter(metavar="N", group=LOG)] = 0


@app.command(name="demo", group=MACHINE)
def demo_command(
    kind: Annotated[
        Literal["insertion", "guidance", "teleop", "autonomous", "rcm", "abdomen"],
        Parameter(name="KIND", group=LOG),
    ] = "insertion",
    /,
    *,
    options: DemoOptions = DemoOptions(),
) -> int:
    """Show what the toolkit does, on a simulated arm; with no name: an insertion.

    insertion: layers and tip force from joint torques, beside the truth; a page in
    demo/. guidance, teleop, autonomous, rcm: the needle in closed loop. abdomen:
    planned on a CT. All print a table; --figure writes the page's first figure alone.
    Simulation only: not a medical device.

    needleforce demo

    needleforce demo teleop --report teleop
    """
    _refuse_unused(kind, options)
    if kind == "insertion":
        require_modules("demo", MODULES)
        say(ANNOUNCEMENT)
        from needleforce.cli.demos import insertion_page

        return insertion_page.run(
            options.report or DEFAULT_FOLDER, options.seed, picture=options.figure
        )
    if kind == "abdomen":
        from needleforce.cli.demos import abdomen_page

        return abdomen_page.run(
            options.data, options.seed, folder=options.report, picture=options.figure
        )
    from needleforce.cli.demos.closed_loops import run

    return run(kind, folder=options.report, picture=options.figure)


def _refuse_unused(kind: str, options: DemoOptions) -> None:
    """Raise `CommandError` for an option that a demonstration does not read."""
    if options.data is not None and kind != "abdomen":
        raise CommandError(
            f"--data {options.data}: only the abdomen is read from files, expected "
            "needleforce demo abdomen"
        )
    if options.seed and kind not in ("insertion", "abdomen"):
        raise CommandError(
            f"--seed {options.seed}: {kind} draws nothing at random that can be "
            "chosen, leave --seed out"
        )
