"""The edge of the toolkit: logs in and out, which column is which channel, and units.

`read_log` turns a file (CSV, npz, Parquet, ROS 2 bag) into a `Log` in SI units; `write_table` and
`write_log` write results. A `ColumnMapping`, from a small TOML file or the command line, says which
columns to use where their names do not.

Reading order: `read_log`, `table` (what a file holds), `select_channels` (what it means), `log`. A
format is a `*_format` to read it and a `*_writer`; bags begin at `bag_format`. Row by row, whatever
the length: `table_stream` and `log_stream` in, `open_table` out. What the commands share:
`command_line` (errors, Ctrl-C), `source_arguments`, `mapping_arguments` and `output_arguments`,
`log_session` (a command reads its log), `row_overview` (few rows for a picture), `toml_file`.
"""

from recordings.channel import CHANNELS
from recordings.column_spec import ColumnSpec
from recordings.errors import (
    ColumnError,
    FileAccessError,
    FormatError,
    LogError,
    MappingError,
    RecordingError,
)
from recordings.log import Log
from recordings.mapping import ColumnMapping
from recordings.mapping_arguments import mapping_arguments, mapping_from_arguments
from recordings.mapping_file import load_mapping
from recordings.read_log import read_log, read_table
from recordings.table import Table
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
