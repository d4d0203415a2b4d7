"""What was touched, as a file."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from foundation.arrays import Array
from needleforce.cli.patient.case_files import write_plan_fields
from needleforce.cli.terminal import CommandError

VERSION = 1
"""Of the file."""


class LandmarkTouch(msgspec.Struct, forbid_unknown_fields=True):
    """A touched landmark.

    Attributes:
        name: As in the CT's markups.
        place_m: Of the needle's tip in the robot's base.
    """

    name: str
    place_m: tuple[float, float, float]


class TouchFile(msgspec.Struct, forbid_unknown_fields=True):
    """What was touched.

    Attributes:
        version: Of the file.
        landmarks: In the order in which they were touched.
        touches_m: Of the skin, in the robot's base.
    """

    version: int
    landmarks: tuple[LandmarkTouch, ...] = ()
    touches_m: tuple[tuple[float, float, float], ...] = ()

    def skin_m(self) -> Array:
        """Return the touches of the skin, (n, 3)."""
        return np.array(self.touches_m, dtype=float).reshape(-1, 3)


def read_touches(path: Path) -> TouchFile:
    """Read what `needleforce touch` wrote.

    Raises:
        CommandError: The file cannot be read, or is of another version.
    """
    try:
        touched = msgspec.json.decode(path.read_bytes(), type=TouchFile)
    except (OSError, msgspec.MsgspecError) as error:
        raise CommandError(
            f"{path}: {error}; expected what `needleforce touch` writes",
        ) from error
    if touched.version != VERSION:
        raise CommandError(
            f"{path} has version {touched.version}: expected {VERSION}",
        )
    return touched


def write_touches(path: Path, touched: TouchFile) -> None:
    """Write what was touched, whole or not at all."""
    fields: dict[str, Any] = msgspec.to_builtins(touched)
    write_plan_fields(path, fields)
