"""Bags as they are written: standard messages, valid for others, equal when read back."""

import shutil
import sqlite3

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.rosbag2 import Reader

from needleforce.recordings import FileAccessError, LogError, read_log, read_table, write_table
from needleforce.recordings.output import open_table
from needleforce.recordings.table import Labels

START_NS = 1_700_000_000_123_456_789
SUFFIXES = (".mcap", ".db3")


@pytest.fixture(params=SUFFIXES)
def path(request, tmp_path):
    return tmp_path / f"out{request.param}"


def joint_columns(rows=20):
    rng = np.random.default_rng(3)
    return {
        "t_s": np.arange(rows) / 1000,
        "q_rad": rng.normal(size=(rows, 2)),
        "dq_rad_s": rng.normal(size=(rows, 2)),
        "tau_Nm": rng.normal(size=(rows, 2)),
        "ft_force_N": rng.normal(size=(rows, 3)),
        "ft_torque_Nm": rng.normal(size=(rows, 3)),
    }


def estimate_columns(rows=20):
    rng = np.random.default_rng(4)
    columns = {"t_s": np.arange(rows) / 1000, "axial_N": rng.normal(size=rows)}
    for xyz in "xyz":
        columns[f"force_{xyz}_in_base_N"] = rng.normal(size=rows)
    return columns | {"status": np.arange(rows) // 7}


def messages_of(path, topic):
    with AnyReader([path]) as bag:
        connections = [c for c in bag.connections if c.topic == topic]
        return [
            (stamp_ns, bag.deserialize(data, connection.msgtype))
            for connection, stamp_ns, data in bag.messages(connections=connections)
        ]


def test_joint_signals_are_joint_states_and_a_wrench(path):
    columns = joint_columns()
    write_table(path, columns, labels=Labels(joint_names=("a", "b"), start_ns=START_NS))
    for k, (stamp_ns, state) in enumerate(messages_of(path, "/joint_states")):
        assert stamp_ns == START_NS + k * 1_000_000
        assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == stamp_ns
        assert state.name == ["a", "b"]
        for field, name in (("position", "q_rad"), ("velocity", "dq_rad_s"), ("effort", "tau_Nm")):
            np.testing.assert_array_equal(getattr(state, field), columns[name][k])
    for k, (_, wrench) in enumerate(messages_of(path, "/ft_sensor/wrench")):
        assert wrench.header.frame_id == "ft_sensor"
        assert [wrench.wrench.force.x, wrench.wrench.torque.z] == [
            columns["ft_force_N"][k, 0],
            columns["ft_torque_Nm"][k, 2],
        ]


def test_an_arm_without_velocities_sends_none(path):
    columns = {k: v for k, v in joint_columns().items() if k != "dq_rad_s"}
    write_table(path, columns)
    (_, state), *_ = messages_of(path, "/joint_states")
    assert state.velocity.size == 0
    assert state.name == ["joint_1", "joint_2"]


def test_estimates_are_a_wrench_and_numbers(path):
    columns = estimate_columns()
    write_table(path, columns, labels=Labels(frame="base"))
    (_, wrench), *_ = messages_of(path, "/needleforce/wrench")
    assert wrench.header.frame_id == "base"
    assert wrench.wrench.force.y == columns["force_y_in_base_N"][0]
    assert wrench.wrench.torque.x == 0.0
    axial = [message.data for _, message in messages_of(path, "/needleforce/axial_N")]
    assert axial == columns["axial_N"].tolist()


def test_events_are_diagnostic_messages_where_a_value_changes(path):
    texts = ("", "begun", "layer {}")
    with open_table(path, labels=lambda: Labels(events={"status": texts})) as table:
        for value in (0, 0, 1, 1, 3, 3):
            table.append({"t_s": [0.1], "status": np.array([value])})
    reported = [message.status[0] for _, message in messages_of(path, "/diagnostics")]
    assert [status.message for status in reported] == ["begun", "layer 3"]
    assert [status.level for status in reported] == [1, 1]
    assert reported[1].values[0].value == "3"


def test_metadata_quality_of_service_and_definitions_are_there(path):
    write_table(path, joint_columns())
    with Reader(path) as bag:
        assert bag.message_count == 40
        assert bag.duration == 19_000_001
        for connection in bag.connections:
            assert connection.msgdef.data
            (quality,) = connection.ext.offered_qos_profiles
            assert quality.reliability == QosReliability.RELIABLE
            assert quality.history == QosHistory.KEEP_LAST
            assert quality.durability == QosDurability.VOLATILE
    if path.suffix == ".db3":
        text = (path / "metadata.yaml").read_text()
        assert "storage_identifier: sqlite3" in text
        assert "version: 8" in text
        assert "type_description_hash" in text
        assert sorted(p.name for p in path.iterdir()) == ["metadata.yaml", "out.db3"]
        with sqlite3.connect(path / "out.db3") as connection:
            assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        connection.close()


@settings(max_examples=20)
@given(
    values=arrays(np.float64, st.tuples(st.integers(1, 20), st.integers(1, 3))),
    steps_ns=st.lists(st.integers(1, 10**10), min_size=20, max_size=20),
    start_ns=st.sampled_from([0, 5, START_NS]),
    suffix=st.sampled_from(SUFFIXES),
)
def test_numbers_and_stamps_read_back_bit_for_bit(
    tmp_path_factory, values, steps_ns, start_ns, suffix
):
    path = tmp_path_factory.mktemp("bag") / f"x{suffix}"
    since_ns = np.cumsum([0, *steps_ns])[: len(values)]
    columns = {"t_s": since_ns / 1e9, "q_rad": values, "other": values[:, 0]}
    write_table(path, columns, labels=Labels(start_ns=start_ns))
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["/joint_states/position"], values)
    np.testing.assert_array_equal(table.columns["/needleforce/other"], values[:, 0])
    found_ns = table.start_ns + np.rint(table.columns["t_s"] * 1e9).astype(np.int64)
    assert found_ns.tolist() == (start_ns + since_ns).tolist()
    assert table.warnings == ()


