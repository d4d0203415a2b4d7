"""``python -m identification LOG``: layers, ruptures and friction from a recording."""

import sys
from argparse import Namespace
from collections.abc import Sequence

from figures import FiguresError, require_matplotlib
from figures.report_folder import folder_if_filled
from identification.command.arguments import CHANNELS, build_parser
from identification.command.figure import save_figure
from identification.command.layer_table import layer_table
from identification.command.report import write_report
from identification.command.run_log import run_log
from identification.errors import IdentificationError
from recordings import RecordingError
from recordings.command.log_session import LogSession
from recordings.command.mapping_arguments import mapping_from_arguments
from recordings.command.output_arguments import check_outputs
from recordings.command.run_command import run_command, write_out
from recordings.command.suggest_mapping import suggest_mapping
from recordings.open_table import STANDARD_STREAM

ERRORS = (IdentificationError, RecordingError, FiguresError)
"""What is told in one line."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code, see `run_command`."""
    return run_command(build_parser(), argv, _run, ERRORS)


def _run(arguments: Namespace) -> int:
    if arguments.print_config:
        known = mapping_from_arguments(arguments)
        write_out(suggest_mapping(arguments.log, CHANNELS, mapping=known))
        return 0
    check_outputs(arguments)
    if arguments.png is not None:
        require_matplotlib("--png")
    optional = ("speed", "force_status", "force_cautions")
    log = LogSession(arguments, required=("depth", "force"), optional=optional)
    with folder_if_filled(arguments.report), log:
        is_drawn = arguments.png is not None or arguments.report is not None
        result = run_log(arguments, log, needs_overview=is_drawn)
        if arguments.png is not None:
            save_figure(arguments.png, result)
        if arguments.report is not None:
            write_report(arguments.report, result)
    write_out(layer_table(result), to_stderr=arguments.output == STANDARD_STREAM)
    return log.exit_code


if __name__ == "__main__":
    sys.exit(main())
