"""Reading ROS 2 bags, whole or a number of rows at a time."""

from collections.abc import Iterator
from pathlib import Path

from recordings.bag_storage.messages import bag_messages
from recordings.bags.plan import plan_bag, survey_table
from recordings.bags.survey import survey_bag
from recordings.bags.tables import bag_tables
from recordings.columns.wanted import Wanted
from recordings.tables.table import Table


def read_bag(path: Path, wanted: Wanted | None = None) -> Table:
    """Read a ROS 2 bag in MCAP or SQLite files.

    The messages of one topic are the rows, those of others are interpolated to its time stamps.
    A cut or damaged bag yields what can be read of it, and says in the table's warnings what was
    lost.

    Args:
        path: see `bag_files`.
        wanted: what to read; all topics with numbers if None.

    Returns:
        `t_s` and the columns. If a required channel is missing, all columns, without rows.

    Raises:
        FileAccessError: the bag cannot be read, or rosbags is not installed.
        FormatError: it is not a bag, or holds no messages or no numbers.
        ColumnError: a mapped channel was not found, or is ambiguous.
    """
    return next(bag_chunks(path, rows=None, wanted=wanted))


def bag_chunks(path: Path, rows: int | None, wanted: Wanted | None = None) -> Iterator[Table]:
    """Read a ROS 2 bag a number of rows at a time.

    Args:
        path: see `bag_files`.
        rows: the most rows of a table; None for all in one.
        wanted: what to read; all topics with numbers if None.

    Yields:
        Tables of consecutive rows with equal columns.

    Raises:
        FileAccessError: see `read_bag`.
        FormatError: see `read_bag`.
        ColumnError: see `read_bag`.
    """
    survey = survey_bag(path)
    whole = survey_table(survey)
    needed = frozenset(whole.columns) if wanted is None else wanted.columns(whole)
    if not needed:
        yield whole
        return
    plan = plan_bag(survey, wanted or Wanted(), needed)
    messages = bag_messages(survey.files, [], plan.columns)
    yield from bag_tables(messages, survey, plan, rows)
