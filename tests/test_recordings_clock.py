"""Source time stamps: whole nanoseconds that survive seconds in float64, in every format."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings import Log, read_log, write_log, write_table
from needleforce.recordings.timestamps import start_of_clock, to_nanoseconds, to_seconds
from needleforce.recordings.log import LogStream
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.open_recording import stream_tables

SUFFIXES = ("csv", "csv.gz", "npz", "parquet", "mcap", "db3")
EPOCH_NS = 1_700_000_000_123_456_789


@given(
    first_ns=st.one_of(st.integers(0, 1 << 40), st.integers(1 << 60, (1 << 62) - 1)),
    since_ns=st.lists(st.integers(0, 86_400 * 10**9), min_size=1, max_size=20),
)
def test_stamps_come_back_from_seconds(first_ns, since_ns):
    stamps_ns = np.array([first_ns, *(first_ns + step for step in since_ns)])
    start_ns = start_of_clock(first_ns)
    assert to_nanoseconds(to_seconds(stamps_ns, start_ns), start_ns).tolist() == stamps_ns.tolist()
    assert start_ns in (0, first_ns)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("start_ns", [0, EPOCH_NS])
def test_every_format_keeps_the_clock_of_the_source(tmp_path, suffix, start_ns):
    stamps_ns = start_ns + np.cumsum(np.arange(300)) * 1_000_003
    log = Log(
        t_s=to_seconds(stamps_ns, start_ns),
        channels={"q_rad": np.zeros((300, 2))},
        start_ns=start_ns,
    )
    path = tmp_path / f"log.{suffix}"
    write_log(path, log)
    again = read_log(path, required=["q"])
    assert to_nanoseconds(again.t_s, again.start_ns).tolist() == stamps_ns.tolist()
    stream = LogStream(stream_tables(path, FollowOptions()), required=["q"])
    t_s = np.concatenate([chunk.t_s for chunk in stream])
    assert to_nanoseconds(t_s, stream.start_ns).tolist() == stamps_ns.tolist()


def test_the_comment_of_a_csv_is_read_and_others_are_not(tmp_path):
    path = tmp_path / "log.csv"
    for comment, start_ns in (("# start_ns = 17", 17), ("#start_ns=-3", -3), ("# start_ns = x", 0)):
        path.write_text(f"{comment}\nt,force\n0.0,1\n0.1,2\n", encoding="utf-8")
        assert read_log(path).start_ns == start_ns


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "npz", "parquet"])
@pytest.mark.parametrize("is_ragged", [False, True])
def test_whole_nanoseconds_since_the_epoch_lose_no_digit(tmp_path, suffix, is_ragged):
    stamps_ns = EPOCH_NS + np.cumsum(np.arange(5000)) % 7 + 1_000_003 * np.arange(5000)
    path = tmp_path / f"log.{suffix}"
    write_table(path, {"time [ns]": stamps_ns, "force_N": np.ones(5000)})
    if is_ragged and suffix == "csv":
        lines = path.read_text().splitlines()
        lines[3000:3000] = ["1,2,3", f"{EPOCH_NS}"]
        path.write_text("\n".join(lines) + "\n")
    log = read_log(path)
    assert to_nanoseconds(log.t_s, log.start_ns).tolist() == stamps_ns.tolist()
    stream = LogStream(stream_tables(path, FollowOptions()))
    t_s = np.concatenate([chunk.t_s for chunk in stream])
    assert to_nanoseconds(t_s, stream.start_ns).tolist() == stamps_ns.tolist()
    write_log(tmp_path / "log.mcap", log)
    again = read_log(tmp_path / "log.mcap")
    assert to_nanoseconds(again.t_s, again.start_ns).tolist() == stamps_ns.tolist()


@pytest.mark.parametrize("row", [100, 4000])
def test_a_stamp_that_is_no_whole_number_costs_digits_but_no_second(tmp_path, row):
    path = tmp_path / "log.csv"
    stamps_ns = [EPOCH_NS + 1_000_000 * k for k in range(5000)]
    lines = [f"{stamp},1.0" for stamp in stamps_ns]
    lines[row] = "oops,1.0"
    path.write_text("\n".join(["time_ns,force_N", *lines]) + "\n")
    t_s = np.concatenate([chunk.t_s for chunk in LogStream(stream_tables(path, FollowOptions()))])
    assert len(t_s) == 4999
    expected_s = np.delete(1e-3 * np.arange(5000), row)
    np.testing.assert_allclose(t_s - t_s[0], expected_s, atol=2e-6)
