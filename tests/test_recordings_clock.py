"""Source time stamps: whole nanoseconds that survive seconds in float64, in every format."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recordings import Log, read_log, write_log
from recordings.byte_source import Patience
from recordings.log_stream import LogStream
from recordings.nanoseconds import start_of_clock, to_nanoseconds, to_seconds
from recordings.table_stream import stream_tables

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
    stream = LogStream(stream_tables(path, Patience()), required=["q"])
    t_s = np.concatenate([chunk.t_s for chunk in stream])
    assert to_nanoseconds(t_s, stream.start_ns).tolist() == stamps_ns.tolist()


def test_the_comment_of_a_csv_is_read_and_others_are_not(tmp_path):
    path = tmp_path / "log.csv"
    for comment, start_ns in (("# start_ns = 17", 17), ("#start_ns=-3", -3), ("# start_ns = x", 0)):
        path.write_text(f"{comment}\nt,force\n0.0,1\n0.1,2\n", encoding="utf-8")
        assert read_log(path).start_ns == start_ns
