"""What is written reads back, bags are valid for others, a failed write leaves no
trace."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from needleforce.recordings import (
    FileAccessError,
    Log,
    LogError,
    TableLabels,
    check_outputs,
    check_writable,
    open_table,
    read_log,
    read_table,
    write_log,
    write_table,
)
from tests.needleforce.recordings.bag_samples import START_NS

T_S = np.arange(3) / 1000.0


@pytest.mark.slow
@settings(max_examples=60)
@given(
    values=arrays(np.float64, st.tuples(st.integers(2, 20), st.integers(1, 3))),
    steps_ns=st.lists(st.integers(1, 10**10), min_size=20, max_size=20),
    start_ns=st.sampled_from([0, 5, START_NS]),
    suffix=st.sampled_from(("csv", "npz", "parquet", "mcap")),
)
def test_numbers_and_stamps_read_back_bit_for_bit(
    tmp_path_factory, values, steps_ns, start_ns, suffix
):
    since_ns = np.cumsum([0, *steps_ns])[: len(values)]
    values[0] = np.arange(values.shape[1])
    assume(np.isfinite(values).all(axis=1).mean() > 0.8)  # else of two clocks
    channels = {"q_rad": values, "tau_Nm": values[::-1], "depth_m": values[:, 0]}
    path = tmp_path_factory.mktemp("log") / f"x.{suffix}"
    write_log(path, Log(t_s=since_ns / 1e9, channels=channels, start_ns=start_ns))
    log = read_log(path)
    for name, numbers in channels.items():
        np.testing.assert_array_equal(log[name], numbers)

    assert list(log.channels) == list(channels)

    found_ns = log.start_ns + np.rint(log.t_s * 1e9).astype(np.int64)

    assert found_ns.tolist() == (start_ns + since_ns).tolist()


def test_csv_numbers_two_dimensional_columns_and_quotes_names(tmp_path):
    path = tmp_path / "t.csv"
    write_table(
        path, {"n": [1, 2], "on": [True, False], "w, z": np.array([[0.1, 0.2], [1, 2]])}
    )

    assert path.read_text() == 'n,on,"w, z_1","w, z_2"\n1,1,0.1,0.2\n2,0,1.0,2.0\n'
    assert list(read_table(path).columns) == ["n", "on", "w, z_1", "w, z_2"]


@pytest.mark.parametrize("old", [None, {"t_s": [1.0]}])
@pytest.mark.parametrize(
    ("suffix", "columns"),
    [
        ("csv", {}),
        ("csv", {"#t": T_S}),
        ("csv", {" ": T_S}),
        ("csv", {"t": T_S, "f": T_S[:2]}),
        ("csv", {"t": ["a", "b"]}),
        ("csv", {"t": np.zeros((2, 2, 2))}),
        ("csv", {"q": np.zeros((3, 2)), "q_1": T_S}),
        ("mcap", {"axial_N": [1.0]}),
        ("mcap", {"t_s": [0.0, np.nan]}),
        ("mcap", {"t_s": [-1.0, 0.0]}),
    ],
)
def test_unwritable_tables_leave_old_files(tmp_path, old, suffix, columns):
    path = tmp_path / f"t.{suffix}"
    if old:
        write_table(path, old)

    contents = {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()}
    with pytest.raises(LogError):
        write_table(path, columns)

    assert {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()} == contents


def test_a_failing_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "t.csv"
    write_table(path, {"old": [1.0]})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)

    with pytest.raises(FileAccessError, match="space"):
        write_table(path, {"new": [2.0]})

    assert path.read_text() == "old\n1.0\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["t.csv"]


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_rows_appended_are_rows_written_at_once(tmp_path, suffix):
    rng = np.random.default_rng(5)
    columns = {
        "t_s": np.arange(50.0),
        "q_rad": rng.normal(size=(50, 7)),
        "status": np.arange(50),
    }
    write_table(tmp_path / f"once.{suffix}", columns)
    path = tmp_path / f"pieces.{suffix}"
    with open_table(path) as table:
        for start in range(0, 50, 7):
            table.append(
                {name: values[start : start + 7] for name, values in columns.items()}
            )

    assert path.read_bytes() == (tmp_path / f"once.{suffix}").read_bytes()

    if suffix == "npz":
        assert np.load(path)["status"].dtype == columns["status"].dtype


@pytest.mark.parametrize(
    "later",
    [
        {"t": T_S},
        {"t": T_S, "x": T_S},
        {"f": T_S, "t": T_S},
        {"t": T_S, "f": [1, 2, 3]},
    ],
)
def test_rows_with_other_columns_are_refused(tmp_path, later):
    with open_table(tmp_path / "t.csv") as table:
        table.append({"t": T_S, "f": T_S})
        with pytest.raises(LogError, match="columns"):
            table.append(later)

    assert len(read_table(tmp_path / "t.csv").columns["t"]) == 3


@pytest.fixture
def path(tmp_path):
    return tmp_path / "out.mcap"


def joint_columns():
    rng = np.random.default_rng(3)
    sizes = {"q_rad": 2, "dq_rad_s": 2, "tau_Nm": 2, "ft_force_N": 3, "ft_torque_Nm": 3}
    signals = {name: rng.normal(size=(20, size)) for name, size in sizes.items()}
    return {"t_s": np.arange(20) / 1000, **signals}


def estimate_columns(rows=20):
    rng = np.random.default_rng(4)
    columns = {"t_s": np.arange(rows) / 1000, "axial_N": rng.normal(size=rows)}
    columns |= {f"force_{xyz}_in_base_N": rng.normal(size=rows) for xyz in "xyz"}
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
    write_table(
        path, columns, labels=TableLabels(joint_names=("a", "b"), start_ns=START_NS)
    )
    for k, (stamp_ns, state) in enumerate(messages_of(path, "/joint_states")):
        assert stamp_ns == START_NS + k * 1_000_000
        assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == stamp_ns
        assert state.name == ["a", "b"]
        for field, name in (
            ("position", "q_rad"),
            ("velocity", "dq_rad_s"),
            ("effort", "tau_Nm"),
        ):
            np.testing.assert_array_equal(getattr(state, field), columns[name][k])

    for k, (_, wrench) in enumerate(messages_of(path, "/ft_sensor/wrench")):
        assert wrench.header.frame_id == "ft_sensor"
        assert [wrench.wrench.force.x, wrench.wrench.torque.z] == [
            columns["ft_force_N"][k, 0],
            columns["ft_torque_Nm"][k, 2],
        ]


def test_estimates_are_a_wrench_and_numbers(path):
    columns = estimate_columns()
    write_table(path, columns, labels=TableLabels(frame="base"))
    (_, wrench), *_ = messages_of(path, "/needleforce/wrench")

    assert wrench.header.frame_id == "base"
    assert wrench.wrench.force.y == columns["force_y_in_base_N"][0]
    assert wrench.wrench.torque.x == 0.0

    axial = [message.data for _, message in messages_of(path, "/needleforce/axial_N")]

    assert axial == columns["axial_N"].tolist()


def test_definitions_are_there_and_joints_without_names_are_numbered(path):
    write_table(path, {k: v for k, v in joint_columns().items() if k != "dq_rad_s"})
    with Reader(path) as bag:
        assert bag.message_count == 40
        assert all(connection.msgdef.data for connection in bag.connections)

    (_, state), *_ = messages_of(path, "/joint_states")
    assert state.velocity.size == 0
    assert state.name == ["joint_1", "joint_2"]


def test_an_existing_bag_is_replaced_only_whole(path):
    write_table(path, estimate_columns(5))
    with open_table(path) as table:
        table.append(estimate_columns(20))
        assert read_table(path).columns["/needleforce/axial_N"].size == 5

    assert read_table(path).columns["/needleforce/axial_N"].size == 20
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet", "mcap"])
@pytest.mark.parametrize("is_live", [False, True])
def test_a_file_that_is_there_is_replaced_only_if_asked(tmp_path, suffix, is_live):
    path = tmp_path / f"x.{suffix}"
    path.write_text("old")
    with (
        pytest.raises(FileAccessError, match="exists"),
        open_table(path, is_live=is_live, overwrites=False) as table,
    ):
        table.append({"t_s": T_S})
    with pytest.raises(FileAccessError, match="exists"):
        check_writable(path, overwrites=False)

    assert path.read_text() == "old"


@pytest.mark.parametrize(
    ("outputs", "source"),
    [
        (("x.csv", "x.csv"), "log.csv"),
        (("link.csv", "x.csv"), "log.csv"),
        (("log.csv",), "log.csv"),
        (("bag/x.csv",), "bag"),
        (("bag",), "bag/log.csv"),
    ],
)
def test_outputs_never_replace_each_other_or_the_log(tmp_path, outputs, source):
    (tmp_path / "bag").mkdir()
    for name in ("log.csv", "x.csv", "bag/log.csv"):
        (tmp_path / name).write_text("old")
    (tmp_path / "link.csv").hardlink_to(tmp_path / "x.csv")
    paths = {f"--{k}": tmp_path / name for k, name in enumerate(outputs)}

    with pytest.raises(FileAccessError, match="--0"):
        check_outputs(paths, [tmp_path / source])
    check_outputs(
        {"-o": tmp_path / "new.csv", "-p": tmp_path / "n.csv"}, [tmp_path / source]
    )
