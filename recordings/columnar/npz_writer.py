"""Writing npz archives: rows wait in temporary files, since an archive cannot be appended to."""

import io
import shutil
import tempfile
import zipfile
from typing import Any, BinaryIO

import numpy as np

from recordings.tables.checked_columns import Columns
from recordings.tables.labels import PLAIN, START_KEY, Labels

_BLOCK = 1 << 20  # bytes


class NpzWriter:
    """Collects rows in a temporary file for each column; writes the archive at the end.

    An npz file holds one column after the other. So that memory stays bounded, the columns wait
    uncompressed on the disk for temporary files.

    Args:
        stream: where the archive goes; must be able to seek.
        labels: the start of the clock, unless it is zero, becomes a single number.
    """

    def __init__(self, stream: BinaryIO, labels: Labels = PLAIN) -> None:
        self._start_ns = labels.start_ns
        self._stream = stream
        self._waiting: dict[str, Any] = {}
        self._kinds: dict[str, tuple[np.dtype, tuple[int, ...]]] = {}
        self._rows = 0

    def append(self, columns: Columns) -> None:
        """Take rows.

        Args:
            columns: checked columns, the same in every call.
        """
        for name, values in columns.items():
            if name not in self._waiting:
                self._waiting[name] = tempfile.TemporaryFile()  # noqa: SIM115 closed in finish
                self._kinds[name] = (values.dtype, values.shape[1:])
            self._waiting[name].write(np.ascontiguousarray(values).data)
        self._rows += len(next(iter(columns.values())))

    def flush(self) -> None:
        """Nothing can be read before the end."""

    def finish(self) -> None:
        """Write the archive."""
        with zipfile.ZipFile(self._stream, "w") as archive:
            if self._start_ns:
                with archive.open(zipfile.ZipInfo(f"{START_KEY}.npy"), "w") as member:
                    np.lib.format.write_array(member, np.array(self._start_ns, dtype=np.int64))
            for name, waiting in self._waiting.items():
                dtype, shape = self._kinds[name]
                # numpy.savez would stamp the time and could not write a column called "file".
                entry = zipfile.ZipInfo(f"{name}.npy")
                entry.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(entry, "w", force_zip64=True) as member, waiting:
                    member.write(_array_header((self._rows, *shape), dtype))
                    waiting.seek(0)
                    shutil.copyfileobj(waiting, member, _BLOCK)


def _array_header(shape: tuple[int, ...], dtype: np.dtype) -> bytes:
    header = io.BytesIO()
    told = {
        "shape": shape,
        "fortran_order": False,
        "descr": np.lib.format.dtype_to_descr(dtype),
    }
    np.lib.format.write_array_header_1_0(header, told)
    return header.getvalue()
