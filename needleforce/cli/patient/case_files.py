"""CT and labels of a patient, and the plan's file that names them."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from needleforce.anatomy import Labels, Volume, read_labels, read_volume
from needleforce.cli.patient.structure_names import StructureNames
from needleforce.cli.terminal import (
    OTHER_PLACE,
    CommandError,
    staged_progress,
)
from needleforce.files import whole_file
from needleforce.plan_file import GIVE_PLAN, PLAN, PLAN_VERSION


class CaseFiles(NamedTuple):
    """Where the data of a patient lie.

    Attributes:
        ct: CT: a folder with a DICOM series, or a file.
        labels: Segmentation.
        structures: Names of structures, or a file with them, where the segmentation
            has none.
        situs_inversus: Liver and spleen are exchanged.
    """

    ct: Path
    labels: Path
    structures: StructureNames = None
    situs_inversus: bool = False


class PatientCase(NamedTuple):
    """CT and labels of a patient.

    Attributes:
        files: Where they come from.
        scan: The CT.
        labels: The segmentation with ``fat`` and ``lean`` of the body around it, and
            with what is dense as bone and not labelled.
        file_labels: The segmentation as in its file.
    """

    files: CaseFiles
    scan: Volume
    labels: Labels
    file_labels: Labels


def read_case(files: CaseFiles) -> PatientCase:
    """Read CT and labels, and find the body in the CT.

    Raises:
        needleforce.anatomy.VolumeError: They cannot be read, or do not belong together.
    """
    with staged_progress("reading the CT"):
        scan = read_volume(files.ct)
    with staged_progress("reading the labels"):
        file_labels = read_labels(
            files.labels, files.structures, situs_inversus=files.situs_inversus
        )
    with staged_progress("finding body, fat and lean tissue") as progress:
        labels = file_labels.with_body(scan, fat=True, progress=progress)
    labels = labels.with_dense(scan)
    return PatientCase(files, scan, labels, file_labels)


def read_plan_fields(place: Path) -> dict[str, Any]:
    """Return the fields of a plan's file.

    Raises:
        CommandError: The file cannot be read, or is no plan of this version.
    """
    path = place / PLAN if place.is_dir() else place
    try:
        fields = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except (OSError, msgspec.MsgspecError) as error:
        raise CommandError(f"{path}: {error}", GIVE_PLAN) from error
    if fields.get("version") != PLAN_VERSION:
        raise CommandError(
            f"{path} has version {fields.get('version')}: expected {PLAN_VERSION}, as "
            "`needleforce plan` writes it; earlier ones do not say what they were made "
            "of",
        )
    return fields


def case_of_plan(place: Path) -> PatientCase:
    """Read CT and labels that a plan's file names.

    Raises:
        CommandError: The file is no plan, or does not name them.
        needleforce.anatomy.VolumeError: They cannot be read any more.
    """
    path = place / PLAN if place.is_dir() else place
    fields = read_plan_fields(path)
    if not fields.get("ct") or not fields.get("labels"):
        raise CommandError(
            f"{path} names no CT and labels: expected a plan that `needleforce plan` "
            "wrote",
        )
    folder = path.parent
    structures = fields.get("structures") or None
    return read_case(
        CaseFiles(
            folder / fields["ct"],
            folder / fields["labels"],
            folder / structures if isinstance(structures, str) else structures,
            bool(fields.get("situs_inversus", False)),
        )
    )


def write_plan_fields(path: Path, fields: Mapping[str, Any]) -> None:
    """Write the fields of a plan's file, whole or not at all.

    Raises:
        CommandError: The file cannot be written.
    """
    content = msgspec.json.encode(fields, enc_hook=_as_list)
    try:
        with whole_file(path) as file:
            file.write(msgspec.json.format(content, indent=1) + b"\n")
    except OSError as error:
        raise CommandError(
            f"cannot write {path}: {error.strerror}", OTHER_PLACE
        ) from error


def relative_path(path: Path, folder: Path) -> str:
    """Return how a file is found from a folder, with / between its parts."""
    return Path(os.path.relpath(path, folder)).as_posix()


def _as_list(value: Any) -> Any:
    """Return an array, or a number of one, as what JSON has."""
    return np.asarray(value).tolist()
