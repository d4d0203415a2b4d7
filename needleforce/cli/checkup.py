"""What `needleforce doctor` finds: versions, extras, cache, and a verdict."""

import os
import platform
import re
import sys
from collections.abc import Iterator
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from foundation import jit
from foundation.extras import EXTRA_OF_MODULE, EXTRAS, PACKAGE, install_command
from needleforce.cli.terminal import aligned

PROJECT = Path(__file__).resolve().parents[2]
"""The folder in which the project's packages lie."""

CORE = ("pin", "pandas", "numpy", "scipy", "numba", "msgspec", "cyclopts")
"""What is always required."""


def examine() -> dict[str, Any]:
    """Return what is found, as JSON has it; nothing is compiled or written."""
    _import_compiled()
    limited = os.environ.get("OMP_NUM_THREADS", "")
    found: dict[str, Any] = {
        "version": _version_of(PACKAGE) or "not installed",
        "folder": str(PROJECT),
        "python": platform.python_version(),
        "executable": sys.executable,
        "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
        "cores": len(os.sched_getaffinity(0)) if sys.platform == "linux" else None,
        "blas_threads": limited or "not set (1 suits a control loop)",
        "core": {name: _version_of(name) or "not installed" for name in CORE},
        "extras": [_examine_extra(extra) for extra in EXTRAS],
        "cache": {
            "compiler": jit.COMPILER,
            "is_writable": all(one.stats.cache_path for one in jit.dispatchers),
            "functions": len(jit.dispatchers),
        },
    }
    return found | {"doubts": list(_find_doubts(found))}


def describe(found: dict[str, Any]) -> str:
    """Return what `examine` has found as lines of text, the verdict last."""
    core = ", ".join(f"{name} {version}" for name, version in found["core"].items())
    rows = [
        ("needleforce", f"{found['version']} in {found['folder']}"),
        ("python", f"{found['python']}, {found['executable']}"),
        ("packages", core),
        ("compiler", found["cache"]["compiler"] or "none"),
        ("system", found["system"]),
        ("cores", f"{found['cores']}; OMP_NUM_THREADS is {found['blas_threads']}"),
    ]
    extras = [(f"  {one['name']}", _describe_extra(one)) for one in found["extras"]]
    verdict = "; ".join(found["doubts"]) or "ready"
    return f"{aligned(rows)}\nextras:\n{aligned(extras)}\nverdict: {verdict}\n"


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
    if not found["cache"]["compiler"]:
        yield "NUMBA_DISABLE_JIT is set: everything runs fifty times slower"
    if not found["cache"]["is_writable"]:
        yield (
            "compiled code cannot be kept, and every start compiles: set "
            "NUMBA_CACHE_DIR to a folder that can be written"
        )


def _examine_extra(extra: str) -> dict[str, Any]:
    """Return what an extra adds, and which of its modules are missing."""
    modules = [name for name, owner in EXTRA_OF_MODULE.items() if owner == extra]
    if extra == "ros2":  # which no package index installs
        modules = ["rclpy"]
    missing = [
        name for name in modules if find_spec(name) is None and not _version_of(name)
    ]
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
    command = "" if name == "ros2" else f": {install_command(name)}"
    missing = ", ".join(extra["missing"])
    return f"not installed  {extra['adds']}{command} (missing: {missing})"


def _version_of(name: str) -> str | None:
    """Return the version of an installed package, None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
