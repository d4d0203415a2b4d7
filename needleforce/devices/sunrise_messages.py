"""The messages of FRI for Sunrise: what an LBR iiwa sends, and what it wants back.

Protocol buffers, from the public description of the interface (numbers of fields and of
states as public drivers have them). Versions 1 and 2 differ in what is used here in one
field: only version 1 sends the commanded position.
"""

from enum import IntEnum
from functools import cache
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.errors import import_client

JOINTS = 7

MONITORING_KIND = 0x245142
"""Of the message that the controller of an LBR sends."""

COMMAND_KIND = 0x34001
"""Of the answer."""

MAX_PERIOD_MS = 100
"""The interface sends no less often."""

LAYOUT: dict[str, dict[str, tuple[int, str]]] = {
    "Joints": {"value": (1, "double")},
    "Time": {"seconds": (1, "uint32"), "nanoseconds": (2, "uint32")},
    "Header": {
        "kind": (1, "uint32"),
        "number": (2, "uint32"),
        "reflected": (3, "uint32"),  # number of the other side's latest message
    },
    "Robot": {"joints": (1, "uint32"), "safety_stop": (2, "uint32")},
    "Measured": {
        "position_rad": (1, "Joints"),
        "torque_Nm": (2, "Joints"),  # behind the gears, with gravity
        "commanded_rad": (3, "Joints"),  # of version 1 only
        "external_Nm": (5, "Joints"),  # the controller's own estimate
        "time": (15, "Time"),
    },
    "Connection": {
        "session": (1, "uint32"),
        "quality": (2, "uint32"),
        "period_ms": (3, "uint32"),  # some controllers send none
        "answer_cycles": (4, "uint32"),  # an answer is wanted every so many messages
    },
    "Program": {
        "position_rad": (1, "Joints"),  # to which a client adds
        "mode": (10, "uint32"),
    },
    "Monitoring": {
        "header": (1, "Header"),
        "robot": (2, "Robot"),
        "measured": (3, "Measured"),
        "connection": (4, "Connection"),
        "program": (5, "Program"),
    },
    "Wanted": {"position_rad": (1, "Joints")},
    "Command": {"header": (1, "Header"), "wanted": (2, "Wanted")},
}
"""Number and type of each field, by message; a list of doubles has a tag for each."""


class Session(IntEnum):
    """States of the interface."""

    IDLE = 0
    MONITORING_WAIT = 1
    MONITORING_READY = 2
    COMMANDING_WAIT = 3
    COMMANDING_ACTIVE = 4


class Quality(IntEnum):
    """Qualities of the connection, as the controller rates it."""

    POOR = 0
    FAIR = 1
    GOOD = 2
    EXCELLENT = 3


POSITION_MODE = 1
"""The program on the controller lets a client command positions."""


@cache
def message_type(name: str) -> Any:
    """Return the class of a message of `LAYOUT`.

    Raises:
        MissingClientError: protobuf is not installed.
    """
    descriptors = import_client("google.protobuf.descriptor_pb2", "protobuf")
    pools = import_client("google.protobuf.descriptor_pool", "protobuf")
    factory = import_client("google.protobuf.message_factory", "protobuf")
    field_type = descriptors.FieldDescriptorProto
    numbers = {"double": field_type.TYPE_DOUBLE, "uint32": field_type.TYPE_UINT32}
    file = descriptors.FileDescriptorProto(
        name="fri.proto", package="fri", syntax="proto2"
    )
    for message_name, fields in LAYOUT.items():
        message = file.message_type.add(name=message_name)
        for field_name, (number, kind) in fields.items():
            field = message.field.add(name=field_name, number=number)
            is_list = kind == "double"
            field.label = (
                field_type.LABEL_REPEATED if is_list else field_type.LABEL_OPTIONAL
            )
            field.type = numbers.get(kind, field_type.TYPE_MESSAGE)
            if kind not in numbers:
                field.type_name = f".fri.{kind}"
    pool = pools.DescriptorPool()
    pool.Add(file)
    return factory.GetMessageClass(pool.FindMessageTypeByName(f"fri.{name}"))


def read_monitoring(data: bytes) -> Any | None:
    """Decode a datagram of the controller.

    Returns:
        A ``Monitoring`` of `LAYOUT`; None if the datagram is no such message, or has
        impossible values.
    """
    decode_error = import_client("google.protobuf.message", "protobuf").DecodeError
    try:
        message = message_type("Monitoring").FromString(data)
        Session(message.connection.session)
        Quality(message.connection.quality)
    except (decode_error, ValueError):
        return None

    measured = message.measured
    signals = [measured.position_rad, measured.torque_Nm, measured.external_Nm]
    if measured.HasField("commanded_rad"):
        signals.append(measured.commanded_rad)
    if message.program.HasField("position_rad"):
        signals.append(message.program.position_rad)
    is_kind = message.header.kind == MONITORING_KIND
    is_period = message.connection.period_ms <= MAX_PERIOD_MS
    is_whole = message.HasField("connection") and all(
        len(signal.value) == JOINTS and np.isfinite(signal.value).all()
        for signal in signals
    )
    return message if is_kind and is_period and is_whole else None


def write_command(number: int, reflected: int, position_rad: Array | None) -> bytes:
    """Return an answer as a datagram.

    Args:
        number: Its own, modulo 2^32.
        reflected: Number of the message that it answers.
        position_rad: To be commanded, shape (7,); None while nothing is.
    """
    command = message_type("Command")()
    command.header.kind = COMMAND_KIND
    command.header.number = number
    command.header.reflected = reflected
    if position_rad is not None:
        command.wanted.position_rad.value.extend(position_rad)
    return command.SerializeToString()
