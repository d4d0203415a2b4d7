"""Which files make a bag."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recordings.errors import FileAccessError, FormatError
from recordings.optional_library import optional_library

BAG_SUFFIXES = (".mcap", ".db3")
_FILES = (*BAG_SUFFIXES, *(f"{suffix}.zstd" for suffix in BAG_SUFFIXES))
METADATA = "metadata.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class BagFiles:
    """A bag: one file, or a folder of files that follow each other.

    Attributes:
        paths: the files in order.
        expected: how many messages the metadata speak of; None if there are none.
        warnings: what is wrong with the folder.
    """

    paths: tuple[Path, ...]
    expected: int | None = None
    warnings: tuple[str, ...] = ()


def is_bag(path: Path) -> bool:
    """Return whether a path names a ROS 2 bag: by its suffix, or as a folder that holds one."""
    return path.name.lower().endswith(_FILES) or (path.is_dir() and bool(_storage(path)))


def bag_files(path: Path) -> BagFiles:
    """Find the files of a bag.

    Args:
        path: a `.mcap` or `.db3` file, or a folder of them with or without `metadata.yaml`.

    Raises:
        FileAccessError: it cannot be read.
        FormatError: the folder holds no such file.
    """
    if not path.is_dir():
        return BagFiles(paths=(path,))
    found = _storage(path)
    if not found:
        raise FormatError(f"{path} is a folder without {' or '.join(BAG_SUFFIXES)} files")
    told, warnings = _metadata(path / METADATA)
    paths, missing = _listed(told, found)
    if missing:
        warnings += (f"files of the bag that are missing: {', '.join(missing)}",)
    expected = told.get("message_count")
    return BagFiles(
        paths=paths,
        expected=expected if isinstance(expected, int) else None,
        warnings=warnings,
    )


def _storage(folder: Path) -> list[Path]:
    """Return the files of messages in a folder, numbers in their names in order of size."""
    try:
        found = [p for p in folder.iterdir() if p.is_file() and p.name.endswith(_FILES)]
    except OSError as error:
        raise FileAccessError(f"cannot read {folder}: {error.strerror or error}") from error
    return sorted(found, key=lambda p: [int(x) for x in re.findall(r"\d+", p.name)] or [0])


def _listed(told: Mapping[str, Any], found: list[Path]) -> tuple[tuple[Path, ...], list[str]]:
    """Return the files in the order of the metadata, and the names of those that are missing."""
    listed = told.get("relative_file_paths")
    names = [Path(str(name)).name for name in listed] if isinstance(listed, list) else []
    here = {path.name: path for path in found}
    missing = [name for name in names if name not in here]
    paths = tuple(here[name] for name in names if name in here)
    return paths or tuple(found), missing if paths else []


def _metadata(path: Path) -> tuple[Mapping[str, Any], tuple[str, ...]]:
    """Return what `metadata.yaml` says; a bag can be read without it."""
    if not path.exists():
        return {}, (f"the bag has no {METADATA}: its recorder did not finish it",)
    yaml = optional_library("ruamel.yaml", "bags in folders")
    try:
        content = yaml.YAML(typ="safe").load(path.read_text(encoding="utf-8"))
        told = content["rosbag2_bagfile_information"]
        return (told, ()) if isinstance(told, dict) else ({}, (f"{METADATA} is damaged",))
    except (OSError, ValueError, TypeError, KeyError, yaml.error.YAMLError):
        return {}, (f"{METADATA} is damaged and was left aside",)
