"""What lies in the cache of compiled code, without compiling anything."""

import re
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from foundation.compile_cache import PROJECT, find_cache, folder_name
from foundation.jit import COMPILER, compile_waiting

PACKAGES = ("foundation", "residual", "identification", "needleforce")
"""Packages with compiled functions."""

COMPILED = re.compile(r"^@compiled$", re.MULTILINE)
"""How a source marks a function that Python calls and that is compiled."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CompileCache:
    """The cache of compiled code.

    Attributes:
        compiler: Name and version; empty where compiling is disabled.
        folder: Where compiled code is kept; empty where no folder can be written.
        is_writable: Whether new code can be kept there.
        modules: Modules with compiled functions.
        kept_modules: Those of them whose code, as it now stands, is kept.
    """

    compiler: str
    folder: str
    is_writable: bool
    modules: int
    kept_modules: int

    @property
    def is_warm(self) -> bool:
        """Whether nothing has to be compiled when the first estimator is made."""
        return self.kept_modules == self.modules


def inspect_cache() -> CompileCache:
    """Return the state of the cache; nothing is compiled or written."""
    cache = find_cache()
    sources = _compiled_sources()
    kept = [path for path in sources if _is_kept(cache.folder, path)]
    return CompileCache(
        compiler=COMPILER,
        folder=str(cache.folder or ""),
        is_writable=cache.is_writable,
        modules=len(sources),
        kept_modules=len(kept),
    )


def compile_everything() -> None:
    """Compile and keep what is not kept yet: nothing has to be compiled later."""
    for source in _compiled_sources():
        import_module(_module_name(source))
    compile_waiting()


def _compiled_sources() -> list[Path]:
    """Return the files with compiled functions that Python calls."""
    return [
        path
        for package in PACKAGES
        for path in sorted((PROJECT / package).rglob("*.py"))
        if COMPILED.search(path.read_text(encoding="utf-8"))
    ]


def _module_name(source: Path) -> str:
    return ".".join(source.relative_to(PROJECT).with_suffix("").parts)


def _is_kept(root: Path | None, source: Path) -> bool:
    """Return whether the compiled code of a source is in the cache."""
    if root is None:
        return False
    return any((root / folder_name(_module_name(source))).rglob("*.nbi"))
