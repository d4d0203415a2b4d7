"""Where the numbers stand in a serialised ROS 2 message.

Messages of one topic mostly have one layout: the same texts, arrays of the same lengths. It is
learned from one message; others of the same layout are then read together as a numpy array.
The encoding is plain CDR (OMG DDS-RTPS 10.2, XCDR1): primitives aligned to their size, counted from
behind the four bytes of encapsulation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from struct import Struct
from typing import Any, NamedTuple

from recordings.errors import FormatError

Path = tuple[str, ...]

BODY = 4
"""Bytes of encapsulation before the message."""
NAMES = ("name", "names", "joint_names")
"""Fields that name the elements of the arrays beside them."""

_KINDS = {
    "bool": "u1",
    "byte": "u1",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_MOST_ELEMENTS = 64
"""Longer arrays are images and point clouds, not signals."""


class Place(NamedTuple):
    """Numbers in a message.

    Attributes:
        path: names of the fields that lead there.
        offset: of the first, in bytes.
        dtype: as numpy spells it, with its byte order.
        length: how many; None for a single number.
    """

    path: Path
    offset: int
    dtype: str
    length: int | None


@dataclass(slots=True, kw_only=True)
class CdrLayout:
    """What messages of one layout have in common.

    Attributes:
        size: of the message in bytes.
        fixed: what must be the same in each: offset and bytes (lengths, names).
        places: where numbers stand.
        names: texts of a field of `NAMES` at the top of the message.
    """

    size: int
    fixed: list[tuple[int, bytes]] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    names: tuple[str, ...] = ()

    def fits(self, data: bytes) -> bool:
        """Return whether a message has this layout."""
        return len(data) == self.size and all(
            data.startswith(part, offset) for offset, part in self.fixed
        )


def learn_layout(data: bytes, kind: str, fields: Callable[[str], Mapping[str, Any]]) -> CdrLayout:
    """Learn the layout of a message.

    Args:
        data: the message.
        kind: its type.
        fields: gives the fields of a type: name to description as in `rosbags.interfaces`.

    Raises:
        FormatError: the message does not fit its type, or is encoded in another way.
    """
    if len(data) < BODY or data[0] != 0 or data[1] not in (0, 1):
        raise FormatError("is not plain CDR")
    walk = _Walk(data, fields)
    try:
        walk.message((), kind, is_read=True)
    except (IndexError, ValueError, KeyError, RecursionError) as error:
        raise FormatError(f"does not fit its type {kind}") from error
    if walk.at > len(data):
        raise FormatError(f"is shorter than its type {kind}")
    return walk.layout()


class _Walk:
    """A walk through one message."""

    def __init__(self, data: bytes, fields: Callable[[str], Mapping[str, Any]]) -> None:
        self._data, self._fields = data, fields
        self._order = "<" if data[1] else ">"
        self._length = Struct(f"{self._order}I")
        self._fixed: list[tuple[int, bytes]] = [(0, data[:BODY])]
        self._places: list[Place] = []
        self._names: tuple[str, ...] = ()
        self.at = BODY

    def layout(self) -> CdrLayout:
        return CdrLayout(
            size=len(self._data),
            fixed=_joined(self._fixed),
            places=self._places,
            names=self._names,
        )

    def message(self, path: Path, kind: str, *, is_read: bool) -> None:
        for name, description in self._fields(kind).items():
            self._field((*path, name), description, is_read=is_read)

    def _field(self, path: Path, description: Any, *, is_read: bool) -> None:
        node, rest = int(description[0]), description[1]
        if node == 1:
            self._base(path, rest[0], is_read=is_read)
        elif node == 2:
            self.message(path, rest, is_read=is_read)
        else:
            inner, count = rest
            count = count if node == 3 else self._read_length()
            self._elements(path, inner, count, is_read=is_read)

    def _base(self, path: Path, kind: str, *, is_read: bool) -> None:
        if kind == "string":
            self._text()
            return
        self._numbers(path, kind, None, is_read=is_read)

    def _elements(self, path: Path, inner: Any, count: int, *, is_read: bool) -> None:
        node, rest = int(inner[0]), inner[1]
        if node == 1 and rest[0] != "string":
            self._numbers(path, rest[0], count, is_read=is_read)
            return
        if count > len(self._data):
            raise ValueError(f"{count} elements in {len(self._data)} bytes")
        start, texts = self.at, []
        for _ in range(count):
            if node == 1:
                texts.append(self._text())
            else:
                self.message(path, rest, is_read=False)
        if texts and len(path) == 1 and path[0] in NAMES:
            self._fixed.append((start, self._data[start : self.at]))
            self._names = tuple(texts)

    def _numbers(self, path: Path, kind: str, count: int | None, *, is_read: bool) -> None:
        dtype = _KINDS[kind]
        size = int(dtype[1])
        if count != 0:
            self._align(size)
        if is_read and count != 0 and (count or 1) <= _MOST_ELEMENTS:
            self._places.append(Place(path, self.at, self._order + dtype, count))
        self.at += size * (1 if count is None else count)

    def _text(self) -> str:
        length = self._read_length()
        start, self.at = self.at, self.at + length
        if self.at > len(self._data):
            raise ValueError("text beyond the end")
        return self._data[start : self.at].rstrip(b"\0").decode(errors="replace")

    def _read_length(self) -> int:
        self._align(4)
        start, self.at = self.at, self.at + 4
        if self.at > len(self._data):
            raise ValueError("length beyond the end")
        self._fixed.append((start, self._data[start : self.at]))
        return self._length.unpack_from(self._data, start)[0]

    def _align(self, size: int) -> None:
        self.at += -(self.at - BODY) % size


def _joined(parts: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """Join parts that touch or overlap, so that there are few to compare."""
    joined: list[tuple[int, bytes]] = []
    for offset, part in sorted(parts, key=lambda item: (item[0], -len(item[1]))):
        if joined and offset <= joined[-1][0] + len(joined[-1][1]):
            first, before = joined[-1]
            known = first + len(before) - offset
            joined[-1] = (first, before + part[max(known, 0) :] if known < len(part) else before)
        else:
            joined.append((offset, part))
    return joined
