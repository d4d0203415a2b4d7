"""The command `needleforce demo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, MACHINE, app
from needleforce.cli.terminal import CommandError, require_modules, say


@Parameter(name="*", group=LIVE_OUTPUT)
@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Where a demonstration goes, and what it begins with.

    Attributes:
        report: Folder for a page (insertion: demo; abdomen: no page).
        figure: The chart of the forces alone: .png, .svg or .pdf.
        data: For abdomen: folder with ct.nii.gz and labels.nii.gz; else an analytic
            torso.
        seed: Of everything that is drawn at random (default: 0).
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
        Literal["insertion", "abdomen"],
        Parameter(name="KIND", group=LOG),
    ] = "insertion",
    /,
    *,
    options: DemoOptions = DemoOptions(),
) -> int:
    """Show what the toolkit does, on a simulated arm; with no name: an insertion.

    insertion: layers and tip force from joint torques, beside the truth; a page in
    demo/. abdomen: planned on a CT, ruptures correct the plan. Both print a table.
    The needle in closed loop (led by hand, about its entry, by itself, from afar) is in
    examples/. Simulation only: not a medical device.

    needleforce demo

    needleforce demo abdomen --report abdomen
    """
    if kind == "abdomen":
        from needleforce.cli.demos import abdomen

        return abdomen.run(
            options.data, options.seed, folder=options.report, picture=options.figure
        )
    if options.data is not None:
        raise CommandError(
            f"--data {options.data}: only the abdomen is read from files, expected "
            "needleforce demo abdomen"
        )
    require_modules("demo", ("mujoco", "matplotlib", "jinja2"))
    # Said before anything is compiled.
    say(
        "A simulated arm pushes a needle through three gels; the force at its tip is "
        "estimated from joint torques alone. Takes about 40 s, the first time a minute."
    )
    from needleforce.cli.demos import insertion

    return insertion.run(
        options.report or Path("demo"), options.seed, picture=options.figure
    )
