"""Bags as robots record them, whole and cut: stamps, joints, topics as columns."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from needleforce.recordings import (
    ColumnError,
    ColumnMapping,
    FormatError,
    open_table,
    read_log,
    read_table,
)
from tests.needleforce.recordings.bag_samples import (
    START_NS,
    STEP_NS,
    TYPES,
    data_file,
    header,
    insertion_rows,
    joint_state,
    mapped,
    message,
    number,
    write_bag,
)

ROWS = 60
PANDA = [f"panda_joint{i}" for i in range(1, 8)]
Q_RAD = np.arange(ROWS)[:, None] * 0.01 + np.arange(7)


@pytest.mark.parametrize(
    ("names", "joints", "mapping", "row"),
    [
        (("elbow", "gripper", "base"), ("base", "elbow"), None, [1.2, 1.0]),
        (("elbow", "gripper", "base"), (), ("gripper", "elbow"), [1.1, 1.0]),
        (("b", "c", "a"), (), None, [1.0, 1.1, 1.2]),
        (("left_b", "finger", "left_a"), ("a", "b"), None, [1.2, 1.0]),
        (("joint_2", "x", "joint_1"), ("j_joint_1", "j_joint_2"), None, [1.2, 1.0]),
        (("l_b", "l_a", "r_b", "r_a"), ("a", "b"), ("r_*",), [1.3, 1.2]),
    ],
)
def test_joints_are_put_into_the_robots_order(tmp_path, names, joints, mapping, row):
    folder = write_bag(tmp_path / "bag", insertion_rows(4, names=names))
    chosen = ColumnMapping(joints=mapping or ())
    log = read_log(folder, chosen, required=["q", "tau"], joints=joints)

    np.testing.assert_allclose(log["q_rad"][1], row)
    np.testing.assert_allclose(log["tau_Nm"][1], 2.0 * np.array(row))
    is_exact = not joints or {*joints} <= {*names}
    assert len(log.warnings) == (not is_exact)


@pytest.mark.parametrize(
    ("names", "mapping"),
    [(("l_b", "l_a", "r_b", "r_a"), ()), (("a", "b"), ("c",)), (("x", "y"), ())],
)
def test_joints_that_are_not_clear_are_refused(tmp_path, names, mapping):
    folder = write_bag(tmp_path / "bag", insertion_rows(4, names=names))
    with pytest.raises(ColumnError, match="joint"):
        read_log(
            folder, ColumnMapping(joints=mapping), required=["q"], joints=("a", "b")
        )


def test_joints_follow_names_and_missing_ones_are_nan(tmp_path):
    orders = ["ab", "ba", "a", ["finger"]]
    places = {"a": 1.0, "b": 2.0, "finger": 3.0}
    rows = [
        ("/j", k, joint_state(k + 1, order, [places[name] for name in order]))
        for k, order in enumerate(orders)
    ]
    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"], joints=["a", "b"])

    np.testing.assert_array_equal(log["q_rad"], [[1.0, 2.0], [1.0, 2.0], [1.0, np.nan]])


def test_the_topic_of_the_robots_joints_is_read_or_the_mapped_one(tmp_path):
    rows = [
        (topic, k, joint_state(k, names, [k, factor * k], [k, k], [factor * k, k]))
        for k in range(1, 4)
        for topic, names, factor in (("/arm", "ab", 2.0), ("/hand", "xy", 3.0))
    ]
    folder = write_bag(tmp_path / "bag", rows)
    log = read_log(folder, required=["q", "tau"], optional=["dq"], joints=["b", "a"])
    assert log["q_rad"].tolist() == [[2.0, 1.0], [4.0, 2.0], [6.0, 3.0]]
    assert "dq_rad_s" in log

    mapping = mapped(q="/hand/position", tau="/hand/effort")
    log = read_log(folder, mapping, required=["q", "tau"])
    assert log["tau_Nm"][:, 0].tolist() == [3.0, 6.0, 9.0]
    for joints in ([], ["a", "x"]):
        with pytest.raises(ColumnError, match="/hand/position"):
            read_log(folder, required=["q", "tau"], joints=joints)


def test_a_bag_compressed_as_a_file_is_unpacked(tmp_path, monkeypatch):
    rows = list(insertion_rows(40))
    plain = read_log(write_bag(tmp_path / "plain", rows, storage="sqlite3"))
    packed = tmp_path / "packed"
    write_bag(packed, rows, storage="sqlite3", compression="FILE")
    log = read_log(packed)

    file = packed / "packed.db3.zstd"
    for read in (log, read_log(file)):
        for name, values in plain.channels.items():
            np.testing.assert_array_equal(read[name], values)

    size = data_file(tmp_path / "plain").stat().st_size
    monkeypatch.setattr("needleforce.recordings.errors.MAX_BYTES", size)
    read_log(file)
    for source in ([file, file], packed):
        with pytest.raises(FormatError, match="limit"):
            read_log(source)
        monkeypatch.setattr("needleforce.recordings.errors.MAX_BYTES", size - 1)


def test_efforts_that_no_message_holds_are_named(tmp_path):
    states = [("/j", k, joint_state(k, "ab", [k, k], [1, 1])) for k in range(1, 9)]
    with pytest.raises(ColumnError, match=r"/j/effort \(empty\)"):
        read_log(write_bag(tmp_path / "bag", states), required=["q", "tau"])


def test_a_topic_is_read_by_its_own_definition(tmp_path):
    definition = (
        "std_msgs/Header header\nfloat64[3] tau_j\ngeometry_msgs/Point tip\nint8 mode\n"
    )
    TYPES.register(get_types_from_msg(definition, "arm_msgs/msg/State"))
    tip = message("geometry_msgs/msg/Point", 4.0, 5.0, 6.0)
    torques = np.array([1.0, 2.0, 3.0])
    state = message("arm_msgs/msg/State", header(5, "base"), torques, tip, -7)
    folder = write_bag(tmp_path / "bag", [("/arm", 9, state)], storage="sqlite3")
    table = read_table(folder)

    assert table.stamps_ns["/arm"].tolist() == [5]
    assert {name: values.tolist() for name, values in table.columns.items()} == {
        "/arm/tau_j": [[1.0, 2.0, 3.0]],
        "/arm/tip_xyz": [[4.0, 5.0, 6.0]],
        "/arm/mode": [-7.0],
    }


@pytest.mark.slow
@pytest.mark.parametrize("is_split_by_topic", [False, True])
def test_a_bag_split_into_files_is_one_log(tmp_path, is_split_by_topic):
    rows = [
        row for row in insertion_rows(900) if row[0] in ("/joint_states", "/ft/wrench")
    ]
    halves = [rows[::2], rows[1::2]] if is_split_by_topic else [rows[:600], rows[600:]]
    whole = tmp_path / "whole"
    whole.mkdir()
    for i, messages in enumerate(halves):
        part = data_file(write_bag(tmp_path / f"part_{i}", messages))
        part.rename(whole / f"whole_{9 + i}.mcap")

    log = read_log(
        whole, mapped(force="/ft/wrench/force_xyz[2]"), required=["q", "force"]
    )

    np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(900.0))
    np.testing.assert_array_equal(log["force_N"], -np.arange(900.0))


def test_slower_topics_are_interpolated_to_the_fastest(tmp_path):
    rows = [("/force_mN", k, number(k)) for k in range(0, 1000, 10)]
    rows += [("/depth_mm", k, number(2.0 * k)) for k in range(0, 1000, 100)]
    log = read_log(write_bag(tmp_path / "bag", sorted(rows, key=lambda row: row[1])))

    np.testing.assert_allclose(log["depth_m"][:91], 0.02 * np.arange(91))
    assert np.isnan(log["depth_m"][91:]).all()


def test_a_bag_that_is_cut_is_read_up_to_there(tmp_path):
    whole = tmp_path / "whole.mcap"
    q_rad = np.arange(12_000.0).reshape(6000, 2)
    with open_table(whole) as table:
        for rows in np.split(np.arange(6000), 60):
            table.append({"t_s": rows / 1000, "q_rad": q_rad[rows]})
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    table = read_table(cut)
    position = table.columns["/joint_states/position"]

    assert 2000 < len(position) < 6000
    np.testing.assert_array_equal(position, q_rad[: len(position)])
    assert "cut.mcap" in table.warnings[0]


@pytest.mark.parametrize("name", ["x.mcap", "x.db3", "x.bag"])
def test_a_bag_without_a_message_or_no_bag_is_refused(tmp_path, name):
    folder = write_bag(tmp_path / "bag", insertion_rows(20))
    path = tmp_path / name
    path.write_bytes(data_file(folder).read_bytes()[:40])
    with pytest.raises(FormatError, match=name):
        read_table(path)


def test_a_bad_or_missing_stamp_in_a_bag_costs_only_its_message(tmp_path):
    rows = []
    for k in range(ROWS):
        log_ns = START_NS + k * STEP_NS
        # The recorder's clock is 10 ms ahead of that of the source.
        stamp_ns = {30: log_ns + 400 * 10**9, 40: 0}.get(k, log_ns - 10**7)
        rows.append(("/joint_states", log_ns, joint_state(stamp_ns, PANDA, Q_RAD[k])))

    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"])

    np.testing.assert_allclose(log["q_rad"], np.delete(Q_RAD, 30, axis=0))
    expected_s = 1e-9 * STEP_NS * np.delete(np.arange(ROWS), 30)
    np.testing.assert_allclose(log.t_s - log.t_s[0], expected_s, atol=1e-9)


FRANKA_STATE = """std_msgs/Header header
float64[7] q
float64[7] q_d
float64[7] dq
float64[7] tau_J
float64[7] tau_J_d
float64[7] tau_ext_hat_filtered
uint8 ROBOT_MODE_OTHER=0
uint8 robot_mode
"""


@pytest.mark.parametrize("compression", [None, "LZ4", "BZ2"])
def test_states_of_a_franka_in_ros1_are_found_beside_joint_states(
    tmp_path, compression
):
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(get_types_from_msg(FRANKA_STATE, "franka_msgs/msg/FrankaState"))
    make = types.types
    bag = Writer(tmp_path / "arm.bag")
    if compression is not None:
        bag.set_compression(Writer.CompressionFormat[compression])

    kinds = ("franka_msgs/msg/FrankaState", "sensor_msgs/msg/JointState")
    with bag:
        arm, joints = (
            bag.add_connection(topic, kind, typestore=types)
            for topic, kind in zip(("/states", "/joint_states"), kinds, strict=True)
        )
        for k, q in enumerate(Q_RAD):
            stamp = divmod(START_NS + k * STEP_NS, 1_000_000_000)
            time = make["builtin_interfaces/msg/Time"](*stamp)
            head = make["std_msgs/msg/Header"](k, time, "base")
            signals = (q, 0 * q, 2.0 * q, 3.0 * q, 0 * q, 4.0 * q)
            state = make[kinds[0]](head, *signals, 0)
            other = make[kinds[1]](head, PANDA, 9.0 * q, 0 * q, 0 * q)
            for connection, content in ((arm, state), (joints, other)):
                data = types.serialize_ros1(content, content.__msgtype__)
                bag.write(connection, START_NS + k * STEP_NS + 500, data)

    log = read_log(
        tmp_path / "arm.bag", required=["q", "tau"], optional=["dq"], joints=PANDA
    )
    for name, factor in (("q_rad", 1), ("dq_rad_s", 2), ("tau_Nm", 3)):
        np.testing.assert_allclose(log[name], factor * Q_RAD)

    assert log.start_ns == START_NS
    assert log.warnings == ()
