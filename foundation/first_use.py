"""The first use: compiles what is not on disk yet, in two processes, and says so."""

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import Any, NamedTuple

MIN_ANNOUNCED = 4
"""Functions from which on their compiling is announced: about a second."""

MIN_MEASURED = 0.1
"""Part of the work from which on its time tells that of the rest."""

MIN_SHARED = 20
"""Functions from which on a second process is worth its start."""

HELPER_START = 0.1
"""Part of the whole work that the start of a second process costs it."""

HELPER = (
    "import sys; from foundation.jit import compile_modules; "
    "compile_modules(sys.argv[1:])"
)
"""What the second process runs; the modules follow as arguments."""


class Entry(NamedTuple):
    """A function with its one signature.

    Attributes:
        dispatcher: What the compiler has made of it.
        parameters: The compiler's types of its parameters.
        cache: Where it is kept on disk, a `foundation.compile_cache.FunctionCache`;
            None where nothing is.
    """

    dispatcher: Any
    parameters: list[Any]
    cache: Any

    @property
    def module(self) -> str:
        """Name of the module that it stands in."""
        return self.dispatcher.py_func.__module__

    @property
    def file(self) -> Path:
        """File of that module."""
        return Path(self.dispatcher.py_func.__code__.co_filename)

    @property
    def is_cold(self) -> bool:
        """Whether it has to be compiled, rather than loaded from disk."""
        is_kept = self.cache is not None and self.cache.is_warm
        return not self.dispatcher.overloads and not is_kept

    def compile(self) -> None:
        """Compile it, or load it from disk, for its one signature."""
        if not self.dispatcher.overloads:
            self.dispatcher.compile(tuple(self.parameters))
            self.dispatcher.disable_compile()

    def check_types(self, arguments: Sequence[Any]) -> None:
        """Check arguments of its first call, which no one else does.

        Raises:
            TypeError: For one that does not convert to the type of its parameter.
        """
        context = self.dispatcher.targetdescr.typing_context
        for value, wanted in zip(arguments, self.parameters, strict=True):
            given = self.dispatcher.typeof_pyval(value)
            if context.can_convert(given, wanted) is None:
                name = self.dispatcher.py_func.__qualname__
                raise TypeError(f"{name} takes {wanted}, got {given}")


def compile_cold(cold: Sequence[Entry], *, is_kept: bool) -> None:
    """Compile functions that are not on disk, half of them in a second process.

    What the second process was given and did not keep is left to the caller.

    Args:
        cold: The functions.
        is_kept: Whether there is a folder to keep them in.
    """
    progress = _Progress(cold, is_kept=is_kept)
    # An interpreter inside another program cannot run a second process of ours.
    is_shared = (
        len(cold) >= MIN_SHARED
        and is_kept
        and (os.cpu_count() or 1) > 1
        and Path(sys.executable or "").name.startswith("python")
    )
    helper_modules = choose_modules(cold) if is_shared else set()
    helper = _start_helper(helper_modules) if helper_modules else None
    try:
        for entry in cold:
            if entry.module not in helper_modules:
                entry.compile()
        if helper is not None:
            helper.wait()
    finally:
        if helper is not None and helper.poll() is None:
            helper.kill()
        progress.finish()


def choose_modules(entries: Iterable[Entry]) -> set[str]:
    """Choose modules that hold about half of the work, by the size of their sources."""
    sizes = source_sizes(entries)
    own_size = 0.0
    helper_size = HELPER_START * sum(sizes.values())
    helper_modules: set[str] = set()
    for module in sorted(sizes, key=lambda name: -sizes[name]):
        if helper_size < own_size:
            helper_modules.add(module)
            helper_size += sizes[module]
        else:
            own_size += sizes[module]
    return helper_modules


def source_sizes(entries: Iterable[Entry]) -> dict[str, int]:
    """Return the size of the source of each module that functions stand in."""
    files = {entry.module: entry.file for entry in entries}
    return {module: file.stat().st_size for module, file in files.items()}


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


class _Progress:
    """Says on stderr what is compiled, how much of it is done, and how long it takes.

    A thread of its own writes, also while one long function is compiled or a second
    process is waited for: every second into one line of a terminal, every ten seconds
    elsewhere.
    """

    def __init__(self, cold: Sequence[Entry], *, is_kept: bool) -> None:
        self._cold = cold
        self._start_s = monotonic()
        self._text = "needleforce: compiling once"
        if not is_kept:
            self._text = (
                "needleforce: compiling at every start: no folder can be written; name "
                "one in NUMBA_CACHE_DIR"
            )
        # A module's source stands for its work, shared by its functions.
        sizes = source_sizes(cold)
        counts = Counter(entry.module for entry in cold)
        self._weights = [sizes[entry.module] / counts[entry.module] for entry in cold]
        self._is_terminal = bool(getattr(sys.stderr, "isatty", bool)())
        self._ended = Event()
        self._is_announced = len(cold) >= MIN_ANNOUNCED
        self._thread = Thread(target=self._show, daemon=True)
        if self._is_announced:
            self._write("" if self._is_terminal else "\n")
            self._thread.start()

    def finish(self) -> None:
        """End the line."""
        self._ended.set()
        if self._is_announced:
            self._thread.join()
            if self._is_terminal:
                self._write(f": done in {monotonic() - self._start_s:.0f} s\n")

    def _show(self) -> None:
        period_s = 1.0 if self._is_terminal else 10.0
        end = "" if self._is_terminal else "\n"
        while not self._ended.wait(period_s):
            self._write(f": {self._describe()}{end}")

    def _describe(self) -> str:
        """Say how much is done and, from what that took, how long the rest takes."""
        done = sum(
            weight
            for entry, weight in zip(self._cold, self._weights, strict=True)
            if not entry.is_cold
        )
        fraction = done / sum(self._weights)
        elapsed_s = monotonic() - self._start_s
        if fraction < MIN_MEASURED:
            return f"{elapsed_s:.0f} s so far"
        left_s = elapsed_s * (1.0 - fraction) / fraction
        return f"{fraction:.0%}, about {left_s:.0f} s left"

    def _write(self, end: str) -> None:
        if sys.stderr is not None:
            start = "\r\033[K" if self._is_terminal else ""
            sys.stderr.write(f"{start}{self._text}{end}")
            sys.stderr.flush()
