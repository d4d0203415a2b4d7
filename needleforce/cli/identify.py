"""``python -m identification LOG``: layers, ruptures and friction from a recording."""

import sys
from argparse import ArgumentParser, Namespace
from collections import deque
from collections.abc import Sequence

import numpy as np

from identification.errors import IdentificationError
from identification.log_replay import ReplayedRows, ReplayStream
from needleforce.cli.identify_report import (
    METHODS,
    ForceStatus,
    IdentificationResult,
    LogClock,
    estimate_table,
    layer_table,
    save_figure,
    write_report,
)
from needleforce.plots import FiguresError, folder_if_filled, require_matplotlib
from recordings import RecordingError, mapping_arguments
from recordings.command.log_session import LogSession
from recordings.command.mapping_arguments import mapping_from_arguments
from recordings.command.output_arguments import check_outputs, open_output, output_arguments
from recordings.command.row_overview import RowOverview
from recordings.command.run_command import run_command, say, write_out
from recordings.command.source_arguments import source_arguments
from recordings.command.suggest_mapping import suggest_mapping
from recordings.open_table import STANDARD_STREAM, OpenTable
from recordings.tables.labels import Labels

# The command line of ``python -m identification``.


CHANNELS = ("depth", "speed", "force", "force_status", "force_warnings")
"""What is read of a log beside time."""


def build_parser() -> ArgumentParser:
    """Return the parser of the command."""
    parser = ArgumentParser(
        prog="python -m identification",
        description="Ruptures, layers, stiffness and friction from depth, speed and axial force.",
        epilog="Depth grows into the tissue; force is positive when tissue pushes back. Times of "
        "the table are on the log's clock. A ? marks what the data do not identify.",
    )
    source_arguments(parser, "time, depth, force, perhaps speed")
    output_arguments(
        parser,
        table="online estimates",
        picture="picture after the paper's Figure 8",
        page="that picture, the layers, warnings and settings",
    )
    parser.add_argument(
        "--method",
        choices=tuple(METHODS),
        default="default",
        help="ours, or the method as published with the multi-layer or the Kelvin-Voigt model",
    )
    parser.add_argument(
        "--ignore-status",
        action="store_true",
        help="use also rows that `python -m residual` has marked as not tared, settling, doubtful",
    )
    mapping_arguments(parser, CHANNELS)
    return parser


# The log's clock beside the identifier's, which never goes back.


# What the command found out, for the table of layers, pictures and reports.


# From a log to its result: rows in, online estimates out, as they come.


_TRACKED = (
    "force_N",
    "predicted_force_N",
    "enhanced_force_N",
    "tip_force_N",
    "stiffness_N_per_m",
    "friction_Ns_per_m2",
    "cumulative_friction_Ns_per_m",
)
_MOST_EVENTS = 1000
_FLIP = "; a factor of -1 after the unit does, as in --force fz:N:-1"


def run_log(arguments: Namespace, log: LogSession, *, needs_overview: bool) -> IdentificationResult:
    """Run the identifier over a log and write its estimates.

    Args:
        arguments: Of the command: the method and where the table goes.
        log: The log, entered.
        needs_overview: Whether a chart is to be drawn.

    Raises:
        recordings.RecordingError: The log cannot be read, or the table not written.
    """
    stream = ReplayStream(METHODS[arguments.method])
    status = ForceStatus(is_ignored=arguments.ignore_status)
    with open_output(arguments, is_live=log.is_live, labels=lambda: _labels(log)) as table:
        found = _Found(table, needs_overview=needs_overview)
        for chunk in log:
            depth_m, speed_m_s = chunk.channels["depth_m"], chunk.channels.get("speed_m_s")
            force_N = status.force_N(chunk)
            found.add(stream.run(chunk.t_s, depth_m, force_N, speed_m_s, chunk.dt_s))
        found.add(stream.finish())
    told = (f"{hint.rstrip('?')}{_FLIP}" if "flip" in hint else hint for hint in stream.hints)
    hints = (*status.warnings, *told)
    for hint in hints:
        say(f"warning: {hint}")
    return IdentificationResult(
        log=log.name,
        method=arguments.method,
        layers=stream.layers,
        clock=found.clock,
        ruptures_s=tuple(found.ruptures_s),
        compensations_s=tuple(found.compensations_s),
        warnings=(*log.warnings, *hints),
        overview=found.overview.columns(),
    )


def _labels(log: LogSession) -> Labels:
    """What a bag of estimates says beside the numbers: the source's clock, and events in words."""
    events = {
        "rupture": ("", "left layer {}"),
        "compensated": ("", "friction of layer {} identified"),
    }
    return Labels(start_ns=log.start_ns, prefix="/needleforce/identification", events=events)


class _Found:
    """Writes rows of estimates and keeps what is needed at the end."""

    def __init__(self, table: OpenTable | None, *, needs_overview: bool) -> None:
        self._table, self._needs_overview = table, needs_overview
        self.clock, self._time_s = LogClock(), 0.0
        self.overview = RowOverview(_TRACKED)
        self.ruptures_s: deque[float] = deque(maxlen=_MOST_EVENTS)
        self.compensations_s: deque[float] = deque(maxlen=_MOST_EVENTS)

    def add(self, rows: ReplayedRows) -> None:
        if not rows.estimates:
            return
        times_s = np.array([estimate.time_s for estimate in rows.estimates])
        # Where time does not advance, the identifier's stands still.
        advances = np.diff(times_s, prepend=self._time_s) > 0.0
        self._time_s = float(times_s[-1])
        self.clock.add(rows.t_s[advances], times_s[advances])
        self._note_events(rows)
        if self._table is None and not self._needs_overview:
            return
        columns = estimate_table(rows)
        if self._table is not None:
            self._table.append(columns)
        if self._needs_overview:
            self.overview.add({"force_N": rows.force_N} | columns)

    def _note_events(self, rows: ReplayedRows) -> None:
        for t_s, estimate in zip(rows.t_s.tolist(), rows.estimates, strict=True):
            if estimate.rupture is not None:
                self.ruptures_s.append(self.clock.at(estimate.rupture.time_s))
            if estimate.compensated is not None:
                self.compensations_s.append(t_s)


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
        require_matplotlib("--png", arguments.png)
    optional = ("speed", "force_status", "force_warnings")
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
