"""The time of a log: stamps in the file, or a sample rate."""

import numpy as np

from recordings.channel import CHANNELS
from recordings.errors import ColumnError
from recordings.mapping import ColumnMapping
from recordings.si_channel import SiChannel, find_si_channel
from recordings.table import Table

_RATE_NAMES = ("sample_rate_hz", "sampling_rate_hz", "rate_hz", "fs_hz")


def find_time(
    table: Table, mapping: ColumnMapping, rows: int, first_row: int = 0
) -> tuple[SiChannel, tuple[str, ...]]:
    """Return a table's time stamps.

    In this order: the mapping's `rate_hz`; its time column; a column with a usual name; a sample
    rate stored in the file (`sample_rate_Hz` and the like), with a warning.

    Args:
        table: the file's columns and constants.
        mapping: may hold a rate or a time column.
        rows: how many stamps are needed if they are made from a rate.
        first_row: how many rows of the recording came before these.

    Returns:
        The stamps in s, and what had to be assumed.

    Raises:
        ColumnError: there is neither a time column nor a rate.
    """
    if mapping.rate_hz is not None:
        return _even(first_row, rows, mapping.rate_hz), ()
    found = find_si_channel(table, CHANNELS["time"], mapping.channels.get("time"))
    if found is not None:
        return found, ()
    for name, value in table.constants.items():
        if name.lower() in _RATE_NAMES and 0.0 < value < np.inf:
            return _even(first_row, rows, value), (f"no time column: time from {name} = {value:g}",)
    raise ColumnError(
        "no time column found; say which one with --time, or the sample rate with --rate "
        f"(rate_hz in the mapping). Columns are: {table.describe()}"
    )


def _even(first_row: int, rows: int, rate_hz: float) -> SiChannel:
    return SiChannel(values=np.arange(first_row, first_row + rows) / rate_hz, is_unit_stated=True)
