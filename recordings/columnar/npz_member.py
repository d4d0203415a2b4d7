"""One array of an npz archive, read a number of rows at a time."""

import zipfile
from contextlib import ExitStack
from math import prod
from typing import IO

import numpy as np

NUMBER_KINDS = "fiub"
"""Kinds of numpy's types that are numbers: float, signed, unsigned, bool."""

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


class UnusableArrayError(ValueError):
    """An array that is no column of numbers; the message goes on after its name."""


class NpzMember:
    """Reads the rows of one array in order.

    An array that lies column by column in the file is read through one handle for each column.

    Args:
        archive: the open archive.
        member: the array's name in it.
        stack: closes what is opened.

    Raises:
        UnusableArrayError: it does not hold numbers, is empty, or has more than two dimensions.
        ValueError: it is no array.
        zipfile.BadZipFile: it is damaged; `zlib.error`, `EOFError` and `RuntimeError` as well.
    """

    def __init__(self, archive: zipfile.ZipFile, member: str, stack: ExitStack) -> None:
        handle = stack.enter_context(archive.open(member))
        version = np.lib.format.read_magic(handle)
        if version not in _HEADERS:
            raise UnusableArrayError(f"has version {version} of numpy's format")
        self.shape, by_column, self._dtype = _HEADERS[version](handle)
        _check(self.shape, self._dtype)
        self._width = prod(self.shape[1:])
        self._left = self.shape[0] if self.shape else 1
        self._handles: list[IO[bytes]] = [handle]
        if by_column and self._width > 1:
            start = handle.tell()
            for column in range(1, self._width):
                further = stack.enter_context(archive.open(member))
                further.seek(start + column * self._left * self._dtype.itemsize)
                self._handles.append(further)

    def read(self, rows: int) -> np.ndarray:
        """Return the next rows, none at the end; shape (n,) or (n, k), () as (1,).

        Raises:
            ValueError: the array is cut short.
            zipfile.BadZipFile: it is damaged; `zlib.error`, `EOFError` and `RuntimeError` as well.
        """
        rows = min(rows, self._left)
        self._left -= rows
        width = self._width if len(self._handles) == 1 else 1
        parts = [self._numbers(handle, rows * width) for handle in self._handles]
        if len(parts) > 1:
            return np.stack(parts, axis=1)
        return parts[0].reshape(rows, *self.shape[1:])

    def _numbers(self, handle: IO[bytes], count: int) -> np.ndarray:
        size = count * self._dtype.itemsize
        data = handle.read(size)
        if len(data) < size:
            raise ValueError(f"{size - len(data)} bytes are missing")
        return np.frombuffer(data, dtype=self._dtype)


def _check(shape: tuple[int, ...], dtype: np.dtype) -> None:
    if dtype.hasobject:
        raise UnusableArrayError("cannot be read (Object arrays cannot be loaded)")
    if dtype.kind not in NUMBER_KINDS:
        raise UnusableArrayError(f"holds {dtype}, no numbers,")
    if len(shape) > 2 or prod(shape) == 0:
        raise UnusableArrayError(f"has shape {shape}, not (n,) or (n, k),")
