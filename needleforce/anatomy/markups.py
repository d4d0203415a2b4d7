"""Points, lines and transforms as 3D Slicer, ITK and laboratories write them.

Points come out in LPS, in metres: frame and unit are what the file says, or its user.
Files of ITK (``.h5``, ``.tfm``, ``.mat``) hold x_out = A (x_in - c) + t + c in LPS and
millimetres. 3D Slicer writes into them the inverse of what it shows, and shows RAS, in
which x and y have the other sign.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.registration import RigidTransform
from needleforce.anatomy.volume import RAS_TO_LPS
from needleforce.files import whole_file

SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/"
    "Markups/Resources/Schema/markups-schema-v1.0.3.json#"
)
"""What Slicer writes at the head of its own files."""


UNITS_m = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6}
"""Metres per unit of length."""

FRAMES = {"LPS": np.ones(3), "RAS": RAS_TO_LPS}
"""Factors to LPS by the name of a frame."""

NUMBERED_FRAMES = {"0": "RAS", "1": "LPS"}
"""Names of frames by their numbers in old files of 3D Slicer."""

MALFORMED = (
    *(ValueError, LookupError, AttributeError, TypeError, RecursionError),
    *(csv.Error, msgspec.MsgspecError),
)
"""What a file that holds something else leads to."""

OTHER_POINTS = (
    "Save one list of points from 3D Slicer as .mrk.json or .fcsv, or give a .csv with "
    "the columns name, x_mm, y_mm, z_mm."
)


OTHER_TRANSFORM = (
    "Save a rigid transform, in millimetres, as .h5, .tfm or .mat, or a matrix of "
    "4 x 4 numbers as .txt or .json."
)


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


class PointList(NamedTuple):
    """Points as they stand in a file.

    Attributes:
        names: Of the points; empty where one has none.
        places: In the file's frame and unit, (n, 3).
        unit: Of length; empty where the file does not say it.
        frame: Key of `FRAMES`, or one that is not known; empty where the file does not
            say it.
        is_line: They are the two ends of a line.
    """

    names: list[str]
    places: Array
    unit: str
    frame: str
    is_line: bool = False


def read_markup(
    path: Path | str, unit: str | None = None, frame: str | None = None
) -> Markup:
    """Read the one list of points, or the one line, of a file.

    Args:
        path: See `read_points`.
        unit: Of places in a file that does not say it.
        frame: LPS or RAS, for a file that does not say it.

    Raises:
        VolumeError: Not readable, several lists, no points, a frame or a unit that is
            not known or not said, or said differently in the file, or two points of one
            name.
    """
    points = read_points(path)
    to_lps = look_up(FRAMES, points.frame, (frame or "").upper(), "frame", path)
    scale_m = look_up(UNITS_m, points.unit, unit or "", "unit", path)
    points_m = scale_m * to_lps * points.places
    names = tuple(name or str(n) for n, name in enumerate(points.names, 1))
    if not names or len({*names}) < len(names):
        raise VolumeError(
            f"{path} holds the points {', '.join(names) or 'none'}: expected placed "
            "ones with a name each",
            OTHER_POINTS,
        )
    return Markup(names, points_m, points.is_line)


def look_up(
    known: Mapping[str, Any], in_file: str, asked: str, quantity: str, path: Path | str
) -> Any:
    """Return what a name of a unit or a frame means.

    Args:
        known: Meanings by their names.
        in_file: The name in the file; empty where the file does not say it.
        asked: The name that the user says; empty if none.
        quantity: ``unit`` or ``frame``; an option of that name lets the user say it.
        path: The file.

    Raises:
        VolumeError: Nobody says it, file and user contradict each other, or it is not
            known.
    """
    names = {in_file, asked} - {""}
    if len(names) != 1 or not names <= known.keys():
        raise VolumeError(
            f"{path}: the {quantity} is {' and '.join(sorted(names)) or 'not said'}: "
            f"expected one of {', '.join(known)}, in the file (x_lps_mm) or by "
            f"`--{quantity}`",
            OTHER_POINTS,
        )
    return known[names.pop()]


def read_points(path: Path | str) -> PointList:
    """Read points as they stand in a file.

    Args:
        path: ``.mrk.json`` or ``.fcsv`` of 3D Slicer, or a table with a header. Columns
            are x, y and z, and a name or label. Their headers state unit and frame
            beside the letter (``x_mm``, ``X [m]``, ``x_lps_mm``); so do lines in front
            of them (``# unit = mm``, ``# CoordinateSystem = LPS``). Between fields
            stands a comma, a semicolon or a tab; beside the last two numbers may have
            decimal commas.

    Raises:
        VolumeError: Not readable, several lists, no such table, one that states two
            units or frames, or places that are not finite.
    """
    kind = Path(path).suffix.lower()
    try:
        content = Path(path).read_bytes()
        if kind == ".json":
            points = _parse_slicer_json(content)
        else:
            lines = content.decode("utf-8-sig").splitlines()
            points = _parse_table(lines, is_slicers=kind == ".fcsv")
        if not np.isfinite(points.places).all():
            raise ValueError("places that are not finite")
        return points
    except (OSError, StopIteration, *MALFORMED) as error:
        raise VolumeError(
            f"cannot read {path}: {error!r}; expected one list of points, or one line, "
            "or a table with a header and the columns name, x_mm, y_mm, z_mm",
            OTHER_POINTS,
        ) from error


def _parse_slicer_json(content: bytes) -> PointList:
    """Return the one list of points, or the one line, of a ``.mrk.json`` file."""
    # States of control points that have no place.
    unplaced = ("undefined", "missing", "preview")
    (markup,) = msgspec.json.decode(content, type=dict[str, Any])["markups"]
    placed = [
        point
        for point in markup["controlPoints"]
        if point.get("position") is not None
        and point.get("positionStatus", "defined") not in unplaced
    ]
    places = np.array([one["position"] for one in placed], dtype=float)
    frame = str(markup.get("coordinateSystem", ""))
    return PointList(
        names=[str(one.get("label") or "") for one in placed],
        places=places.reshape(len(placed), 3),
        unit=str(markup.get("coordinateUnits", "mm")),
        frame=NUMBERED_FRAMES.get(frame, frame),
        is_line=markup.get("type") == "Line",
    )


def _parse_table(lines: list[str], *, is_slicers: bool) -> PointList:
    """Return the points of a table; see `read_points`.

    Args:
        lines: Of the file.
        is_slicers: It is a ``.fcsv`` file: in millimetres.
    """
    text = "\n".join(lines)
    stated: dict[str, str] = dict(re.findall(r"(?m)^#\s*(\w+)\s*=\s*(.*?)\s*$", text))
    rows_of_text = [line for line in lines if line.strip() and line[0] != "#"]
    if "columns" in stated:
        rows_of_text.insert(0, stated["columns"])
    separator = next(mark for mark in ";\t," if mark in rows_of_text[0])
    table = csv.DictReader(rows_of_text, delimiter=separator, skipinitialspace=True)
    words = {
        header: {*re.split(r"[\W_]+", header.lower())}
        for header in table.fieldnames or ()
    }
    axes = [[one for one in words if axis in words[one]] for axis in "xyz"]
    ((x,), (y,), (z,)) = axes
    names = [one for one in words if words[one] & {"name", "label"}]
    rows = [*table]
    # Decimal commas between commas. 3D Slicer writes more fields than it names.
    if any(None in row for row in rows) and not is_slicers:
        raise ValueError("rows have more fields than the header")
    beside = words[x] | words[y] | words[z]
    stated_frame = stated.get("CoordinateSystem", "").upper()
    units = {stated.get("unit", ""), *(UNITS_m.keys() & beside)} - {""}
    frames = {NUMBERED_FRAMES.get(stated_frame, stated_frame)} - {""}
    frames |= {frame for frame in FRAMES if frame.lower() in beside}
    if len(units) > 1 or len(frames) > 1:
        raise ValueError(f"x, y and z are in {', '.join(sorted(units | frames))}")
    usual_unit = "mm" if is_slicers else ""
    decimal_mark = "." if separator == "," else ","
    places = [
        [float(row[one].replace(decimal_mark, ".")) for one in (x, y, z)]
        for row in rows
    ]
    return PointList(
        names=[(row[names[0]] or "").strip() if names else "" for row in rows],
        places=np.array(places).reshape(len(rows), 3),
        unit=units.pop() if units else usual_unit,
        frame=frames.pop() if frames else "",
    )


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


def read_transform(
    path: Path | str, source: TransformSource, unit: str | None = None
) -> RigidTransform:
    """Read the motion from the CT to the robot's base.

    Args:
        path: Of ITK (``.h5``, ``.tfm``, ``.mat`` of ANTs), or a matrix of 4 x 4 numbers
            as text (``.txt``, ``.csv``) or in a JSON file.
        source: ``slicer``: 3D Slicer saved the transform under which the CT lies where
            the robot sees it, with the robot's x, y, z as R, A, S; a matrix is the one
            that it shows. ``itk``: its ``TransformPoint``, or the matrix, carries a
            point of the CT (LPS) to the robot's base.
        unit: Of the shift of a matrix; by default the millimetres of both programs.

    Raises:
        VolumeError: Not readable, not linear, stretched, sheared or mirrored, or not in
            millimetres.
    """
    max_stretch = 1e-3  # lengths change by no more: files round their numbers
    max_distance_mm = 1e4  # a CT further from the base is not in millimetres
    try:
        content = Path(path).read_bytes()
        is_text = Path(path).suffix.lower() in (".txt", ".csv", ".json")
        is_matrix = is_text and not content.startswith(b"#Insight")
        transform = (
            _parse_matrix(content, unit)
            if is_matrix
            else _read_itk_transform(path, content)
        )
        shift_mm = np.array(transform.TransformPoint([0.0, 0.0, 0.0]))
        images_mm = [transform.TransformPoint(axis) for axis in np.eye(3).tolist()]
        left, stretches, right = np.linalg.svd((np.array(images_mm) - shift_mm).T)
    except (OSError, RuntimeError, *MALFORMED) as error:
        raise VolumeError(
            f"cannot read {path}: {error}; expected a transform of ITK in three "
            "dimensions, or 4 rows of 4 numbers, the last 0 0 0 1",
            OTHER_TRANSFORM,
        ) from error
    rotation = left @ right
    is_rigid = transform.IsLinear() and np.linalg.det(rotation) > 0.0
    is_stretched = np.abs(stretches - 1.0).max() > max_stretch
    if not is_rigid or is_stretched or np.linalg.norm(shift_mm) > max_distance_mm:
        raise VolumeError(
            f"{path} is a {transform.GetName()} that stretches by "
            f"{stretches.min():.4g} to {stretches.max():.4g} and carries the CT by "
            f"{shift_mm.tolist()} mm: expected a rigid motion in millimetres, and no "
            "mirror image",
            OTHER_TRANSFORM,
        )
    if source == "slicer" and is_matrix:
        rotation = rotation * RAS_TO_LPS
    elif source == "slicer":
        rotation = RAS_TO_LPS[:, None] * rotation.T
        shift_mm = -rotation @ shift_mm
    return RigidTransform(rotation, 1e-3 * shift_mm)


def _read_itk_transform(path: Path | str, content: bytes) -> Any:
    """Read a transform of `SimpleITK` in three dimensions."""
    import SimpleITK

    # The HDF5 library prints pages about other files.
    if content.startswith(b"\x89HDF") != str(path).endswith((".h5", ".hdf5")):
        raise ValueError("it is not what its name says")
    transform = SimpleITK.ReadTransform(str(path))
    if transform.GetDimension() != 3:
        raise ValueError(f"it has {transform.GetDimension()} dimensions")
    return transform


def _parse_matrix(content: bytes, unit: str | None) -> Any:
    """Return a matrix of 4 x 4 numbers as a transform of `SimpleITK`, in millimetres.

    Args:
        content: Text; or JSON: the matrix, or an object with nothing else in it.
        unit: Of the shift. If it is not said, millimetres; a shift so small that it
            could be in metres is refused.
    """
    import SimpleITK

    min_shift_mm = 10.0
    text = content.decode("utf-8-sig").strip()
    if text.startswith(("{", "[")):
        rows = msgspec.json.decode(text)
        (rows,) = rows.values() if isinstance(rows, dict) else (rows,)
    else:
        lines = [line.replace(",", " ").split() for line in text.splitlines()]
        rows = [line for line in lines if line and not line[0].startswith("#")]
    matrix = np.array(rows, dtype=float)
    is_whole = matrix.shape == (4, 4) and np.isfinite(matrix).all()
    if not is_whole or not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"{matrix.tolist()}")
    if unit is None and np.linalg.norm(matrix[:3, 3]) < min_shift_mm:
        raise ValueError(
            f"a shift of {matrix[:3, 3].tolist()}, metres or millimetres: `--unit` "
            "says it"
        )
    shift_mm = 1e3 * UNITS_m[unit or "mm"] * matrix[:3, 3]
    turn = matrix[:3, :3].ravel().tolist()
    return SimpleITK.AffineTransform(turn, shift_mm.tolist())
