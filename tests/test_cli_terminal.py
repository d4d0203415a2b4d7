"""What every command does with errors, signals, outputs, long tables, help and options."""

import io
import os
import signal
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path
from typing import Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleforce.cli import app, main
from needleforce.cli import options as options_module
from needleforce.cli.log import RowOverview, check_outputs
from needleforce.cli.options import Output
from needleforce.cli.terminal import (
    FAILED,
    INTERRUPTED,
    READER_GONE,
    CommandError,
    StopRequest,
    progress,
    run_command,
    say,
    write_out,
)
from needleforce.plots import FiguresError
from needleforce.recordings import CHANNELS, FileAccessError, check_writable, write_table
from needleforce.recordings.output import open_table


def failing(error):
    def work():
        raise error

    return work


@pytest.fixture(autouse=True)
def _open_output(monkeypatch):
    """What is done to standard output must not outlive the test."""
    monkeypatch.setattr("needleforce.cli.terminal._close_output", lambda: None)


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (CommandError("no such\noption"), FAILED, "error: no such option\n"),
        (FileAccessError("no such\nfile"), FAILED, "error: no such file\n"),
        (KeyboardInterrupt(), INTERRUPTED, "interrupted\n"),
        (BrokenPipeError(), READER_GONE, ""),
        (OSError(28, "disk full"), FAILED, "error: cannot write standard output: disk full\n"),
    ],
)
def test_a_foreseen_failure_is_one_line_and_a_code(capsys, error, code, said):
    assert run_command(failing(error)) == code
    assert capsys.readouterr().err == said


def test_what_was_not_foreseen_is_not_hidden():
    for error in (ZeroDivisionError(), PermissionError(13, "forbidden", "some.file")):
        with pytest.raises(type(error)):
            run_command(failing(error))


def test_the_code_of_the_work_is_handed_on(capsys):
    assert run_command(lambda: 7) == 7
    say("two\nlines")
    write_out("table\n", to_stderr=True)
    write_out("result\n")
    printed = capsys.readouterr()
    assert printed.err == "two lines\ntable\n"
    assert printed.out == "result\n"


class FullDisk(io.StringIO):
    def write(self, text):
        raise OSError(28, "No space left on device")


def test_standard_output_that_cannot_be_written_is_reported(monkeypatch):
    monkeypatch.setattr(sys, "stdout", FullDisk())
    with pytest.raises(CommandError, match="cannot write standard output: No space left"):
        write_out("result\n")


