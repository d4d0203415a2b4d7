"""A bag that a recorder still writes, row by row as it grows."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from recordings.bag_storage.files import BagFiles
from recordings.bag_storage.messages import growing_messages
from recordings.bag_storage.raw_message import NONE_YET
from recordings.bags.format import bag_chunks
from recordings.bags.message_types import MessageTypes
from recordings.bags.plan import BagPlan, plan_bag, survey_table
from recordings.bags.survey import BagSurvey, SurveyedTopic, survey_message
from recordings.bags.tables import bag_tables
from recordings.clock.nanoseconds import NS_PER_S
from recordings.columns.wanted import Wanted
from recordings.errors import ColumnError, FormatError
from recordings.sources.byte_source import Patience
from recordings.tables.table import Table

SETTLED_S = 1.0
"""When so much recording has brought no new topic, it is decided which topics are read."""

_SETTLED_NS = int(SETTLED_S * NS_PER_S)


def growing_chunks(path: Path, rows: int, wanted: Wanted, patience: Patience) -> Iterator[Table]:
    """Read an MCAP file as a recorder writes it, until it finishes the file.

    The file is read from its start twice: until it is clear which topics are read, and then on as
    it grows.

    Args:
        path: the file.
        rows: the most rows of a table.
        wanted: what to read.
        patience: how long more is waited for.

    Yields:
        Tables of consecutive rows with equal columns, as soon as nothing that may still come can
        change them; the last may have none, but warnings.

    Raises:
        FileAccessError: it cannot be read, or rosbags is not installed.
        FormatError: it is no MCAP file, or holds no messages or no numbers.
        ColumnError: it ended and a mapped channel had not come, or is ambiguous.
    """
    begun = _begin(path, wanted, replace(patience, advance=lambda more: None))
    if begun is None:
        yield from bag_chunks(path, rows, wanted)
        return
    faults: list[str] = []
    messages = growing_messages(path, patience, faults, begun.plan.columns)
    table = None
    for table in bag_tables(messages, begun.survey, begun.plan, rows):
        yield table
    if faults and table is not None:
        yield Table(
            columns={name: values[:0] for name, values in table.columns.items()},
            warnings=("; ".join(faults),),
            joint_names=table.joint_names,
            start_ns=table.start_ns,
        )


class _Begun(NamedTuple):
    survey: BagSurvey
    plan: BagPlan


def _begin(path: Path, wanted: Wanted, patience: Patience) -> _Begun | None:
    """Go through a bag until it is clear what is read; None if it ends before."""
    topics: dict[str, SurveyedTopic] = {}
    types, told, settled_ns = MessageTypes(), "", 0
    for message in growing_messages(path, patience, []):
        if message is NONE_YET:
            continue
        if message.topic.name not in topics:
            # Counted anew from here, so that rates are those of the same time.
            for found in topics.values():
                found.count, found.first_ns = 0, message.log_ns
            settled_ns = message.log_ns + _SETTLED_NS
        survey_message(message, topics, types)
        if message.log_ns < settled_ns:
            continue
        settled_ns = message.log_ns + _SETTLED_NS
        files = BagFiles(paths=(path,))
        survey = BagSurvey(path=path, files=files, topics=topics, types=types, warnings=())
        plan, missing = _plan(survey, wanted)
        if plan is not None:
            return _Begun(survey, plan)
        if missing not in ("", told):
            told = missing
            patience.warn(f"{path.name}: waiting for more topics; {missing}")
    return None


def _plan(survey: BagSurvey, wanted: Wanted) -> tuple[BagPlan | None, str]:
    """Return what is read, if that is clear; else what is missing, if something is."""
    try:
        needed = wanted.columns(survey_table(survey))
        if not needed:
            here = ", ".join(survey.topics)
            return None, f"needed are {', '.join(wanted.required)}, and until now there are {here}"
        plan = plan_bag(survey, wanted, needed)
    except (ColumnError, FormatError) as error:
        return None, str(error)
    has_rates = all(survey.topics[name].rate_hz > 0.0 for name in plan.columns)
    return (plan, "") if has_rates else (None, "")
