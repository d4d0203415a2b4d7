"""The command `needleforce demo`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, MACHINE, app
from needleforce.cli.terminal import CommandError, require_modules, say


@app.command(name="demo", group=MACHINE)
def demo_command(
    kind: Annotated[
        Literal["insertion", "abdomen"],
        Parameter(name="KIND", group=LOG),
    ] = "insertion",
    /,
    *,
    report: Annotated[
        Path | None,
        Parameter(
            metavar="DIR",
            group=LIVE_OUTPUT,
            help="Folder for a page (insertion: demo; abdomen: no page).",
        ),
    ] = None,
    data: Annotated[
        Path | None,
        Parameter(
            metavar="DIR",
            group=LOG,
            help="For abdomen: folder with ct.nii.gz and labels.nii.gz; else an "
            "analytic torso.",
        ),
    ] = None,
    seed: Annotated[
        int,
        Parameter(
            metavar="N",
            group=LOG,
            help="Of everything that is drawn at random (default: 0).",
        ),
    ] = 0,
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

        return abdomen.run(data, seed, report)
    if data is not None:
        raise CommandError(
            f"--data {data}: only the abdomen is read from files, expected "
            "needleforce demo abdomen"
        )
    require_modules("demo", ("mujoco", "matplotlib", "jinja2"))
    # Said before anything is compiled.
    say(
        "A simulated arm pushes a needle through three gels; the force at its tip is "
        "estimated from joint torques alone. Takes about 40 s, the first time a minute."
    )
    from needleforce.cli.demos import insertion

    return insertion.run(report or Path("demo"), seed)
