"""Functions that numba may compile: the same numbers without it, and safe to keep on disk."""

import ast
import math
import subprocess
import sys
from pathlib import Path

import pytest

from needleforce.jit import COMPILER, compiled

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("residual", "identification", "needleforce")


def test_what_is_compiled_uses_nothing_of_another_file():
    """What numba keeps on disk is made anew when the function's own file changes, not another."""
    found, count = {}, 0
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        foreign = {
            alias.asname or alias.name
            for node in tree.body
            if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in (*PACKAGES, "urdf")
            for alias in node.names
        }
        for node in ast.walk(tree):
            marks = [ast.unparse(mark) for mark in getattr(node, "decorator_list", [])]
            if "compiled" in marks:
                count += 1
                body = ast.Module(body=node.body, type_ignores=[])
                used = {item.id for item in ast.walk(body) if isinstance(item, ast.Name)} & foreign
                if used:
                    found[f"{path.relative_to(ROOT)}:{node.name}"] = used
    assert found == {}
    assert count > 20


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
    script = (
        f"import sys; {hidden}"
        "from needleforce.jit import COMPILER, compiled\n"
        "plain = lambda x: x\n"
        "assert COMPILER == '' and compiled(plain) is plain\n"
        "print('plain')"
    )
    options = {"cwd": ROOT, "env": {"NUMBA_DISABLE_JIT": "1"}, "text": True, "check": True}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, **options)
    assert done.stdout == "plain\n"
