"""The command `needleforce simulate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.application import LOGS, OUTPUT, app
from needleforce.cli.terminal import CommandError, require_modules


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class SimulationOptions:
    """What is simulated, and where it goes.

    Attributes:
        output: Recording: .csv, .npz, .parquet, or .mcap, a ROS 2 bag.
        truth: Ground truth, which the robot does not know: forces, depth, layers,
            ruptures.
        plant: Plant model: how good arm and sensors are (default: clean); or needle, a
            needle on a linear stage with its force sensor, without an arm.
        seed: Seed of everything that is drawn at random (default: 0).
        overwrite: Replace files that are there.
        list: Print the scenarios and stop.
    """

    output: Annotated[
        Path | None, Parameter(name=("--output", "-o"), metavar="FILE")
    ] = None
    truth: Annotated[Path | None, Parameter(metavar="FILE")] = None
    plant: Literal["ideal", "clean", "fri", "degraded", "needle"] = "clean"
    seed: Annotated[int, Parameter(metavar="N")] = 0
    overwrite: Annotated[bool, Parameter(negative="")] = False
    list: bool = False


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
    if scenario == "torso" and options.output is not None:
        _refuse_plant(options, "a patient at rest has no arm")
        if options.truth is not None:
            raise CommandError(
                f"--truth {options.truth}: labels.nii.gz holds what is true of the "
                "torso, leave --truth out"
            )
        require_modules("simulate torso", ("SimpleITK",))
        return simulated_log.write_torso(options.output, options.seed)
    if scenario is not None and scenario.endswith(".json"):
        _refuse_plant(options, "the insertion of a plan is always on clean")
        if options.seed:
            raise CommandError(
                f"--seed {options.seed}: the insertion of a plan is always that of "
                "seed 0, leave --seed out"
            )
    return simulated_log.write_simulation(
        scenario,
        plant=options.plant,
        seed=options.seed,
        recording=options.output,
        truth=options.truth,
        overwrites=options.overwrite,
    )


def _refuse_plant(options: SimulationOptions, reason: str) -> None:
    """Raise `CommandError` if a plant is named where none is chosen."""
    if options.plant != "clean":
        raise CommandError(f"--plant {options.plant}: {reason}, leave --plant out")
