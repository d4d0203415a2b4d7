"""What is compiled: the same numbers without the compiler, and safe to keep on disk."""

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from foundation import jit
from foundation.arrays import Vector
from foundation.jit import COMPILER, compiled, compiled_inside
from identification import MIXTURE, PUBLISHED, replay
from needleforce import InsertionSession
from urdf import NeedleTool, load_lwr

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("foundation", "residual", "identification", "needleforce")


needs_compiler = pytest.mark.skipif(not COMPILER, reason="NUMBA_DISABLE_JIT is set")


class Spring(NamedTuple):
    """Arguments that travel together."""

    stiffness: float
    rest_lengths: Vector


@needs_compiler
def test_named_tuples_are_read_by_name_when_compiled():
    @compiled
    def energy(spring: Spring, length: float) -> float:
        return 0.5 * spring.stiffness * (length - spring.rest_lengths[0]) ** 2

    jit.compile_waiting()

    assert len(energy.signatures) == 1

    springs = Spring(4.0, np.ones(1)), Spring(4, np.frombuffer(np.ones(1).tobytes()))

    assert [energy(spring, 3.0) for spring in springs] == [8.0, 8.0]
    assert len(energy.signatures) == 1


@compiled_inside
def triple_it(x: float) -> float:
    """A function that only compiled functions call."""
    return 3.0 * x


@needs_compiler
def test_first_call_refuses_what_does_not_convert():
    triple = compiled(triple_it)
    with pytest.raises(TypeError, match="takes float64"):
        triple(np.zeros(3))


@needs_compiler
def test_open_type_is_refused_when_decorated():
    with pytest.raises(TypeError, match="the type of x of"):
        compiled(lambda x: x)


@needs_compiler
def test_function_inside_others_stays_plain_for_python():
    @compiled
    def six_times(x: float) -> float:
        return 2.0 * triple_it(x)

    assert (six_times(1.0), triple_it(1.0)) == (6.0, 3.0)
    assert not hasattr(triple_it, "py_func")


def test_functions_stay_plain_where_compiling_is_disabled():
    script = (
        "from foundation.jit import COMPILER, compiled\n"
        "plain = lambda x: x\n"
        "assert COMPILER == '' and compiled(plain) is plain\n"
        "print('plain')"
    )
    done = subprocess.check_output(
        [sys.executable, "-c", script], cwd=ROOT, env={"NUMBA_DISABLE_JIT": "1"}
    )

    assert done == b"plain\n"


@needs_compiler
def test_every_compiled_function_is_compiled_once_before_the_first_sample():
    found = {
        f"{function.__module__}.{function.__name__}": function
        for name in sorted(sys.modules)
        if name.startswith(PACKAGES)
        for function in vars(sys.modules[name]).values()
        if hasattr(function, "py_func")
    }
    jit.compile_waiting()
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
    dt_s = 4e-3
    times = dt_s * np.arange(joint_rows)[:, None]
    q = 0.3 + 0.05 * np.cos(times * np.arange(1, 8))
    dq = -0.05 * np.arange(1, 8) * np.sin(times * np.arange(1, 8))
    tau = 2.0 + np.sin(times) + 0.01 * rng.normal(size=q.shape)
    for velocities in (dq, [None] * joint_rows):
        session = InsertionSession(robot)
        for k in range(joint_rows):
            if k == 250:
                session.tare(ignore_contact=True)
            estimate = session.update(q[k], velocities[k], tau[k], dt_s)
            wrench = estimate.wrench
            found.append([wrench.axial, wrench.axial_std, estimate.speed_m_s])
    depth_m = 2e-5 * np.arange(needle_rows) - 2e-3
    force_N = np.where(depth_m < 0.01, 60.0, 20.0) * np.maximum(depth_m, 0.0)
    force_N += 0.005 * rng.normal(size=needle_rows)
    force_N[100] = np.nan
    depth_m[200:] += 0.05
    for config in (MIXTURE, PUBLISHED):
        made = replay(0.01 * np.arange(needle_rows), depth_m, force_N, config=config)
        found += [
            [e.tip_force_N, e.enhanced_force_N, e.predicted_force_N]
            for e in made.estimates
        ]
    return np.array(found)


@pytest.mark.slow
@needs_compiler
def test_the_chain_gives_the_same_numbers_without_the_compiler(tmp_path):
    script = (
        "import sys, numpy; from tests.foundation.test_jit import chain_numbers; "
        "numpy.save(sys.argv[1], chain_numbers(300, 300))"
    )
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", script, str(tmp_path / "a.npy")]
    subprocess.run(command, env=environment, check=True)
    plain = np.load(tmp_path / "a.npy")

    assert np.isfinite(plain).all()
    np.testing.assert_allclose(chain_numbers(300, 300), plain, rtol=1e-6, atol=1e-9)
