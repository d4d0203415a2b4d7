"""A long command shows on a terminal how far it is, on stderr, and nowhere else."""

import io

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.cli.terminal import progress_bar
from needleforce.recordings import FollowOptions, stream_tables, write_table

ROWS = np.arange(20_000)
COLUMNS = {"t_s": ROWS / 1000, "depth_m": 1e-6 * ROWS, "force_N": 1e-3 * ROWS**0.5}


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("suffix", ["csv", "mcap"])
def test_readers_say_which_share_of_a_recording_was_read(tmp_path, suffix):
    path, shares = tmp_path / f"log.{suffix}", []
    write_table(path, COLUMNS)
    assert list(stream_tables(path, FollowOptions(progress=shares.append)))
    assert shares == sorted(shares)
    assert len(shares) > 2
    assert shares[-1] == 1.0


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_bar_is_drawn_on_a_terminal_only(monkeypatch, is_terminal):
    stream = Terminal() if is_terminal else io.StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar("log.csv") as progress:
        progress(0.5)
    with progress_bar("other.csv", is_wanted=False) as progress:
        progress(0.5)
    assert ("log.csv" in stream.getvalue(), "50%" in stream.getvalue()) == (is_terminal,) * 2
    assert "other.csv" not in stream.getvalue()


def test_a_command_draws_it_and_prints_what_it_prints_without(tmp_path, monkeypatch, capsys):
    path = tmp_path / "log.csv"
    write_table(path, COLUMNS)
    assert main(["identify", str(path)]) == 0
    plain, stream = capsys.readouterr().out, Terminal()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    assert main(["identify", str(path)]) == 0
    assert capsys.readouterr().out == plain
    assert "log.csv" in stream.getvalue()
