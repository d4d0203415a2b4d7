"""Functions that numba may compile: the same numbers without it, and safe to keep on
disk."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from identification import MULTILAYER, PUBLISHED, replay
from needleforce import InsertionSession
from needleforce.jit import COMPILER, compiled
from urdf import NeedleTool, load_lwr

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("residual", "identification", "needleforce")


def test_what_is_compiled_uses_nothing_of_another_file():
    """What numba keeps is made anew when the function's own file changes; `dot`
    never does."""
    found = {}
    count = 0
    for path in (
        path for package in PACKAGES for path in (ROOT / package).rglob("*.py")
    ):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        foreign = {
            alias.asname or alias.name
            for node in tree.body
            if isinstance(node, ast.ImportFrom)
            and node.module.split(".")[0] in (*PACKAGES, "urdf")
            for alias in node.names
            if alias.name != "dot"
        }
        for node in ast.walk(tree):
            marks = [ast.unparse(mark) for mark in getattr(node, "decorator_list", [])]
            if "compiled" in marks:
                count += 1
                body = ast.Module(body=node.body, type_ignores=[])
                used = {
                    item.id for item in ast.walk(body) if isinstance(item, ast.Name)
                } & foreign
                if used:
                    found[f"{path.relative_to(ROOT)}:{node.name}"] = used
    assert found == {}
    assert count > 20


@pytest.mark.skipif(not COMPILER, reason="numba (the extra `fast`) is not installed")
@pytest.mark.parametrize(
    "error", [RuntimeError("no locator"), EOFError(), OSError("disk full")]
)
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
    options = {
        "cwd": ROOT,
        "env": {"NUMBA_DISABLE_JIT": "1"},
        "text": True,
        "check": True,
    }
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, **options
    )
    assert done.stdout == "plain\n"


@pytest.mark.skipif(not COMPILER, reason="numba (the extra `fast`) is not installed")
def test_every_compiled_function_is_compiled_once_before_the_first_sample():
    modules = [
        sys.modules[name] for name in sorted(sys.modules) if name.startswith(PACKAGES)
    ]
    found = {
        f"{function.__module__}.{function.__name__}": function
        for module in modules
        for function in vars(module).values()
        if hasattr(function, "py_func")
    }
    before = {name: len(function.signatures) for name, function in found.items()}
    assert len(found) > 20
    assert set(before.values()) == {1}
    chain_numbers(10, 300)
    assert {
        name: len(function.signatures) for name, function in found.items()
    } == before


def chain_numbers(joint_rows, needle_rows):
    """What a sensor with both kinds of velocity and both identifiers make of made-up
    signals."""
    rng = np.random.default_rng(0)
    robot = load_lwr(payload=NeedleTool())
    found = []
    times = 1e-3 * np.arange(joint_rows)[:, None]
    q = 0.3 + 0.05 * np.cos(times * np.arange(1, 8))
    dq = -0.05 * np.arange(1, 8) * np.sin(times * np.arange(1, 8))
    tau = 2.0 + np.sin(times) + 0.01 * rng.normal(size=q.shape)
    for has_velocity in (True, False):
        session = InsertionSession(robot)
        for k in range(joint_rows):
            if k == 1000:
                session.tare(ignore_contact=True)
            estimate = session.update(
                q[k], dq[k] if has_velocity else None, tau[k], 1e-3
            )
            wrench = estimate.wrench
            found.append([wrench.axial, wrench.axial_std, estimate.speed_m_s])
    depth_m = 2e-5 * np.arange(needle_rows) - 2e-3
    force_N = np.where(depth_m < 0.01, 60.0, 20.0) * np.maximum(depth_m, 0.0)
    force_N += 0.005 * rng.normal(size=needle_rows)
    force_N[100] = np.nan
    depth_m[200:] += 0.05
    for config in (MULTILAYER, PUBLISHED):
        made = replay(0.01 * np.arange(needle_rows), depth_m, force_N, config=config)
        found += [
            [e.tip_force_N, e.enhanced_force_N, e.predicted_force_N]
            for e in made.estimates
        ]
    return np.array(found)


@pytest.mark.skipif(not COMPILER, reason="numba (the extra `fast`) is not installed")
def test_the_chain_gives_the_same_numbers_without_the_compiler(tmp_path):
    script = f"from tests.needleforce import test_jit; test_jit.np.save({str(tmp_path / 'a')!r}, test_jit.chain_numbers"
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": str(ROOT),
    }
    command = [sys.executable, "-c", f"{script}(1100, 900))"]
    subprocess.run(command, env=environment, check=True)
    plain = np.load(tmp_path / "a.npy")
    compiled_ = chain_numbers(1100, 900)
    assert np.isfinite(plain).all()
    np.testing.assert_allclose(compiled_, plain, rtol=1e-6, atol=1e-9)
