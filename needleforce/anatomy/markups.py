"""Points and lines of 3D Slicer: ``.mrk.json`` files.

The file states its frame, LPS or RAS, and its unit; points come out in LPS, in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.files import whole_file

SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/"
    "Markups/Resources/Schema/markups-schema-v1.0.3.json#"
)
"""What Slicer writes at the head of its own files."""

RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])


MM_PER_M = 1e3

MALFORMED = (msgspec.MsgspecError, AttributeError, TypeError)
"""What reading JSON of another shape raises."""


class _ControlPoint(msgspec.Struct):
    """A control point of a file.

    Attributes:
        label: Its name.
        position: Its place; None where it has none.
        status: Whether it was placed.
    """

    label: str = ""
    position: tuple[float, float, float] | None = None
    status: str = msgspec.field(name="positionStatus", default="defined")


@dataclass(frozen=True, eq=False)
class Markup:
    """Named points.

    Attributes:
        names: Of the points.
        points_m: Their places in LPS, shape (n, 3).
        is_line: They are the two ends of a line.
    """

    names: tuple[str, ...]
    points_m: Array
    is_line: bool = False


def read_markup(path: Path | str) -> Markup:
    """Read the one list of points, or the one line, of a ``.mrk.json`` file.

    Raises:
        VolumeError: Not readable, several lists, no points, a frame or a unit that is
            not known, or two points of one name.
    """
    # States of control points that have no place.
    unplaced = ("undefined", "missing", "preview")
    # Metres per unit of length.
    units_m = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6}
    # Factors to LPS by the name of a frame, and by the number in old files.
    frames = {"LPS": np.ones(3), "0": RAS_TO_LPS, "1": np.ones(3), "RAS": RAS_TO_LPS}
    try:
        content = msgspec.json.decode(Path(path).read_bytes(), type=dict[str, Any])
        (markup,) = content["markups"]
        factors = frames[str(markup.get("coordinateSystem", "RAS"))]
        scale_m = units_m[markup.get("coordinateUnits", "mm")]
        points = msgspec.convert(markup["controlPoints"], list[_ControlPoint])
    except (OSError, LookupError, ValueError, *MALFORMED) as error:
        raise VolumeError(
            f"cannot read {path}: {error!r}; expected one list of points, or one line, "
            f"in LPS or RAS and one of {', '.join(units_m)}, that 3D Slicer saved as "
            ".mrk.json"
        ) from error
    placed = [
        point
        for point in points
        if point.position is not None and point.status not in unplaced
    ]
    names = tuple(point.label or str(n) for n, point in enumerate(placed, 1))
    positions = np.array([point.position for point in placed], dtype=float)
    points_m = scale_m * factors * positions.reshape(-1, 3)
    if not placed or len({*names}) < len(names) or not np.isfinite(points_m).all():
        raise VolumeError(
            f"{path} holds the points {', '.join(names) or 'none'}: expected placed, "
            "finite ones with a name each"
        )
    return Markup(names, points_m, markup.get("type") == "Line")


def write_markup(
    path: Path | str,
    kind: Literal["Fiducial", "Line"],
    names: Sequence[str],
    points_m: Array,
) -> None:
    """Write points or a line for 3D Slicer, in LPS and millimetres.

    Args:
        path: The file, ``.mrk.json``.
        kind: Points, or a line between two.
        names: Of the points.
        points_m: Their places in LPS, shape (n, 3).
    """
    points: list[dict[str, Any]] = [
        {
            "id": str(number),
            "label": name,
            "position": (MM_PER_M * point_m).round(4).tolist(),
            "positionStatus": "defined",
        }
        for number, (name, point_m) in enumerate(zip(names, points_m, strict=True), 1)
    ]
    markup = {
        "type": kind,
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "controlPoints": points,
    }
    content = msgspec.json.encode({"@schema": SCHEMA, "markups": [markup]})
    with whole_file(path) as file:
        file.write(msgspec.json.format(content, indent=2) + b"\n")
