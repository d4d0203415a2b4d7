"""Functions that numba may compile: the same numbers without it, and safe to keep on disk."""

import ast
import math
import subprocess
import sys
from pathlib import Path

import pytest

from needleforce.jit import COMPILER, compiled

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("residual", "identification", "insertion")


def compiled_functions(tree):
    marks = {
        node: [ast.unparse(mark) for mark in node.decorator_list]
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    }
    return [node for node, names in marks.items() if "compiled" in names]


def files_with_compiled_functions():
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            if functions := compiled_functions(tree):
                yield path, tree, functions


def imported_names(tree):
    """Names that a file takes from another of ours."""
    return {
        alias.asname or alias.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in (*ROOMS, "urdf")
        for alias in node.names
    }


def test_what_is_compiled_uses_nothing_of_another_file():
    """What numba keeps on disk is made anew when the function's own file changes, not another."""
    found = {}
    for path, tree, functions in files_with_compiled_functions():
        foreign = imported_names(tree)
        for function in functions:
            body = ast.Module(body=function.body, type_ignores=[])
            used = {node.id for node in ast.walk(body) if isinstance(node, ast.Name)} & foreign
            if used:
                found[f"{path.relative_to(ROOT)}:{function.name}"] = used
    assert found == {}


def test_a_compiled_function_gives_what_the_plain_one_gives():
    def hypotenuse(a, b):
        return math.sqrt(a * a + b * b)

    assert compiled(hypotenuse)(3.0, 4.0) == hypotenuse(3.0, 4.0) == 5.0


@pytest.mark.skipif(not COMPILER, reason="numba (the extra `fast`) is not installed")
@pytest.mark.parametrize("error", [RuntimeError("no locator"), EOFError(), OSError("disk full")])
def test_where_nothing_can_be_kept_it_compiles_all_the_same(monkeypatch, error):
    import numba

    def njit(*types, cache=False):
        if cache:
            raise error
        return lambda function: function

    monkeypatch.setattr(numba, "njit", njit)

    def double(x):
        return 2.0 * x

    assert compiled(double)(2.0) == 4.0


@pytest.mark.parametrize("hidden", ["", "sys.modules['numba'] = None; "])
def test_everything_runs_without_a_compiler(hidden):
    environment = {"NUMBA_DISABLE_JIT": "1"}
    script = (
        f"import sys; {hidden}"
        "from needleforce.jit import COMPILER, compiled\n"
        "plain = lambda x: x\n"
        "assert COMPILER == '' and compiled(plain) is plain\n"
        "print('plain')"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "plain\n"
