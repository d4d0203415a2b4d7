"""The page on bags says what the code does: its examples run, its tables are the code's."""

import re
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
from page_sessions import session_failures

from needleforce import recordings
from needleforce.cli import app
from needleforce.cli.options import RobotOptions
from needleforce.cli.robot import payload_from_options
from recordings.bags.layout import bag_layout
from needleforce.recordings.mapping import load_mapping
from needleforce.recordings.table import Labels

PAGE = Path(__file__).parents[1] / "docs" / "bags.md"
TEXT = PAGE.read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_the_sessions_give_what_the_page_shows():
    assert session_failures(PAGE) == ""


def test_the_command_lines_are_those_of_the_commands():
    lines = re.findall(r"^needleforce (\w+) (.*?)(?: > \S+)?$", TEXT, re.MULTILINE)
    assert {name for name, _ in lines} == {"simulate", "force", "identify"}
    for name, arguments in lines:
        tokens = [name, *shlex.split(arguments)]
        assert app.parse_args(tokens, exit_on_error=False, print_error=False)


def test_the_payload_of_the_page_is_one():
    (lines,) = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    Path("payload.toml").write_text(lines, encoding="utf-8")
    assert load_mapping("payload.toml").payload == tomllib.loads(lines)["payload"]
    assert payload_from_options(RobotOptions(), "payload.toml").mass_kg == 0.9


def test_the_table_of_topics_is_the_codes():
    rows = np.zeros(1)
    columns = {
        "t_s": rows,
        **dict.fromkeys(("q_rad", "dq_rad_s", "tau_Nm"), np.zeros((1, 7))),
        **dict.fromkeys(("ft_force_N", "ft_torque_Nm"), np.zeros((1, 3))),
        **{f"force_{xyz}_in_base_N": rows for xyz in "xyz"},
        **{f"torque_{xyz}_in_base_Nm": rows for xyz in "xyz"},
        "axial_N": rows,
    }
    table = TEXT.split("## What is written")[1].split("## When")[0]
    for topic in bag_layout(columns, Labels()):
        (row,) = [line for line in table.splitlines() if f"| `{topic.name}`" in line]
        assert f"`{topic.kind.replace('/msg', '')}`" in row
    for kind in re.findall(r"`(\w+_msgs/\w+)`", TEXT):
        package, name = kind.split("/")
        assert f"{package}/msg/{name}" in recordings.bags.message_types.standard_types().types


def test_every_error_named_is_the_codes():
    for name in set(re.findall(r"`(\w+Error)`", TEXT)):
        assert issubclass(getattr(recordings, name), recordings.RecordingError)
