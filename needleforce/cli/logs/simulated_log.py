"""`needleforce simulate`: a simulated insertion as a recording."""

from pathlib import Path

from groundtruth import SCENARIOS, NeedleRun, Run, insert_needle, scenarios, simulate
from needleforce.cli.options import RobotOptions
from needleforce.cli.patient.case_files import read_plan_fields
from needleforce.cli.robot import labels_of_arm
from needleforce.cli.terminal import (
    CommandError,
    aligned,
    progress_bar,
    require_modules,
    write_out,
)
from needleforce.recordings import check_writable, write_table
from needleforce.recordings.output import check_outputs
from needleforce.recordings.table import TableLabels
from needleforce.simulation import tables
from needleforce.simulation.patient import insert_into_patient
from needleforce.simulation.torso_case import write_torso_case


def print_scenarios() -> int:
    """Print every scenario with its title; return the exit code."""
    titles = {name: item.title for name, item in SCENARIOS.items()}
    titles[scenarios.RANDOM_STACK] = "one to four layers drawn from the seed"
    titles[scenarios.RANDOM_TISSUE] = "the same, each layer of its own law"
    write_out(aligned(titles.items()))
    return 0


def write_simulation(
    scenario: str | None,
    output: Path | None,
    truth: Path | None,
    *,
    plant: str,
    seed: int,
    overwrites: bool,
) -> int:
    """Simulate a scenario, or the insertion of a plan, write its files, and a summary.

    Args:
        scenario: Name of the scenario, a plan's file (.json), or ``torso`` for a
            patient to plan on.
        output: The recording, or the folder of the torso.
        truth: Ground truth.
        plant: Plant model, or ``needle``.
        seed: Seed of everything that is drawn at random.
        overwrites: Whether files that are there are replaced.

    Returns:
        The exit code.

    Raises:
        CommandError: No scenario or file is named, or an option says nothing of it.
    """
    paths = {"-o": output, "--truth": truth}
    named = {option: path for option, path in paths.items() if path is not None}
    if scenario is None or not named:
        raise CommandError(
            "nothing to write: expected a scenario (--list prints them), and -o FILE "
            "or --truth FILE"
        )
    _require_possible(scenario, truth, plant, seed)
    if scenario == "torso" and output is not None:
        return _write_torso(output, seed)
    check_outputs(named)
    for path in named.values():
        check_writable(path, overwrites=overwrites)
    with progress_bar(f"simulating {scenario}"):
        run = _simulate(scenario, plant, seed)
    if isinstance(run, NeedleRun):
        recorded = tables.needle_table(run)
        true = tables.tissue_table(run.truth, run.t_s, run.depth_m, run.speed_m_s)
        labels = TableLabels()
        next_command = "identify {} --figure layers.png"
    else:
        recorded = tables.signal_table(run)
        true = tables.truth_table(run)
        labels = labels_of_arm(RobotOptions(), run.robot)
        suffixes = "".join(output.suffixes) if output else ""
        next_command = f"force {{}} --tare 0:{run.tare_end_s:.4g} -o forces{suffixes}"
    if truth is not None:
        names = TableLabels(joint_names=labels.joint_names, prefix="/truth")
        write_table(truth, true, labels=names)
    t_s = true["t_s"]
    write_out(
        f"{run.scenario.id}: {run.scenario.title}; plant model {plant}, seed "
        f"{run.seed}\n{len(t_s)} samples in {t_s[-1]:.4g} s, without contact until "
        f"{run.tare_end_s:.4g} s\n"
    )
    if output is not None:
        write_table(output, recorded, labels=labels)
        write_out(f"next: needleforce {next_command.format(output)}\n")
    return 0


def _require_possible(scenario: str, truth: Path | None, plant: str, seed: int) -> None:
    """Refuse options that say nothing of what is simulated."""
    is_plan = scenario.endswith(".json")
    is_torso = scenario == "torso"
    is_free = plant == "clean" and not (is_plan and seed) and not (is_torso and truth)
    if (is_plan or is_torso) and not is_free:
        raise CommandError(
            f"{scenario}: --plant, --seed and --truth: a torso has neither plant nor "
            "truth, the insertion of a plan is that of seed 0 on clean; leave them out"
        )


def _simulate(scenario: str, plant: str, seed: int) -> Run | NeedleRun:
    """Return the insertion of a plan's file, or that of a scenario."""
    if scenario.endswith(".json"):
        return insert_into_patient(read_plan_fields(Path(scenario)))
    chosen = scenarios.scenario(scenario, seed)
    if plant == "needle":
        return insert_needle(chosen, seed=seed)
    return simulate(chosen, plant=plant, seed=seed)


def _write_torso(folder: Path, seed: int) -> int:
    """Write the example patient into a folder; return the exit code.

    Raises:
        CommandError: The folder cannot be written to.
    """
    require_modules("simulate torso", ("SimpleITK",))
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
