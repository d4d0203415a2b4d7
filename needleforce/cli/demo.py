"""The command `needleforce demo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, app


@Parameter(name="*", group=LIVE_OUTPUT)
@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Where a demonstration goes, and what that of the abdomen begins with.

    Attributes:
        report: Folder for a page.
        figure: First figure of that page: .png, .svg or .pdf.
        data: For abdomen: folder with ct.nii.gz and labels.nii.gz; else an analytic
            torso.
        seed: For abdomen.
    """

    report: Annotated[Path | None, Parameter(metavar="DIR")] = None
    figure: Annotated[
        Path | None, Parameter(name=("--figure", "--png"), metavar="FILE")
    ] = None
    data: Annotated[Path | None, Parameter(metavar="DIR", group=LOG)] = None
    seed: Annotated[int, Parameter(metavar="N", group=LOG)] = 0


@app.command(name="demo")
def demo_command(
    kind: Annotated[
        Literal["guidance", "teleop", "autonomous", "rcm", "abdomen"],
        Parameter(name="KIND", group=LOG),
    ],
    /,
    *,
    options: DemoOptions = DemoOptions(),
) -> int:
    """Show a needle in closed loop on the simulated arm, or planned on a CT.

    Prints a table and writes a page into DIR; --figure writes its first figure alone.
    Simulation only: not a medical device.

    needleforce demo teleop --report demo
    """
    if kind == "abdomen":
        from needleforce.cli.demos import abdomen_page

        return abdomen_page.run(
            options.data, options.seed, folder=options.report, picture=options.figure
        )
    from needleforce.cli.demos.closed_loops import run

    return run(kind, folder=options.report, picture=options.figure)
