"""The messages of FRI for Sunrise: what an LBR iiwa sends, and what it wants back.

From the public description of the interface (numbers of fields and of states as public
drivers have them). Versions 1 and 2 differ in what is used here in one field: only
version 1 sends the commanded position.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.devices.protobuf_wire import (
    Fields,
    read_doubles,
    read_fields,
    write_doubles,
    write_message,
    write_number,
)

JOINTS = 7

MONITORING_KIND = 0x245142
"""Of the message that the controller of an LBR sends."""

COMMAND_KIND = 0x34001
"""Of the answer."""

MS_TO_S = 1e-3
NS_TO_S = 1e-9


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


class CommandMode(IntEnum):
    """What the program on the controller lets a client command."""

    NONE = 0
    POSITION = 1
    WRENCH = 2
    TORQUE = 3
    CARTESIAN_POSE = 4


class Header(NamedTuple):
    """How every message begins.

    Attributes:
        kind: Of the message.
        number: Its own, modulo 2^32.
        reflected: Number of the latest message from the other side.
    """

    kind: int
    number: int
    reflected: int


class Monitoring(NamedTuple):
    """What the controller sends.

    Attributes:
        header: Kind and numbers.
        session: State of the interface.
        quality: Of the connection.
        period_s: Of these messages; zero where the controller does not say it.
        answer_cycles: The controller wants an answer every so many messages.
        safety_stop: Zero in normal operation.
        command_mode: What may be commanded.
        stamp_s: On the controller's clock.
        position_rad: Measured, shape (7,).
        torque_Nm: Measured behind the gears, with gravity, shape (7,).
        external_Nm: The controller's own estimate, shape (7,).
        commanded_rad: Position that is commanded, shape (7,); None in version 2.
        interpolated_rad: Position of the program on the controller, to which a client
            adds, shape (7,); None outside of command states.
    """

    header: Header
    session: Session
    quality: Quality
    period_s: float
    answer_cycles: int
    safety_stop: int
    command_mode: CommandMode
    stamp_s: float
    position_rad: Array
    torque_Nm: Array
    external_Nm: Array
    commanded_rad: Array | None
    interpolated_rad: Array | None


class PositionCommand(NamedTuple):
    """What the controller wants back.

    Attributes:
        header: Kind and numbers.
        position_rad: To be commanded, shape (7,); None while nothing is.
    """

    header: Header
    position_rad: Array | None


def _number(fields: Fields, field: int, default: int = 0) -> int | None:
    """Return the number in a field, the latest of several; None for other types."""
    values = fields.get(field)
    if not values:
        return default

    value = values[-1]
    return value if isinstance(value, int) else None


def _inner(fields: Fields, field: int) -> Fields | None:
    """Return the fields of an inner message, empty if it is missing."""
    values = fields.get(field)
    if not values:
        return {}

    value = values[-1]
    return read_fields(value) if isinstance(value, bytes) else None


def _joints(fields: Fields, field: int) -> Array | None:
    """Return the finite values of seven joints, or None."""
    values = fields.get(field)
    if not values or not isinstance(values[-1], bytes):
        return None

    joints = read_doubles(values[-1])
    is_valid = (
        joints is not None and joints.shape == (JOINTS,) and np.isfinite(joints).all()
    )
    return joints if is_valid else None


def _read_header(fields: Fields) -> Header | None:
    """Return the header of a message."""
    header = _inner(fields, 1)
    if not header:
        return None

    numbers = [_number(header, field) for field in (1, 2, 3)]
    kind, number, reflected = numbers
    if kind is None or number is None or reflected is None:
        return None

    return Header(kind, number, reflected)


def read_kind(data: bytes) -> int | None:
    """Return the kind of a message; None if it is none of this format."""
    fields = read_fields(data)
    header = None if fields is None else _read_header(fields)
    return None if header is None else header.kind


def read_monitoring(data: bytes) -> Monitoring | None:
    """Decode a datagram of the controller.

    Returns:
        What it says; None if it is no such message, or has impossible values.
    """
    fields = read_fields(data)
    if fields is None:
        return None

    header = _read_header(fields)
    robot = _inner(fields, 2)
    monitor = _inner(fields, 3)
    connection = _inner(fields, 4)
    program = _inner(fields, 5)
    if header is None or header.kind != MONITORING_KIND:
        return None
    if robot is None or not monitor or not connection or program is None:
        return None

    position_rad = _joints(monitor, 1)
    torque_Nm = _joints(monitor, 2)
    external_Nm = _joints(monitor, 5)
    if position_rad is None or torque_Nm is None or external_Nm is None:
        return None

    found = (
        _number(connection, 1),
        _number(connection, 2),
        _number(connection, 3),
        _number(connection, 4, 1),
        _number(robot, 2),
        _number(program, 10),
    )
    numbers = [number for number in found if number is not None]
    if len(numbers) < len(found) or not _are_possible(numbers):
        return None

    session, quality, period_ms, answer_cycles, safety_stop, mode = numbers
    return Monitoring(
        header=header,
        session=Session(session),
        quality=Quality(quality),
        period_s=MS_TO_S * period_ms,
        answer_cycles=max(answer_cycles, 1),
        safety_stop=safety_stop,
        command_mode=CommandMode(mode),
        stamp_s=_read_stamp(monitor),
        position_rad=position_rad,
        torque_Nm=torque_Nm,
        external_Nm=external_Nm,
        commanded_rad=_joints(monitor, 3),
        interpolated_rad=_joints(program, 1),
    )


MAX_PERIOD_MS = 100
"""The interface sends no less often."""


def _are_possible(numbers: list[int]) -> bool:
    """Return whether states, period and modes are ones that exist."""
    session, quality, period_ms, _, _, mode = numbers
    return (
        session in Session.__members__.values()
        and quality in Quality.__members__.values()
        and 0 <= period_ms <= MAX_PERIOD_MS
        and mode in CommandMode.__members__.values()
    )


def _read_stamp(monitor: Fields) -> float:
    """Return the time of a measurement on the controller's clock; zero without one."""
    stamp = _inner(monitor, 15) or {}
    seconds = _number(stamp, 1) or 0
    nanoseconds = _number(stamp, 2) or 0
    return seconds + NS_TO_S * nanoseconds