def test_chunks_make_the_same_bag_as_the_whole(path, tmp_path):
    columns = joint_columns() | estimate_columns()
    write_table(path, columns)
    pieces = tmp_path / f"pieces{path.suffix}"
    with open_table(pieces) as table:
        for rows in (slice(0, 1), slice(1, 13), slice(13, 20)):
            table.append({name: values[rows] for name, values in columns.items()})
    one, other = read_table(path), read_table(pieces)
    assert one.columns.keys() == other.columns.keys()
    for name, values in one.columns.items():
        np.testing.assert_array_equal(values, other.columns[name])


def test_what_is_written_is_read_without_a_mapping(path):
    columns = joint_columns()
    write_table(path, columns)
    log = read_log(path, required=["q", "tau"], optional=["dq"])
    np.testing.assert_array_equal(log["dq_rad_s"], columns["dq_rad_s"])
    np.testing.assert_array_equal(log["tau_Nm"], columns["tau_Nm"])


def test_an_existing_bag_is_replaced_only_by_a_whole_one(path):
    write_table(path, estimate_columns(5))
    with open_table(path) as table:
        table.append(estimate_columns(20))
        assert read_table(path).columns["t_s"].size == 5
    assert read_table(path).columns["t_s"].size == 20
    with pytest.raises(LogError):
        write_table(path, {"t_s": [np.nan]})
    assert read_table(path).columns["t_s"].size == 20
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("columns", "reported"),
    [
        ({"axial_N": [1.0]}, "a bag needs time stamps: a column t_s"),
        ({"t_s": [0.0, np.nan]}, "one is not finite"),
        ({"t_s": [-1.0, 0.0]}, "before zero; t_s reaches -1.0 s"),
    ],
)
def test_what_no_bag_can_hold_is_refused(path, columns, reported):
    with pytest.raises(LogError, match=reported):
        write_table(path, columns)
    assert not path.exists()


@pytest.mark.parametrize("name", ["x.mcap", "x.db3"])
def test_a_place_that_cannot_be_written_is_reported(tmp_path, name):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileAccessError, match="cannot write"):
        write_table(tmp_path / "file" / name, {"t_s": [0.0]})


def test_copies_of_a_bag_read_the_same(tmp_path):
    write_table(tmp_path / "a.db3", joint_columns())
    shutil.copytree(tmp_path / "a.db3", tmp_path / "b")
    assert read_table(tmp_path / "b").columns["t_s"].size == 20
