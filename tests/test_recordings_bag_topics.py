"""Topics of a bag become rows: different rates, several publishers, pieces."""

import numpy as np
import pytest
from bag_samples import (
    TYPES,
    insertion_rows,
    joint_state,
    number,
    write_bag,
)
from mappings import mapped

from needleforce.recordings import (
    ColumnError,
    ColumnMapping,
    read_log,
)
from needleforce.recordings.bag_reader import bag_tables
from needleforce.recordings.mapping import ChannelRequest
from needleforce.recordings.log import LogStream


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "bag"


def test_names_decide_when_their_order_changes_and_missing_joints_are_nan(folder):
    orders = ["ab", "ba", "a"]
    places = {"a": 1.0, "b": 2.0}
    rows = [
        ("/j", k, joint_state(k + 1, order, [places[name] for name in order]))
        for k, order in enumerate(orders)
    ]
    log = read_log(write_bag(folder, rows), required=["q"])
    np.testing.assert_array_equal(log["q_rad"], [[1.0, 2.0], [1.0, 2.0], [1.0, np.nan]])
    assert "/j: messages that lack joints: 1" in log.warnings


def test_messages_of_a_gripper_on_the_same_topic_are_left_out(folder):
    rows = []
    for k in range(1, 6):
        rows.append(("/j", k, joint_state(10 * k, "ab", [k, k])))
        rows.append(("/j", k, joint_state(10 * k + 5, ["finger"], [0.5])))
    log = read_log(write_bag(folder, rows), required=["q"], joints=["a", "b"])
    np.testing.assert_array_equal(log["q_rad"][:, 0], np.arange(1.0, 6.0))
    assert "/j: messages without any of the joints, left out: 5" in log.warnings


def test_slower_topics_are_interpolated_to_the_stamps_of_the_fastest(folder):
    rows = [("/force", k, number(k)) for k in range(0, 1000, 10)]
    rows += [("/depth", k, number(2.0 * k)) for k in range(0, 1000, 100)]
    log = read_log(write_bag(folder, sorted(rows, key=lambda row: row[1])))
    np.testing.assert_allclose(log["depth_m"][:91], 20.0 * np.arange(91))
    assert np.isnan(log["depth_m"][91:]).all()
    assert "rows are the messages of /force" in log.warnings[0]
    assert "/depth" in log.warnings[0]


def test_the_mapping_may_choose_the_clock(folder):
    write_bag(folder, insertion_rows(40))
    mapping = ColumnMapping(
        reference_topic="/depth_mm", channels=mapped(force="/ft/wrench/force_xyz[2]").channels
    )
    log = read_log(folder, mapping, required=["depth", "force"])
    np.testing.assert_allclose(log["force_N"], [-0.0, -10.0, -20.0, -30.0], atol=2e-3)
    with pytest.raises(ColumnError, match="'/none' is no topic that can be read; topics are"):
        read_log(folder, ColumnMapping(reference_topic="/none"), required=["depth"])


def test_nothing_is_interpolated_across_a_gap(folder):
    rows = [("/force", k * 10_000_000, number(1.0)) for k in range(200)]
    rows += [("/depth", k * 10_000_000, number(0.0)) for k in (*range(50), *range(150, 200))]
    log = read_log(write_bag(folder, sorted(rows, key=lambda row: row[1])))
    assert np.isnan(log["depth_m"][50:150]).all()
    assert np.isfinite(log["depth_m"][:50]).all()


def test_several_topics_that_would_fit_must_be_chosen_from(folder):
    rows = [(topic, k, joint_state(k, "ab", [k, k])) for k in range(1, 4) for topic in ("/l", "/r")]
    write_bag(folder, rows)
    with pytest.raises(
        ColumnError, match=r"several columns would fit \(/l/position, /r/position\)"
    ):
        read_log(folder, required=["q"])
    assert len(read_log(folder, mapped(q="/r/position"), required=["q"])) == 3


def test_of_several_topics_the_one_with_the_joints_of_the_robot_is_read(folder):
    rows = [
        (topic, k, joint_state(k, names, [k, factor * k], [k, k], [k, k]))
        for k in range(1, 4)
        for topic, names, factor in (("/arm", "ab", 2.0), ("/hand", "xy", 3.0))
    ]
    write_bag(folder, rows)
    asked = {"required": ["q", "tau"], "optional": ["dq"]}
    log = read_log(folder, joints=["b", "a"], **asked)
    assert log["q_rad"][:, 0].tolist() == [2.0, 4.0, 6.0]
    assert len(list(LogStream(bag_tables(folder, 2, ChannelRequest(joints=("a", "b"), **asked)), **asked)))
    with pytest.raises(ColumnError, match="several columns would fit"):
        read_log(folder, joints=["a", "x"], **asked)


def test_a_channel_that_is_mapped_decides_for_those_that_are_not(folder):
    rows = [
        (topic, k, joint_state(k, "ab", [k, k], [k, k], [factor * k, k]))
        for k in range(1, 4)
        for topic, factor in (("/l", 2.0), ("/r", 3.0))
    ]
    write_bag(folder, rows)
    log = read_log(folder, mapped(q="/r/position"), required=["q", "tau"], optional=["dq"])
    assert log["tau_Nm"][:, 0].tolist() == [3.0, 6.0, 9.0]
    assert "dq_rad_s" in log


def test_messages_of_another_length_are_told(folder):
    array = TYPES.types["std_msgs/msg/Float64MultiArray"]
    layout = TYPES.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    rows = [("/tau", k, array(layout, np.arange(float(n)))) for k, n in enumerate([2, 2, 3, 2])]
    log = read_log(write_bag(folder, rows), required=["tau"])
    np.testing.assert_array_equal(np.isfinite(log["tau_Nm"][:, 0]), [True, True, False, True])
    assert "/tau: messages with another number of values of /tau: 1" in log.warnings


@pytest.mark.parametrize("rows", [1, 7, 64, 1000])
def test_chunks_are_the_bag_in_pieces(folder, rows):
    write_bag(folder, insertion_rows(333))
    wanted = ChannelRequest(mapping=mapped(depth="/depth_mm", force="/ft/wrench/force_xyz[2]"))
    whole = next(bag_tables(folder, None, wanted))
    chunks = list(bag_tables(folder, rows, wanted))
    for name, values in whole.columns.items():
        joined = np.concatenate([chunk.columns[name] for chunk in chunks])
        np.testing.assert_array_equal(joined, values)
    assert [w for chunk in chunks for w in chunk.warnings] == list(whole.warnings)
    assert max(chunk.columns["t_s"].size for chunk in chunks) <= rows
