"""The first use: compiles what is not on disk yet, in two processes, and says so."""

import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from foundation.compile_cache import find_cache

if TYPE_CHECKING:
    from foundation.jit import Entry

SECONDS_PER_FUNCTION = 0.3
"""Processor time that a function takes to compile, on average."""

MIN_ANNOUNCED_S = 1.0
"""Shorter times are not announced."""

MIN_SHARED = 20
"""Functions from which on a second process is worth its start."""

HELPER_START = 0.1
"""Part of the whole work that the start of a second process costs it."""

HELPER = (
    "import sys; from foundation.first_use import compile_modules; "
    "compile_modules(sys.argv[1:])"
)
"""What the second process runs; the modules follow as arguments."""


def compile_with_helper(cold: Sequence["Entry"]) -> None:
    """Compile functions that are not on disk, half of them in a second process.

    What the second process was given and did not keep is left to the caller.
    """
    progress = _Progress(len(cold))
    is_shared = (
        len(cold) >= MIN_SHARED
        and progress.is_kept
        and (os.cpu_count() or 1) > 1
        and Path(sys.executable or "").name.startswith("python")
    )
    others = choose_modules(cold) if is_shared else set()
    helper = _start_helper(others) if others else None
    try:
        for entry in cold:
            if entry.module not in others:
                entry.compile()
                progress.show_next()
        if helper is not None:
            helper.wait()
    finally:
        if helper is not None and helper.poll() is None:
            helper.kill()
        progress.finish()


def choose_modules(entries: Iterable["Entry"]) -> set[str]:
    """Choose modules that hold about half of the work, by the size of their sources."""
    files = {entry.module: entry.file for entry in entries}
    sizes = {module: file.stat().st_size for module, file in files.items()}
    own_size = 0.0
    other_size = HELPER_START * sum(sizes.values())
    others: set[str] = set()
    for module in sorted(sizes, key=lambda name: -sizes[name]):
        if other_size < own_size:
            others.add(module)
            other_size += sizes[module]
        else:
            own_size += sizes[module]
    return others


def _start_helper(modules: Iterable[str]) -> subprocess.Popen[bytes] | None:
    path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
    try:
        return subprocess.Popen(
            [sys.executable, "-c", HELPER, *sorted(modules)],
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:  # no more processes, or no interpreter: compile alone
        return None


def compile_modules(modules: Sequence[str]) -> None:
    """Compile and keep the functions of some modules; the work of the helper."""
    from foundation.jit import waiting_entries

    for module in modules:
        import_module(module)
    for entry in waiting_entries():
        if entry.module in modules:
            entry.compile()


class _Progress:
    """Says on stderr that something is compiled, and on a terminal how far it is."""

    def __init__(self, count: int) -> None:
        seconds = SECONDS_PER_FUNCTION * count
        self._done = 0
        self._count = count
        self._is_announced = seconds >= MIN_ANNOUNCED_S
        status = find_cache()
        self.is_kept = status.folder is not None and status.is_writable
        self._text = f"needleforce: compiling once, about {seconds:.0f} s"
        if not self.is_kept:
            self._text = (
                f"needleforce: compiling, about {seconds:.0f} s at every start: no "
                "folder can be written; name one in NUMBA_CACHE_DIR"
            )
        self._is_terminal = bool(getattr(sys.stderr, "isatty", bool)())
        self._write("" if self._is_terminal else "\n")

    def show_next(self) -> None:
        """Count one more function."""
        self._done += 1
        if self._is_terminal:
            self._write(f": {self._done} of {self._count} functions")

    def finish(self) -> None:
        """End the line."""
        if self._is_terminal:
            self._write(": done\n")

    def _write(self, end: str) -> None:
        if self._is_announced and sys.stderr is not None:
            start = "\r\033[K" if self._is_terminal else ""
            sys.stderr.write(f"{start}{self._text}{end}")
            sys.stderr.flush()
