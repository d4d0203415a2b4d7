"""From a log to its result: rows in, online estimates out, as they come."""

from argparse import Namespace
from collections import deque

import numpy as np

from identification.command.arguments import METHODS
from identification.command.estimate_table import estimate_table
from identification.command.force_status import ForceStatus
from identification.command.log_clock import LogClock
from identification.command.result import IdentificationResult
from identification.replay_stream import ReplayedRows, ReplayStream
from recordings.command.log_session import LogSession
from recordings.command.output_arguments import open_output
from recordings.command.row_overview import RowOverview
from recordings.command.run_command import say
from recordings.open_table import OpenTable
from recordings.tables.labels import Labels

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
