"""A bag that is followed while it is recorded gives what the finished file gives."""

import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from bag_samples import data_file, insertion_rows, write_bag
from growing_bags import (
    ASKED,
    END,
    HEADER,
    LONGEST_S,
    assert_same,
    followed,
    grow,
    in_pieces,
    recorded,
    without_chunks,
)
from residual_command_log import write_insertion

from needleforce.recordings import FileAccessError, FormatError, read_log, write_table
from needleforce.recordings.bag_storage import MAGIC
from needleforce.recordings.mapping import ChannelRequest
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.open_recording import stream_tables

ROWS = np.arange(5000)
DEPTHS = {"t_s": ROWS / 1000, "depth_m": 1e-6 * ROWS, "force_N": 1e-3 * ROWS**0.5}


@pytest.mark.parametrize("kind", ["plain", "zstd", "without chunks"])
@pytest.mark.parametrize("count", [3, 41])
def test_a_growing_bag_gives_what_the_finished_one_gives(tmp_path, kind, count):
    data = recorded(tmp_path / "bag", insertion_rows(3000), "STORAGE" if kind == "zstd" else None)
    if kind == "without chunks":
        data = without_chunks(data_file(tmp_path / "bag"))
    path = tmp_path / "growing.mcap"
    writer = grow(path, in_pieces(data, count))
    start_s = time.monotonic()
    chunks, warnings = followed(path)
    writer.join()
    # It ended because the recorder finished the file, not because nothing came.
    assert time.monotonic() - start_s < 0.8 * LONGEST_S
    log = read_log(path, **ASKED)
    assert len(log) == 3000
    assert_same(chunks, log)
    assert "cut short" not in "".join(warnings)


def test_rows_come_while_the_recorder_still_writes(tmp_path):
    recorded(tmp_path / "bag", insertion_rows(3000))
    data = without_chunks(data_file(tmp_path / "bag"))
    path, go_on = tmp_path / "growing.mcap", threading.Event()
    half = len(data) // 2
    writer = grow(path, [data[:half], data[half:]], go_on=go_on)
    tables = stream_tables(path, FollowOptions(follow=True, idle_s=LONGEST_S), ChannelRequest(**ASKED))
    rows, before = 0, None
    for table in tables:
        rows += len(table.columns["t_s"])
        if rows > 1400 and before is None:
            before = rows
            go_on.set()
    writer.join()
    assert 1400 < before < 1600
    assert rows == 3000


def test_who_stops_hears_nothing_of_what_was_not_finished_and_an_idle_end_tells_it(tmp_path):
    recorded(tmp_path / "bag", insertion_rows(3000))
    data = without_chunks(data_file(tmp_path / "bag"))
    path = tmp_path / "growing.mcap"
    path.write_bytes(data[: len(data) * 2 // 3 + 7])
    chunks, warnings = followed(path, FollowOptions(follow=True, idle_s=0.2))
    assert "growing.mcap is cut short" in warnings
    rows = sum(len(chunk.t_s) for chunk in chunks)
    assert 1900 < rows < 2100
    is_over = threading.Event()
    patience = FollowOptions(follow=True, should_stop=is_over.is_set)
    timer = threading.Timer(0.5, is_over.set)
    timer.start()
    chunks, warnings = followed(path, patience)
    assert sum(len(chunk.t_s) for chunk in chunks) == rows
    assert "cut short" not in "".join(warnings)


def test_an_idle_end_between_two_messages_is_no_fault(tmp_path):
    recorded(tmp_path / "bag", insertion_rows(2000))
    path = tmp_path / "growing.mcap"
    path.write_bytes(without_chunks(data_file(tmp_path / "bag"))[: -len(END)])
    chunks, warnings = followed(path, FollowOptions(follow=True, idle_s=0.2))
    assert sum(len(chunk.t_s) for chunk in chunks) == 2000
    assert "cut short" not in "".join(warnings)


def test_a_recording_shorter_than_what_decides_its_topics_is_read_when_it_ends(tmp_path):
    path = tmp_path / "growing.mcap"
    writer = grow(path, in_pieces(recorded(tmp_path / "bag", insertion_rows(300)), 5))
    chunks, warnings = followed(path)
    writer.join()
    log = read_log(path, **ASKED)
    assert_same(chunks, log)
    assert set(warnings) == set(log.warnings)


def test_what_cannot_be_followed_is_told_with_what_to_do(tmp_path):
    follow = FollowOptions(follow=True, idle_s=0.1)
    with pytest.raises(FileAccessError, match=r"x.db3 cannot be followed.*ros2 bag record -s mcap"):
        list(stream_tables(tmp_path / "x.db3", follow))
    with pytest.raises(FileAccessError, match=r"is a folder.*name the .mcap file in it"):
        list(stream_tables(write_bag(tmp_path / "bag", insertion_rows(3)), follow))
    with pytest.raises(FileAccessError, match=r"cannot read .*none.mcap: No such file"):
        list(stream_tables(tmp_path / "none.mcap", follow))
    path = tmp_path / "x.mcap"
    for data, message in (
        (b"", "x.mcap is empty"),
        (b"0123456789", "is not an MCAP file"),
        (MAGIC + HEADER, "holds no messages"),
    ):
        path.write_bytes(data)
        with pytest.raises(FormatError, match=message):
            list(stream_tables(path, follow))


@pytest.mark.parametrize("name", ["identification", "residual"])
def test_the_commands_follow_a_bag(tmp_path, lwr, name):
    path, out, expected = (tmp_path / file for file in ("log.mcap", "out.csv", "expected.csv"))
    if name == "residual":
        write_insertion(tmp_path / "whole.mcap", lwr)
    else:
        write_table(tmp_path / "whole.mcap", DEPTHS)
    command = [sys.executable, "-m", name]
    options = ["--tare", "0:2.5"] if name == "residual" else []
    whole = [*command, str(tmp_path / "whole.mcap"), *options, "-o", str(expected)]
    subprocess.run(whole, check=True, capture_output=True)
    writer = grow(path, in_pieces((tmp_path / "whole.mcap").read_bytes(), 20), pause_s=0.1)
    argv = [*command, str(path), "--follow", *options, "-o", str(out)]
    done = subprocess.run(argv, capture_output=True, check=False, timeout=120)
    writer.join()
    assert done.returncode == 0, done.stderr
    assert out.read_bytes() == expected.read_bytes()
