"""Other names for the structures of a segmentation, from a user."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from needleforce.anatomy.errors import EXPORT_LABELS, VolumeError
from needleforce.anatomy.labels import Labels
from needleforce.anatomy.segment_names import AUTOMATIC, tell_apart
from needleforce.anatomy.structures import Structure


def is_unnamed(labels: Labels) -> bool:
    """Return whether all names are such as ``label_5``, which the file did not have."""
    return all(AUTOMATIC.fullmatch(item.name) for item in labels.structures)


def rename(labels: Labels, names: Mapping[Any, str] | Path | str) -> Labels:
    """Return labels whose structures are called as a user says.

    Several structures may get one name: each then has its old one behind it.

    Args:
        labels: The segmentation.
        names: By the name in the file, or by label value where no structures overlap;
            or a JSON file with them. Values that no voxel has are left out.

    Raises:
        VolumeError: The names cannot be read, or belong to no structure of the file.
    """
    stated = _read_names(names)
    structures = labels.structures
    found = {item.name for item in structures}
    has_one_volume = len(labels.volumes) == 1
    unknown = [
        key
        for key in stated
        if key not in found and not (has_one_volume and key.isdecimal())
    ]
    if unknown:
        raise VolumeError(
            f"no structure is called {', '.join(unknown)}: there are "
            f"{', '.join(item.name for item in structures)}",
        )
    old_names = [item.name for item in structures]
    new_names = tell_apart([_new_name(item, stated) for item in structures], old_names)
    renamed = [
        item if item.name == name else _called(item, name)
        for item, name in zip(structures, new_names, strict=True)
    ]
    return Labels.of(labels.volumes, labels.grid, renamed)


def _read_names(names: Mapping[Any, str] | Path | str) -> dict[str, str]:
    """Return names by label value or name, both as text."""
    try:
        is_file = isinstance(names, Path | str)
        stated = json.loads(Path(names).read_bytes()) if is_file else names
        by_key = msgspec.convert(stated, dict[Any, str])
    except (OSError, ValueError, msgspec.ValidationError) as error:
        raise VolumeError(
            f"cannot read names from {names}: {error}", EXPORT_LABELS
        ) from error
    return {str(key): name for key, name in by_key.items()}


def _new_name(item: Structure, stated: Mapping[str, str]) -> str:
    """Return the name that is stated for a structure, else the one it has."""
    return stated.get(item.name, stated.get(str(item.value), item.name))


def _called(item: Structure, name: str) -> Structure:
    """Return a structure under another name, which says what it is."""
    named = Structure.named(name, item.value, item.volume)
    return replace(named, voxels=item.voxels, box=item.box)
