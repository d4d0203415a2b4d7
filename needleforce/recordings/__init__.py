"""Logs in and out: which column is which channel, and in which unit.

`read_log` turns a file (CSV, npz, Parquet, Feather, ROS bag) into a `Log` in SI units;
`write_table` and `write_log` write results.

Reading order: `open_recording`, `table`, `channels`, `channel_request`, `log`. The
formats: `text_file`, `columnar`, `bag_file`.
"""

from needleforce.recordings.channel_request import ChannelRequest as ChannelRequest
from needleforce.recordings.channels import (
    CHANNELS as CHANNELS,
    ColumnMapping as ColumnMapping,
    ColumnSpec as ColumnSpec,
    load_layouts as load_layouts,
    load_mapping as load_mapping,
    parse_column_spec as parse_column_spec,
)
from needleforce.recordings.errors import (
    ColumnError as ColumnError,
    FileAccessError as FileAccessError,
    FormatError as FormatError,
    LogError as LogError,
    MappingError as MappingError,
    RecordingError as RecordingError,
    UnitError as UnitError,
)
from needleforce.recordings.log import Log as Log
from needleforce.recordings.open_recording import (
    columns_of as columns_of,
    read_log as read_log,
    read_table as read_table,
    suggest_mapping as suggest_mapping,
)
from needleforce.recordings.output import (
    check_outputs as check_outputs,
    check_writable as check_writable,
    open_table as open_table,
    write_log as write_log,
    write_table as write_table,
)
from needleforce.recordings.table import Table as Table, TableLabels as TableLabels
