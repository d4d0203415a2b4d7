"""What every command does with errors, Ctrl-C, readers that go away, and long tables."""

import io
import os
import signal
import sys
import threading
from argparse import ArgumentParser
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recordings import FileAccessError, RecordingError
from recordings.command.progress import progress
from recordings.command.row_overview import RowOverview
from recordings.command.run_command import (
    FAILED,
    INTERRUPTED,
    READER_GONE,
    run_command,
    say,
    write_out,
)
from recordings.command.source_arguments import source_arguments
from recordings.command.stop_request import StopRequest
from recordings.open_table import open_table


def run(work):
    """The exit code of a command without arguments."""
    return run_command(ArgumentParser(), [], work, (RecordingError,))


def failing(error):
    def work(_arguments):
        raise error

    return work


@pytest.fixture(autouse=True)
def _open_output(monkeypatch):
    """What is done to standard output must not outlive the test."""
    monkeypatch.setattr("recordings.command.run_command._close_output", lambda: None)


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (FileAccessError("no such\nfile"), FAILED, "error: no such file\n"),
        (KeyboardInterrupt(), INTERRUPTED, "interrupted\n"),
        (BrokenPipeError(), READER_GONE, ""),
        (OSError(28, "disk full"), FAILED, "error: cannot write standard output: disk full\n"),
    ],
)
def test_a_foreseen_failure_is_one_line_and_a_code(capsys, error, code, said):
    assert run(failing(error)) == code
    assert capsys.readouterr().err == said


def test_what_was_not_foreseen_is_not_hidden():
    for error in (ZeroDivisionError(), PermissionError(13, "forbidden", "some.file")):
        with pytest.raises(type(error)):
            run(failing(error))


def test_the_code_of_the_work_is_handed_on(capsys):
    assert run(lambda _: 7) == 7
    say("two\nlines")
    write_out("table\n", to_stderr=True)
    write_out("result\n")
    printed = capsys.readouterr()
    assert printed.err == "two lines\ntable\n"
    assert printed.out == "result\n"


class FullDisk(io.StringIO):
    def write(self, text):
        raise OSError(28, "No space left on device")


def test_standard_output_that_cannot_be_written_is_told(monkeypatch):
    monkeypatch.setattr(sys, "stdout", FullDisk())
    with pytest.raises(FileAccessError, match="cannot write standard output: No space left"):
        write_out("result\n")


def test_closed_standard_streams_are_told_or_done_without(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(FileAccessError, match="standard output: it is closed"):
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


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf", "soon"])
def test_idle_must_be_a_time(seconds, capsys):
    parser = ArgumentParser()
    source_arguments(parser, "time")
    with pytest.raises(SystemExit):
        parser.parse_args(["log.csv", "--idle", seconds])
    assert "is not a number of seconds" in capsys.readouterr().err
    assert parser.parse_args(["-", "--idle", "2.5"]).idle == 2.5


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
