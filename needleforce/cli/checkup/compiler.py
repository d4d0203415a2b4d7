"""What lies in the cache of compiled code, without compiling anything."""

import re
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from foundation import jit
from foundation.compile_cache import cache_roots, writable_root

PROJECT = Path(__file__).resolve().parents[3]
"""The folder in which the project's packages lie."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CompileCache:
    """The cache of compiled code.

    Attributes:
        compiler: Name and version; empty where compiling is disabled.
        folder: Where compiled code is kept.
        is_writable: Whether new code can be kept there.
        functions: Functions that are compiled.
        kept_functions: Those of them whose code, as it now stands, is kept.
    """

    compiler: str
    folder: str
    is_writable: bool
    functions: int
    kept_functions: int

    @property
    def is_warm(self) -> bool:
        """Whether nothing has to be compiled when the first estimator is made."""
        return self.kept_functions == self.functions


def inspect_cache() -> CompileCache:
    """Return the state of the cache; nothing is compiled or written."""
    _import_compiled()
    root = writable_root()
    return CompileCache(
        compiler=jit.COMPILER,
        folder=str(root or next(cache_roots())),
        is_writable=root is not None,
        functions=len(jit.entries),
        kept_functions=sum(entry.cache.is_warm for entry in jit.entries),
    )


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
