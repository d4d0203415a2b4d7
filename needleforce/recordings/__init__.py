"""Logs in and out: which column is which channel, and in which unit.

`read_log` turns a file (CSV, npz, Parquet, Feather, ROS bag) into a `Log` in SI units;
`write_table` and `write_log` write results. A `ColumnMapping`, from a small TOML file
or the command line, says which columns to use where their names do not. Row by row,
whatever the length: `stream_tables` and `LogStream` in, `open_table` out.

What is known of names, units and layouts is data: `layouts.toml`.

Reading order: `open_recording`, `table` (what a file holds), `channels` (what is known,
with units), `column_names`, `joint_names`, `mapping`, `channel_request`,
`channel_units`, `log_signal`, `stamp_order` and `time_stamps`, `log_stream`, `log`,
`mapping_suggestion`. The formats: `follow` (bytes as they come), `text_lines`,
`text_table` (where a table begins), `written_numbers`, `csv_file`; `columnar` (npz,
Parquet, Feather); `bags`. Writing: `output`, `writers`.
"""

from needleforce.recordings.channel_request import ChannelRequest as ChannelRequest
from needleforce.recordings.channels import CHANNELS as CHANNELS
from needleforce.recordings.errors import (
    ColumnError as ColumnError,
    FileAccessError as FileAccessError,
    FormatError as FormatError,
    LogError as LogError,
    MappingError as MappingError,
    RecordingError as RecordingError,
    UnitError as UnitError,
)
from needleforce.recordings.follow import FollowOptions as FollowOptions
from needleforce.recordings.log import Log as Log
from needleforce.recordings.log_stream import LogStream as LogStream
from needleforce.recordings.mapping import (
    ColumnMapping as ColumnMapping,
    ColumnSpec as ColumnSpec,
    load_layouts as load_layouts,
    load_mapping as load_mapping,
)
from needleforce.recordings.open_recording import (
    read_log as read_log,
    read_table as read_table,
    stream_tables as stream_tables,
)
from needleforce.recordings.output import (
    check_writable as check_writable,
    write_log as write_log,
    write_table as write_table,
)
from needleforce.recordings.table import Table as Table
