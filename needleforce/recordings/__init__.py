"""Logs in and out: which column is which channel, and in which unit.

`read_log` turns a file (CSV, npz, Parquet, ROS 2 bag) into a `Log` in SI units; `write_table` and
`write_log` write results. A `ColumnMapping`, from a small TOML file or the command line, says which
columns to use where their names do not. Row by row, whatever the length: `stream_tables` and
`LogStream` in, `open_table` out.

Reading order: `open_recording`, `table` (what a file holds), `channels` (units and usual names),
`mapping`, `log`, `timestamps`. The formats: `follow` (bytes as they come), `csv_file`, `columnar`
(npz, Parquet); ROS 2 bags: `bag_reader`, `bag_topics`, `bag_storage`, `bag_writer`. Writing:
`output`.
"""

from needleforce.recordings.channels import CHANNELS
from needleforce.recordings.errors import (
    ColumnError,
    FileAccessError,
    FormatError,
    LogError,
    MappingError,
    RecordingError,
)
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.log import Log, LogStream
from needleforce.recordings.mapping import ColumnMapping, ColumnSpec, load_mapping
from needleforce.recordings.open_recording import read_log, read_table, stream_tables
from needleforce.recordings.output import check_writable, write_log, write_table
from needleforce.recordings.table import Table

__all__ = [
    "CHANNELS",
    "ColumnError",
    "ColumnMapping",
    "ColumnSpec",
    "FileAccessError",
    "FollowOptions",
    "FormatError",
    "Log",
    "LogError",
    "LogStream",
    "MappingError",
    "RecordingError",
    "Table",
    "check_writable",
    "load_mapping",
    "read_log",
    "read_table",
    "stream_tables",
    "write_log",
    "write_table",
]
