"""Puts deliberate faults into a copy of the project: its tests must notice each.

    python -m tests.mutations              # all of tests/mutations.toml
    python -m tests.mutations --only NAME

Each fault replaces a text of one file in a temporary copy, where the tests that are
named beside it then run. The exit code is 1 if one does not fail.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
from cyclopts import App

from foundation.errors import NeedleforceError
from needleforce.cli.terminal import run_command
from tests.source_files import ROOT, project_files

TABLE = ROOT / "tests" / "mutations.toml"

app = App(name="python -m tests.mutations", help=__doc__, version_flags=[])


class MutationError(NeedleforceError, ValueError):
    """A fault that cannot be put in, or tests that cannot judge it."""

    usual_advice = "tests/mutations.toml names the texts, their files and the tests"


class Mutation(msgspec.Struct, forbid_unknown_fields=True):
    """A deliberate fault.

    Attributes:
        name: By which it is selected.
        file: Which has it, from the project's folder.
        old: Text that occurs once in that file.
        new: What takes its place.
        tests: Files or tests of which one at least must fail.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def text(self):
        """Return the file's text with the fault.

        Raises:
            MutationError: The old text is not there, or more than once.
        """
        text = (ROOT / self.file).read_text(encoding="utf-8")
        if (count := text.count(self.old)) != 1:
            raise MutationError(
                f"{self.name}: {self.file} has {self.old!r} {count} times, expected 1"
            )
        return text.replace(self.old, self.new)


def read_mutations():
    """Return the deliberate faults by name."""
    table = msgspec.toml.decode(
        TABLE.read_bytes(), type=dict[str, tuple[Mutation, ...]]
    )
    return {mutation.name: mutation for mutation in table["mutations"]}


def run_tests(tests, mutation=None):
    """Run tests in a copy of the project; return pytest's exit code and its output.

    Compiled code comes from a copy of its cache, whose files are links: a fault leaves
    no trace in the cache.
    """
    with TemporaryDirectory(prefix="mutation-") as folder:
        copy = Path(folder) / "project"
        for path in project_files():
            place = copy / path.relative_to(ROOT)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, place)
        if mutation is not None:
            (copy / mutation.file).write_text(mutation.text(), encoding="utf-8")
        compiled = Path(folder) / "compiled"
        environment = os.environ | {
            "PYTHONPATH": str(copy),
            "NUMBA_CACHE_DIR": str(compiled),
            "PYTHONPYCACHEPREFIX": str(Path(folder) / "bytecode"),
        }
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "", *tests]
        found = subprocess.run(
            [*command, "-p", "no:cacheprovider"],
            cwd=copy,
            env=environment,
            capture_output=True,
            text=True,
        )
        return found.returncode, found.stdout + found.stderr


def link_or_copy(source, target):
    """Link a file, or copy it where the file system has no such links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


@app.default
def try_mutations(*, only: tuple[str, ...] = ()):
    """Put in each fault and run its tests.

    Args:
        only: Names of the faults; all by default.
    """
    known = read_mutations()
    if unknown := [name for name in only if name not in known]:
        raise MutationError(f"no fault is named {', '.join(unknown)}")
    chosen = [known[name] for name in only] or list(known.values())
    for mutation in chosen:
        mutation.text()
    tests = sorted({test for mutation in chosen for test in mutation.tests})
    code, output = run_tests(tests)
    if code:
        raise MutationError(f"without any fault the tests do not pass:\n{output}")
    unnoticed = 0
    for mutation in chosen:
        code, output = run_tests(mutation.tests, mutation)
        if code not in (0, 1):
            raise MutationError(f"with {mutation.name} no test can run:\n{output}")
        unnoticed += code == 0
        print("noticed  " if code else "UNNOTICED", mutation.name, flush=True)  # noqa: T201
    print(f"{len(chosen) - unnoticed} of {len(chosen)} noticed")  # noqa: T201
    return int(unnoticed > 0)


if __name__ == "__main__":
    sys.exit(run_command(lambda: app(result_action="return_value")))
