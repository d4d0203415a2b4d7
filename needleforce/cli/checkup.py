"""What `needleforce doctor` finds: versions, extras, cache, and a verdict."""

import os
import platform
import re
import sys
from collections.abc import Iterator
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path

from foundation import jit
from foundation.extras import EXTRA_OF_MODULE, EXTRAS, PACKAGE, install_command

PROJECT = Path(__file__).resolve().parents[2]
"""The folder in which the project's packages lie."""

CORE = ("pin", "pandas", "numpy", "scipy", "numba", "msgspec", "cyclopts")
"""What is always required."""


def examine(*, compiles: bool = False) -> dict[str, str]:
    """Return what is found, by label, the verdict last.

    The name of an extra is the label of what is missing for it.

    Args:
        compiles: Whether what is not kept yet is compiled first, so that nothing has to
            be later; else nothing is compiled or written.
    """
    _import_compiled()
    if compiles:
        jit.compile_waiting()
    versions = {name: _version_of(name) for name in (PACKAGE, *CORE)}
    core = ", ".join(f"{name} {versions[name] or '(missing)'}" for name in CORE)
    threads = os.environ.get("OMP_NUM_THREADS") or "not set (1 suits a control loop)"
    return {
        "needleforce": f"{versions[PACKAGE] or 'not installed'} in {PROJECT}",
        "python": f"{platform.python_version()}, {sys.executable}",
        "packages": core,
        "compiler": jit.COMPILER or "none",
        "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
        "cores": f"{os.cpu_count()}; OMP_NUM_THREADS is {threads}",
        **{extra: _describe_extra(extra) for extra in EXTRAS},
        "verdict": "; ".join(_find_doubts(versions)) or "ready",
    }


def _import_compiled() -> None:
    """Import all modules with compiled functions that Python calls."""
    for package in ("foundation", "residual", "identification", "needleforce"):
        for path in sorted((PROJECT / package).rglob("*.py")):
            if re.search("^@compiled$", path.read_text("utf-8"), re.MULTILINE):
                relative = path.relative_to(PROJECT).with_suffix("")
                import_module(".".join(relative.parts))


def _find_doubts(versions: dict[str, str | None]) -> Iterator[str]:
    """Yield what keeps this installation from doing its work, or slows it down."""
    if missing := [name for name in CORE if versions[name] is None]:
        yield f"missing: {', '.join(missing)}; pip install {PACKAGE}"
    if not jit.COMPILER:
        yield "NUMBA_DISABLE_JIT is set: everything runs fifty times slower"
    if not all(one.stats.cache_path for one in jit.dispatchers):
        yield (
            "compiled code cannot be kept, and every start compiles: set "
            "NUMBA_CACHE_DIR to a folder that can be written"
        )


def _describe_extra(extra: str) -> str:
    """Return whether an extra is installed, what it adds and how to install it."""
    modules = [name for name, owner in EXTRA_OF_MODULE.items() if owner == extra]
    command = install_command(extra)
    if extra == "ros2":  # which no package index installs
        modules = ["rclpy"]
        command = "docs/how-to/ros2.md"
    missing = ", ".join(
        name for name in modules if find_spec(name) is None and not _version_of(name)
    )
    if not missing:
        return f"extra, installed: {EXTRAS[extra]}"
    return f"extra, not installed: {EXTRAS[extra]} (missing: {missing}; {command})"


def _version_of(name: str) -> str | None:
    """Return the version of an installed package, None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
