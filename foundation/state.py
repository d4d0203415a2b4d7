"""States of estimators in files: written, and read back bit for bit.

A file has one line of text (what it is, its version, what the state is of, the SHA-256
of the rest) and the state as a pickle of which only records of this project, named
tuples and data classes, and arrays of numpy are read: nothing else in it is looked up,
and nothing is executed.
"""

import hashlib
import os
import pickle
from collections.abc import Mapping
from dataclasses import is_dataclass
from enum import Enum
from io import BytesIO
from pathlib import Path
from typing import Any

from foundation.errors import NeedleforceError

STATE_FORMAT = "needleforce-state"
"""First word of a file."""

STATE_VERSION = 15
"""Grows whenever a file of the version before cannot be read, or is misread."""

MAX_FILE_BYTES = 64 << 20
"""A state has one or two megabytes; a wrong file is not read to its end."""

OWN_PACKAGES = ("foundation", "residual", "identification", "needleforce")
"""Packages of which a file may hold records."""

NUMPY_NAMES = ("_reconstruct", "_frombuffer", "scalar", "ndarray", "dtype")
"""What a pickle of an array names of numpy."""

OWN_SNAPSHOT = "Give a file that `write_snapshot` wrote."
SAME_KIND = "Restore it with an object of the class whose `snapshot` was taken."
SAME_SETTINGS = (
    "Build the object with the robot and the settings of the snapshot, then `restore` "
    "it."
)


class StateError(NeedleforceError, ValueError):
    """A file that holds no state, or that of another version or kind."""

    usual_advice = OWN_SNAPSHOT


class _Unpickler(pickle.Unpickler):
    """Reads records of this project and arrays."""

    def find_class(self, module_name: str, global_name: str) -> Any:
        """Return a class that a state may hold.

        Raises:
            UnpicklingError: For any other.
        """
        package = module_name.partition(".")[0]
        if package == "numpy" and global_name in NUMPY_NAMES:
            return super().find_class(module_name, global_name)
        if package in OWN_PACKAGES and "." not in global_name:
            found = super().find_class(module_name, global_name)
            is_class = isinstance(found, type)
            if is_class and (issubclass(found, tuple | Enum) or is_dataclass(found)):
                return found
        raise pickle.UnpicklingError(f"a state holds no {module_name}.{global_name}")


def decode_state(data: bytes) -> Any:
    """Return the state of a pickle.

    Raises:
        StateError: It is none, or holds something else than records and arrays.
    """
    try:
        return _Unpickler(BytesIO(data)).load()
    except Exception as error:  # a pickle that is none may raise anything
        raise StateError(f"it holds no state: {error}") from error


def seal_state(state: Any, kind: str) -> bytes:
    """Return the content of a file that holds a state.

    Args:
        state: The state.
        kind: What it is of, one word.

    Raises:
        StateError: For a state that could not be read again.
    """
    data = pickle.dumps(state, protocol=pickle.HIGHEST_PROTOCOL)
    decode_state(data)
    digest = hashlib.sha256(data).hexdigest()
    return f"{STATE_FORMAT} {STATE_VERSION} {kind} {digest}\n".encode() + data


def read_sealed_state(path: str | os.PathLike[str], kinds: Mapping[str, type]) -> Any:
    """Read a file with the content that `seal_state` returned.

    Args:
        path: The file.
        kinds: Type of the state for each kind that may be read.

    Raises:
        StateError: The file is no state, is damaged, or is of another version or kind.
        OSError: The file cannot be read.
    """
    with Path(path).open("rb") as file:
        content = file.read(MAX_FILE_BYTES + 1)
    line, _, data = content.partition(b"\n")
    words = line[:200].decode("ascii", "replace").split(" ")
    if len(words) != 4 or words[0] != STATE_FORMAT or len(content) > MAX_FILE_BYTES:
        raise StateError(f"{path} holds no state")
    _, version, kind, digest = words
    if version != str(STATE_VERSION):
        raise StateError(
            f"{path} has version {version}, this package reads version {STATE_VERSION}",
            "Resume it with the package that wrote it.",
        )
    if digest != hashlib.sha256(data).hexdigest():
        raise StateError(f"{path} is damaged or cut short: its bytes changed")
    if kind not in kinds:
        raise StateError(
            f"{path} holds the state of a {kind!r}, expected one of {', '.join(kinds)}",
            SAME_KIND,
        )
    state = decode_state(data)
    if type(state) is not kinds[kind]:
        raise StateError(f"{path} holds a {type(state).__name__}, not that of a {kind}")
    return state
