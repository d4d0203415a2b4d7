"""The command `needleforce`: a robot's joint signals to forces, forces to layers.

Whatever computes is imported when a command is run, so that `--help` answers at once.

Reading order: `options` (the application, what several commands take), `commands`,
`terminal` (errors, signals, printing), `robot` (the robot from options and TOML files),
`logs`, `session_parts`, `arms`, `patient`, `demos`, `checkup`.
"""

import re
import sys
from collections.abc import Sequence

from needleforce.cli import commands as commands
from needleforce.cli.options import app as app
from needleforce.cli.terminal import CommandError, run_command


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
