"""The pages on the commands say what they do: their commands run, their tables are
the code's."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from groundtruth import insert_needle
from needleforce.cli import main
from needleforce.recordings import read_table, write_table
from residual import SensorWarning
from tests.needleforce.cli.residual_command_log import SMALL_ARM, write_insertion
from urdf import MissingPackageError, example_robot_path, load_urdf

pytestmark = pytest.mark.slow


ROOT = Path(__file__).parents[3]
FILES_PAGE = (ROOT / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
TASKS = ("force", "tare", "tool-and-payload", "noise-and-rate", "your-robot")
FORCE = "\n".join(
    (ROOT / "docs" / "how-to" / f"{name}.md").read_text(encoding="utf-8")
    for name in TASKS
)
FORCE = re.sub(r"(:\+?)13\b", r"\g<1>2.5", FORCE)  # the log of these tests lasts 4 s
FILES = dict(
    re.findall(r"^```toml\n# (\S+)\n(.*?)^```$", FORCE, re.DOTALL | re.MULTILINE)
)
COMMANDS = re.findall(r"^needleforce ((?:force|report) .*)$", FORCE, re.MULTILINE)


@pytest.fixture(scope="module")
def folder(lwr, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    for name, content in FILES.items():
        (folder / name).write_text(content, encoding="utf-8")
    (folder / "arm.urdf").write_text(SMALL_ARM)
    arm = load_urdf(folder / "arm.urdf", tool_frame="tip", locked_joints=["gripper"])
    write_insertion(folder / "arm.npz", arm)
    write_insertion(folder / "insertion.csv", lwr)
    write_insertion(folder / "panda.npz", lwr)
    write_insertion(
        folder / "own_estimate.npz", lwr, only=("t_s", "q_rad", "tau_ext_Nm")
    )
    return folder


@pytest.fixture(autouse=True)
def _in_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_runs(command, capsys):
    if "--figure" in command or "report" in command:
        pytest.importorskip("matplotlib")
    if "--robot panda" in command:
        try:
            example_robot_path("panda")
        except MissingPackageError as error:
            pytest.skip(str(error))

    assert main(shlex.split(command)) == 0

    # Of a report: forces from before the tare are not used for the layers.
    said = capsys.readouterr().err.splitlines()
    if "--payload payload.toml" in command:  # of which the arm of the log has none
        assert said.pop().startswith("warning: torque: ")

    assert [line for line in said if not command.startswith("report")] == []
    assert all("--ignore-status takes them" in line for line in said)


def test_pipe_of_the_page_runs():
    (line,) = re.findall(r"^cat .*$", FORCE, re.MULTILINE)
    line = line.replace(
        "needleforce ", f"{shlex.quote(sys.executable)} -m needleforce "
    )
    where = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.run(
        line, shell=True, capture_output=True, text=True, check=False, env=where
    )

    assert process.returncode == 0, process.stderr
    assert len(read_table("layers.csv").columns["t_s"]) == 4000


def test_identification_page_runs_and_names_its_columns(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = insert_needle("gel-50-constant", seed=1, rate_hz=150.0)
    columns = {"t_s": run.t_s, "depth_m": run.depth_m, "force_N": run.force_N}
    write_table("forces.csv", columns)
    (line,) = re.findall(r"^needleforce (identify .*)$", FILES_PAGE, re.MULTILINE)

    assert main(shlex.split(line)) == 0
    assert "friction N" in capsys.readouterr().out
    assert read_table("estimates.csv").columns


def test_the_page_lists_every_warning_with_its_number():
    (listed,) = re.findall(r"sum of the warnings: (.*?) \|", FILES_PAGE)

    assert listed.split(", ") == [f"{one.value} {one}" for one in SensorWarning]
