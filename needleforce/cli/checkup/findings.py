"""All that `needleforce doctor` finds, as text and as JSON."""

import platform
import sys
from dataclasses import dataclass

import msgspec

from foundation.extras import PACKAGE, install_command
from needleforce.cli.checkup.compiler import PROJECT, CompileCache, inspect_cache
from needleforce.cli.checkup.distributions import (
    OUTSIDE,
    ExtraState,
    InstalledSize,
    core_versions,
    extra_states,
    installed_sizes,
    version_of,
)
from needleforce.cli.checkup.machine import Machine, inspect_machine
from needleforce.cli.terminal import aligned

BYTES_PER_MB = 1e6
S_TO_MS = 1e3
S_TO_NS = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What was found.

    Attributes:
        version: Version of needleforce.
        folder: Where it lies.
        python: Version of Python.
        executable: Its program.
        core: Versions of the packages that are always needed, by name.
        extras: What of each extra is installed.
        cache: The cache of compiled code.
        machine: What a control loop would find.
        sizes: Sizes of core and extras; empty where they were not asked for.
    """

    version: str
    folder: str
    python: str
    executable: str
    core: dict[str, str]
    extras: tuple[ExtraState, ...]
    cache: CompileCache
    machine: Machine
    sizes: tuple[InstalledSize, ...] = ()

    def json(self) -> str:
        """Return everything as JSON, indented."""
        return msgspec.json.format(msgspec.json.encode(self)).decode() + "\n"

    def text(self) -> str:
        """Return everything as lines of text."""
        parts = [aligned(self._installation()), f"extras:\n{aligned(self._extras())}"]
        if self.sizes:
            parts.append(f"sizes on disk:\n{aligned(self._sizes())}")
        return "\n".join(parts)

    def _installation(self) -> list[tuple[str, str]]:
        """Return label and text of every line but those on extras."""
        machine = self.machine
        core = ", ".join(f"{name} {version}" for name, version in self.core.items())
        median_ms = S_TO_MS * machine.sleep_median_s
        longest_ms = S_TO_MS * machine.sleep_longest_s
        return [
            ("needleforce", f"{self.version} in {self.folder}"),
            ("python", f"{self.python}, {self.executable}"),
            ("packages", core),
            ("compiler", _describe_compiler(self.cache)),
            ("cache", _describe_cache(self.cache)),
            ("system", f"{machine.system}, {machine.processor}"),
            ("cores", _describe_cores(machine)),
            (
                "clock",
                f"steps of {S_TO_NS * machine.clock_step_s:.0f} ns; a sleep of 1 ms "
                f"takes {median_ms:.2f} ms, at the longest {longest_ms:.2f} ms",
            ),
            ("real time", _describe_real_time(machine)),
            ("GPU", "not needed"),
        ]

    def _extras(self) -> list[tuple[str, str]]:
        """Return name and state of every extra."""
        return [(f"  {extra.name}", _describe_extra(extra)) for extra in self.extras]

    def _sizes(self) -> list[tuple[str, str]]:
        """Return name and size of the core and of every extra."""
        return [(f"  {size.name}", _describe_size(size)) for size in self.sizes]


def examine(*, with_sizes: bool) -> Findings:
    """Return what is found; nothing is compiled or written.

    Args:
        with_sizes: Also measure the sizes of core and extras, which takes seconds.
    """
    return Findings(
        version=version_of(PACKAGE) or "not installed",
        folder=str(PROJECT),
        python=platform.python_version(),
        executable=sys.executable,
        core=core_versions(),
        extras=extra_states(),
        cache=inspect_cache(),
        machine=inspect_machine(),
        sizes=installed_sizes() if with_sizes else (),
    )


def _describe_compiler(cache: CompileCache) -> str:
    if cache.compiler:
        return cache.compiler
    return "disabled by NUMBA_DISABLE_JIT: everything runs fifty times slower"


def _describe_cache(cache: CompileCache) -> str:
    """Return where compiled code is kept, and whether a start has to compile."""
    if cache.is_warm:
        state = "warm: nothing is left to compile"
    else:
        state = (
            f"{cache.kept_functions} of {cache.functions} functions compiled; the "
            "first estimator compiles the others"
        )
    if not cache.is_writable:
        state += "; not writable: set NUMBA_CACHE_DIR to a folder that is"
    return f"{cache.folder}, {state}"


def _describe_cores(machine: Machine) -> str:
    threads = machine.blas_threads
    if threads:
        return f"{machine.cores}; OMP_NUM_THREADS={threads}"
    return f"{machine.cores}; OMP_NUM_THREADS is not set (1 suits a control loop)"


def _describe_real_time(machine: Machine) -> str:
    """Return whether threads may have a real-time priority, and the kernel's kind."""
    kernel = "real-time" if machine.is_real_time_kernel else "not a real-time one"
    permission = {
        None: "this system has no SCHED_FIFO",
        True: "SCHED_FIFO is permitted",
        False: "SCHED_FIFO is not permitted (see ulimit -r)",
    }
    return f"{permission[machine.may_run_real_time]}; kernel: {kernel}"


def _describe_extra(extra: ExtraState) -> str:
    """Return whether an extra is installed, what it adds and how to install it."""
    if extra.is_installed:
        return f"installed      {extra.adds}"
    missing = ", ".join(extra.missing)
    if extra.name in OUTSIDE:
        return f"not installed  {extra.adds} (missing: {missing})"
    return (
        f"not installed  {extra.adds}: {install_command(extra.name)} "
        f"(missing: {missing})"
    )


def _describe_size(size: InstalledSize) -> str:
    text = f"{size.bytes / BYTES_PER_MB:7.1f} MB in {size.packages} packages"
    if size.missing:
        text += f"; without {', '.join(size.missing)}, not installed here"
    return text
