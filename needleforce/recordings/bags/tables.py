"""ROS bags as tables: topics are columns, the messages of one topic are the rows."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from needleforce.recordings.bags.joined_rows import JoinedRows
from needleforce.recordings.bags.message_reader import read_messages
from needleforce.recordings.bags.messages import NONE_YET, RawMessage
from needleforce.recordings.bags.topics import Bag
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.errors import MAX_BYTES, ColumnError, FormatError
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.table import Table
from needleforce.recordings.time_stamps import NS_PER_S


def bag_tables(
    path: Path, request: ChannelRequest | None, options: FollowOptions, max_bytes: int
) -> Iterator[Table]:
    """Read a ROS bag in tables of at most `MAX_TABLE_ROWS`.

    A file is read from its start twice: until it is clear which topics are read, and
    for their rows. An MCAP file that is followed is read on as a recorder writes it,
    until it is finished.

    Args:
        path: Of the bag, a file or a folder.
        request: Which channels are read; None for all columns.
        options: Whether more is waited for.
        max_bytes: See `stream_tables`.

    Yields:
        Tables of consecutive rows; if a required channel is missing, one with all
        columns and no rows.

    Raises:
        RecordingError: As `stream_tables` does.
    """
    if options.follow:
        bag = Bag(path)
        joined = learn_topics(bag, request, options, max_bytes)
        if joined is not None:
            yield from _growing_tables(bag, joined, options, max_bytes)
            return

    # It is whole, or has ended: all of it can be counted.
    bag = Bag(path)
    learn_topics(bag, max_bytes=max_bytes)
    table = bag.table()
    needed = frozenset(table.columns) if request is None else request.columns(table)
    if not needed:
        yield table
        return

    joined = JoinedRows(bag, request or ChannelRequest(), needed)
    row_count = 0
    for table in joined.tables(read_messages(path, [], max_bytes)):
        yield table
        row_count += len(table)
        options.progress(row_count / joined.reference.count)


def _growing_tables(
    bag: Bag, joined: JoinedRows, options: FollowOptions, max_bytes: int
) -> Iterator[Table]:
    """Yield rows as they are recorded, then what is wrong with the file."""
    faults: list[str] = []
    table = None
    messages = read_messages(bag.path, faults, max_bytes, options)
    for table in joined.tables(messages):
        yield table

    if faults and table is not None:
        columns = {name: values[:0] for name, values in table.columns.items()}
        yield replace(table, columns=columns, warnings=("; ".join(faults),))


def learn_topics(
    bag: Bag,
    request: ChannelRequest | None = None,
    growing: FollowOptions | None = None,
    max_bytes: int = MAX_BYTES,
) -> JoinedRows | None:
    """Learn a bag's topics: to its end, or of a growing one until its rows are clear.

    Args:
        bag: Gets the topics.
        request: What is read of a growing bag.
        growing: How long more is waited for; None for a bag that does not grow.
        max_bytes: See `read_messages`.

    Returns:
        The rows of a growing bag; None where the end came first.
    """
    reported = ""
    settled_ns = 0
    for message in read_messages(bag.path, bag.faults, max_bytes, growing):
        if message is NONE_YET:
            continue

        is_new = bag.learn(message)
        if growing is None or not (is_new or message.log_ns >= settled_ns):
            continue

        # A second without a new topic, and it is decided which topics are read.
        settled_ns = message.log_ns + NS_PER_S
        if is_new:
            _count_from(bag, message)
            continue

        joined, missing = _join_if_clear(bag, request or ChannelRequest())
        if joined is not None:
            return joined
        if missing not in ("", reported):
            reported = missing
            growing.warn(f"{bag.path.name}: waiting for more topics; {missing}")

    return None


def _count_from(bag: Bag, message: RawMessage) -> None:
    """Count messages anew from one on, so that rates are those of the same time."""
    for topic in bag.topics.values():
        topic.count = int(topic.first_ns == message.log_ns)
        topic.first_ns = message.log_ns


def _join_if_clear(bag: Bag, request: ChannelRequest) -> tuple[JoinedRows | None, str]:
    """Return the rows that are read, if that is clear by now.

    Returns:
        The rows or None, and what is missing, if something is.
    """
    try:
        needed = request.columns(bag.table())
        if not needed:
            return None, (
                f"needed are {', '.join(request.required)}, and until now there are "
                f"{', '.join(bag.topics)}"
            )

        joined = JoinedRows(bag, request, needed)
    except (ColumnError, FormatError) as error:
        return None, str(error)

    has_rates = all(topic.rate_hz > 0.0 for topic in joined.topics.values())
    return (joined if has_rates else None), ""
