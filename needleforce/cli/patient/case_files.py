"""CT and labels of a patient, the plan's file that names them, and what was touched.

Names that a user gives to structures of a segmentation, too: ``--structures``.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from needleforce.anatomy import Labels, Volume, read_labels, read_volume
from needleforce.anatomy.markups import UNITS_m, look_up, read_points
from needleforce.anatomy.volume import is_known
from needleforce.cli.terminal import CommandError, json_text, progress_bar
from needleforce.files import whole_file
from needleforce.plan_file import GIVE_PLAN, PLAN, PLAN_VERSION
from needleforce.recordings.errors import file_errors

MODULES = ("SimpleITK", "nibabel", "skimage", "manifold3d", "trimesh", "igl")
"""Modules of extras that the commands need."""

NOT_MEDICAL = "Research only: not a medical device."


StructureNames = Path | Mapping[str, str] | None
"""A JSON file with names, or names by those in the segmentation."""

KINDS = (
    "bone, rib, cartilage, vertebra, lung, vessel, bowel, liver, kidney, spleen, "
    "muscle, fat, lesion, or soft, which a needle may pass"
)
"""Kinds that messages offer."""


class PatientCase(NamedTuple):
    """CT and labels of a patient.

    Attributes:
        scan: The CT.
        labels: The segmentation with ``fat`` and ``lean`` of the body around it, and
            with what is dense as bone and not labelled.
        file_labels: The segmentation as in its file.
    """

    scan: Volume
    labels: Labels
    file_labels: Labels


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

    version: Literal[1]
    landmarks: tuple[LandmarkTouch, ...] = ()
    touches_m: tuple[tuple[float, float, float], ...] = ()


def read_case(
    ct: Path, labels: Path, structures: StructureNames, *, situs_inversus: bool
) -> PatientCase:
    """Read CT and labels, and find the body in the CT.

    Args:
        ct: A folder with a DICOM series, or a file.
        labels: Segmentation.
        structures: Names of structures, or a file with them, where the segmentation
            has none.
        situs_inversus: Liver and spleen are exchanged.

    Raises:
        needleforce.anatomy.VolumeError: They cannot be read, or do not belong together.
    """
    with progress_bar("reading the CT, finding body, fat and lean tissue") as progress:
        scan = read_volume(ct)
        file_labels = read_labels(labels, structures, situs_inversus=situs_inversus)
        with_body = file_labels.with_body(scan, fat=True, progress=progress)
    return PatientCase(scan, with_body.with_dense(scan), file_labels)


def parse_structures(text: str | None) -> StructureNames:
    """Return what ``--structures`` says: a file, or ``NAME=KIND,...``.

    Raises:
        CommandError: A part has no `=`, a name stands twice, or a kind is not known.
    """
    if text is None:
        return None
    if "=" not in text or Path(text).is_file():
        return Path(text)
    names: dict[str, str] = {}
    for part in text.split(","):
        name, _, kind = (piece.strip() for piece in part.partition("="))
        if not name or not is_known(kind) or name in names:
            raise CommandError(
                f"--structures {text}: {part.strip()!r} is not NAME=KIND, with a name "
                f"that does not stand in it twice and a known kind: {KINDS}; a JSON "
                "file takes names that contain a comma"
            )
        names[name] = kind
    return names


def read_touches(path: Path | None, unit: str | None) -> TouchFile:
    """Read what was touched; without a file nothing was.

    Args:
        path: What `needleforce touch` wrote, or a table of places in the robot's base:
            those with a name are landmarks.
        unit: Of places in a table that does not say it.

    Raises:
        CommandError: The file cannot be read, or is of another version.
        needleforce.anatomy.VolumeError: Nor can the table, or it is not in the base.
    """
    if path is None:
        return TouchFile(version=1)
    if path.suffix.lower() == ".json":
        try:
            return msgspec.json.decode(path.read_bytes(), type=TouchFile)
        except (OSError, msgspec.MsgspecError) as error:
            raise CommandError(
                f"{path}: {error}; expected what `needleforce touch` writes, "
                "version 1, or a .csv with the columns name, x_mm, y_mm, z_mm"
            ) from error
    points = read_points(path)
    if points.frame:
        raise CommandError(
            f"{path} holds points of a CT: expected places in the robot's base"
        )
    scale_m = look_up(UNITS_m, points.unit, unit or "", "unit", path)
    places_m = (scale_m * points.places).tolist()
    touched = [*zip(points.names, map(tuple, places_m), strict=True)]
    return TouchFile(
        version=1,
        landmarks=tuple(LandmarkTouch(*one) for one in touched if one[0]),
        touches_m=tuple(place_m for name, place_m in touched if not name),
    )


def read_plan_fields(place: Path) -> dict[str, Any]:
    """Return the fields of a plan's file that `needleforce plan` wrote.

    Raises:
        CommandError: The file cannot be read, or is no plan of this version.
    """
    path = place / PLAN if place.is_dir() else place
    try:
        fields = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except (OSError, msgspec.MsgspecError) as error:
        raise CommandError(f"{path}: {error}", GIVE_PLAN) from error
    is_whole = fields.get("ct") and fields.get("labels")
    if fields.get("version") != PLAN_VERSION or not is_whole:
        raise CommandError(
            f"{path} has version {fields.get('version')}, or names no CT and labels: "
            f"expected {PLAN_VERSION}, as `needleforce plan` writes it"
        )
    return fields


def case_of_plan(fields: Mapping[str, Any], folder: Path) -> PatientCase:
    """Read CT and labels that a plan names.

    Args:
        fields: Of the plan's file.
        folder: Where it lies.

    Raises:
        needleforce.anatomy.VolumeError: They cannot be read any more.
    """
    structures = fields.get("structures") or None
    return read_case(
        folder / fields["ct"],
        folder / fields["labels"],
        folder / structures if isinstance(structures, str) else structures,
        situs_inversus=bool(fields.get("situs_inversus", False)),
    )


def write_plan_fields(path: Path, fields: Mapping[str, Any] | TouchFile) -> None:
    """Write a plan's file, or what was touched, whole or not at all.

    Raises:
        needleforce.recordings.FileAccessError: The file cannot be written.
    """
    with file_errors(path, "write"), whole_file(path) as file:
        file.write(json_text(fields).encode())


def relative_path(path: Path, folder: Path) -> str:
    """Return how a file is found from a folder, with / between its parts."""
    return Path(os.path.relpath(path, folder)).as_posix()
