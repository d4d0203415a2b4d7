"""What `needleforce doctor` finds: versions, extras, cache, and a verdict."""

import os
import platform
import re
import sys
from collections.abc import Iterator
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from foundation import jit
from foundation.extras import EXTRAS, PACKAGE, install_command
from needleforce.cli.terminal import aligned

PROJECT = Path(__file__).resolve().parents[2]
"""The folder in which the project's packages lie."""

OUTSIDE = {"ros2": "rclpy"}
"""Module that an extra needs and no package index installs, by extra."""


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


def examine(*, with_sizes: bool) -> dict[str, Any]:
    """Return what is found, as JSON has it; nothing is compiled or written.

    Args:
        with_sizes: Also measure the sizes of core and extras, which takes seconds.
    """
    _import_compiled()
    found: dict[str, Any] = {
        "version": version_of(PACKAGE) or "not installed",
        "folder": str(PROJECT),
        "python": platform.python_version(),
        "executable": sys.executable,
        "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
        "cores": _count_cores(),
        "blas_threads": os.environ.get("OMP_NUM_THREADS", ""),
        "may_run_real_time": _may_run_real_time(),
        "core": {
            item.name: version_of(item.name) or "not installed"
            for item in requirements_of(PACKAGE)
            if not item.of_extra
        },
        "extras": [_examine_extra(extra) for extra in EXTRAS],
        "cache": {
            "compiler": jit.COMPILER,
            "is_writable": all(one.stats.cache_path for one in jit.dispatchers),
            "functions": len(jit.dispatchers),
        },
        "sizes": installed_sizes() if with_sizes else [],
    }
    return found | {"doubts": list(_find_doubts(found))}


def describe(found: dict[str, Any]) -> str:
    """Return what `examine` has found as lines of text, the verdict last."""
    cache = found["cache"]
    core = ", ".join(f"{name} {version}" for name, version in found["core"].items())
    threads = found["blas_threads"] or "not set (1 suits a control loop)"
    rows = [
        ("needleforce", f"{found['version']} in {found['folder']}"),
        ("python", f"{found['python']}, {found['executable']}"),
        ("packages", core),
        ("compiler", cache["compiler"] or "none"),
        ("system", found["system"]),
        ("cores", f"{found['cores']}; OMP_NUM_THREADS is {threads}"),
        (
            "real time",
            "permitted" if found["may_run_real_time"] else "not permitted (ulimit -r)",
        ),
    ]
    extras = [(f"  {one['name']}", _describe_extra(one)) for one in found["extras"]]
    sizes = [
        (
            f"  {one['name']}",
            f"{one['bytes'] / 1e6:7.1f} MB in {one['packages']} packages"
            + "".join(f"; without {name}" for name in one["missing"]),
        )
        for one in found["sizes"]
    ]
    verdict = "; ".join(found["doubts"]) or "ready"
    parts = [aligned(rows), f"extras:\n{aligned(extras)}"]
    if sizes:
        parts.append(f"sizes on disk:\n{aligned(sizes)}")
    return "\n".join([*parts, f"verdict: {verdict}\n"])


def compile_everything() -> None:
    """Compile and keep what is not kept yet: nothing has to be compiled later."""
    _import_compiled()
    jit.compile_waiting()


def _import_compiled() -> None:
    """Import all modules with compiled functions that Python calls."""
    for package in ("foundation", "residual", "identification", "needleforce"):
        for path in sorted((PROJECT / package).rglob("*.py")):
            if re.search("^@compiled$", path.read_text("utf-8"), re.MULTILINE):
                relative = path.relative_to(PROJECT).with_suffix("")
                import_module(".".join(relative.parts))


def _find_doubts(found: dict[str, Any]) -> Iterator[str]:
    """Yield what keeps this installation from doing its work, or slows it down."""
    for name, version in found["core"].items():
        if version == "not installed":
            yield f"{name} is missing: pip install {PACKAGE}"
    cache = found["cache"]
    if not cache["compiler"]:
        yield "NUMBA_DISABLE_JIT is set: everything runs fifty times slower"
    if not cache["is_writable"]:
        yield (
            "compiled code cannot be kept, and every start compiles: set "
            "NUMBA_CACHE_DIR to a folder that can be written"
        )


def _count_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _may_run_real_time() -> bool:
    """Return whether a thread may take a real-time priority (SCHED_FIFO)."""
    if sys.platform != "linux":
        return False
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return os.geteuid() == 0 or limit != 0


def _examine_extra(extra: str) -> dict[str, Any]:
    """Return what an extra adds, and which of its packages are missing."""
    missing = [name for name in sorted(_own_packages(extra)) if not version_of(name)]
    outside = OUTSIDE.get(extra)
    if outside is not None and find_spec(outside) is None:
        missing.append(outside)
    return {
        "name": extra,
        "adds": EXTRAS[extra],
        "is_installed": not missing,
        "missing": missing,
    }


def _describe_extra(extra: dict[str, Any]) -> str:
    """Return whether an extra is installed, what it adds and how to install it."""
    if extra["is_installed"]:
        return f"installed      {extra['adds']}"
    name = extra["name"]
    command = "" if name in OUTSIDE else f": {install_command(name)}"
    missing = ", ".join(extra["missing"])
    return f"not installed  {extra['adds']}{command} (missing: {missing})"


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
    here = {"sys_platform": sys.platform, "platform_machine": platform.machine()}
    for line in lines:
        text, _, marker = line.partition(";")
        found = re.match(r"\s*([\w.-]+)\s*(?:\[([^\]]*)\])?", text)
        only_on = re.findall(
            r"""(sys_platform|platform_machine)\s*==\s*["']([\w-]+)["']""", marker
        )
        is_here = all(here[key] == value for key, value in only_on)
        if found is None or not is_here:
            continue
        asked = re.search(r"""extra\s*==\s*["']([\w-]+)["']""", marker)
        yield Requirement(
            name=re.sub(r"[-_.]+", "-", found[1]).lower(),
            extras=tuple(re.findall(r"[\w-]+", found[2] or "")),
            of_extra=asked[1] if asked else "",
        )


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


def installed_sizes() -> list[dict[str, Any]]:
    """Return the size of the core, and of what each extra adds to it.

    Packages that are not installed here are named, and not counted.
    """
    core = _closure(PACKAGE, ())
    added = {extra: _closure(PACKAGE, (extra,)) - core for extra in EXTRAS}
    return [_size_of(*item) for item in ({"core": core} | added).items()]


def _size_of(name: str, packages: set[str]) -> dict[str, Any]:
    """Return the size on disk of packages together, compiled files too."""
    present = {package for package in packages if version_of(package)}
    places = [
        Path(str(path.locate()))
        for package in present
        for path in metadata.distribution(package).files or ()
    ]
    return {
        "name": name,
        "packages": len(present),
        "bytes": sum(place.stat().st_size for place in places if place.is_file()),
        "missing": sorted(packages - present),
    }


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
