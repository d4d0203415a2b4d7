"""`needleforce simulate`: a simulated insertion as a recording."""

from collections.abc import Mapping
from pathlib import Path

from groundtruth import SCENARIOS, NeedleRun, Run, Scenario, insert_needle, simulate
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


NOTHING_TO_WRITE = "nothing to write, expected -o FILE or --truth FILE"


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
    """Simulate a scenario, write recording and ground truth, and print a summary.

    Args:
        scenario: Name of the scenario.
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
    outputs = {"-o": recording, "--truth": truth}
    paths = {option: path for option, path in outputs.items() if path is not None}
    chosen = _check_simulation(scenario, seed)
    _check_places(paths, overwrites=overwrites)
    if plant == NEEDLE:
        return _write_needle_simulation(chosen, seed, recording, truth)
    with progress_bar(f"simulating {chosen.id}"):
        run = simulate(chosen, plant=plant, seed=seed)
    _write_run(run, recording, truth)
    return 0


def write_patient_simulation(
    plan: Path,
    recording: Path | None,
    truth: Path | None,
    *,
    overwrites: bool = False,
) -> int:
    """Simulate the insertion of a plan, write its files, and print a summary.

    Args:
        plan: The plan's file.
        recording: File of the measured signals, if any.
        truth: File of the ground truth, if any.
        overwrites: Whether files that are there are replaced.

    Returns:
        The exit code.
    """
    outputs = {"-o": recording, "--truth": truth}
    paths = {option: path for option, path in outputs.items() if path is not None}
    _check_places(paths, overwrites=overwrites)
    with progress_bar("simulating"):
        run = insert_into_patient(read_plan_fields(plan))
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
    write_out(_summary(run, recording))


def _write_needle_simulation(
    scenario: Scenario, seed: int, recording: Path | None, truth: Path | None
) -> int:
    """Simulate a needle without an arm, write its files, and print a summary."""
    run = insert_needle(scenario, seed=seed)
    if recording is not None:
        write_table(recording, needle_table(run))
    if truth is not None:
        table = tissue_table(run.truth, run.t_s, run.depth_m, run.speed_m_s)
        write_table(truth, table, labels=TableLabels(prefix="/truth"))
    write_out(_needle_summary(run, recording))
    return 0


def _check_simulation(scenario: str | None, seed: int) -> Scenario:
    """Return the scenario of that name."""
    if scenario is None:
        raise CommandError("no scenario is named; --list prints the scenarios")
    if seed < 0:
        raise CommandError(f"--seed {seed}: expected a whole number from 0 up")
    return scenario_named(scenario, seed)


def _check_places(paths: Mapping[str, Path], *, overwrites: bool) -> None:
    """Refuse files that cannot be written, or are there; and none at all."""
    if not paths:
        raise CommandError(NOTHING_TO_WRITE)
    check_outputs(paths)
    for path in paths.values():
        check_writable(path, overwrites=overwrites)


def _summary(run: Run, recording: Path | None) -> str:
    """Return what was simulated, and the command for the recording, if there is one."""
    end_s = f"{run.tare_end_s:.4g}"
    t_s = run.signals.t_s
    text = (
        f"{run.scenario.id}: {run.scenario.title}; plant model {run.plant}, "
        f"seed {run.seed}\n"
        f"{len(t_s)} samples in {t_s[-1]:.4g} s, without contact until {end_s} s\n"
    )
    if recording is not None:
        forces = f"forces{''.join(recording.suffixes)}"
        text += f"next: needleforce force {recording} --tare 0:{end_s} -o {forces}\n"
    return text


def _needle_summary(run: NeedleRun, recording: Path | None) -> str:
    """Return what was simulated, and the command for the recording, if there is one."""
    text = (
        f"{run.scenario.id}: {run.scenario.title}; needle without an arm, "
        f"seed {run.seed}\n"
        f"{len(run.t_s)} samples in {run.t_s[-1]:.4g} s, without contact until "
        f"{run.tare_end_s:.4g} s\n"
    )
    if recording is not None:
        text += f"next: needleforce identify {recording} --figure layers.png\n"
    return text
