"""`needleforce doctor`: what is installed and what the machine offers, for a report."""

import json
import os
import platform
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from shutil import copy

import pytest

from foundation import compile_cache
from foundation.extras import EXTRAS, install_command
from foundation.jit import COMPILER
from needleforce.cli import main
from needleforce.cli.checkup import distributions, findings, machine
from needleforce.cli.checkup.compiler import (
    CompileCache,
    compile_everything,
    inspect_cache,
)
from needleforce.cli.checkup.distributions import (
    extra_states,
    installed_sizes,
    requirements_of,
)


def report(capsys, *options):
    assert main(["doctor", *options]) == 0
    return capsys.readouterr().out


def test_text_names_versions_cache_machine_and_every_extra(capsys):
    said = report(capsys)

    assert f"python       {platform.python_version()}" in said
    for name in ("pin", "numpy", "numba"):
        assert f"{name} {metadata.version(name)}" in said
    for label in ("compiler", "cache", "cores", "clock", "real time"):
        assert f"\n{label} " in said
    assert "GPU          not needed" in said
    for extra, adds in EXTRAS.items():
        assert f"  {extra} " in said
        assert adds in said
    assert "sizes on disk" not in said


def test_json_holds_the_same(capsys):
    said = json.loads(report(capsys, "--json"))

    assert said["version"] == metadata.version("needleforce")
    assert said["core"]["numba"] == metadata.version("numba")
    assert [extra["name"] for extra in said["extras"]] == list(EXTRAS)
    assert said["machine"]["cores"] == len(os.sched_getaffinity(0))
    assert said["machine"]["sleep_median_s"] >= machine.SLEEP_s
    assert said["sizes"] == []


def test_the_core_is_what_the_project_always_requires():
    assert set(distributions.core_versions()) == {
        "pin",
        "numpy",
        "scipy",
        "numba",
        "msgspec",
        "cyclopts",
    }


def test_a_missing_package_of_an_extra_is_named_with_the_command(monkeypatch, capsys):
    known = distributions.version_of
    monkeypatch.setattr(
        distributions,
        "version_of",
        lambda name: None if name == "mujoco" else known(name),
    )
    states = {state.name: state for state in extra_states()}

    assert not states["demo"].is_installed
    assert states["demo"].missing == ("mujoco",)
    assert states["recordings"].is_installed

    line = next(
        line for line in report(capsys).splitlines() if line.startswith("  demo ")
    )

    assert "not installed" in line
    assert install_command("demo") in line
    assert "(missing: mujoco)" in line


def test_what_no_extra_can_install_is_named_without_a_command(monkeypatch, capsys):
    monkeypatch.setattr(distributions, "find_spec", lambda name: None)
    states = {state.name: state for state in extra_states()}

    assert not states["ros2"].is_installed
    assert states["ros2"].missing == ("rclpy",)

    line = next(
        line for line in report(capsys).splitlines() if line.startswith("  ros2 ")
    )

    assert "not installed" in line
    assert "pip install" not in line


def test_an_extra_counts_what_it_contains():
    states = {
        state.name: distributions._own_packages(state.name) for state in extra_states()
    }

    assert states["patient"] < states["scene"]
    assert "simpleitk" in states["patient"]


@pytest.mark.slow
def test_sizes_are_those_of_files_and_an_extra_adds_to_the_core():
    sizes = {size.name: size for size in installed_sizes()}

    assert list(sizes) == ["core", *EXTRAS]

    numpy_bytes = sum(
        path.locate().stat().st_size
        for path in metadata.files("numpy")
        if path.locate().is_file()
    )

    assert sizes["core"].bytes > numpy_bytes > 1e6
    assert sizes["demo"].packages >= 3
    assert sizes["scene"].bytes > sizes["patient"].bytes
    assert sizes["core"].missing == ()


def test_every_package_is_listed_with_its_licence_and_what_brings_it(capsys):
    assert main(["doctor", "--licences"]) == 0

    table = capsys.readouterr().out

    assert re.search(r"^\| numpy \| [\d.]+ \| BSD.* \| core \|$", table, re.M)
    assert re.search(r"^\| msgspec \| [\d.]+ \| BSD.* \| core \|$", table, re.M)
    assert re.search(r"^\| llvmlite \| .* \| core \|$", table, re.M)
    assert re.search(r"^\| mcap \| .* \| `recordings` \|$", table, re.M)
    assert "| needleforce |" not in table


def test_requirements_of_other_platforms_are_left_out(monkeypatch):
    lines = [
        "here>=1; sys_platform == 'linux' and extra == 'devices'",
        "there>=1; sys_platform == 'plan9' and extra == 'devices'",
        "Always_Needed[one,two]>=2",
    ]
    monkeypatch.setattr(metadata, "requires", lambda name: lines)
    monkeypatch.setitem(distributions._HERE, "sys_platform", "linux")
    names = [(item.name, item.extras, item.of_extra) for item in requirements_of("x")]

    assert names == [
        ("here", (), "devices"),
        ("always-needed", ("one", "two"), ""),
    ]


@pytest.mark.skipif(not COMPILER, reason="NUMBA_DISABLE_JIT is set")
def test_cache_counts_the_functions_whose_code_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_cache, "cache_roots", lambda: [tmp_path])
    empty = inspect_cache()

    assert empty.functions > 70
    assert empty.kept_functions == 0
    assert not empty.is_warm
    assert empty.folder == str(tmp_path)
    assert empty.is_writable


def test_a_cache_that_cannot_be_written_names_the_variable():
    cache = CompileCache(
        compiler="numba 1",
        folder="/x",
        is_writable=False,
        functions=9,
        kept_functions=4,
    )
    text = findings._describe_cache(cache)

    assert text.startswith("/x, 4 of 9 functions compiled")
    assert "NUMBA_CACHE_DIR" in text


@pytest.mark.skipif(sys.platform != "linux", reason="SCHED_FIFO is Linux's")
def test_the_trial_of_a_priority_leaves_this_thread_as_it_was():
    before = os.sched_getscheduler(0)

    assert machine.inspect_machine().may_run_real_time in (True, False)
    assert os.sched_getscheduler(0) == before


@pytest.mark.slow
def test_compile_leaves_nothing_for_a_later_start(tmp_path):
    """All but the checks of the sensor is kept already: all takes a minute."""
    compile_everything()
    for kept in Path(inspect_cache().folder).glob("*.compiled"):
        if not kept.name.startswith("residual.checks."):
            copy(kept, tmp_path)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "needleforce", "doctor", "--compile", "--json"]
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, check=True
    )
    cache = json.loads(done.stdout)["cache"]

    assert "needleforce: compiling once\n" in done.stderr
    assert cache["kept_functions"] == cache["functions"] > 70
    assert cache["folder"] == str(tmp_path)
    assert list(tmp_path.glob("residual.checks.*"))


@pytest.mark.slow
def test_nothing_is_compiled_or_written(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-m", "needleforce", "doctor"],
        capture_output=True,
        text=True,
        env=environment,
        check=True,
    )

    assert f"{tmp_path / 'cache'}, 0 of " in done.stdout
    assert not (tmp_path / "cache").exists()
    assert done.stderr == ""
