"""`needleforce doctor`: what is installed and what the machine offers, for a report."""

import json
import os
import platform
import re
import subprocess
import sys
from importlib import metadata

import pytest

from foundation.extras import EXTRAS, install_command
from needleforce.cli import checkup, main
from needleforce.cli.checkup import (
    describe,
    examine,
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
    for label in ("compiler", "cores", "real time"):
        assert f"\n{label} " in said
    for extra, adds in EXTRAS.items():
        assert f"  {extra} " in said
        assert adds in said
    assert "sizes on disk" not in said
    assert said.splitlines()[-1].startswith("verdict: ")


def test_json_holds_the_same(capsys):
    said = json.loads(report(capsys, "--json"))

    assert said["version"] == metadata.version("needleforce")
    assert said["core"]["numba"] == metadata.version("numba")
    assert [extra["name"] for extra in said["extras"]] == list(EXTRAS)
    assert said["cores"] == len(os.sched_getaffinity(0))
    assert said["sizes"] == []


def test_the_core_is_what_the_project_always_requires():
    assert set(examine(with_sizes=False)["core"]) == {
        "pandas",
        "pin",
        "numpy",
        "scipy",
        "numba",
        "msgspec",
        "cyclopts",
    }


def test_a_missing_package_of_an_extra_is_named_with_the_command(monkeypatch, capsys):
    known = checkup.version_of
    monkeypatch.setattr(
        checkup,
        "version_of",
        lambda name: None if name == "mujoco" else known(name),
    )
    states = {one["name"]: one for one in examine(with_sizes=False)["extras"]}

    assert not states["demo"]["is_installed"]
    assert states["demo"]["missing"] == ["mujoco"]
    assert states["recordings"]["is_installed"]

    line = next(
        line for line in report(capsys).splitlines() if line.startswith("  demo ")
    )

    assert "not installed" in line
    assert install_command("demo") in line
    assert "(missing: mujoco)" in line


def test_what_no_extra_can_install_is_named_without_a_command(monkeypatch, capsys):
    monkeypatch.setattr(checkup, "find_spec", lambda name: None)
    states = {one["name"]: one for one in examine(with_sizes=False)["extras"]}

    assert not states["ros2"]["is_installed"]
    assert states["ros2"]["missing"] == ["rclpy"]

    line = next(
        line for line in report(capsys).splitlines() if line.startswith("  ros2 ")
    )

    assert "not installed" in line
    assert "pip install" not in line


def test_an_extra_counts_what_it_contains():
    states = {extra: checkup._own_packages(extra) for extra in EXTRAS}

    assert states["patient"] < states["scene"]
    assert "simpleitk" in states["patient"]


@pytest.mark.slow
def test_sizes_are_those_of_files_and_an_extra_adds_to_the_core():
    sizes = {size["name"]: size for size in installed_sizes()}

    assert list(sizes) == ["core", *EXTRAS]

    numpy_bytes = sum(
        path.locate().stat().st_size
        for path in metadata.files("numpy")
        if path.locate().is_file()
    )

    assert sizes["core"]["bytes"] > numpy_bytes > 1e6
    assert sizes["demo"]["packages"] >= 3
    assert sizes["scene"]["bytes"] > sizes["patient"]["bytes"]
    assert sizes["core"]["missing"] == []


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
    monkeypatch.setattr(sys, "platform", "linux")
    names = [(item.name, item.extras, item.of_extra) for item in requirements_of("x")]

    assert names == [
        ("here", (), "devices"),
        ("always-needed", ("one", "two"), ""),
    ]


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        ({"is_writable": False}, "NUMBA_CACHE_DIR"),
        ({"compiler": ""}, "NUMBA_DISABLE_JIT"),
        ({}, "verdict: ready"),
    ],
)
def test_the_verdict_names_what_is_in_the_way(change, doubt):
    found = examine(with_sizes=False)
    found["cache"] |= change
    found["doubts"] = list(checkup._find_doubts(found))

    assert doubt in describe(found).splitlines()[-1]


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

    assert not list((tmp_path / "cache").rglob("*.nb?"))
    assert done.stderr == ""
