"""What is compiled: the same numbers without the compiler, and safe to keep on disk."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from foundation import compile_cache, first_use, jit
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

    read_only = np.ones(1)
    read_only.setflags(write=False)

    assert energy(Spring(4.0, np.ones(1)), 3.0) == 8.0
    assert energy(Spring(4, read_only), 3.0) == 8.0
    assert len(energy.signatures) == 1


BASE = "def base(x: float) -> float:\n    'Says it.'\n    return WIDTH * x"


def hash_of_user(base="", user="base(x)", other="0.0", width="1.0"):
    """The hash of a function that calls `base`, which uses a constant; not `other`."""
    names = {}
    text = f"""
WIDTH = {width}

{base or BASE}

def other(x: float) -> float:
    return {other}

def user(x: float) -> float:
    return {user}
"""
    exec(text, names | {"__name__": "made_up"}, names)
    for name in ("base", "other", "user"):
        names[name].__globals__.update(names)
    return compile_cache.hash_function(names["user"])


@pytest.mark.parametrize(
    "change",
    [
        {"user": "2.0 * base(x)"},
        {"base": BASE.replace("*", "+")},
        {"base": BASE.replace("x", "y")},
        {"base": BASE.replace("x: float", "x: int")},
        {"width": "30.0"},
        {"width": "(1.0, 2.0)"},
    ],
    ids=str,
)
def test_what_a_function_depends_on_compiles_it_anew(change):
    assert hash_of_user(**change) != hash_of_user()


@pytest.mark.parametrize(
    "change",
    [
        {"other": "1.0"},
        {"base": f"# why\n\n\n{BASE}  # how"},
        {"base": BASE.replace("Says it.", "Says much more than before.")},
    ],
    ids=str,
)
def test_a_comment_a_docstring_a_moved_line_or_another_function_keeps_it(change):
    assert hash_of_user(**change) == hash_of_user()


class Elastic(NamedTuple):
    """Stands for a type of arguments as it was."""

    stiffness: float


class Viscous(NamedTuple):
    """Stands for the same type with another field."""

    damping: float


def test_a_changed_type_of_arguments_compiles_anew():
    Viscous.__qualname__ = Elastic.__qualname__ = "Law"
    Viscous.__name__ = Elastic.__name__ = "Law"
    hashes = set()
    for law in (Elastic, Viscous):
        names = {"Law": law, "__name__": "made_up"}
        exec("def user(law: Law) -> float:\n    return law[0]", names)
        hashes.add(compile_cache.hash_function(names["user"]))

    assert len(hashes) == 2


@needs_compiler
def test_a_hash_is_the_same_in_every_process():
    """Also where the site is built, with its own short types of arrays."""
    of_site = "import array_types; array_types.shorten(); "
    script = (
        "import identification.identifier; from foundation import jit; "
        "print(sorted(e.cache.file_name for e in jit.entries))"
    )
    path = os.pathsep.join([str(ROOT), str(ROOT / "docs" / "extensions")])
    runs = [
        subprocess.run(
            [sys.executable, "-c", before + script],
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": path, "PYTHONHASHSEED": seed},
        ).stdout
        for seed, before in (("1", ""), ("2", of_site))
    ]

    assert runs[0] == runs[1]
    assert "identification" in runs[0]


@needs_compiler
def test_only_the_newest_versions_stay(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_cache, "cache_roots", lambda: [tmp_path])
    name = f"{__name__}.double_it"
    for k in range(8):
        file = tmp_path / f"{name}-{k:016x}.compiled"
        file.touch()
        os.utime(file, (k, k))
    (tmp_path / f"{name}_too-0000000000000000.compiled").touch()
    double = compiled(double_it)
    double(2.0)
    kept = {path.name for path in tmp_path.iterdir()}

    assert len(kept) == 5
    assert f"{name}-0000000000000007.compiled" in kept
    assert f"{name}_too-0000000000000000.compiled" in kept


def double_it(x: float) -> float:
    """A function to compile."""
    return 2.0 * x


@needs_compiler
def test_where_nothing_can_be_kept_it_compiles_all_the_same(monkeypatch):
    monkeypatch.setattr(compile_cache, "cache_roots", lambda: [])
    double = compiled(double_it)

    assert double(2) == 4.0


@needs_compiler
@pytest.mark.parametrize("error", [OSError("disk full"), PermissionError("not yours")])
def test_what_cannot_be_written_is_compiled_all_the_same(monkeypatch, tmp_path, error):
    monkeypatch.setattr(compile_cache, "cache_roots", lambda: [tmp_path])

    def refuse(self, data):
        raise error

    monkeypatch.setattr(Path, "write_bytes", refuse)

    assert compiled(double_it)(2.0) == 4.0


@needs_compiler
def test_a_file_that_was_cut_off_is_compiled_again(monkeypatch, tmp_path):
    monkeypatch.setattr(compile_cache, "cache_roots", lambda: [tmp_path])

    assert compiled(double_it)(2.0) == 4.0

    [kept] = tmp_path.iterdir()
    whole = kept.read_bytes()
    kept.write_bytes(whole[:40])

    assert compiled(double_it)(2.0) == 4.0
    assert len(kept.read_bytes()) > 1000


@needs_compiler
def test_warm_folder_is_used_where_it_cannot_be_written(monkeypatch, tmp_path):
    warm = tmp_path / "warm"
    monkeypatch.setattr(compile_cache, "cache_roots", lambda: [warm, tmp_path / "own"])
    compiled(double_it)(2.0)
    monkeypatch.setattr(compile_cache, "writable_root", lambda: tmp_path / "own")
    double = compiled(double_it)

    assert double(2.0) == 4.0
    assert double.stats.cache_hits
    assert not (tmp_path / "own").exists()


@needs_compiler
def test_first_call_refuses_what_does_not_convert(monkeypatch):
    monkeypatch.setattr(compile_cache, "cache_roots", lambda: [])
    double = compiled(double_it)
    with pytest.raises(TypeError, match="takes float64"):
        double(np.zeros(3))


@needs_compiler
def test_open_type_is_refused_when_decorated():
    with pytest.raises(TypeError, match="the type of x of"):
        compiled(lambda x: x)


@compiled_inside
def triple_it(x: float) -> float:
    """A function that only compiled functions call."""
    return 3.0 * x


@needs_compiler
def test_function_inside_others_stays_plain_for_python(monkeypatch):
    monkeypatch.setattr(compile_cache, "cache_roots", lambda: [])

    @compiled
    def six_times(x: float) -> float:
        return 2.0 * triple_it(x)

    assert six_times(1.0) == 6.0
    assert triple_it(1.0) == 3.0
    assert not hasattr(triple_it, "py_func")


FUNCTIONS = 12
"""In each of two modules: enough that a second process compiles one of them."""

MODULE = "from foundation.jit import compiled\n" + "".join(
    f"\n@compiled\ndef times_{k}(x: float) -> float:\n    return {k}.0 * x\n"
    for k in range(FUNCTIONS)
)

FIRST_USE = (
    "import first, second; from foundation.jit import compile_waiting; "
    "compile_waiting(); print(first.times_3(2.0), second.times_5(2.0))"
)


def start(folder):
    """Start an interpreter that uses the modules of a folder, and keeps them there."""
    environment = {
        "NUMBA_CACHE_DIR": str(folder / "kept"),
        "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)]),
    }
    return subprocess.Popen(
        [sys.executable, "-c", FIRST_USE],
        cwd=folder,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
@needs_compiler
def test_two_first_uses_at_once_share_a_folder_and_say_so_once_each(tmp_path):
    for name in ("first", "second"):
        (tmp_path / f"{name}.py").write_text(MODULE)
    outputs = [run.communicate() for run in [start(tmp_path), start(tmp_path)]]

    for printed, said in outputs:
        assert printed == "6.0 10.0\n"
        # Beside the first line, one every ten seconds where the machine is busy.
        assert said.splitlines()[0] == "needleforce: compiling once"

    printed, said = start(tmp_path).communicate()

    assert (printed, said) == ("6.0 10.0\n", "")
    kept = list((tmp_path / "kept").iterdir())
    assert len(kept) == 2 * FUNCTIONS


def test_modules_are_shared_out_by_size(tmp_path):
    made = []
    for name, size in (("a", 100), ("b", 60), ("c", 50), ("d", 5)):
        file = tmp_path / f"{name}.py"
        file.write_text("#" * size)
        made.append(SimpleNamespace(module=name, file=file))

    assert first_use.choose_modules(made) == {"b", "c"}


def test_functions_stay_plain_where_compiling_is_disabled():
    script = (
        "from foundation.jit import COMPILER, compiled\n"
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


@needs_compiler
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
    for has_velocity in (True, False):
        session = InsertionSession(robot)
        for k in range(joint_rows):
            if k == 250:
                session.tare(ignore_contact=True)
            estimate = session.update(
                q[k], dq[k] if has_velocity else None, tau[k], dt_s
            )
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
    path = str(tmp_path / "a")
    script = (
        "from tests.foundation import test_jit; "
        f"test_jit.np.save({path!r}, test_jit.chain_numbers"
    )
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": str(ROOT),
    }
    command = [sys.executable, "-c", f"{script}(300, 300))"]
    subprocess.run(command, env=environment, check=True)
    plain = np.load(tmp_path / "a.npy")
    compiled_ = chain_numbers(300, 300)

    assert np.isfinite(plain).all()
    np.testing.assert_allclose(compiled_, plain, rtol=1e-6, atol=1e-9)
