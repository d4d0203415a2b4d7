"""The command `needleforce`: a robot's joint signals to forces, forces to layers.

One file a command holds its text in the help and its own options; what several commands
take stands in `shared_options`. Whatever computes is imported when a command is run, so
that `--help` answers at once: `logs` has what works on recordings, `arms` what works on
an arm, `demos` the demonstrations, `checkup` what `doctor` finds.

Reading order: `application`, `shared_options`, `terminal` (errors, signals, printing),
`force`, `check`, `identify`, `report`, `simulate`, `record`, `plan`, `touch`,
`register`, `live`, `lag`, `ros2`, `view`, `demo`, `doctor` (the commands), `robot` (the
robot from options and TOML files), `logs`, `plan_option`, `auto_tare`, `loop_threads`,
`arms`, `patient`, `demos`, `checkup`.
"""

import re
import sys
from collections.abc import Sequence

from needleforce.cli import (
    check,
    demo,
    doctor,
    force,
    identify,
    lag,
    live,
    plan,
    record,
    register,
    report,
    ros2,
    simulate,
    touch,
    view,
)
from needleforce.cli.application import app
from needleforce.cli.terminal import CommandError, run_command

__all__ = [
    "app",
    "check",
    "demo",
    "doctor",
    "force",
    "identify",
    "lag",
    "live",
    "main",
    "plan",
    "record",
    "register",
    "report",
    "ros2",
    "run_ros2_node",
    "simulate",
    "touch",
    "view",
]


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command with its arguments, or those of the process.

    Returns:
        The exit code.
    """

    def dispatch() -> int:
        tokens = list(sys.argv[1:] if argv is None else argv)
        # As a path it would be the current folder.
        if empty := [token for token in tokens if re.fullmatch(r"(-[\w-]+=)?", token)]:
            raise CommandError(
                f"{empty[0]!r}: nothing is given there, expected a name or a value (a "
                "variable of the shell may not be set)",
                "--help lists what a command takes",
            )
        command, bound, _ = app.parse_args(
            tokens, exit_on_error=False, print_error=False
        )
        return command(*bound.args, **bound.kwargs) or 0

    return run_command(dispatch)


def run_ros2_node() -> int:
    """Run `needleforce ros2` as `ros2 run needleforce node`, the package's executable.

    Returns:
        The exit code.
    """
    return main(["ros2", *sys.argv[1:]])
