"""``python -m groundtruth SCENARIO -o FILE``: a simulated insertion as a recording."""

import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundtruth.errors import GroundTruthError, RunError
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.scenarios import RANDOM_STACK, RANDOM_TISSUE, SCENARIOS, Scenario, named_scenario
from groundtruth.simulation import Run, simulate
from recordings import RecordingError, check_writable, write_table
from recordings.apart import require_apart
from recordings.command.progress import progress
from recordings.command.run_command import run_command, write_out
from recordings.tables.labels import Labels
from urdf import UrdfError

# The command line of ``python -m groundtruth``.


_DESCRIPTION = (
    "A recording of a simulated insertion, as a robot would have made it: joint positions, "
    "velocities and torques of a KUKA LWR 4+, and the wrench of a force sensor at the needle."
)

_EPILOG = """\
FILE may end in .csv, .csv.gz, .npz, .parquet, .mcap, or in .db3 for a folder with a ROS 2 bag.

examples:
  python -m groundtruth --list
  python -m groundtruth gel-25-constant -o insertion.mcap --truth truth.csv
  python -m residual insertion.mcap -o forces.mcap
  python -m identification forces.mcap

See docs/recordings.md for columns and topics."""


def build_parser() -> ArgumentParser:
    """Return the parser of the command."""
    parser = ArgumentParser(
        prog="python -m groundtruth",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scenario", metavar="SCENARIO", nargs="?", help="what is simulated; see --list"
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="the recording")
    parser.add_argument(
        "--truth",
        metavar="FILE",
        help="what the robot does not know: true forces, depth, layers, ruptures",
    )
    parser.add_argument(
        "--plant",
        choices=tuple(PLANT_MODELS),
        default="clean",
        help="how good arm and sensors are (default: clean)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of everything drawn (default: 0)"
    )
    parser.add_argument("--list", action="store_true", help="print the scenarios and stop")
    return parser


# A run as a table: what a robot's own recording would hold, and apart from it, what was true.


Columns = dict[str, NDArray]


def signal_table(run: Run) -> Columns:
    """Return what the robot and its F/T sensor gave; n rows, units in the names.

    Args:
        run: The run.

    Returns:
        Time stamps (from zero on, like those of the truth), joint signals of shape (n, 7) (no
        velocities from an arm that reports none), force and torque of the sensor in its axes of
        shape (n, 3).
    """
    signals = run.signals
    columns: Columns = {"t_s": signals.t_s + _shift_s(run), "q_rad": signals.q_rad}
    if signals.dq_rad_s is not None:
        columns["dq_rad_s"] = signals.dq_rad_s
    columns["tau_Nm"] = signals.tau_Nm
    columns["ft_force_N"] = signals.ft_wrench[:, :3]
    columns["ft_torque_Nm"] = signals.ft_wrench[:, 3:]
    return columns


def truth_table(run: Run) -> Columns:
    """Return what was true at the same samples; see `Truth` for the meaning.

    `rupture` is the number of the layer that the tip begins to leave at a row, counted from 1, else
    0; of two that give way within one row the second is told at the next. `surface_rupture` is 1
    where a membrane on the surface gives way.

    Args:
        run: The run.
    """
    truth = run.truth
    columns: Columns = {
        "t_s": truth.t_s + _shift_s(run),
        "depth_m": truth.depth_m,
        "speed_m_s": truth.speed_m_s,
        "axial_N": truth.axial_N,
        "tip_N": truth.tip_N,
        "friction_N": truth.friction_N,
        "layer": truth.layer,
        "rupture": _ruptures(run, on_surface=False),
        "surface_rupture": _ruptures(run, on_surface=True),
        "tau_ext_Nm": truth.external_torque_Nm,
    }
    if truth.layer_friction_N.shape[1]:
        columns["layer_friction_N"] = truth.layer_friction_N
    return columns


def _shift_s(run: Run) -> float:
    """What makes the first stamp of a clock with jitter no less than zero, as bags want it."""
    return max(0.0, -float(run.signals.t_s[0]))


def _ruptures(run: Run, *, on_surface: bool) -> NDArray[np.int64]:
    marks = np.zeros(len(run.truth.t_s), dtype=np.int64)
    for rupture in run.truth.ruptures:
        if (rupture.layer == 0) is not on_surface:
            continue
        row = int(np.searchsorted(run.truth.t_s, rupture.onset_s))
        while row < len(marks) and marks[row]:
            row += 1
        if row < len(marks):
            marks[row] = rupture.layer or 1
    return marks


ERRORS = (GroundTruthError, RecordingError, UrdfError)
"""What is told in one line."""

_EVENTS = {
    "layer": ("above the tissue", "in layer {}"),
    "rupture": ("", "layer {} gives way"),
    "surface_rupture": ("", "the membrane on the surface gives way"),
}
"""Columns of the truth in words, see `recordings.tables.labels.Labels`."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code, see `run_command`."""
    return run_command(build_parser(), argv, _run, ERRORS)


def _run(arguments: Namespace) -> int:
    if arguments.list:
        write_out(_listed())
        return 0
    chosen = _chosen(arguments)
    outputs = {"-o": arguments.output, "--truth": arguments.truth}
    named = {option: Path(path) for option, path in outputs.items() if path is not None}
    require_apart(named)
    for path in named.values():
        check_writable(path)
    run = _simulate(chosen, arguments)
    if arguments.output is not None:
        labels = Labels(joint_names=run.robot.joint_names)
        write_table(arguments.output, signal_table(run), labels=labels)
    if arguments.truth is not None:
        labels = Labels(joint_names=run.robot.joint_names, prefix="/truth", events=_EVENTS)
        write_table(arguments.truth, truth_table(run), labels=labels)
    write_out(_summary(run, arguments))
    return 0


def _chosen(arguments: Namespace) -> Scenario:
    if not (arguments.output or arguments.truth):
        raise RunError("nothing to write: name a file with -o FILE or --truth FILE")
    if arguments.scenario is None:
        raise RunError("no scenario is named; --list prints them")
    if arguments.seed < 0:
        raise RunError(f"--seed {arguments.seed}: expected a whole number from 0 up")
    return named_scenario(arguments.scenario, arguments.seed)


def _simulate(chosen: Scenario, arguments: Namespace) -> Run:
    done = 0.0
    with progress(1.0, chosen.id) as advance:

        def report(share: float) -> None:
            nonlocal done
            advance(share - done)
            done = share

        return simulate(chosen, plant=arguments.plant, seed=arguments.seed, progress=report)


def _listed() -> str:
    rows = {name: item.title for name, item in SCENARIOS.items()}
    rows[RANDOM_STACK] = "one to four layers drawn from the seed"
    rows[RANDOM_TISSUE] = "the same, each layer of its own law"
    width = max(map(len, rows))
    return "".join(f"{name:<{width}}  {title}\n" for name, title in rows.items())


def _summary(run: Run, arguments: Namespace) -> str:
    samples = len(run.signals.t_s)
    lines = [
        f"{run.scenario.id}: {run.scenario.title}; {run.plant} arm, seed {run.seed}",
        f"{samples} samples in {run.signals.t_s[-1]:.4g} s, free of contact until "
        f"{run.tare_end_s:.4g} s",
    ]
    if arguments.output is not None:
        forces = f"forces{''.join(Path(arguments.output).suffixes)}"
        lines.append(
            f"next: python -m residual {arguments.output} --tare 0:{run.tare_end_s:.4g} -o {forces}"
        )
    return "".join(f"{line}\n" for line in lines)


if __name__ == "__main__":
    sys.exit(main())
