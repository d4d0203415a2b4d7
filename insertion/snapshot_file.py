"""Snapshots in files: plain JSON with a format name and a version, see docs/loop.md."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from identification import Snapshot as IdentifierSnapshot
from insertion.errors import SnapshotFileError
from insertion.plain_value import Plain, from_plain, to_plain
from insertion.session_estimate import SessionSnapshot
from insertion.typed_value import check_value
from residual.sensor_state import SensorState

SNAPSHOT_FORMAT = "needleforce-snapshot"
SNAPSHOT_VERSION = 3
"""Grows whenever a file of the version before could no longer be read, or would be misread."""

AnySnapshot = SessionSnapshot | SensorState | IdentifierSnapshot


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
    if not isinstance(snapshot, AnySnapshot):
        raise SnapshotFileError(
            f"expected a snapshot of a session, a sensor or an identifier, got a "
            f"{type(snapshot).__name__}"
        )
    plain = to_plain(snapshot)
    content = {
        "format": SNAPSHOT_FORMAT,
        "version": SNAPSHOT_VERSION,
        "sha256": _digest(plain),
        "snapshot": plain,
    }
    target = Path(path)
    partial = target.with_name(target.name + ".part")
    partial.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
    partial.replace(target)


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
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        _check_header(content, path)
        snapshot = from_plain(content.get("snapshot"))
    except SnapshotFileError:
        raise
    except (ValueError, RecursionError) as error:
        raise SnapshotFileError(f"{path} is not JSON, or cut short: {error}") from error
    if not isinstance(snapshot, AnySnapshot):
        raise SnapshotFileError(f"{path} holds a {type(snapshot).__name__}, not a snapshot")
    check_value(snapshot, type(snapshot), "snapshot")
    return snapshot


def _digest(plain: Plain) -> str:
    """SHA-256 of the value as JSON with sorted names and without spaces."""
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _check_header(content: Any, path: str | os.PathLike[str]) -> None:
    if not isinstance(content, dict) or content.get("format") != SNAPSHOT_FORMAT:
        raise SnapshotFileError(f"{path} is not a snapshot: it has no format {SNAPSHOT_FORMAT!r}")
    version = content.get("version")
    if version != SNAPSHOT_VERSION or isinstance(version, bool):
        raise SnapshotFileError(
            f"{path} is a snapshot of version {version}, this package reads version "
            f"{SNAPSHOT_VERSION}: resume it with the package that wrote it"
        )
    if content.get("sha256") != _digest(content.get("snapshot")):
        raise SnapshotFileError(
            f"{path} is damaged: its sha256 is not that of its snapshot; take an older one, or "
            "start and tare anew"
        )
