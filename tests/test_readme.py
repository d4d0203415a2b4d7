"""The README does what it says: examples run, commands exist, tables come from a run."""

import ast
import io
import re
import shlex
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from residual_command_log import write_insertion

from benchmarks.cli import app
from benchmarks.results_page import BEGIN, END, fill
from groundtruth import SCENARIOS
from identification import MULTILAYER as IDENTIFIER
from needleforce.cli import app as commands_app
from needleforce.cli import main as command_main
from residual.config import DEFAULT
from residual.velocity_estimator import VelocityEstimator

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
SHELL = re.findall(r"^```sh\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
COMMANDS = [line for block in SHELL for line in block.splitlines()]


def run_example(code):
    """Names and printed text of an example."""
    names, said = {}, io.StringIO()
    with redirect_stdout(said):
        exec(compile(code, "README.md", "exec"), names)
    return names, said.getvalue()


def marked_command(name):
    """The block that `.ci/run` takes from under a mark."""
    found = re.findall(
        rf"^<!-- command: {name} -->\n```sh\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE
    )
    assert len(found) == 1
    return found[0].strip()


def test_the_sensor_example_reads_the_force():
    names, said = run_example(EXAMPLES[0])
    run = names["run"]
    felt = (run.signals.t_s > run.contact_s) & (run.signals.t_s < run.withdrawn_s)
    error = (np.array(names["forces"]) - run.truth.axial_N)[felt]
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert max(names["forces"]) > 0.5
    assert names["wrench"].status.value == "ok"
    assert re.fullmatch(r"at most \d\.\d\d N, now -?\d\.\d{3} ± \d\.\d{3} N\n", said)


def test_the_sensor_example_has_twelve_lines():
    assert len(EXAMPLES[0].splitlines()) <= 13
    assert len([line for line in EXAMPLES[0].splitlines() if line]) <= 12


def test_the_identification_example_finds_the_layers():
    names, said = run_example(EXAMPLES[1])
    layers = names["identifier"].layers
    truth = names["run"].scenario.layers
    assert [layer.layer for layer in layers] == [1, 2, 3]
    for found, true in zip(layers, truth, strict=True):
        assert found.thickness_m == pytest.approx(true.thickness_m, abs=1e-3)
    assert said.count("left layer") == 3


def test_the_first_screen_tells_what_and_for_whom():
    first = "\n".join(TEXT.splitlines()[:30])
    for word in ("virtual force/torque sensor", "control engineers", "researchers", "pip install"):
        assert word in first
    assert ast.parse(EXAMPLES[0])


def test_the_two_commands_install_and_run():
    assert marked_command("run").startswith('pip install -e ".[bench]" && python -m benchmarks run')
    assert marked_command("test") == 'pip install -e ".[test]" && python -m pytest'


def benchmark_commands():
    found = re.findall(r"python -m benchmarks (\w.*)", "\n".join(COMMANDS))
    assert len(found) >= 5
    return found


@pytest.mark.parametrize("command", benchmark_commands())
def test_every_benchmark_command_is_understood(command):
    chosen, _, _ = app.parse_args(shlex.split(command), exit_on_error=False, print_error=False)
    assert chosen.__name__.rstrip("_") == command.split()[0]


def test_the_commands_for_recordings_run_one_after_the_other(lwr, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (made,) = [c for c in COMMANDS if c.startswith("python -m groundtruth")]
    tokens = ["simulate", *shlex.split(made)[3:]]
    _, asked, _ = commands_app.parse_args(tokens, exit_on_error=False, print_error=False)
    assert asked.args[0] in SCENARIOS
    write_insertion(asked.kwargs["options"].output, lwr, seconds=15.0, contact_s=14.0)
    commands = [c for c in COMMANDS if c.startswith(("python -m residual", "python -m identif"))]
    assert len(commands) == 2
    for command, name in zip(commands, ("force", "identify"), strict=True):
        assert command_main([name, *shlex.split(command)[3:]]) == 0, capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} >= {"forces.csv", "forces.png", "layers.png"}


def test_the_lags_it_states_are_those_delivered():
    assert f"late by 1/K, {1e3 / DEFAULT.gain_per_s:.0f} ms as delivered" in TEXT
    delay_s = VelocityEstimator(7, DEFAULT.velocity_bandwidth_per_s).delay_s
    assert f"by {1e3 * delay_s:.0f} ms more" in TEXT


def test_every_link_leads_to_a_file():
    targets = re.findall(r"\]\(([^)#:]+)\)", TEXT)
    assert targets
    for target in targets:
        assert (ROOT / target).is_file(), target


def test_where_to_find_what_is_told():
    table = TEXT.split("| Where is … |")[1].split("\n\n")[0]
    for word, file in (
        ("NaN", "residual/input_validation.py"),
        ("false_alarm_interval_s", "identification/config.py"),
        ("(12)", "identification/published_identifier.py"),
        ("robot of one's own", "docs/force.md#the-robot"),
        ("ROS 2 bag", "docs/bags.md"),
    ):
        (row,) = [line for line in table.splitlines() if word in line]
        assert file in row
    assert hasattr(IDENTIFIER, "false_alarm_interval_s")
    assert "(12)" in (ROOT / "identification" / "reweighting.py").read_text(encoding="utf-8")


def test_every_room_and_every_command_is_told():
    rooms = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    table = TEXT.split("| room | job | imports |")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == rooms
    (commands,) = [line for line in TEXT.splitlines() if line.startswith("| `python -m benchmarks")]
    for name in (name for name in app if not name.startswith("-")):
        assert re.search(rf"[ `]{name}`", commands), name


def test_its_results_stand_between_their_marks():
    block = TEXT.partition(BEGIN)[2].partition(END)[0].strip()
    assert fill(TEXT, f"{block}\n") == TEXT
