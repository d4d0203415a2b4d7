"""States in files: that of a session, of a virtual sensor or of an identifier.

`foundation.state` writes and reads them bit for bit, and checks them. Here stands which
types a file may hold: the annotations of an identifier's state leave its method open,
so the kind that a file names also says which method it is of.
"""

import os
from typing import Any, NamedTuple, get_type_hints

from foundation.state import SAME_KIND, StateError, read_sealed_state, seal_state
from identification import MultilayerConfig, PublishedConfig
from identification import Snapshot as IdentifierSnapshot
from identification.multilayer.method import MultilayerState
from identification.published.state import PublishedState
from needleforce.files import whole_file
from needleforce.insertion_course import InsertionProgress
from needleforce.needle_channels import NeedleChannel, OldChannel
from needleforce.session import (
    Checkpoint,
    Checkpoints,
    SessionSnapshot,
    SnapshotFileError,
)
from residual.virtual_force_sensor import SensorState

AnySnapshot = SessionSnapshot | SensorState | IdentifierSnapshot


def write_snapshot(snapshot: AnySnapshot, path: str | os.PathLike[str]) -> None:
    """Write the state of a session, of a virtual sensor or of an identifier.

    The file appears whole or not at all.

    Args:
        snapshot: What ``snapshot()`` of one of them returned.
        path: Where to; an older file of that name is replaced.

    Raises:
        SnapshotFileError: For anything but such a state.
        OSError: If the file cannot be written.
    """
    try:
        content = seal_state(snapshot, _kind_of(snapshot))
    except StateError as error:
        raise SnapshotFileError(str(error), error.advice) from error
    with whole_file(path) as file:
        file.write(content)


def read_snapshot(path: str | os.PathLike[str]) -> AnySnapshot:
    """Read a file of `write_snapshot`.

    Args:
        path: The file.

    Returns:
        The state, for ``restore`` of its kind.

    Raises:
        SnapshotFileError: If it holds no state, is damaged, or of another version.
        OSError: If the file cannot be read.
    """
    try:
        state = read_sealed_state(path, _TYPES)
    except StateError as error:
        raise SnapshotFileError(str(error), error.advice) from error
    return _widened(state)


def _kind_of(snapshot: AnySnapshot) -> str:
    """Return the name by which a file says what it holds."""
    if type(snapshot) is SensorState:
        return "sensor"
    if type(snapshot) is SessionSnapshot:
        return f"session, {_method_of(snapshot.identifier)}"
    if type(snapshot) is IdentifierSnapshot:
        return f"identifier, {_method_of(snapshot)}"
    raise SnapshotFileError(
        "expected what snapshot() of a session, a sensor or an identifier returns, "
        f"got a {type(snapshot).__name__}",
        SAME_KIND,
    )


def _method_of(identifier: IdentifierSnapshot) -> str:
    """Return the name of the method that an identifier's state is of."""
    for method, types in _METHODS.items():
        if type(identifier.config) is types.config:
            return method
    raise SnapshotFileError(
        f"the identifier's settings are a {type(identifier.config).__name__}, expected "
        f"those of one of the methods {', '.join(_METHODS)}",
        SAME_KIND,
    )


def _narrowed(record: type[Any], **types: Any) -> Any:
    """Return a named tuple like another one, with narrower types of some fields."""
    annotations: Any = (get_type_hints(record) | types).items()
    return NamedTuple(record.__name__, annotations)


def _widened(state: Any) -> AnySnapshot:
    """Return a state that was read in its own types instead of narrowed ones."""
    if isinstance(state, SensorState):
        return state
    if not hasattr(state, "checkpoints"):
        return IdentifierSnapshot(*state)
    older, newer = (
        Checkpoint(checkpoint.time_s, IdentifierSnapshot(*checkpoint.identifier))
        for checkpoint in state.checkpoints
    )
    return SessionSnapshot(*state)._replace(
        identifier=IdentifierSnapshot(*state.identifier),
        checkpoints=Checkpoints(older, newer),
        insertion=_widened_insertion(state.insertion),
        channels=tuple(
            NeedleChannel(*channel)._replace(
                identifier=IdentifierSnapshot(*channel.identifier)
            )
            for channel in state.channels
        ),
    )


def _widened_insertion(insertion: Any) -> InsertionProgress:
    """Return an insertion that was read in its own types."""
    old = insertion.channel
    if old is not None:
        old = OldChannel(*old)._replace(in_air=IdentifierSnapshot(*old.in_air))
    return InsertionProgress(*insertion)._replace(channel=old)


class _MethodTypes(NamedTuple):
    """Types in the state of an identifier that its method decides.

    Attributes:
        config: Type of its settings.
        state: Type of the method's state.
    """

    config: type[Any]
    state: type[Any]


_METHODS = {
    "multilayer": _MethodTypes(MultilayerConfig, MultilayerState),
    "published": _MethodTypes(PublishedConfig, PublishedState),
}


def _types() -> dict[str, Any]:
    """Return the type of the state for every kind of file."""
    kinds: dict[str, Any] = {"sensor": SensorState}
    for method, types in _METHODS.items():
        identifier = _narrowed(
            IdentifierSnapshot, config=types.config, state=types.state
        )
        checkpoint = _narrowed(Checkpoint, identifier=identifier)
        channel = _narrowed(NeedleChannel, identifier=identifier)
        old_channel = _narrowed(OldChannel, in_air=identifier)
        kinds[f"identifier, {method}"] = identifier
        kinds[f"session, {method}"] = _narrowed(
            SessionSnapshot,
            identifier=identifier,
            checkpoints=_narrowed(Checkpoints, older=checkpoint, newer=checkpoint),
            insertion=_narrowed(InsertionProgress, channel=old_channel | None),
            channels=tuple[channel, ...],
        )
    return kinds


_TYPES = _types()
