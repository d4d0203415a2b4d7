"""Writing Parquet rows as they come."""

from typing import Any, BinaryIO

from recordings.optional_library import optional_library
from recordings.tables.checked_columns import Columns
from recordings.tables.flat_columns import flat_columns
from recordings.tables.labels import PLAIN, START_KEY, Labels


class ParquetWriter:
    """Writes each chunk as a row group; two-dimensional columns become numbered ones, as in CSV.

    Args:
        stream: where the bytes go.
        labels: its `start_ns` goes into the file's metadata.

    Raises:
        FileAccessError: pyarrow is not installed.
    """

    def __init__(self, stream: BinaryIO, labels: Labels = PLAIN) -> None:
        self._arrow = optional_library("pyarrow", "Parquet files")
        self._parquet = optional_library("pyarrow.parquet", "Parquet files")
        self._stream = stream
        self._metadata = {START_KEY: str(labels.start_ns)} if labels.start_ns else {}
        self._writer: Any = None

    def append(self, columns: Columns) -> None:
        """Write rows.

        Args:
            columns: checked columns, the same in every call.

        Raises:
            LogError: a name would stand twice.
        """
        table = self._arrow.table(flat_columns(columns), metadata=self._metadata)
        if self._writer is None:
            self._writer = self._parquet.ParquetWriter(self._stream, table.schema)
        if table.num_rows:
            self._writer.write_table(table)

    def flush(self) -> None:
        """Nothing can be read before the end."""

    def finish(self) -> None:
        """Write the table of contents, without which the file cannot be read."""
        if self._writer is not None:
            self._writer.close()
