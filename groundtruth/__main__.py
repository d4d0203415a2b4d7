"""``python -m groundtruth SCENARIO -o FILE``: a simulated insertion as a recording."""

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from groundtruth.arguments import build_parser
from groundtruth.errors import GroundTruthError, RunError
from groundtruth.named_scenario import named_scenario
from groundtruth.random_stack import RANDOM_STACK
from groundtruth.run import Run
from groundtruth.scenario import Scenario
from groundtruth.scenarios import SCENARIOS
from groundtruth.signal_table import signal_table, truth_table
from groundtruth.simulate import simulate
from recordings import RecordingError, check_writable, write_table
from recordings.apart import require_apart
from recordings.command.progress import progress
from recordings.command.run_command import run_command, write_out
from recordings.tables.labels import Labels
from urdf import UrdfError

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

        return simulate(chosen, arm=arguments.arm, seed=arguments.seed, progress=report)


def _listed() -> str:
    rows = {name: item.title for name, item in SCENARIOS.items()}
    rows[RANDOM_STACK] = "one to four layers drawn from the seed"
    width = max(map(len, rows))
    return "".join(f"{name:<{width}}  {title}\n" for name, title in rows.items())


def _summary(run: Run, arguments: Namespace) -> str:
    samples = len(run.signals.t_s)
    lines = [
        f"{run.scenario.id}: {run.scenario.title}; {run.arm} arm, seed {run.seed}",
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
