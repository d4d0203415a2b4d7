"""`needleforce doctor`: what is installed and what the machine offers, for a report."""

import json
import os
import platform
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

from foundation import jit
from foundation.extras import EXTRA_OF_MODULE, EXTRAS, install_command
from needleforce.cli import checkup, main


def report(capsys, *options):
    assert main(["doctor", *options]) == 0
    return capsys.readouterr().out


def test_text_and_json_name_versions_machine_and_every_extra(capsys):
    found = json.loads(report(capsys, "--json"))
    lines = report(capsys).splitlines()

    assert [line.split()[0] for line in lines] == list(found)
    assert all(text in said for text, said in zip(found.values(), lines, strict=True))
    assert platform.python_version() in found["python"]
    assert f"numba {metadata.version('numba')}" in found["packages"]
    assert all(adds in found[extra] for extra, adds in EXTRAS.items())
    assert list(found)[-1] == "verdict"


def test_the_core_is_what_the_project_always_requires():
    project = Path(__file__).parents[3] / "pyproject.toml"
    required = tomllib.loads(project.read_text())["project"]["dependencies"]
    names = {re.match(r"[\w-]+", line)[0] for line in required}

    assert set(checkup.CORE) == names


@pytest.mark.parametrize("module", [*EXTRA_OF_MODULE, "rclpy"])
def test_a_missing_module_of_an_extra_is_named_with_the_command(
    monkeypatch, capsys, module
):
    monkeypatch.setattr(
        checkup, "find_spec", lambda name: None if name == module else name
    )
    monkeypatch.setattr(checkup, "_version_of", lambda name: "")
    found = json.loads(report(capsys, "--json"))
    extra = EXTRA_OF_MODULE.get(module, "ros2")
    texts = {name: found[name] for name in EXTRAS}

    assert [name for name in texts if "not installed" in texts[name]] == [extra]
    assert module in found[extra]
    # No package index has a ROS.
    assert (install_command(extra) in found[extra]) is (extra != "ros2")


@pytest.mark.parametrize(
    ("name", "value", "doubt"),
    [
        (
            "dispatchers",
            [SimpleNamespace(stats=SimpleNamespace(cache_path=None))],
            "NUMBA_CACHE_DIR",
        ),
        ("COMPILER", "", "NUMBA_DISABLE_JIT"),
    ],
)
def test_the_verdict_names_what_is_in_the_way(monkeypatch, capsys, name, value, doubt):
    monkeypatch.setattr(jit, name, value)

    assert doubt in report(capsys).splitlines()[-1]


@pytest.mark.slow
def test_nothing_is_compiled_or_written(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "needleforce", "doctor"],
        capture_output=True,
        text=True,
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        check=True,
    )

    assert done.stdout.splitlines()[-1].split() == ["verdict", "ready"]
    assert not list((tmp_path / "cache").rglob("*.nb?"))
    assert done.stderr == ""
