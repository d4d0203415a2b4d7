"""Messages in the wire format of Protocol Buffers, as far as FRI for Sunrise uses it.

A message is a sequence of fields: a varint with number and type, then the value. What
is malformed is no message, and gives None.
"""

import struct
from collections.abc import Iterable

import numpy as np

from foundation.arrays import Array

VARINT = 0
FIXED64 = 1
BYTES = 2
FIXED32 = 5
"""Types of fields."""

TYPE_BITS = 3
TYPE_MASK = (1 << TYPE_BITS) - 1

MAX_VARINT_BYTES = 10
"""A longer one is no number of 64 bits."""

DOUBLE = struct.Struct("<d")

DOUBLE_TAG = 1 << TYPE_BITS | FIXED64
"""Begins each of the doubles in a message that holds only those, as field 1."""

UNPACKED_DOUBLE = np.dtype([("tag", "u1"), ("value", "<f8")])

Fields = dict[int, list[int | bytes]]
"""Values of a message by the numbers of their fields: varints as whole numbers, all
else as bytes."""


def read_varint(data: bytes, begin: int) -> tuple[int, int] | None:
    """Return the number that begins at a byte, and where the next value begins."""
    number = 0
    for place in range(MAX_VARINT_BYTES):
        if begin + place >= len(data):
            return None

        byte = data[begin + place]
        number |= (byte & 0x7F) << (7 * place)
        if byte < 0x80:
            return number, begin + place + 1

    return None


def read_fields(data: bytes) -> Fields | None:
    """Return the fields of a message; None if it is malformed."""
    fields: Fields = {}
    place = 0
    while place < len(data):
        tag = read_varint(data, place)
        if tag is None:
            return None

        number, begin = tag
        field = _read_value(data, begin, number & TYPE_MASK)
        if field is None:
            return None

        value, place = field
        fields.setdefault(number >> TYPE_BITS, []).append(value)

    return fields


def _read_value(data: bytes, begin: int, kind: int) -> tuple[int | bytes, int] | None:
    """Return a value of a type, and where the next field begins."""
    if kind == VARINT:
        return read_varint(data, begin)

    size = {FIXED64: 8, FIXED32: 4}.get(kind)
    if kind == BYTES:
        length = read_varint(data, begin)
        if length is None:
            return None

        size, begin = length

    if size is None or begin + size > len(data):
        return None

    return data[begin : begin + size], begin + size


def read_doubles(data: bytes) -> Array | None:
    """Return the doubles of a message that holds only those as field 1, shape (n,).

    Each may have its own tag, as KUKA's controllers send them, or all one, packed.
    """
    size = UNPACKED_DOUBLE.itemsize
    if data and len(data) % size == 0:
        rows = np.frombuffer(data, UNPACKED_DOUBLE)
        if (rows["tag"] == DOUBLE_TAG).all():
            return rows["value"].astype(float)

    fields = read_fields(data)
    if fields is None:
        return None

    values = fields.get(1, [])
    if not all(isinstance(value, bytes) and len(value) % 8 == 0 for value in values):
        return None

    joined = b"".join(value for value in values if isinstance(value, bytes))
    return np.frombuffer(joined, "<f8").astype(float)


def write_varint(number: int) -> bytes:
    """Return a whole number from 0 as a varint."""
    data = bytearray()
    while number > 0x7F:
        data.append(number & 0x7F | 0x80)
        number >>= 7

    data.append(number)
    return bytes(data)


def write_number(field: int, number: int) -> bytes:
    """Return a field with a whole number from 0."""
    return write_varint(field << TYPE_BITS | VARINT) + write_varint(number)


def write_message(field: int, data: bytes) -> bytes:
    """Return a field with a message or bytes."""
    return write_varint(field << TYPE_BITS | BYTES) + write_varint(len(data)) + data


def write_double(field: int, value: float) -> bytes:
    """Return a field with a double."""
    return write_varint(field << TYPE_BITS | FIXED64) + DOUBLE.pack(value)


def write_doubles(field: int, values: Iterable[float]) -> bytes:
    """Return a field with a message of doubles, each with its own tag."""
    data = b"".join(write_double(1, value) for value in values)
    return write_message(field, data)
