"""The edge of the toolkit: logs in and out, which column is which channel, and units.

`read_log` turns a file (CSV, npz, Parquet, ROS 2 bag) into a `Log` in SI units; `write_table` and
`write_log` write results. A `ColumnMapping`, from a small TOML file or the command line, says which
columns to use where their names do not.

Reading order: `read_log`, `tables` (what a file holds), `columns` (which column is which channel),
`select_channels` (the two together), `log`, `clock` (its time). Row by row, whatever the length:
`table_stream` and `log_stream` in, `open_table` out. The formats: `sources` (bytes as they come),
`text` (CSV), `columnar` (npz, Parquet), `bags` and below them `bag_storage` (ROS 2). `command` is
what the commands share.
"""

from recordings.columns.channel import CHANNELS
from recordings.columns.mapping import ColumnMapping
from recordings.columns.mapping_file import load_mapping
from recordings.columns.spec import ColumnSpec
from recordings.command.mapping_arguments import mapping_arguments, mapping_from_arguments
from recordings.errors import (
    ColumnError,
    FileAccessError,
    FormatError,
    LogError,
    MappingError,
    RecordingError,
)
from recordings.log import Log
from recordings.read_log import read_log, read_table
from recordings.tables.table import Table
from recordings.write_table import check_writable, write_log, write_table

__all__ = [
    "CHANNELS",
    "ColumnError",
    "ColumnMapping",
    "ColumnSpec",
    "FileAccessError",
    "FormatError",
    "Log",
    "LogError",
    "MappingError",
    "RecordingError",
    "Table",
    "check_writable",
    "load_mapping",
    "mapping_arguments",
    "mapping_from_arguments",
    "read_log",
    "read_table",
    "write_log",
    "write_table",
]
