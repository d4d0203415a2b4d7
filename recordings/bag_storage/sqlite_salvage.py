"""Rows of a damaged SQLite file, read page by page without its tree.

A file that was cut has lost pages to which others point, so that SQLite refuses it; the rows in
the pages that are left are whole. The layout is that of https://sqlite.org/fileformat2.html.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from recordings.errors import FormatError

MAGIC = b"SQLite format 3\x00"
Value = int | float | str | bytes | None
Row = tuple[int, tuple[Value, ...]]

_HEADER_SIZE = 100  # of the file, on its first page
_LEAF = 0x0D
_LEAF_HEAD = 8
_INTEGER_SIZES = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
_REAL, _BLOB = 7, 12
_SHORT, _LONG, _DOUBLE = Struct(">H"), Struct(">I"), Struct(">d")


def is_cut(path: Path) -> bool:
    """Return whether a file is shorter than its header says, which SQLite does not always see.

    Args:
        path: a file that begins as an SQLite file.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEADER_SIZE)
        if len(head) < _HEADER_SIZE:
            return True
        pages = _Pages(stream, head)
        (written,) = _LONG.unpack_from(head, 28)
        return pages.size * written > pages.length


def salvage_rows(path: Path) -> Iterator[Row]:
    """Read the rows of all tables, in the order of the pages.

    Args:
        path: the file.

    Yields:
        Row number and values; rows that are not whole are left out.

    Raises:
        FormatError: not even the file's header is there.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEADER_SIZE)
        if len(head) < _HEADER_SIZE or not head.startswith(MAGIC):
            raise FormatError("is not an SQLite file: it does not begin as one")
        pages = _Pages(stream, head)
        for number in range(1, pages.count + 1):
            yield from _leaf_rows(pages, number)


class _Pages:
    """The pages of a file, counted from 1; those beyond its end are empty."""

    def __init__(self, stream: BinaryIO, head: bytes) -> None:
        (size,) = _SHORT.unpack_from(head, 16)
        self.size = 65536 if size == 1 else size
        if self.size < 512:
            raise FormatError("has a damaged SQLite header")
        self._stream = stream
        self.usable = self.size - head[20]
        self.length = stream.seek(0, 2)
        self.count = -(-self.length // self.size)

    def __getitem__(self, number: int) -> bytes:
        self._stream.seek((number - 1) * self.size)
        return self._stream.read(self.size)

    def overflow(self, number: int, size: int) -> bytes:
        parts = []
        while number and size > 0:
            page = self[number]
            parts.append(page[4 : self.usable][:size])
            size -= len(parts[-1])
            if len(parts[-1]) == 0:
                break
            (number,) = _LONG.unpack_from(page)
        return b"".join(parts)


def _leaf_rows(pages: _Pages, number: int) -> Iterator[Row]:
    page = pages[number]
    start = _HEADER_SIZE if number == 1 else 0
    if len(page) < start + _LEAF_HEAD or page[start] != _LEAF:
        return
    (cells,) = _SHORT.unpack_from(page, start + 3)
    for i in range(cells):
        try:
            (at,) = _SHORT.unpack_from(page, start + _LEAF_HEAD + 2 * i)
            yield _row(pages, page, at)
        except (IndexError, KeyError, ValueError, struct.error):
            continue


def _row(pages: _Pages, page: bytes, at: int) -> Row:
    size, at = _varint(page, at)
    number, at = _varint(page, at)
    local = _local_size(size, pages.usable)
    payload = page[at : at + local]
    if size > local:
        (following,) = _LONG.unpack_from(page, at + local)
        payload += pages.overflow(following, size - local)
    if len(payload) < size:
        raise ValueError("the row is not whole")
    return number, _values(payload)


def _local_size(size: int, usable: int) -> int:
    """How much of a row stands on its leaf."""
    most = usable - 35
    if size <= most:
        return size
    least = (usable - 12) * 32 // 255 - 23
    rest = least + (size - least) % (usable - 4)
    return rest if rest <= most else least


def _values(payload: bytes) -> tuple[Value, ...]:
    end, at = _varint(payload, 0)
    kinds = []
    while at < end:
        kind, at = _varint(payload, at)
        kinds.append(kind)
    values = []
    for kind in kinds:
        value, at = _value(payload, at, kind)
        values.append(value)
    return tuple(values)


def _value(payload: bytes, at: int, kind: int) -> tuple[Value, int]:
    if kind >= _BLOB:
        end = at + (kind - _BLOB) // 2
        part = payload[at:end]
        return (part.decode(errors="replace") if kind % 2 else part), end
    if kind == _REAL:
        return _DOUBLE.unpack_from(payload, at)[0], at + _DOUBLE.size
    end = at + _INTEGER_SIZES[kind]
    constants = {0: None, 8: 0, 9: 1}
    if kind in constants:
        return constants[kind], end
    return int.from_bytes(payload[at:end], "big", signed=True), end


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for _ in range(8):
        byte = data[at]
        at += 1
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at
    return value << 8 | data[at], at + 1
