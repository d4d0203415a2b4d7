"""How many files one piece of work passes, and how long the import chains are.

A newcomer who wants to understand one update has to open every file that it passes.
What numba compiles is not seen here; with ``NUMBA_DISABLE_JIT=1`` it is.
"""

import ast
import sys
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.insertion.signals import JointSignals
from needleforce import InsertionSession
from needleforce.cli import main
from residual import VirtualForceSensor
from tests.insertion_run import short_run, tare_index
from tests.needleforce.cli.residual_command_log import write_insertion

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = (
    "foundation",
    "urdf",
    "residual",
    "identification",
    "groundtruth",
    "needleforce",
)
ALL = (*PRODUCT, "benchmarks")
MAX_FILES_PER_UPDATE = 35
MAX_FILES_PER_ROW = 17
MAX_CHAIN = 25


def file_of(code):
    """Name of the product's file that a code object is from, empty for any other."""
    path = Path(code.co_filename)
    if not path.is_relative_to(ROOT):
        return ""
    name = path.relative_to(ROOT)
    return name.as_posix() if name.parts[0] in PRODUCT else ""


@contextmanager
def profiled(on_call):
    """Call a function with the frame of every Python function that is entered, or
    resumed."""

    def note(frame, event, _):
        if event == "call":
            on_call(frame)

    previous = sys.getprofile()
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(previous)


def files_passed(work):
    """Files of the product that a call passes."""
    codes = set()
    with profiled(lambda frame: codes.add(frame.f_code)):
        work()
    return {name for name in map(file_of, codes) if name}


def listed(names):
    return f"{len(names)} files:\n" + "\n".join(sorted(names))


@pytest.mark.slow
def test_one_update_of_the_chain_passes_few_files():
    run = short_run()
    session = InsertionSession(run.robot)
    tare = tare_index(run)
    touched = int(np.searchsorted(run.signals.t_s, run.truth.contact_s))
    files = []
    for k, sample in enumerate(JointSignals.of_run(run).samples()[: touched + 3000]):
        if k == tare:
            session.tare()
        if k > touched and k % 10 == 0:
            files.append(files_passed(lambda sample=sample: session.update(*sample)))
        else:
            session.update(*sample)
    busiest = max(files, key=len)

    assert "needleforce/session.py" in busiest
    assert len(busiest) <= MAX_FILES_PER_UPDATE, listed(busiest)


def files_of_a_row(log, out):
    """Files that rows of a log pass on their way into the sensor.

    Those passed before the first update (reading, but also setting up) that are passed
    again between later ones (reading, but also writing): what belongs to reading alone
    is in both.
    """
    update = VirtualForceSensor.update.__code__
    setup = set()
    between = set()
    latest = set()

    def note(frame):
        code = frame.f_code
        above = frame
        if code is update:
            between.update(latest)
            latest.clear()
            note.is_running = True
        # What the sensor itself passes, in an update or at the tare, is not on the way
        # to it.
        while above is not None and above.f_code.co_filename != update.co_filename:
            above = above.f_back
        if above is None:
            (latest if note.is_running else setup).add(code)

    note.is_running = False
    with profiled(note):
        assert main(["force", str(log), "--tare", "0:13", "-o", str(out)]) == 0
    return {name for name in map(file_of, setup & between) if name}


@pytest.mark.slow
def test_a_csv_row_passes_few_files(lwr, tmp_path):
    write_insertion(tmp_path / "log.csv", lwr, seconds=15.0, contact_s=14.0)
    files = files_of_a_row(tmp_path / "log.csv", tmp_path / "out.csv")

    assert files
    assert len(files) <= MAX_FILES_PER_ROW, listed(files)


@cache
def modules(packages=PRODUCT):
    """Modules of packages, the product's unless said otherwise, and their files, by
    dotted name."""
    paths = {}
    for package in packages:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            paths[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return paths


def imports_of(name, *, ever=False):
    """Modules of the product that a module imports when it is imported, its own parents
    aside.

    With `ever` also those it imports inside functions or for type checkers only, and
    benchmarks.
    """
    known = modules(ALL) if ever else modules()
    tree = ast.parse(known[name].read_text(encoding="utf-8"))
    imported = set()
    for node in ast.walk(tree) if ever else tree.body:
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                imported.add(inner if inner in known else node.module)
    return sorted(imported & set(known) - {name})


def longest_chain(graph):
    """The longest chain of imports in a graph of names.

    Raises:
        AssertionError: The graph has a circle; the message names it.
    """
    chains = {}

    def chain(name, path):
        assert name not in path, f"a circle of imports: {' -> '.join((*path, name))}"
        if name not in chains:
            below = [chain(imported, (*path, name)) for imported in graph[name]]
            chains[name] = (name, *max(below, key=len, default=()))
        return chains[name]

    return max((chain(name, ()) for name in graph), key=len, default=())


@pytest.mark.slow
def test_import_chains_are_short_without_circles():
    longest = longest_chain({name: imports_of(name) for name in modules()})
    assert len(longest) <= MAX_CHAIN, f"{len(longest)}: {' -> '.join(longest)}"


@pytest.mark.slow
def test_imports_inside_functions_make_no_circle():
    assert longest_chain({name: imports_of(name, ever=True) for name in modules(ALL)})


def test_a_circle_would_be_noticed():
    with pytest.raises(AssertionError, match="a circle of imports: a -> b -> a"):
        longest_chain({"a": ["b"], "b": ["a"]})
