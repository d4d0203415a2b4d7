"""Snapshots in files: the state tree of a session, a sensor or an identifier, bit for
bit.

A snapshot is a tree of named tuples, frozen data classes, enumerations, numbers and
float64 arrays. `msgspec` writes it as MessagePack and reads it back by the annotations
of its types: a file cannot name a type, and nothing in it is executed. The envelope
carries a format name, a version, what the snapshot is of, and the SHA-256 of its bytes;
see docs/loop.md.
"""

import hashlib
import os
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_type_hints

import msgspec
import numpy as np

from identification import MultilayerConfig, PublishedConfig
from identification import Snapshot as IdentifierSnapshot
from identification.multilayer.method import SwitchingState
from identification.published.online import PublishedState
from needleforce.files import whole_file
from needleforce.session import (
    Checkpoint,
    Checkpoints,
    SessionSnapshot,
    SnapshotFileError,
)
from residual.snapshot import arrays
from residual.virtual_force_sensor import SensorState

SNAPSHOT_FORMAT = "needleforce-snapshot"
# Grows whenever a file of the one before cannot be read, or is misread.
SNAPSHOT_VERSION = 27
MOST_BYTES = (
    64 << 20
)  # A snapshot has one or two megabytes; a wrong file is not read to its end

AnySnapshot = SessionSnapshot | SensorState | IdentifierSnapshot

_KINDS = {
    "session": SessionSnapshot,
    "sensor": SensorState,
    "identifier": IdentifierSnapshot,
}
# The annotations of an identifier's snapshot name both methods; the envelope says which
# it is.
_METHODS: dict[str, dict[str, Any]] = {
    "multilayer": {"config": MultilayerConfig, "state": SwitchingState},
    "published": {"config": PublishedConfig, "state": PublishedState},
}


class _Envelope(msgspec.Struct, forbid_unknown_fields=True):
    """What stands around the bytes of a snapshot."""

    format: str
    version: int
    kind: str
    method: str
    sha256: str
    data: bytes


def write_snapshot(snapshot: AnySnapshot, path: str | os.PathLike[str]) -> None:
    """Write the snapshot of a session, of a virtual sensor or of an identifier.

    The file appears whole or not at all.

    Args:
        snapshot: What ``snapshot()`` of one of them returned.
        path: Where to; an older file of that name is replaced.

    Raises:
        SnapshotFileError: For anything but such a snapshot.
        OSError: If the file cannot be written.
    """
    kind = next(
        (name for name, type_ in _KINDS.items() if type(snapshot) is type_), None
    )
    if kind is None:
        raise SnapshotFileError(
            "expected what snapshot() of a session, a sensor or an identifier "
            f"returns, got a {type(snapshot).__name__}"
        )
    identifier = (
        snapshot.identifier if isinstance(snapshot, SessionSnapshot) else snapshot
    )
    config = type(getattr(identifier, "config", None))
    method = next(
        (name for name, types in _METHODS.items() if types["config"] is config), ""
    )
    data = msgspec.msgpack.encode(snapshot, enc_hook=_plain_array)
    digest = hashlib.sha256(data).hexdigest()
    envelope = _Envelope(SNAPSHOT_FORMAT, SNAPSHOT_VERSION, kind, method, digest, data)
    with whole_file(path) as file:
        file.write(msgspec.msgpack.encode(envelope))


def read_snapshot(path: str | os.PathLike[str]) -> AnySnapshot:
    """Read what `write_snapshot` wrote.

    Args:
        path: The file.

    Returns:
        The snapshot, for ``restore`` of its kind.

    Raises:
        SnapshotFileError: If it is no snapshot, damaged, or of another version.
        OSError: If the file cannot be read.
    """
    with Path(path).open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise SnapshotFileError(
            f"{path} is no snapshot: it has more than {MOST_BYTES >> 20} MB, a "
            "snapshot one or two"
        )
    try:
        envelope = msgspec.msgpack.decode(content, type=_Envelope)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise SnapshotFileError(
            f"{path} is no snapshot, or cut short: {error}"
        ) from error
    _check_envelope(envelope, path)
    try:
        snapshot = _decoded(envelope)
        list(arrays(snapshot))  # refuses numbers that no state can have
    except (msgspec.MsgspecError, RecursionError, ValueError, TypeError) as error:
        raise SnapshotFileError(f"{path} is damaged: {error}") from error
    return snapshot


