"""States in files: that of a session, of a virtual sensor or of an identifier.

`foundation.state` writes and reads them bit for bit, and checks them.
"""

import os

from foundation.state import SAME_KIND, StateError, read_sealed_state, seal_state
from identification import Snapshot as IdentifierSnapshot
from needleforce.files import whole_file
from needleforce.session_snapshot import SessionSnapshot, SnapshotFileError
from residual.virtual_force_sensor import SensorState

AnySnapshot = SessionSnapshot | SensorState | IdentifierSnapshot

_KINDS = {
    "session": SessionSnapshot,
    "sensor": SensorState,
    "identifier": IdentifierSnapshot,
}
"""What a file may hold; it says which."""


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
    names = [name for name, kind in _KINDS.items() if type(snapshot) is kind]
    if not names:
        raise SnapshotFileError(
            "expected what snapshot() of a session, a sensor or an identifier returns, "
            f"got a {type(snapshot).__name__}",
            SAME_KIND,
        )
    try:
        content = seal_state(snapshot, names[0])
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
        return read_sealed_state(path, _KINDS)
    except StateError as error:
        raise SnapshotFileError(str(error), error.advice) from error
