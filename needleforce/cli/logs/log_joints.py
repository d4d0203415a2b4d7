"""Which joints a log has, before it is known which robot moves them."""

from contextlib import suppress

from needleforce import recordings
from needleforce.cli.kept_joints import LogJoints
from needleforce.recordings import ColumnError, ColumnMapping
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.errors import readable_path
from needleforce.recordings.table import STANDARD_STREAM, Table


def find_log_joints(source: str, mapping: ColumnMapping, torque: str) -> LogJoints:
    """Return the joints of a log: those of the mapping, else those that it names.

    Args:
        source: The log as the command line names it; a pipe, which can be read only
            once, is not looked at.
        mapping: Which columns are which channels.
        torque: Channel of the torques.
    """
    if mapping.joint_order:
        return LogJoints(mapping.joint_order, len(mapping.joint_order))
    if source == STANDARD_STREAM or readable_path(source).is_fifo():
        return LogJoints()
    table = recordings.columns_of(source, mapping)
    names: dict[str, None] = {}
    for column in _columns(table, mapping, ("q", torque)):
        names |= dict.fromkeys(table.joint_names.get(column, ()))
    positions = _columns(table, mapping, ("q",))
    count = sum(_width(table, column) for column in positions)
    return LogJoints(tuple(names), count or None)


def _columns(
    table: Table, mapping: ColumnMapping, channels: tuple[str, ...]
) -> frozenset[str]:
    """Return the columns of channels; all of them where names do not say which."""
    with suppress(ColumnError):  # several would fit, which reading the log will say
        columns = ChannelRequest(mapping, channels).columns(table)
        return columns or frozenset()
    return frozenset(table.joint_names)


def _width(table: Table, column: str) -> int:
    """Return how many values a column has in a row."""
    values = table.columns.get(column)
    return 1 if values is None or values.ndim == 1 else values.shape[1]
