"""A bag that is followed while it is recorded gives what the finished file gives."""

import threading
import time

import numpy as np
import pytest

from needleforce.recordings import FileAccessError, FormatError, read_log
from needleforce.recordings.bags.mcap_file import MAGIC
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.open_recording import stream_tables
from tests.needleforce.recordings.bag_samples import (
    ASKED,
    END,
    HEADER,
    MAX_WAIT_S,
    START_NS,
    assert_same,
    data_file,
    followed,
    grow,
    in_pieces,
    insertion_rows,
    joint_state,
    mapped,
    number,
    without_chunks,
    wrench,
    write_bag,
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "zstd", "without chunks"])
@pytest.mark.parametrize("count", [3, 41])
def test_growing_and_finished_bags_give_the_same(tmp_path, kind, count):
    compression = "STORAGE" if kind == "zstd" else None
    bag = write_bag(tmp_path / "bag", insertion_rows(3000), compression=compression)
    data = (
        without_chunks(bag) if kind == "without chunks" else data_file(bag).read_bytes()
    )
    path = tmp_path / "growing.mcap"
    writer = grow(path, in_pieces(data, count))
    start_s = time.monotonic()
    growing_log = followed(path)
    writer.join()

    # It ended because the recorder finished the file, not because nothing came.
    assert time.monotonic() - start_s < 0.8 * MAX_WAIT_S

    log = read_log(path, **ASKED)

    assert len(log) == 3000
    assert_same(growing_log, log)
    assert "cut short" not in "".join(growing_log.warnings)


def test_rows_come_while_the_recorder_still_writes(tmp_path):
    data = without_chunks(write_bag(tmp_path / "bag", insertion_rows(3000)))
    path = tmp_path / "growing.mcap"
    go_on = threading.Event()
    half = len(data) // 2
    writer = grow(path, [data[:half], data[half:]], go_on=go_on)
    options = FollowOptions(follow=True, idle_s=MAX_WAIT_S)
    tables = stream_tables(path, options, ChannelRequest(**ASKED))
    rows = 0
    early_rows = None
    for table in tables:
        rows += len(table.columns["t_s"])
        if rows > 1400 and early_rows is None:
            early_rows = rows
            go_on.set()

    writer.join()

    assert 1400 < early_rows < 1600
    assert rows == 3000


@pytest.mark.slow
def test_only_an_idle_end_reports_an_unfinished_file(
    tmp_path,
):
    data = without_chunks(write_bag(tmp_path / "bag", insertion_rows(3000)))
    path = tmp_path / "growing.mcap"
    path.write_bytes(data[: len(data) * 2 // 3 + 7])
    cut = followed(path, FollowOptions(follow=True, idle_s=0.2))

    assert "growing.mcap is cut short" in cut.warnings
    assert 1900 < len(cut) < 2100

    is_over = threading.Event()
    options = FollowOptions(follow=True, should_stop=is_over.is_set)
    timer = threading.Timer(0.5, is_over.set)
    timer.start()
    stopped = followed(path, options)

    assert len(stopped) == len(cut)
    assert "cut short" not in "".join(stopped.warnings)


@pytest.mark.parametrize(
    ("name", "data", "error", "message"),
    [
        (
            "x.db3",
            None,
            FileAccessError,
            r"(?s)x.db3 cannot be followed.*ros2 bag record -s mcap",
        ),
        ("x.mcap", None, FileAccessError, r"cannot read .*x.mcap: No such file"),
        ("bag", None, FileAccessError, r"(?s)is a folder.*name the file itself"),
        ("x.mcap", b"", FormatError, "x.mcap is empty"),
        ("x.mcap", b"0123456789", FormatError, "is not an MCAP file"),
        ("x.mcap", MAGIC + HEADER, FormatError, "holds no messages"),
    ],
)
def test_unfollowable_sources_are_refused_with_advice(
    tmp_path, name, data, error, message
):
    if name == "bag":
        write_bag(tmp_path / name, insertion_rows(3))
    if data is not None:
        (tmp_path / name).write_bytes(data)

    with pytest.raises(error, match=message):
        list(stream_tables(tmp_path / name, FollowOptions(follow=True, idle_s=0.1)))


STEP_NS = 10_000_000


def late_topic(first):
    """Joint states for 6 s; depths from the message `first` on."""
    for k in range(600):
        t_ns = START_NS + k * STEP_NS
        yield "/joint_states", t_ns, joint_state(t_ns, "ab", (k, k), (), (k, k))
        if k >= first:
            yield "/depth_mm", t_ns, number(k)


def test_a_late_topic_is_awaited_and_reported_once(tmp_path):
    path = tmp_path / "growing.mcap"
    reported = []
    data_file(write_bag(tmp_path / "bag", late_topic(350))).rename(path)
    options = FollowOptions(follow=True, idle_s=MAX_WAIT_S, warn=reported.append)

    assert_same(followed(path, options), read_log(path, **ASKED))
    assert reported == [
        "growing.mcap: waiting for more topics; "
        "needed are q, tau, depth, and until now there are "
        "/joint_states"
    ]


FORCE = {"required": ("q", "force")}
FORCE_MAPPING = mapped(force="/ft/force_xyz[2]")


def arm_and_force(count, late_ns=0, force_ends=None):
    """Joint states, and forces that reach the recorder later than their stamps say."""
    rows = []
    for k in range(count):
        t_ns = START_NS + k * STEP_NS
        rows.append(("/joint_states", t_ns, joint_state(t_ns, "ab", (k, -k))))
        if force_ends is None or k < force_ends:
            rows.append(("/ft", t_ns + late_ns, wrench(t_ns, (0.0, 0.0, k))))

    return sorted(rows, key=lambda row: row[1])


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.0, 0.3, 0.9])
def test_topics_that_reach_the_recorder_late_lose_nothing(tmp_path, late_s):
    data = without_chunks(
        write_bag(tmp_path / "bag", arm_and_force(500, round(1e9 * late_s)))
    )
    path = tmp_path / "growing.mcap"
    writer = grow(path, in_pieces(data, 60))
    growing_log = followed(path, mapping=FORCE_MAPPING, **FORCE)
    writer.join()

    np.testing.assert_array_equal(growing_log["force_N"], np.arange(500.0))
    assert_same(growing_log, read_log(path, FORCE_MAPPING, **FORCE))


def test_rows_do_not_wait_for_ended_topics(tmp_path):
    data = without_chunks(
        write_bag(tmp_path / "bag", arm_and_force(800, force_ends=300))
    )
    path = tmp_path / "growing.mcap"
    is_over = threading.Event()
    path.write_bytes(data[: -len(END)])
    options = FollowOptions(follow=True, should_stop=is_over.is_set)
    tables = stream_tables(
        path, options, ChannelRequest(mapping=FORCE_MAPPING, **FORCE)
    )
    timer = threading.Timer(MAX_WAIT_S, is_over.set)
    timer.start()
    first = next(tables)
    timer.cancel()

    # All but those of the last second, which is how late a topic may be.
    assert len(first.columns["t_s"]) == 699
    assert np.isfinite(first.columns["/ft/force_xyz"][:300]).all()
    assert np.isnan(first.columns["/ft/force_xyz"][300:]).all()

    is_over.set()

    assert sum(len(table.columns["t_s"]) for table in tables) == 101
