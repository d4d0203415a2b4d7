"""Which packages are installed, what each extra would add, and how large they are."""

import platform
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from foundation.extras import EXTRAS, PACKAGE

_NAME = re.compile(r"^([\w.-]+)\s*(?:\[([^\]]*)\])?")
"""Name and extras of what a line of the metadata requires."""

_EXTRA = re.compile(r"""extra\s*==\s*["']([\w-]+)["']""")
_PLATFORM = re.compile(r"""(sys_platform|platform_machine)\s*==\s*["']([\w-]+)["']""")

OUTSIDE = {"ros2": "rclpy"}
"""Module that an extra needs and no package index installs, by extra."""

_HERE = {"sys_platform": sys.platform, "platform_machine": platform.machine()}


class Requirement(NamedTuple):
    """A line of a package's metadata that names another package.

    Attributes:
        name: Name of the other package, lower case with hyphens.
        extras: Extras of the other package that are asked for.
        of_extra: Extra that asks for it; empty where it is always needed.
    """

    name: str
    extras: tuple[str, ...]
    of_extra: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtraState:
    """What of an extra is installed.

    Attributes:
        name: Its name.
        adds: What a user can do with it.
        is_installed: Whether all of its packages are.
        missing: Those that are not.
    """

    name: str
    adds: str
    is_installed: bool
    missing: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class InstalledSize:
    """Size of what an extra adds to the core, or of the core.

    Attributes:
        name: Name of the extra, or ``core``.
        packages: Packages that it adds.
        bytes: Their size on disk.
        missing: Packages of it that are not installed here, and are not counted.
    """

    name: str
    packages: int
    bytes: int
    missing: tuple[str, ...]


def core_versions() -> dict[str, str]:
    """Return the versions of the packages that are always needed, by name."""
    return {
        item.name: version_of(item.name) or "not installed"
        for item in requirements_of(PACKAGE)
        if not item.of_extra
    }


def version_of(name: str) -> str | None:
    """Return the version of an installed package, None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def requirements_of(name: str) -> Iterator[Requirement]:
    """Yield what an installed package requires on this platform."""
    try:
        lines = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return
    for line in lines:
        text, _, marker = line.partition(";")
        found = _NAME.match(text.strip())
        is_here = all(_HERE[key] == value for key, value in _PLATFORM.findall(marker))
        if found is None or not is_here:
            continue
        asked = _EXTRA.search(marker)
        yield Requirement(
            name=_normalised(found[1]),
            extras=tuple(re.findall(r"[\w-]+", found[2] or "")),
            of_extra=asked[1] if asked else "",
        )


def _normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def extra_states() -> tuple[ExtraState, ...]:
    """Return what of each extra of a user is installed."""
    states: list[ExtraState] = []
    for extra, adds in EXTRAS.items():
        missing = tuple(
            name for name in sorted(_own_packages(extra)) if version_of(name) is None
        )
        outside = OUTSIDE.get(extra)
        if outside is not None and find_spec(outside) is None:
            missing += (outside,)
        states.append(
            ExtraState(name=extra, adds=adds, is_installed=not missing, missing=missing)
        )
    return tuple(states)


def _own_packages(extra: str) -> set[str]:
    """Return the packages that an extra of ours names, and the extras in it."""
    names: set[str] = set()
    for item in requirements_of(PACKAGE):
        if item.of_extra != extra:
            continue
        if item.name == PACKAGE:
            names.update(*map(_own_packages, item.extras))
        else:
            names.add(item.name)
    return names


def installed_sizes() -> tuple[InstalledSize, ...]:
    """Return the size of the core, and of what each extra adds to it.

    Packages that are not installed here are named, and not counted.
    """
    core = _closure(PACKAGE, ())
    added = {extra: _closure(PACKAGE, (extra,)) - core for extra in EXTRAS}
    return tuple(_size_of(*item) for item in ({"core": core} | added).items())


def licence_table() -> str:
    """Return name, version, licence and bringer of all that is required, in Markdown.

    Packages are those installed here; a licence is what a package's metadata states.
    """
    brought_by = dict.fromkeys(sorted(_closure(PACKAGE, ()) - {PACKAGE}), "core")
    for extra in EXTRAS:
        added = sorted(_closure(PACKAGE, (extra,)) - brought_by.keys() - {PACKAGE})
        brought_by |= dict.fromkeys(added, f"`{extra}`")

    rows = [
        f"| {name} | {version_of(name)} | {_licence_of(name)} | {bringer} |\n"
        for name, bringer in brought_by.items()
        if version_of(name) is not None
    ]
    head = "| package | version | licence | brought by |\n|---|---|---|---|\n"
    return head + "".join(rows)


def _licence_of(name: str) -> str:
    """Return the licence that an installed package states, in a few words."""
    stated = metadata.metadata(name).json
    if expression := stated.get("license_expression"):
        return str(expression)

    names = [
        item.rpartition(" :: ")[2]
        for item in stated.get("classifier", ())
        if item.startswith("License :: ") and not item.endswith("OSI Approved")
    ]
    text = str(stated.get("license", "")).strip().partition("\n")[0].strip()
    return ", ".join(names) or text[:60] or "not stated"


def _closure(name: str, extras: tuple[str, ...]) -> set[str]:
    """Return a package with all that it requires, also indirectly.

    What only some versions of Python need counts where it is installed.
    """
    found = {name}
    waiting = [(name, extra) for extra in ("", *extras)]
    seen = set(waiting)
    while waiting:
        package, wanted_extra = waiting.pop()
        for item in requirements_of(package):
            if item.of_extra != wanted_extra:
                continue
            if package != PACKAGE and version_of(item.name) is None:
                continue
            found.add(item.name)
            new = {(item.name, extra) for extra in ("", *item.extras)} - seen
            seen |= new
            waiting += new
    return found


def _size_of(name: str, packages: set[str]) -> InstalledSize:
    """Return the size of packages together."""
    missing = {package for package in packages if version_of(package) is None}
    present = packages - missing
    return InstalledSize(
        name=name,
        packages=len(present),
        bytes=sum(map(_bytes_of, present)),
        missing=tuple(sorted(missing)),
    )


def _bytes_of(name: str) -> int:
    """Return the size of the files of an installed package, compiled ones too."""
    places = [
        Path(str(path.locate())) for path in metadata.distribution(name).files or ()
    ]
    return sum(place.stat().st_size for place in places if place.is_file())
