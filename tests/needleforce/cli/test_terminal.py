"""What every command does with errors, signals, what it prints, mappings and help."""

import io
import os
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from needleforce.cli import CommandError, main, run_command
from needleforce.cli.terminal import (
    FAILED,
    INTERRUPTED,
    READER_GONE,
    progress_bar,
    say,
    stop_request,
    write_out,
)
from needleforce.recordings import FileAccessError, load_mapping, read_log
from tests.needleforce.cli.residual_command_log import (
    insertion,
    write_insertion,
    write_turned,
)


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
    assert run_command(Mock(side_effect=error)) == code
    said = capsys.readouterr().err
    assert said.startswith(start)
    assert said.count("\n") == bool(start)


@pytest.mark.parametrize(
    "error", [ZeroDivisionError(), PermissionError(13, "forbidden", "some.file")]
)
def test_an_unforeseen_error_is_raised(error):
    with pytest.raises(type(error)):
        run_command(Mock(side_effect=error))


def test_a_code_is_returned_and_results_are_apart_from_what_is_said(capsys):
    assert run_command(lambda: 7) == 7

    say("two\nlines")
    write_out("table\n", to_stderr=True)
    write_out("result\n")

    assert capsys.readouterr() == ("result\n", "two lines\ntable\n")


def test_sigterm_ends_with_its_own_code(capsys):
    with pytest.raises(SystemExit, match="143"):
        run_command(lambda: os.kill(os.getpid(), signal.SIGTERM))

    assert capsys.readouterr().err == "terminated\n"


def test_first_ctrl_c_asks_second_interrupts():
    # A job in the background of a shell starts with it ignored.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    with stop_request() as stop:
        assert not stop()
        signal.raise_signal(signal.SIGINT)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)

    signal.signal(signal.SIGINT, handler)


def test_unwritable_characters_become_escapes(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    write_out("0.3±0.1 \udcff\n")

    assert stream.buffer.getvalue() == b"0.3\\xb10.1 \\udcff\n"


@pytest.mark.slow
def test_help_answers_without_the_estimators():
    process = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "needleforce", "force", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )

    assert not re.search(r"\| +(pinocchio|numba|numpy)$", process.stderr, re.MULTILINE)
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

    mapping = run("identify", "log.csv", "--rate", "50", "--print-config")

    np.testing.assert_allclose(
        [log.t_s, log["depth_m"], log["force_N"]],
        [[0.0, 1e-3], [-1e-3, -2e-3], [2e-3, 3e-3]],
    )
    assert tomllib.loads(mapping)["rate_hz"] == 50.0


def test_a_layout_of_the_user_is_known_to_the_command(run):
    Path("log.csv").write_text("t [s],droga [mm],load [daN]\n0,1,2\n1,2,3\n")
    Path("my.toml").write_text(
        "[units.force]\ndaN = [10]\n[channels.depth]\nwords = ['droga']\n"
    )
    text = run("identify", "log.csv", "--layout", "my.toml", "--print-config")
    mapping = tomllib.loads(text)

    assert (mapping["depth"]["columns"], mapping["force"]["unit"]) == (
        *("droga [mm]", "daN"),
    )


@pytest.mark.slow
def test_mapping_is_printed_edited_and_read_back(run, lwr):
    write_turned("log.mcap", insertion(lwr), lwr.joint_names)
    write_insertion("log.csv", lwr)
    text = run("force", "log.mcap", "--print-config")
    mapping = tomllib.loads(text)

    assert mapping["joints"] == list(lwr.joint_names)
    assert mapping["payload"]["needle"]["needle_mass_kg"] == 0.068

    Path("map.toml").write_text(text.replace("scale = 1.0 }", "scale = -1.0 }"))
    run("force", "log.csv", "-o", "a.npz", "--tare", "0:2.5")
    run("force", "log.mcap", "-o", "b.npz", "--tare", "0:2.5")
    run("force", "log.mcap", "-o", "c.npz", "--no-tare", "--mapping", "map.toml")
    named, turned, signed = (np.load(f"{name}.npz")["axial_N"] for name in "abc")
    content = tomllib.loads(run("identify", "b.npz", "--print-config"))

    np.testing.assert_allclose(turned, named, atol=1e-9)
    assert not np.allclose(signed, named, equal_nan=True)
    assert [content[name]["columns"] for name in ("force", "depth")] == [
        *("axial_unsmoothed_N", "travel_m"),
    ]


@pytest.mark.parametrize("is_terminal", [False, True])
def test_progress_bar_needs_a_terminal(monkeypatch, is_terminal):
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: is_terminal, raising=False)
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar("log.csv") as progress:
        progress(0.5)

    assert [word in stream.getvalue() for word in ("log.csv", "50%")] == [
        is_terminal
    ] * 2
