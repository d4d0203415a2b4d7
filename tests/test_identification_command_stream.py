"""`python -m identification` on pipes and growing files, and behind `python -m residual`."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from residual_command_log import write_insertion

import needleforce.cli.identify as command
from groundtruth import insert_needle
from identification.log_replay import ReplayStream
from needleforce.cli import identify as run_log
from recordings import read_table, write_table

COMMAND = [sys.executable, "-m", "identification"]


@pytest.fixture(scope="module", params=[True, False], ids=["speed", "no speed"])
def log(request, tmp_path_factory):
    run = insert_needle("gel-50-constant", seed=1, rate_hz=150.0)
    columns = {"t_s": run.t_s, "depth_m": run.depth_m, "force_N": run.force_N}
    if request.param:
        columns["speed_m_s"] = run.speed_m_s
    path = tmp_path_factory.mktemp("log") / "log.csv"
    write_table(path, columns)
    return path


@pytest.fixture(scope="module")
def expected(log):
    path = log.with_name("expected.csv")
    assert command.main([str(log), "-o", str(path)]) == 0
    return path.read_bytes()


def test_a_pipe_in_and_out_gives_the_bytes_of_the_file(log, expected):
    argv = [*COMMAND, "-", "-o", "-"]
    done = subprocess.run(argv, input=log.read_bytes(), capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (0, expected)
    assert b"friction N" in done.stderr


def test_every_row_of_the_log_has_its_row_in_the_table(log, expected, tmp_path):
    path = tmp_path / "expected.csv"
    path.write_bytes(expected)
    np.testing.assert_array_equal(read_table(path).columns["t_s"], read_table(log).columns["t_s"])


def test_following_ends_by_itself_when_nothing_comes(log, expected, tmp_path, capsys):
    out = tmp_path / "out.csv"
    assert command.main([str(log), "--follow", "--idle", "0.3", "-o", str(out)]) == 0
    assert out.read_bytes() == expected
    assert "friction N" in capsys.readouterr().out


def test_ctrl_c_keeps_what_was_done_and_prints_the_layers(log, tmp_path, monkeypatch, capsys):
    run = ReplayStream.run

    def run_and_interrupt(self, *columns):
        os.kill(os.getpid(), signal.SIGINT)
        return run(self, *columns)

    monkeypatch.setattr(run_log.ReplayStream, "run", run_and_interrupt)
    out = tmp_path / "out.csv"
    assert command.main([str(log), "-o", str(out)]) == 130
    printed = capsys.readouterr()
    assert "interrupted: the results are those of the rows read so far" in printed.err
    assert "layer" in printed.out
    rows = len(read_table(out).columns["t_s"])
    assert 0 < rows < len(read_table(log).columns["t_s"])


def test_both_commands_work_in_one_pipe(lwr, tmp_path):
    log = write_insertion(tmp_path / "log.csv", lwr)
    forces = subprocess.run(
        [sys.executable, "-m", "residual", "-", "--tare", "0:2.5", "-o", "-"],
        input=log.read_bytes(),
        capture_output=True,
        check=True,
    ).stdout
    done = subprocess.run(
        [*COMMAND, "-", "-o", "-"], input=forces, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(b"\n") == forces.count(b"\n") == 4001


def test_a_reader_that_goes_away_ends_the_command_quietly(log):
    argv = [*COMMAND, str(log), "-o", "-"]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline().startswith(b"t_s,enhanced_force_N,")
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (141, b"")


@pytest.mark.parametrize(
    ("data", "message"), [(b"", b"it is empty"), (b"\x00\x01" * 99, b"it is not text")]
)
def test_standard_input_without_a_log_is_one_clear_line(data, message):
    done = subprocess.run([*COMMAND, "-"], input=data, capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (2, b"")
    (line,) = done.stderr.splitlines()
    assert line.startswith(b"error: standard input: ")
    assert message in line


def test_the_log_is_not_overwritten_and_a_folder_is_no_picture(log, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    before = log.read_bytes()
    assert command.main([str(log), "-o", str(log)]) == 2
    assert "it is the log itself" in capsys.readouterr().err
    assert log.read_bytes() == before
    assert command.main([str(log), "--png", str(tmp_path)]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_the_command_of_the_page_runs(log, tmp_path, monkeypatch, capsys):
    page = Path(__file__).parents[1] / "docs" / "identification.md"
    (line,) = re.findall(r"^python -m identification (.*)$", page.read_text("utf-8"), re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    Path("forces.csv").write_bytes(log.read_bytes())
    assert command.main(shlex.split(line)) == 0
    assert "friction N" in capsys.readouterr().out
    table = page.read_text("utf-8").split("| column | what |")[1].split("\n\n")[0]
    told = [
        name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])
    ]
    assert told == list(read_table("estimates.csv").columns)