def _write_header(header: Header) -> bytes:
    """Return the field with the header of a message."""
    numbers = b"".join(
        write_number(field, number) for field, number in enumerate(header, start=1)
    )
    return write_message(1, numbers)


def write_command(command: PositionCommand) -> bytes:
    """Return an answer as a datagram."""
    data = _write_header(command.header)
    if command.position_rad is not None:
        data += write_message(2, write_doubles(1, command.position_rad))

    return data


def read_command(data: bytes) -> PositionCommand | None:
    """Decode an answer; None if it is none."""
    fields = read_fields(data)
    header = None if fields is None else _read_header(fields)
    if fields is None or header is None or header.kind != COMMAND_KIND:
        return None

    values = _inner(fields, 2)
    return PositionCommand(header, None if values is None else _joints(values, 1))


def write_monitoring(message: Monitoring) -> bytes:
    """Return what a controller sends as a datagram; for emulators of one."""
    robot = write_number(1, JOINTS) + write_number(2, message.safety_stop)
    robot += b"".join(write_number(5, 2) for _ in range(JOINTS))  # drives: active
    monitor = write_doubles(1, message.position_rad)
    monitor += write_doubles(2, message.torque_Nm)
    if message.commanded_rad is not None:
        monitor += write_doubles(3, message.commanded_rad)

    monitor += write_doubles(5, message.external_Nm)
    seconds = int(message.stamp_s)
    nanoseconds = round((message.stamp_s - seconds) / NS_TO_S)
    stamp = write_number(1, seconds) + write_number(2, nanoseconds)
    monitor += write_message(15, stamp)
    connection = write_number(1, message.session) + write_number(2, message.quality)
    if message.period_s > 0.0:
        connection += write_number(3, round(message.period_s / MS_TO_S))
    connection += write_number(4, message.answer_cycles)
    program = write_number(10, message.command_mode)
    if message.interpolated_rad is not None:
        program = write_doubles(1, message.interpolated_rad) + program

    return (
        _write_header(message.header)
        + write_message(2, robot)
        + write_message(3, monitor)
        + write_message(4, connection)
        + write_message(5, program)
    )
