"""Binary recordings come through a pipe too: what is estimated is what the file gives."""

import errno
import os
import subprocess
import sys
import threading

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.recordings import FileAccessError, read_log, write_table
from needleforce.recordings.log import LogStream
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.follow import peek, spooled
from needleforce.recordings.open_recording import stream_tables

ROWS = np.arange(5000)
COLUMNS = {"t_s": ROWS / 1000, "depth_m": 1e-6 * ROWS, "force_N": 1e-3 * ROWS**0.5}


def piped(data, path, size, should_stop=lambda: False):
    """Time, force and what was told of a recording that comes through a pipe."""
    os.mkfifo(path)

    def write():
        with path.open("wb", buffering=0) as out:
            for at in range(0, len(data), size):
                out.write(data[at : at + size])

    writer, told = threading.Thread(target=write), []
    writer.start()
    patience = FollowOptions(warn=told.append, should_stop=should_stop)
    chunks = list(LogStream(stream_tables(path, patience), required=["depth", "force"]))
    writer.join()
    t_s = np.concatenate([chunk.t_s for chunk in chunks])
    return t_s, np.concatenate([chunk.channels["force_N"] for chunk in chunks]), told


@pytest.mark.parametrize("suffix", ["mcap", "npz", "parquet"])
@pytest.mark.parametrize("size", [3000, 1 << 20])
def test_what_comes_through_a_pipe_is_what_the_file_gives(tmp_path, suffix, size):
    path = tmp_path / f"log.{suffix}"
    write_table(path, COLUMNS)
    t_s, force_N, told = piped(path.read_bytes(), tmp_path / "pipe", size)
    log = read_log(path, required=["depth", "force"])
    np.testing.assert_array_equal(t_s, log.t_s)
    np.testing.assert_array_equal(force_N, log["force_N"])
    assert len(told) == 1
    assert f"is {suffix}, not text: it is read to its end" in told[0]


def test_a_bag_in_sqlite_comes_through_a_pipe(tmp_path):
    write_table(tmp_path / "log.db3", COLUMNS)
    (file,) = (tmp_path / "log.db3").glob("*.db3")
    _, force_N, _ = piped(file.read_bytes(), tmp_path / "pipe", 1 << 16)
    np.testing.assert_array_equal(force_N, COLUMNS["force_N"])


def test_a_bag_that_is_piped_into_the_command_gives_the_bytes_of_the_file(tmp_path):
    path, out = tmp_path / "log.mcap", tmp_path / "out.csv"
    write_table(path, COLUMNS)
    assert main(["identify", str(path), "-o", str(out)]) == 0
    argv = [sys.executable, "-m", "identification", "-", "-o", "-"]
    done = subprocess.run(argv, input=path.read_bytes(), capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (0, out.read_bytes())
    assert b"standard input is mcap, not text" in done.stderr


def test_what_only_begins_as_a_recording_is_told_in_one_line(tmp_path):
    argv = [sys.executable, "-m", "identification", "-"]
    for data, message in ((b"PK\x03\x04\x00", b"not an npz"), (b"\x89MCAP0\r\n", b"no messages")):
        done = subprocess.run(argv, input=data, capture_output=True, check=False)
        assert done.returncode == 2
        warning, error = done.stderr.splitlines()
        assert warning.startswith(b"warning: ")
        assert error.startswith(b"error: ")
        assert b"standard input" in error
        assert message in error, error


def test_no_more_of_a_text_is_waited_for_than_tells_it_from_a_bag():
    taken = []

    def blocks():
        for block in (b"\x89MC", b"AP1", b"more"):
            taken.append(block)
            yield block

    suffix, rest = peek(blocks())
    assert (suffix, len(taken)) == ("", 2)
    assert b"".join(rest) == b"\x89MCAP1more"
    suffix, rest = peek([])
    assert (suffix, list(rest)) == ("", [])


def test_a_pipe_for_which_there_is_no_room_is_told(monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("pathlib.Path.open", full)
    with pytest.raises(FileAccessError, match=r"No space left.*TMPDIR"), spooled([b"x"], ".mcap"):
        pass