def test_closed_standard_streams_are_told_or_done_without(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(CommandError, match="standard output: it is closed"):
        write_out("result\n")
    with pytest.raises(FileAccessError, match="standard output: it is closed"):
        open_table("-").__enter__()
    monkeypatch.setattr(sys, "stderr", None)
    say("nobody hears this")
    write_out("nor this\n", to_stderr=True)
    with progress(None, "unseen") as advance:
        advance(1.0)
    monkeypatch.undo()
    assert capsys.readouterr().err == ""


@pytest.fixture
def _ctrl_c_is_heard():
    # A job in the background of a shell starts with it ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_ctrl_c_is_heard")
def test_the_first_ctrl_c_asks_and_the_second_interrupts():
    with StopRequest() as stop:
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


def test_beside_the_first_thread_ctrl_c_is_left_alone():
    before, seen = signal.getsignal(signal.SIGINT), []

    def enter():
        with StopRequest() as stop:
            seen.append((stop(), signal.getsignal(signal.SIGINT)))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert seen == [(False, before)]


def test_no_bar_is_drawn_where_there_is_no_terminal(capsys):
    with progress(3.0, "work") as advance:
        advance(1.0)
    assert capsys.readouterr().err == ""


def test_what_the_terminal_cannot_write_is_an_escape(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    write_out("0.3±0.1 \udcff\n")
    assert stream.buffer.getvalue() == b"0.3\\xb10.1 \\udcff\n"


# Help, completion and the options.


def test_help_and_version_answer_without_the_estimators(capsys):
    assert main(["--help"]) == 0
    for name in ("simulate", "force", "identify", "report"):
        assert name in capsys.readouterr().out or main([name, "--help"]) == 0
    code = "import sys; from needleforce.cli import main; main(['force', '--help']); "
    code += "print({'pinocchio', 'numba', 'numpy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
    assert "--external-torque" in done.stdout
    assert "START:END" in done.stdout


@pytest.mark.parametrize("package", ["residual", "identification", "groundtruth"])
def test_the_packages_forward_to_their_command(package):
    done = subprocess.run(
        [sys.executable, "-m", package, "--help"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("Usage: needleforce ")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_commands_and_options(shell):
    script = app.generate_completion(shell=shell)
    for word in ("force", "identify", "external-torque", "published-kv"):
        assert word in script


def test_options_name_every_channel_and_every_choice():
    known = {name for name in CHANNELS if hasattr(options_module.AllColumns, name)}
    assert known == set(CHANNELS)
    from groundtruth import PLANT_MODELS
    from needleforce.cli.identify import METHODS
    from residual.momentum_observer import Alignment
    from residual.wrench_estimator import Mode

    def choices(kind, name):
        hint = get_type_hints(kind)[name]
        (literal,) = [part for part in (hint, *get_args(hint)) if get_origin(part) is Literal]
        return set(get_args(literal))

    assert choices(options_module.SimulationOptions, "plant") == set(PLANT_MODELS)
    assert choices(options_module.IdentificationOptions, "method") == set(METHODS)
    assert choices(options_module.SensorOptions, "mode") == set(get_args(Mode))
    assert choices(options_module.SensorOptions, "alignment") == set(get_args(Alignment))


# Outputs never harm the log, each other or what is not the command's own.

COLUMNS = {"t_s": np.arange(3) / 1000.0, "force_N": np.ones(3)}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_table("log.csv", COLUMNS)
    write_table("bag.db3", COLUMNS)
    (tmp_path / "link").symlink_to(tmp_path / "bag.db3")
    (tmp_path / "log.png").symlink_to(tmp_path / "log.csv")
    (tmp_path / "hard.csv").hardlink_to(tmp_path / "log.csv")
    (tmp_path / "f.csv").touch()
    (tmp_path / "f.png").symlink_to(tmp_path / "f.csv")
    return tmp_path


def check(source, **outputs):
    paths = {name: path if name == "output" else Path(path) for name, path in outputs.items()}
    return check_outputs(source, Output(**paths))


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("source", "outputs", "message"),
    [
        ("bag.db3", {"output": "bag.db3/x.db3"}, "the log"),
        ("bag.db3", {"output": "bag.db3/x.csv"}, "the log"),
        ("bag.db3/bag.db3", {"output": "bag.db3"}, "the log"),
        ("bag.db3/bag.db3", {"output": "bag.db3/other.mcap"}, "the log"),
        ("bag.db3", {"output": "bag.db3"}, "the log"),
        ("link", {"output": "bag.db3/x.csv"}, "the log"),
        ("bag.db3", {"figure": "bag.db3/x.png"}, "the log"),
        ("bag.db3", {"report": "bag.db3"}, "the log"),
        ("bag.db3", {"report": "bag.db3/r"}, "the log"),
        ("log.csv", {"figure": "log.png"}, "it is the log itself"),
        ("log.csv", {"output": "hard.csv"}, "it is the log itself"),
        ("log.csv", {"output": "f.csv", "figure": "f.png"}, "both write to"),
        ("log.csv", {"output": "new.csv", "report": "new.csv"}, "both write to"),
        ("log.csv", {"output": "out.db3", "report": "out.db3"}, "both write to"),
        ("other.csv", {"figure": "picture.gif"}, "cannot write picture.gif"),
        ("other.csv", {"figure": "picture"}, "cannot write picture"),
        ("other.csv", {"figure": "no/where.svg"}, "there is no folder no"),
    ],
    ids=str,
)
def test_an_output_that_would_harm_something_is_refused(source, outputs, message):
    pytest.importorskip("matplotlib")
    with pytest.raises((FileAccessError, CommandError, FiguresError), match=message):
        check(source, **outputs)
    if set(outputs) == {"output"}:
        with pytest.raises(FileAccessError, match=message):
            check_writable(outputs["output"], source=source)


@pytest.mark.usefixtures("folder")
def test_outputs_side_by_side_are_fine():
    for source, outputs in (
        ("log.csv", {"output": "f.csv", "figure": "g.pdf", "report": "."}),
        ("bag.db3", {"output": "f.db3", "figure": "g.png", "report": "report"}),
        ("log.csv", {"output": "bag.db3"}),
        ("-", {"output": "-", "figure": "g.svg"}),
    ):
        assert check(source, **outputs) is None


def test_only_a_bag_and_nothing_else_is_replaced_by_a_bag(folder):
    write_table("bag.db3", COLUMNS)
    notes = folder / "bag.db3" / "notes.txt"
    notes.write_text("dear")
    (folder / "file.db3").write_text("dear")
    (folder / "empty.db3").mkdir()
    (folder / "t.csv").mkdir()
    for name, message in (
        ("bag.db3", "'notes.txt', which is no part of a bag"),
        ("file.db3", "a file of this name"),
        ("empty.db3", "it is no bag"),
        ("t.csv", "it is a folder"),
    ):
        with pytest.raises(FileAccessError, match=message):
            check("log.csv", output=name)
    with pytest.raises(FileAccessError, match="no part of a bag"):
        write_table("bag.db3", COLUMNS)
    assert notes.read_text() == (folder / "file.db3").read_text() == "dear"


# Few rows of long tables.


def overview_of(values, pieces, most_rows):
    overview = RowOverview(("x", "v"), most_rows)
    edges = np.linspace(0, len(values), pieces + 1).astype(int)
    for a, b in pairwise(edges):
        x = values[a:b]
        overview.add({"n": np.arange(a, b), "x": x, "v": np.stack([x, -x], axis=1)})
    return overview.columns()


def test_a_short_table_is_kept_whole():
    values = np.random.default_rng(0).normal(size=300)
    kept = overview_of(values, 7, 300)
    np.testing.assert_array_equal(kept["n"], np.arange(300))
    np.testing.assert_array_equal(kept["v"][:, 1], -values)


@given(
    st.lists(st.floats(-10, 10) | st.just(np.nan), min_size=1, max_size=400),
    st.integers(1, 9),
    st.integers(20, 60),
)
def test_of_a_long_table_few_rows_stay_and_the_extremes_are_among_them(values, pieces, most_rows):
    values = np.array(values)
    kept = overview_of(values, pieces, most_rows)
    assert len(kept["n"]) <= most_rows
    assert (np.diff(kept["n"]) > 0).all()
    np.testing.assert_array_equal(kept["x"], values[kept["n"]])
    if np.isfinite(values).any():
        assert np.nanmin(kept["x"]) == np.nanmin(values)
        assert np.nanmax(kept["x"]) == np.nanmax(values)


def test_the_rows_that_stay_are_spread_over_the_whole_table():
    kept = overview_of(np.sin(np.arange(100_000) / 50.0), 90, 1000)
    assert 300 < len(kept["n"]) <= 1000
    assert np.diff(kept["n"]).max() < 1000
    assert RowOverview(("x",)).columns() == {}
