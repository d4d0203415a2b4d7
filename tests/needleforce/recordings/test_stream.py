"""A recording read as it comes is the recording read whole: rows, numbers and
warnings."""

import gzip
import os
import threading
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleforce.recordings import (
    FileAccessError,
    FormatError,
    UnitError,
    read_log,
    write_table,
)
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.csv_file import csv_tables
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.log_stream import LogStream
from needleforce.recordings.open_recording import stream_tables
from needleforce.recordings.table import HEAD_ROWS
from tests.needleforce.recordings.bag_samples import assert_same, followed, grow

ASKED = {"required": ("q", "tau"), "optional": ("dq",)}


def text_of(rows):
    """A CSV text of two joints with the faults that recordings have."""
    rng = np.random.default_rng(rows)
    t_s = 0.001 * np.arange(rows)
    values = rng.normal(size=(rows, 6))
    lines = ["t,q1,q2,dq1,dq2,tau1,tau2,phase"]
    lines += [
        f"{t!r},{','.join(map(repr, row))},{'rest' if t < 0.3 else 7}"
        for t, row in zip(t_s.tolist(), values.tolist(), strict=True)
    ]
    lines[5] = lines[5].replace(",rest", "")
    lines[rows // 2] = "# a comment half way"
    lines[rows // 2 + 1] = lines[rows // 2 - 1]
    lines[rows // 2 + 3] = ",".join(
        [*lines[rows // 2 + 3].split(",")[:-2], "oops,rest"]
    )
    lines[rows // 2 + 5] = ",1,2,3,4,5,6,rest"
    lines[rows // 2 + 7] += ",more"
    return "\n".join(lines) + "\n"


def assert_all_the_same(other, log):
    assert_same(other, log)
    assert set(other.warnings) == set(log.warnings)


@pytest.mark.slow
@settings(max_examples=30)
@given(
    st.integers(1, 3000),
    st.sampled_from([20, HEAD_ROWS, HEAD_ROWS + 7, 1000]),
    st.booleans(),
)
def test_text_in_any_pieces_reads_the_same(tmp_path_factory, size, rows, packed):
    text = text_of(rows).encode()
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_bytes(text)
    data = gzip.compress(text, mtime=0) if packed else text
    pieces = [data[start : start + size] for start in range(0, len(data), size)]
    streamed_log = LogStream(
        csv_tables(pieces, "log"), ChannelRequest(**ASKED)
    ).joined()

    assert_all_the_same(streamed_log, read_log(path, **ASKED))


def test_an_assumed_unit_is_doubted_when_values_show():
    rows = 3 * HEAD_ROWS
    depth = np.where(np.arange(rows) < 2 * HEAD_ROWS, 0.0, 85.0)
    lines = [f"{k / 1000},{z},0.1\n" for k, z in enumerate(depth)]
    tables = csv_tables([b"t,depth,f\n", *(line.encode() for line in lines)], "log")
    stream = LogStream(tables, ChannelRequest(required=("depth", "force")))
    row_counts = []

    with pytest.raises(UnitError, match=r"depth: .*taken as in m, is 85 m"):
        row_counts.extend(len(chunk.t_s) for chunk in stream)

    assert sum(row_counts) == rows


def test_a_line_that_never_ends_is_refused():
    with pytest.raises(FormatError, match="line 1 does not end"):
        list(csv_tables([b"x" * (1 << 20)] * 20, "log"))


@pytest.mark.slow
def test_a_growing_file_is_followed_by_whole_lines(tmp_path):
    text = text_of(600).encode()
    path = tmp_path / "log.csv"
    whole = tmp_path / "whole.csv"
    whole.write_bytes(text)
    cuts = [10, 5000, 17_777, 33_333, len(text)]
    writer = grow(path, [text[a:b] for a, b in pairwise([0, *cuts])], pause_s=0.02)
    followed_log = followed(path, FollowOptions(follow=True, idle_s=0.6), **ASKED)
    writer.join()

    assert_all_the_same(followed_log, read_log(whole, **ASKED))


def test_following_ends_when_asked_without_partial_lines(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t_s,q1,tau1\n0,1,2\n1,1,2\n2,1,2.3")
    asked = []

    def should_stop():
        asked.append(1)
        return len(asked) > 3

    options = FollowOptions(follow=True, should_stop=should_stop)
    followed_log = followed(path, options, **ASKED)

    assert followed_log.t_s.tolist() == [0.0, 1.0]
    assert "cut short" not in "".join(followed_log.warnings)

    followed_log = followed(path, FollowOptions(follow=True, idle_s=0.1), **ASKED)

    assert (
        "line 4, the last, is cut short (3 of 3 cells) and was left out"
        in followed_log.warnings
    )


def test_standard_input_that_is_closed_is_reported(monkeypatch):
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(FileAccessError, match="standard input: it is closed"):
        list(stream_tables("-", FollowOptions()))


ROWS = np.arange(5000)
COLUMNS = {"t_s": ROWS / 1000, "depth_m": 1e-6 * ROWS, "force_N": 1e-3 * ROWS**0.5}
COLUMNS |= {
    "force_std_N": np.where(ROWS < HEAD_ROWS, np.nan, 0.1)
}  # for none in the first rows


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "npz", "parquet", "mcap"])
@pytest.mark.parametrize("size", [3000, 1 << 20])
def test_a_pipe_gives_what_the_file_gives(tmp_path, suffix, size):
    path = tmp_path / f"log.{suffix.removesuffix('.gz')}"
    pipe = tmp_path / "pipe"
    write_table(path, COLUMNS)
    data = (
        gzip.compress(path.read_bytes()) if suffix.endswith("gz") else path.read_bytes()
    )
    os.mkfifo(pipe)

    def write():
        with pipe.open("wb", buffering=0) as out:
            for at in range(0, len(data), size):
                out.write(data[at : at + size])

    writer = threading.Thread(target=write)
    writer.start()
    piped_log = LogStream(stream_tables(pipe, FollowOptions())).joined()
    writer.join()

    assert_all_the_same(piped_log, read_log(path))
    assert list(piped_log.channels) == ["depth_m", "force_N"]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            b"PK\x03\x04" + bytes(2000),
            "takes 0.002 MB unpacked, more than the limit of 0.001 MB",
        ),
        (b"PAR1" + bytes(500), "standard input is not a Parquet file"),
        (b"SQLi" + bytes(500), "standard input is not an SQLite file"),
    ],
)
def test_a_pipe_without_a_recording_is_refused(tmp_path, monkeypatch, data, message):
    path = tmp_path / "data"
    path.write_bytes(data)
    with path.open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        with pytest.raises(FormatError, match=message):
            list(stream_tables("-", FollowOptions(), max_bytes=1000))


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
def test_a_table_is_written_into_a_pipe(tmp_path, suffix):
    pipe = tmp_path / f"pipe.{suffix}"
    path = tmp_path / f"log.{suffix}"
    os.mkfifo(pipe)
    writer = threading.Thread(target=write_table, args=(pipe, COLUMNS))
    writer.start()
    path.write_bytes(pipe.read_bytes())
    writer.join()

    assert pipe.is_fifo()
    np.testing.assert_array_equal(read_log(path)["force_N"], COLUMNS["force_N"])
