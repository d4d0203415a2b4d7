"""The wanted topics of a bag as tables of consecutive rows."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from recordings.bag_storage.raw_message import NONE_YET, RawMessage
from recordings.bags.interpolate import interpolate
from recordings.bags.plan import BagPlan
from recordings.bags.survey import BagSurvey
from recordings.bags.topic_reader import TopicReader, TopicRows
from recordings.clock.nanoseconds import NS_PER_S, start_of_clock, to_seconds
from recordings.tables.table import FloatArray, Table

TIME = "t_s"
_SHORTEST_LIMIT_S = 0.1
_PERIODS = 5.0
"""So many periods of a topic may lie between two of its messages and still be bridged."""

_LATE_NS = NS_PER_S
"""A topic whose messages come so much later than those of others loses nothing."""

_NEVER_NS = -(1 << 62)


def bag_tables(
    messages: Iterable[RawMessage], survey: BagSurvey, plan: BagPlan, rows: int | None
) -> Iterator[Table]:
    """Read what a plan says.

    Args:
        messages: those of the planned topics; rows do not wait for what comes after `NONE_YET`.
        survey: the bag.
        plan: what to read.
        rows: the most rows of a table; None for all in one.

    Yields:
        Tables with the time stamps as `t_s` and the planned columns.
    """
    readers = {
        name: TopicReader(survey.topics[name], columns, survey.types, plan.joints[name])
        for name, columns in plan.columns.items()
    }
    clock = readers[plan.clock]
    rest = _Rest(survey, plan)
    for message in messages:
        if message is not NONE_YET:
            readers[message.topic.name].add(message)
        if rows is not None and (message is NONE_YET or len(clock) >= rows):
            rest.add(readers)
            least = 1 if message is NONE_YET else rows
            while (ready := rest.ready) >= least:
                yield rest.table(min(ready, rows))
            rest.forget()
    rest.add(readers)
    rest.note([note for reader in readers.values() for note in reader.notes()])
    while rest.waiting or rest.has_news:
        yield rest.table(rows or rest.waiting)


@dataclass(slots=True)
class _Signal:
    """What is known of a topic and still needed."""

    rows: TopicRows
    limit_ns: float
    latest_ns: int


class _Rest:
    """What has been read and not yet given out."""

    def __init__(self, survey: BagSurvey, plan: BagPlan) -> None:
        self._plan = plan
        self._warnings = [*survey.warnings, *plan.notes]
        self._signals: dict[str, _Signal] = {}
        self._limits_ns = {
            name: NS_PER_S * max(_SHORTEST_LIMIT_S, _PERIODS / max(topic.rate_hz, 1e-9))
            for name, topic in survey.topics.items()
        }
        self._joints = {
            column: plan.joints[name]
            for name in plan.columns
            for column in plan.columns[name] & survey.topics[name].named
        }
        self._singles = {
            column
            for name in plan.columns
            for column in plan.columns[name]
            if survey.topics[name].columns[column] is None
        }
        self._start_ns: int | None = None
        self._is_new = True

    @property
    def waiting(self) -> int:
        """How many rows could be given out."""
        signal = self._signals.get(self._plan.clock)
        return 0 if signal is None else signal.rows.stamps_ns.size

    @property
    def ready(self) -> int:
        """How many of them nothing that may still come can change."""
        if not self.waiting:
            return 0
        last_ns = np.maximum.accumulate(self._signals[self._plan.clock].rows.stamps_ns)
        until_ns = min(
            max(signal.latest_ns, int(last_ns[-1]) - max(int(signal.limit_ns), _LATE_NS) - 1)
            for signal in self._signals.values()
        )
        return int(np.searchsorted(last_ns, until_ns, side="right"))

    @property
    def has_news(self) -> bool:
        """Whether something is to be told: that there are columns, or a warning."""
        return self._is_new or bool(self._warnings)

    def add(self, readers: dict[str, TopicReader]) -> None:
        """Take what readers hold."""
        for name, reader in readers.items():
            new = reader.take()
            old = self._signals.get(name)
            rows = new if old is None else _joined(old.rows, new)
            latest_ns = _NEVER_NS if old is None else old.latest_ns
            latest_ns = int(new.stamps_ns.max(initial=latest_ns))
            self._signals[name] = _Signal(rows, self._limits_ns[name], latest_ns)

    def note(self, notes: list[str]) -> None:
        """Take what is to be told with the next rows."""
        self._warnings += notes

    def table(self, rows: int) -> Table:
        """Give out rows."""
        clock = self._signals[self._plan.clock]
        at_ns = clock.rows.stamps_ns[:rows]
        if self._start_ns is None:
            self._start_ns = start_of_clock(int(at_ns[0])) if at_ns.size else 0
        columns: dict[str, FloatArray] = {TIME: to_seconds(at_ns, self._start_ns)}
        for name, signal in self._signals.items():
            for column, values in signal.rows.columns.items():
                if name == self._plan.clock:
                    found = values[:rows]
                else:
                    found = interpolate(at_ns, signal.rows.stamps_ns, values, signal.limit_ns)
                columns[column] = found[:, 0] if column in self._singles else found
        self._drop(rows, int(at_ns.max()) if at_ns.size else 0)
        warnings, self._warnings = tuple(self._warnings), []
        self._is_new = False
        return Table(
            columns=columns,
            warnings=warnings,
            joint_names=self._joints,
            start_ns=self._start_ns,
        )

    def forget(self) -> None:
        """Forget what no row needs that may still come late, while none waits."""
        if not self.waiting:
            newest_ns = max(signal.latest_ns for signal in self._signals.values())
            self._drop(0, newest_ns - _LATE_NS)

    def _drop(self, rows: int, latest_ns: int) -> None:
        """Forget rows, and what no later one needs if the latest was at this instant."""
        for name, signal in self._signals.items():
            stamps_ns = signal.rows.stamps_ns
            if name == self._plan.clock:
                kept = slice(rows, None)
            else:
                # Rows may run backward a little: as much as is bridged is kept.
                kept = stamps_ns >= latest_ns - 2 * signal.limit_ns
            columns = {column: v[kept] for column, v in signal.rows.columns.items()}
            signal.rows = TopicRows(stamps_ns[kept], columns)


def _joined(old: TopicRows, new: TopicRows) -> TopicRows:
    return TopicRows(
        np.concatenate([old.stamps_ns, new.stamps_ns]),
        {name: np.concatenate([values, new.columns[name]]) for name, values in old.columns.items()},
    )
