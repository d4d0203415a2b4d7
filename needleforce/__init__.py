"""Needle-tip force from a robot's joint torques: the front door of the toolkit."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from needleforce.session import (
        InsertionError,
        InsertionSession,
        SessionEstimate,
        SessionSnapshot,
        TipTravel,
        Travel,
    )
    from needleforce.snapshot import (
        SNAPSHOT_VERSION,
        SnapshotFileError,
        read_snapshot,
        write_snapshot,
    )

__all__ = [
    "SNAPSHOT_VERSION",
    "InsertionError",
    "InsertionSession",
    "SessionEstimate",
    "SessionSnapshot",
    "SnapshotFileError",
    "TipTravel",
    "Travel",
    "read_snapshot",
    "write_snapshot",
]

_HOME = {
    "needleforce.session": (
        "InsertionError",
        "InsertionSession",
        "SessionEstimate",
        "SessionSnapshot",
        "TipTravel",
        "Travel",
    ),
    "needleforce.snapshot": (
        "SNAPSHOT_VERSION",
        "SnapshotFileError",
        "read_snapshot",
        "write_snapshot",
    ),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for: importing the package costs nothing."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
