"""`needleforce simulate`: a simulated insertion as a recording."""

from dataclasses import replace
from pathlib import Path

from groundtruth import SCENARIOS, NeedleRun, Run, insert_needle, simulate
from groundtruth.scenarios import RANDOM_STACK, RANDOM_TISSUE
from groundtruth.scenarios import scenario as scenario_named
from needleforce.cli.patient.case_files import read_plan_fields
from needleforce.cli.robot import ArmFrames, read_description
from needleforce.cli.shared_options import RobotOptions, SimulationOptions
from needleforce.cli.terminal import CommandError, aligned, progress_bar, write_out
from needleforce.recordings import check_writable, write_table
from needleforce.recordings.output import check_outputs
from needleforce.recordings.table import TableLabels
from needleforce.simulation.patient import insert_into_patient
from needleforce.simulation.tables import (
    needle_table,
    signal_table,
    tissue_table,
    truth_table,
)
from needleforce.simulation.torso_case import write_torso_case

NEEDLE = "needle"
"""As the plant: a needle on a linear stage with its force sensor, without an arm."""


def print_scenarios() -> int:
    """Print every scenario with its title; return the exit code."""
    titles = {name: item.title for name, item in SCENARIOS.items()}
    titles[RANDOM_STACK] = "one to four layers drawn from the seed"
    titles[RANDOM_TISSUE] = "the same, each layer of its own law"
    write_out(aligned(titles.items()))
    return 0


def write_simulation(scenario: str | None, options: SimulationOptions) -> int:
    """Simulate a scenario, or the insertion of a plan, write its files, and a summary.

    Args:
        scenario: Name of the scenario, or a plan's file (.json).
        options: What is simulated, and where it goes.

    Returns:
        The exit code.

    Raises:
        CommandError: No scenario or file is named, or the seed is negative.
    """
    paths = {"-o": options.output, "--truth": options.truth}
    named = {option: path for option, path in paths.items() if path is not None}
    if scenario is None or not named:
        raise CommandError(
            "nothing to write: expected a scenario (--list prints them), and -o FILE "
            "or --truth FILE"
        )
    if options.seed < 0:
        raise CommandError(f"--seed {options.seed}: expected a whole number from 0 up")
    check_outputs(named)
    for path in named.values():
        check_writable(path, overwrites=options.overwrite)
    run = _simulate(scenario, options)
    labels = TableLabels(prefix="/truth")
    if isinstance(run, NeedleRun):
        recorded = needle_table(run)
        truth = tissue_table(run.truth, run.t_s, run.depth_m, run.speed_m_s)
        signal_labels = TableLabels()
        next_command = "identify {} --figure layers.png"
    else:
        recorded = signal_table(run)
        truth = truth_table(run)
        labels = replace(labels, joint_names=run.robot.joint_names)
        signal_labels = TableLabels(
            joint_names=run.robot.joint_names,
            robot_description=read_description(RobotOptions()),
            link_poses=ArmFrames(run.robot),
        )
        suffixes = "".join(options.output.suffixes) if options.output else ""
        next_command = f"force {{}} --tare 0:{run.tare_end_s:.4g} -o forces{suffixes}"
    if options.truth is not None:
        write_table(options.truth, truth, labels=labels)
    t_s = truth["t_s"]
    write_out(
        f"{run.scenario.id}: {run.scenario.title}; plant model {options.plant}, seed "
        f"{run.seed}\n{len(t_s)} samples in {t_s[-1]:.4g} s, without contact until "
        f"{run.tare_end_s:.4g} s\n"
    )
    if options.output is not None:
        write_table(options.output, recorded, labels=signal_labels)
        write_out(f"next: needleforce {next_command.format(options.output)}\n")
    return 0


def _simulate(scenario: str, options: SimulationOptions) -> Run | NeedleRun:
    """Return the insertion of a plan's file, or that of a scenario."""
    if scenario.endswith(".json"):
        with progress_bar(f"simulating {scenario}"):
            return insert_into_patient(read_plan_fields(Path(scenario)))
    chosen = scenario_named(scenario, options.seed)
    with progress_bar(f"simulating {scenario}"):
        if options.plant == NEEDLE:
            return insert_needle(chosen, seed=options.seed)
        return simulate(chosen, plant=options.plant, seed=options.seed)


def write_torso(folder: Path, seed: int) -> int:
    """Write the example patient into a folder; return the exit code.

    Raises:
        CommandError: The folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        grid = write_torso_case(folder, seed)
    except OSError as error:
        raise CommandError(f"cannot write to {folder}: {error.strerror}") from error
    write_out(
        f"{folder}: ct.nii.gz ({' x '.join(map(str, grid.shape))} voxels), "
        "labels.nii.gz, labels.json, landmarks.mrk.json\n"
        f"next: needleforce plan --ct {folder}/ct.nii.gz --labels "
        f"{folder}/labels.nii.gz --target lesion -o plan\n"
    )
    return 0
