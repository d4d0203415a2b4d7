"""The commands without a log or an arm: `needleforce simulate`, `demo`, `doctor`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.application import LIVE_OUTPUT, LOG, LOGS, MACHINE, OUTPUT, app
from needleforce.cli.shared_options import SimulationOptions
from needleforce.cli.terminal import (
    CommandError,
    aligned,
    json_text,
    require_modules,
    say,
    write_out,
)


@app.command(name="simulate", group=LOGS)
def simulate_command(
    scenario: Annotated[
        str | None,
        Parameter(name="SCENARIO", group=OUTPUT, help="What is simulated; see --list."),
    ] = None,
    /,
    *,
    options: SimulationOptions = SimulationOptions(),
) -> int:
    """Simulate an insertion and write it as a recording.

    Joint positions, velocities and torques of a KUKA LWR 4+, and the wrench of a force
    sensor at the needle, as a robot would have recorded them; or, with --plant needle,
    depth and force alone.

    needleforce simulate gel-25-constant -o insertion.mcap --truth truth.csv

    A patient to plan on, a torso's CT with labels and landmarks in a folder:

    needleforce simulate torso -o patient

    and the insertion of a plan: needleforce simulate plan/plan.json -o insertion.csv
    """
    from needleforce.cli.logs import simulated_log

    if options.list:
        return simulated_log.print_scenarios()
    is_plan = scenario is not None and scenario.endswith(".json")
    is_fixed = is_plan or scenario == "torso"
    if is_fixed and (options.plant != "clean" or (is_plan and options.seed)):
        raise CommandError(
            "--plant and --seed: a torso has no plant, the insertion of a plan is "
            "always that of seed 0 on clean; leave them out"
        )
    if scenario != "torso" or options.output is None:
        return simulated_log.write_simulation(scenario, options)
    if options.truth is not None:
        raise CommandError(
            f"--truth {options.truth}: labels.nii.gz holds what is true of the torso, "
            "leave --truth out"
        )
    require_modules("simulate torso", ("SimpleITK",))
    return simulated_log.write_torso(options.output, options.seed)


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


@app.command(name="doctor", group=MACHINE)
def doctor_command(
    *,
    compile: Annotated[
        bool,
        Parameter(
            group=LIVE_OUTPUT,
            help="First compile what is not kept yet, so that no later start has to.",
        ),
    ] = False,
    json: Annotated[bool, Parameter(group=LIVE_OUTPUT, help="Print JSON.")] = False,
) -> int:
    """Print versions, extras, the compiler's cache, and what is in the way of use.

    Unless told to it compiles nothing; it needs no network. For a bug report.

    needleforce doctor --json
    """
    from needleforce.cli.checkup import compile_everything, examine

    if compile:
        compile_everything()
    found = examine()
    write_out(json_text(found) if json else aligned(found.items()))
    return 0
