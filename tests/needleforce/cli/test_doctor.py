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


def test_text_names_versions_cache_machine_and_every_extra(capsys):
    said = report(capsys)

    for text in (platform.python_version(), f"numba {metadata.version('numba')}"):
        assert text in said
    for extra, adds in EXTRAS.items():
        assert re.search(rf"^  {extra} .*{re.escape(adds)}", said, re.MULTILINE)
    assert said.splitlines()[-1].startswith("verdict: ")


def test_json_holds_the_same(capsys):
    said = json.loads(report(capsys, "--json"))

    assert said["version"] == metadata.version("needleforce")
    assert said["core"]["numba"] == metadata.version("numba")
    assert [extra["name"] for extra in said["extras"]] == list(EXTRAS)
    assert said["cores"] == len(os.sched_getaffinity(0))


def test_the_core_is_what_the_project_always_requires():
    project = Path(__file__).parents[3] / "pyproject.toml"
    required = tomllib.loads(project.read_text())["project"]["dependencies"]
    names = {re.match(r"[\w-]+", line)[0] for line in required}

    assert set(checkup.CORE) == names


@pytest.mark.parametrize("module", EXTRA_OF_MODULE)
def test_a_missing_module_of_an_extra_is_named_with_the_command(
    monkeypatch, capsys, module
):
    find_spec = checkup.find_spec
    monkeypatch.setattr(
        checkup, "find_spec", lambda name: None if name == module else find_spec(name)
    )
    monkeypatch.setattr(checkup, "_version_of", lambda name: "")
    extra = EXTRA_OF_MODULE[module]
    (line,) = re.findall(rf"^  {extra} .*$", report(capsys), re.MULTILINE)

    assert "not installed" in line
    assert install_command(extra) in line
    assert module in line


def test_what_no_extra_can_install_is_named_without_a_command(monkeypatch, capsys):
    monkeypatch.setattr(checkup, "find_spec", lambda name: None)
    (line,) = re.findall(r"^  ros2 .*$", report(capsys), re.MULTILINE)

    assert "not installed" in line
    assert "rclpy" in line
    assert "pip install" not in line


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

    assert done.stdout.splitlines()[-1] == "verdict: ready"
    assert not list((tmp_path / "cache").rglob("*.nb?"))
    assert done.stderr == ""
