"""`needleforce simulate`: a simulated insertion as a recording."""

from pathlib import Path

from foundation.arrays import Array
from groundtruth import SCENARIOS, NeedleRun, Run, insert_needle, simulate
from groundtruth.scenarios import RANDOM_STACK, RANDOM_TISSUE
from groundtruth.scenarios import scenario as scenario_named
from needleforce.cli.arm_frames import ArmFrames, read_description
from needleforce.cli.patient.case_files import read_plan_fields
from needleforce.cli.shared_options import RobotOptions
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


def write_simulation(
    scenario: str | None,
    *,
    plant: str,
    seed: int,
    recording: Path | None,
    truth: Path | None,
    overwrites: bool = False,
) -> int:
    """Simulate a scenario, or the insertion of a plan, write its files, and a summary.

    Args:
        scenario: Name of the scenario, or a plan's file (.json).
        plant: Plant model, or `NEEDLE`.
        seed: Seed of everything that is drawn at random.
        recording: File of the measured signals, if any.
        truth: File of the ground truth, if any.
        overwrites: Whether files that are there are replaced.

    Returns:
        The exit code.

    Raises:
        CommandError: No scenario or file is named, or the seed is negative.
    """
    paths = {"-o": recording, "--truth": truth}
    named = {option: path for option, path in paths.items() if path is not None}
    if scenario is None:
        raise CommandError("no scenario is named; --list prints the scenarios")
    if seed < 0:
        raise CommandError(f"--seed {seed}: expected a whole number from 0 up")
    chosen = None if scenario.endswith(".json") else scenario_named(scenario, seed)
    if not named:
        raise CommandError("nothing to write, expected -o FILE or --truth FILE")
    check_outputs(named)
    for path in named.values():
        check_writable(path, overwrites=overwrites)
    with progress_bar(f"simulating {scenario}"):
        if chosen is None:
            run = insert_into_patient(read_plan_fields(Path(scenario)))
        elif plant == NEEDLE:
            return _write_needle_run(insert_needle(chosen, seed=seed), recording, truth)
        else:
            run = simulate(chosen, plant=plant, seed=seed)
    _write_run(run, recording, truth)
    return 0


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


def _write_run(run: Run, recording: Path | None, truth: Path | None) -> None:
    """Write recording and ground truth of a run, and print a summary."""
    joint_names = run.robot.joint_names
    if recording is not None:
        labels = TableLabels(
            joint_names=joint_names,
            robot_description=read_description(RobotOptions()),
            link_poses=ArmFrames(run.robot),
        )
        write_table(recording, signal_table(run), labels=labels)
    if truth is not None:
        labels = TableLabels(joint_names=joint_names, prefix="/truth")
        write_table(truth, truth_table(run), labels=labels)
    write_out(_summary(run, run.signals.t_s, f"plant model {run.plant}"))
    if recording is not None:
        forces = f"forces{''.join(recording.suffixes)}"
        window = f"0:{run.tare_end_s:.4g}"
        write_out(f"next: needleforce force {recording} --tare {window} -o {forces}\n")


def _write_needle_run(
    run: NeedleRun, recording: Path | None, truth: Path | None
) -> int:
    """Write recording and ground truth of a needle without an arm, and a summary."""
    if recording is not None:
        write_table(recording, needle_table(run))
    if truth is not None:
        table = tissue_table(run.truth, run.t_s, run.depth_m, run.speed_m_s)
        write_table(truth, table, labels=TableLabels(prefix="/truth"))
    write_out(_summary(run, run.t_s, "needle without an arm"))
    if recording is not None:
        write_out(f"next: needleforce identify {recording} --figure layers.png\n")
    return 0


def _summary(run: Run | NeedleRun, t_s: Array, plant: str) -> str:
    """Return what was simulated."""
    return (
        f"{run.scenario.id}: {run.scenario.title}; {plant}, seed {run.seed}\n"
        f"{len(t_s)} samples in {t_s[-1]:.4g} s, without contact until "
        f"{run.tare_end_s:.4g} s\n"
    )
