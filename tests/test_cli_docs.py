"""The page on the command says what it does: its commands run, its tables are the code's."""

import re
import shlex
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from residual_command_log import SMALL_ARM, write_insertion

from needleforce.cli.force import main
from needleforce.cli.force_replay import AUTOMATIC_S, STATUS_CODES
from recordings import read_table
from recordings.command.row_overview import MOST_ROWS
from recordings.command.run_command import FAILED, INTERRUPTED, READER_GONE
from residual import SensorConfig, SensorWarning
from urdf import load_urdf

TEXT = (Path(__file__).parents[1] / "docs" / "residual.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```toml\n# (\S+)\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE))
COMMANDS = re.findall(r"^python -m residual (.*)$", TEXT, re.MULTILINE)


@pytest.fixture(scope="module")
def folder(lwr, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    for name, content in FILES.items():
        (folder / name).write_text(content, encoding="utf-8")
    (folder / "arm.urdf").write_text(SMALL_ARM)
    arm = load_urdf(folder / "arm.urdf", tool_frame="tip", locked_joints=["gripper"])
    write_insertion(folder / "arm.npz", arm)
    write_insertion(folder / "insertion.csv", lwr)
    write_insertion(folder / "own_estimate.npz", lwr, only=("t_s", "q_rad", "tau_ext_Nm"))
    return folder


@pytest.fixture(autouse=True)
def _in_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_runs(command, capsys):
    if "--png" in command:
        pytest.importorskip("matplotlib")
    assert main(shlex.split(command)) == 0
    assert capsys.readouterr().err == ""


def test_the_page_uses_every_file_it_shows():
    assert len(COMMANDS) == 9
    assert set(FILES) == set(re.findall(r"\w+\.toml", " ".join(COMMANDS)))


def test_the_pipe_of_the_page_runs_to_its_end():
    (line,) = re.findall(r"^cat .*$", TEXT, re.MULTILINE)
    line = line.replace("python ", f"{shlex.quote(sys.executable)} ")
    done = subprocess.run(line, shell=True, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(read_table("layers.csv").columns["t_s"]) == 4000


def test_the_table_of_exit_codes_is_the_codes():
    codes = TEXT.split("## Exit codes")[1]
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", codes, re.MULTILINE)] == [
        *(0, FAILED, INTERRUPTED, READER_GONE)
    ]
    assert f"at most {MOST_ROWS // 1000} {MOST_ROWS % 1000:03d}" in TEXT


def test_the_summary_has_the_lines_that_the_page_shows(capsys):
    pytest.importorskip("matplotlib")
    main(shlex.split(COMMANDS[0]))
    shown = TEXT.split("```text\n")[1].split("```")[0].splitlines()
    printed = capsys.readouterr().out.splitlines()
    assert [line[:13] for line in printed] == [line[:13] for line in shown]
    exact = ("robot", "skipped", "gaps")
    chosen = [line for line in printed if line.startswith(exact)]
    assert chosen == [line for line in shown if line.startswith(exact)]


@pytest.mark.parametrize("mode", ["axial", "point", "full"])
def test_the_table_of_columns_is_the_codes(mode):
    main(["insertion.csv", "--mode", mode, "--no-tare", "-o", "table.csv"])
    table = TEXT.split("## The table of forces")[1].split("\n## ")[0]
    shown = []
    for cells, modes in re.findall(r"^\| (`.*?) \|.*\| (.*) \|$", table, re.MULTILINE):
        if modes.startswith("all") or f"`{mode}`" in modes:
            names = re.findall(r"`(.*?)`", cells)
            if "…" in cells:
                names = [names[0].replace("_x_", f"_{xyz}_") for xyz in "xyz"]
            shown += names
    assert shown == list(read_table("table.csv").columns)


def test_codes_and_numbers_in_the_text_are_the_codes():
    for status, code in STATUS_CODES.items():
        words = {"settling": "filters settle"}.get(status.value, status.value)
        assert f"{code} {words}" in TEXT
    for caution in SensorWarning:
        assert f"{caution.value} {caution.name.lower().replace('_', ' ')}" in TEXT
    assert f"the first {AUTOMATIC_S:g} s after the filters have settled" in TEXT
    known = {item.name for item in fields(SensorConfig)}
    settings = FILES["settings.toml"].split("[prior]")[0]
    assert set(re.findall(r"^(\w+) =", settings, re.MULTILINE)) <= known
