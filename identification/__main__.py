"""``python -m identification LOG``: layers, ruptures and friction from a recording."""

import sys
from argparse import Namespace
from collections.abc import Sequence

from identification.command.arguments import CHANNELS, build_parser
from identification.command.figure import check_figure, save_figure
from identification.command.layer_table import layer_table
from identification.command.run_log import run_log
from identification.errors import IdentificationError
from recordings import RecordingError, check_writable
from recordings.command_line import run_command, write_out
from recordings.log_session import LogSession
from recordings.open_table import STANDARD_STREAM
from recordings.suggest_mapping import suggest_mapping


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Args:
        argv: Arguments without the program's name; those of the process when None.

    Returns:
        The exit code, see `recordings.command_line`.
    """
    arguments = build_parser().parse_args(argv)
    return run_command(lambda: _run(arguments), (IdentificationError, RecordingError))


def _run(arguments: Namespace) -> int:
    if arguments.print_config:
        write_out(suggest_mapping(arguments.log, CHANNELS))
        return 0
    if arguments.output is not None:
        check_writable(arguments.output, source=arguments.log)
    if arguments.png is not None:
        check_figure(arguments.png)
    channels = {"required": ("depth", "force"), "optional": ("speed", "status")}
    with LogSession(arguments, **channels) as log:
        result = run_log(arguments, log, needs_overview=arguments.png is not None)
        if arguments.png is not None:
            save_figure(arguments.png, result)
    write_out(layer_table(result), to_stderr=arguments.output == STANDARD_STREAM)
    return log.exit_code


if __name__ == "__main__":
    sys.exit(main())
