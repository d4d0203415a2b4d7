"""What every command does with errors, signals, what it prints, mappings and help."""

import io
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.cli.terminal import (
    FAILED,
    INTERRUPTED,
    READER_GONE,
    CommandError,
    progress_bar,
    run_command,
    say,
    stop_request,
    write_out,
)
from needleforce.recordings import FileAccessError, load_mapping, read_log, write_table
from needleforce.recordings.table import TableLabels
from tests.needleforce.cli.residual_command_log import insertion


def failing(error):
    def work():
        raise error

    return work


@pytest.fixture(autouse=True)
def _open_output(monkeypatch):
    """What is done to standard output must not outlive the test."""
    monkeypatch.setattr("needleforce.cli.terminal._close_output", lambda: None)


@pytest.mark.parametrize(
    ("error", "code", "start"),
    [
        (CommandError("no such\noption"), FAILED, "error: no such option. "),
        (FileAccessError("no such\nfile"), FAILED, "error: no such file. "),
        (KeyboardInterrupt(), INTERRUPTED, "interrupted"),
        (BrokenPipeError(), READER_GONE, ""),
        (OSError(28, "disk full"), FAILED, "error: cannot write standard output"),
    ],
)
def test_foreseen_failure_is_one_line_and_code(capsys, error, code, start):
    assert run_command(failing(error)) == code
    said = capsys.readouterr().err
    assert said.startswith(start)
    assert said.count("\n") == bool(start)


def test_unforeseen_error_is_raised_and_code_returned(capsys):
    for error in (ZeroDivisionError(), PermissionError(13, "forbidden", "some.file")):
        with pytest.raises(type(error)):
            run_command(failing(error))

    assert run_command(lambda: 7) == 7

    say("two\nlines")
    write_out("table\n", to_stderr=True)
    write_out("result\n")

    assert capsys.readouterr() == ("result\n", "two lines\ntable\n")


def test_sigterm_ends_with_its_own_code(capsys):
    assert run_command(lambda: os.kill(os.getpid(), signal.SIGTERM)) == 143
    assert capsys.readouterr().err == "terminated\n"


def test_first_ctrl_c_asks_second_interrupts():
    # A job in the background of a shell starts with it ignored.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    with stop_request() as stop:
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)

    signal.signal(signal.SIGINT, handler)


def test_unwritable_characters_become_escapes(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    write_out("0.3±0.1 \udcff\n")

    assert stream.buffer.getvalue() == b"0.3\\xb10.1 \\udcff\n"


@pytest.mark.slow
def test_help_answers_without_the_estimators():
    code = "import sys; from needleforce.cli import main; main(['force', '--help']); "
    code += "print({'pinocchio', 'numba', 'numpy'} & set(sys.modules))"
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )

    assert process.stdout.splitlines()[-1] == "set()"
    assert "--external-torque" in process.stdout


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run a command in an empty folder; return what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(*argv):
        assert main([*argv]) == 0
        return capsys.readouterr().out

    return run


def test_printed_mapping_holds_the_options(run):
    Path("log.csv").write_text("Zeit;Weg;fz [mN]\n0;1;2\n1;2;3\n", encoding="utf-8")
    columns = ["--time", "Zeit:ms", "--depth", "Weg:mm:-1", "--force", "fz [mN]"]
    Path("map.toml").write_text(run("identify", "log.csv", *columns, "--print-config"))
    log = read_log("log.csv", load_mapping("map.toml"), required=["depth", "force"])

    np.testing.assert_allclose(log.t_s, [0.0, 1e-3])
    np.testing.assert_allclose(log["depth_m"], [-1e-3, -2e-3])
    np.testing.assert_allclose(log["force_N"], [2e-3, 3e-3])

    mapping = run("identify", "log.csv", "--rate", "50", "--print-config")

    assert tomllib.loads(mapping)["rate_hz"] == 50.0


def test_a_layout_of_the_user_is_known_to_the_command(run):
    Path("log.csv").write_text("t [s],droga [mm],load [daN]\n0,1,2\n1,2,3\n")
    Path("my.toml").write_text(
        "[units.force]\ndaN = [10]\n[channels.depth]\nwords = ['droga']\n"
    )
    mapping = run("identify", "log.csv", "--layout", "my.toml", "--print-config")

    assert tomllib.loads(mapping)["depth"]["columns"] == "droga [mm]"
    assert tomllib.loads(mapping)["force"]["unit"] == "daN"


@pytest.mark.slow
def test_mapping_is_printed_edited_and_read_back(run, lwr):
    columns = insertion(lwr)
    table = {name: columns[name] for name in ("t_s", "q_rad", "dq_rad_s", "tau_Nm")}
    turned = {k: v[..., ::-1] if v.ndim == 2 else v for k, v in table.items()}
    labels = TableLabels(joint_names=lwr.joint_names[::-1])
    write_table("log.mcap", turned, labels=labels)
    write_table("log.csv", table)
    text = run("force", "log.mcap", "--print-config")

    assert tomllib.loads(text)["joints"] == list(lwr.joint_names)
    assert tomllib.loads(text)["payload"]["needle"]["needle_mass_kg"] == 0.068

    Path("map.toml").write_text(text.replace("scale = 1.0 }", "scale = -1.0 }"))
    results = []
    for options in (
        ["log.csv", "-o", "a.npz", "--tare", "0:2.5"],
        ["log.mcap", "-o", "b.npz", "--tare", "0:2.5"],
        ["log.mcap", "-o", "c.npz", "--no-tare", "--mapping", "map.toml"],
    ):
        run("force", *options)
        results.append(np.load(options[2])["axial_N"])

    np.testing.assert_allclose(results[1], results[0], atol=1e-9)
    assert not np.allclose(results[2], results[0], equal_nan=True)

    content = tomllib.loads(run("identify", "b.npz", "--print-config"))

    assert content["force"]["columns"] == "axial_unsmoothed_N"
    assert content["depth"]["columns"] == "travel_m"


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("is_terminal", [False, True])
def test_progress_bar_needs_a_terminal(monkeypatch, is_terminal):
    stream = Terminal() if is_terminal else io.StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar("log.csv") as progress:
        progress(0.5)

    assert ("log.csv" in stream.getvalue(), "50%" in stream.getvalue()) == (
        is_terminal,
    ) * 2
