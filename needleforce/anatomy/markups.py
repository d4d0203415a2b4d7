"""Points, lines and transforms that 3D Slicer wrote.

``.mrk.json`` files state their frame, LPS or RAS, and their unit; points come out in
LPS, in metres. Files of ITK (``.h5``, ``.tfm``) hold x_out = A (x_in - c) + t + c in
LPS and millimetres. 3D Slicer writes into them the inverse of what it shows, and shows
RAS, in which x and y have the other sign.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.registration import RigidTransform
from needleforce.files import whole_file

SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/"
    "Markups/Resources/Schema/markups-schema-v1.0.3.json#"
)
"""What Slicer writes at the head of its own files."""

RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])


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
    malformed = (msgspec.MsgspecError, AttributeError, TypeError)
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
        placed = [
            point
            for point in markup["controlPoints"]
            if point.get("position") is not None
            and point.get("positionStatus", "defined") not in unplaced
        ]
        names = tuple(str(one.get("label") or n) for n, one in enumerate(placed, 1))
        positions = np.array([one["position"] for one in placed], dtype=float)
        points_m = scale_m * factors * positions.reshape(len(placed), 3)
    except (OSError, LookupError, ValueError, *malformed) as error:
        raise VolumeError(
            f"cannot read {path}: {error!r}; expected one list of points, or one line, "
            f"in LPS or RAS and one of {', '.join(units_m)}, that 3D Slicer saved as "
            ".mrk.json"
        ) from error
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
            "position": (1e3 * point_m).round(4).tolist(),
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


TransformSource = Literal["slicer", "itk"]
"""Who wrote a transform, and so which way round it is."""


def read_transform(path: Path | str, source: TransformSource) -> RigidTransform:
    """Read the motion from the CT (LPS) to the robot's base.

    Args:
        path: The file.
        source: ``slicer``: 3D Slicer saved the transform under which the CT lies where
            the robot sees it, with the robot's x, y, z as R, A, S. ``itk``: its
            ``TransformPoint`` carries a point of the CT to the robot's base.

    Raises:
        VolumeError: Not readable, not linear, stretched, sheared or mirrored, or not in
            millimetres.
    """
    max_stretch = 1e-3  # lengths change by no more: files round their numbers
    max_distance_mm = 1e4  # a CT further from the base is not in millimetres
    import SimpleITK

    try:
        # The HDF5 library prints pages about other files.
        is_hdf5 = Path(path).read_bytes()[:4] == b"\x89HDF"
        if is_hdf5 != str(path).endswith((".h5", ".hdf5")):
            raise OSError("it is not what its name says")
        transform = SimpleITK.ReadTransform(str(path))
        shift_mm = np.array(transform.TransformPoint([0.0, 0.0, 0.0]))
        images_mm = [transform.TransformPoint(axis) for axis in np.eye(3).tolist()]
    except (OSError, RuntimeError, TypeError) as error:
        raise VolumeError(
            f"cannot read {path}: expected a transform of ITK in three dimensions, as "
            ".h5 or .tfm"
        ) from error
    left, stretches, right = np.linalg.svd((np.array(images_mm) - shift_mm).T)
    rotation = left @ right
    is_rigid = transform.IsLinear() and np.linalg.det(rotation) > 0.0
    is_stretched = np.abs(stretches - 1.0).max() > max_stretch
    if not is_rigid or is_stretched or np.linalg.norm(shift_mm) > max_distance_mm:
        raise VolumeError(
            f"{path} is a {transform.GetName()} that stretches by "
            f"{stretches.min():.4g} to {stretches.max():.4g} and carries the CT by "
            f"{shift_mm.tolist()} mm: expected a rigid motion in millimetres, and no "
            "mirror image"
        )
    if source == "slicer":
        rotation = RAS_TO_LPS[:, None] * rotation.T
        shift_mm = -rotation @ shift_mm
    return RigidTransform(rotation, 1e-3 * shift_mm)
