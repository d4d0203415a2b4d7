"""The time of a log: stamps in the file, or a sample rate."""

from dataclasses import replace

import numpy as np

from recordings.clock.nanoseconds import NS_PER_S, start_of_clock, to_seconds
from recordings.columns.channel import CHANNELS
from recordings.columns.mapping import ColumnMapping
from recordings.columns.si_channel import SiChannel, find_si_channel
from recordings.errors import ColumnError
from recordings.tables.table import Table

_RATE_NAMES = ("sample_rate_hz", "sampling_rate_hz", "rate_hz", "fs_hz")


def find_time(
    table: Table, mapping: ColumnMapping, rows: int, first_row: int = 0, start_ns: int | None = None
) -> tuple[SiChannel, tuple[str, ...]]:
    """Return a table's time stamps.

    In this order: the mapping's `rate_hz`; its time column; a column with a usual name; a sample
    rate stored in the file (`sample_rate_Hz` and the like), with a warning.

    Args:
        table: the file's columns and constants.
        mapping: may hold a rate or a time column.
        rows: how many stamps are needed if they are made from a rate.
        first_row: how many rows of the recording came before these.
        start_ns: the `start_ns` of those rows' stamps, None for the first rows.

    Returns:
        The stamps in s, and what had to be assumed.

    Raises:
        ColumnError: there is neither a time column nor a rate.
    """
    if mapping.rate_hz is not None:
        return _even(first_row, rows, mapping.rate_hz), ()
    found = find_si_channel(table, CHANNELS["time"], mapping.channels.get("time"))
    if found is not None:
        return _exact(table, found, start_ns), ()
    for name, value in table.constants.items():
        if name.lower() in _RATE_NAMES and 0.0 < value < np.inf:
            return _even(first_row, rows, value), (f"no time column: time from {name} = {value:g}",)
    raise ColumnError(
        "no time column found; say which one with --time, or the sample rate with --rate "
        f"(rate_hz in the mapping). Columns are: {table.describe()}{table.left_out()}"
    )


def _exact(table: Table, found: SiChannel, start_ns: int | None) -> SiChannel:
    """Count whole nanoseconds too large for float64 from the first, so that none is lost."""
    stamps_ns = table.stamps.get(found.columns[0])
    if table.start_ns or start_ns == 0 or found.factor * NS_PER_S != 1.0:
        return found
    if start_ns is None:
        if stamps_ns is None:
            return found
        start_ns = start_of_clock(int(stamps_ns[0]))
    if stamps_ns is None:
        return replace(found, values=found.values - start_ns / NS_PER_S, start_ns=start_ns)
    return replace(found, values=to_seconds(stamps_ns, start_ns), start_ns=start_ns)


def _even(first_row: int, rows: int, rate_hz: float) -> SiChannel:
    return SiChannel(values=np.arange(first_row, first_row + rows) / rate_hz, is_unit_stated=True)