def _check_envelope(envelope: _Envelope, path: str | os.PathLike[str]) -> None:
    if envelope.format != SNAPSHOT_FORMAT:
        raise SnapshotFileError(
            f"{path} is no snapshot: its format is {envelope.format!r}, expected "
            f"{SNAPSHOT_FORMAT!r}"
        )
    if envelope.version != SNAPSHOT_VERSION:
        raise SnapshotFileError(
            f"{path} is a snapshot of version {envelope.version}, this package reads "
            f"version {SNAPSHOT_VERSION}: resume it with the package that wrote it"
        )
    if envelope.sha256 != hashlib.sha256(envelope.data).hexdigest():
        raise SnapshotFileError(
            f"{path} is damaged: its sha256 is not that of its snapshot; take an older "
            "one, or start and tare anew"
        )
    if envelope.kind not in _KINDS:
        raise SnapshotFileError(
            f"{path} holds a {envelope.kind!r}, expected one of {', '.join(_KINDS)}"
        )
    if envelope.kind != "sensor" and envelope.method not in _METHODS:
        known = ", ".join(_METHODS)
        raise SnapshotFileError(
            f"the snapshot is of the method {envelope.method!r}, expected one of "
            f"{known}"
        )


def _decoded(envelope: _Envelope) -> AnySnapshot:
    """The state tree of an envelope, typed to its leaves."""
    if envelope.kind == "sensor":
        return _typed(envelope.data, SensorState)
    identifier = _annotated(IdentifierSnapshot, _METHODS[envelope.method])
    if envelope.kind == "identifier":
        return IdentifierSnapshot(*_typed(envelope.data, identifier))
    checkpoint = _annotated(Checkpoint, {"identifier": identifier})
    checkpoints = _annotated(Checkpoints, {"older": checkpoint, "newer": checkpoint})
    special = {"identifier": identifier, "checkpoints": checkpoints}
    session = _typed(envelope.data, _annotated(SessionSnapshot, special))
    older, newer = (
        Checkpoint(time_s, IdentifierSnapshot(*state))
        for time_s, state in session.checkpoints
    )
    return SessionSnapshot(*session)._replace(
        identifier=IdentifierSnapshot(*session.identifier),
        checkpoints=Checkpoints(older, newer),
    )


def _annotated(kind: type[Any], special: dict[str, Any]) -> Any:
    """A named tuple like another one, some of its annotations replaced."""
    annotations: Any = (get_type_hints(kind) | special).items()
    return NamedTuple(kind.__name__, annotations)


def _typed(data: bytes, kind: Any) -> Any:
    return msgspec.msgpack.decode(data, type=kind, dec_hook=_array)


def _plain_array(value: Any) -> Any:
    """An array as its shape, its order in memory and its bytes; a number of numpy as
    Python's.

    The order of numbers in memory decides the order of sums, and that their last bit.
    """
    if isinstance(value, np.floating | np.integer | np.bool_):
        return value.item()
    if not isinstance(value, np.ndarray) or value.dtype != np.float64:
        kind = (
            f"array of {value.dtype}"
            if isinstance(value, np.ndarray)
            else type(value).__name__
        )
        raise SnapshotFileError(f"a snapshot cannot hold an object of the type {kind}")
    order = "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
    return list(value.shape), order, value.tobytes(order)


def _array(kind: Any, plain: Any) -> Any:
    """The read-only array that `_plain_array` was given."""
    parts = tuple[tuple[int, ...], Literal["C", "F"], bytes]
    shape, order, data = msgspec.convert(plain, parts)
    flat = np.frombuffer(data, dtype=np.float64)
    array = np.array(flat.reshape(shape, order=order), order=order)
    array.setflags(write=False)
    return array
