"""Bags show the arm, and what happened, to who opens them in a viewer."""

import pickle

import numpy as np
import pytest

from needleforce.cli.arm_frames import ArmFrames, read_description
from needleforce.cli.shared_options import RobotOptions
from needleforce.recordings import read_log, write_table
from needleforce.recordings.bag_topics import standard_types
from needleforce.recordings.table import TableLabels

reader = pytest.importorskip("mcap.reader")
ROWS = 101


def messages_of(path):
    """Messages of a bag by topic, each with the time of its record [s]."""
    found = {}
    with path.open("rb") as stream:
        for schema, channel, record in reader.make_reader(stream).iter_messages():
            message = standard_types().deserialize_cdr(record.data, schema.name)
            found.setdefault(channel.topic, []).append(
                (1e-9 * record.log_time, message)
            )
    return found


@pytest.fixture
def bag(tmp_path, lwr):
    """A bag of 1 s at 100 Hz in which the first joint turns and a layer ruptures."""
    t_s = 0.01 * np.arange(ROWS)
    q_rad = np.zeros((ROWS, lwr.nv))
    q_rad[:, 0] = t_s
    rupture = np.zeros(ROWS)
    rupture[40] = 1
    identified = np.zeros(ROWS)
    identified[60] = 1
    path = tmp_path / "arm.mcap"
    write_table(
        path,
        {
            "t_s": t_s,
            "q_rad": q_rad,
            "tau_Nm": q_rad,
            "rupture": rupture,
            "identified_layer": identified,
        },
        labels=TableLabels(
            joint_names=lwr.joint_names,
            robot_description=read_description(RobotOptions()),
            link_poses=pickle.loads(pickle.dumps(ArmFrames(lwr))),
        ),
    )
    return path


def test_the_description_stands_in_the_bag_once(bag):
    [(_, message)] = messages_of(bag)["/robot_description"]

    assert "<robot" in message.data
    assert 'name="lwr_joint_1"' in message.data


def test_links_are_where_the_joints_put_them(bag, lwr):
    pictures = messages_of(bag)["/tf"]
    time_s, last = pictures[-1]
    transforms = {item.child_frame_id: item for item in last.transforms}
    first_tip = {item.child_frame_id: item for item in pictures[0][1].transforms}
    rotation = transforms[lwr.tool_frame].transform.rotation

    assert 28 <= len(pictures) <= 32
    assert {item.header.frame_id for item in last.transforms} == {lwr.frame_names[1]}
    assert last.transforms[0].header.stamp.nanosec == round(1e9 * (time_s % 1.0))
    # Upright the arm turns about the vertical only.
    assert first_tip[lwr.tool_frame].transform.rotation.w == pytest.approx(1.0, abs=0.8)
    size = rotation.x**2 + rotation.y**2 + rotation.z**2 + rotation.w**2
    assert size == pytest.approx(1.0)
    turned = abs(
        sum(
            getattr(rotation, axis)
            * getattr(first_tip[lwr.tool_frame].transform.rotation, axis)
            for axis in "xyzw"
        )
    )
    assert 2.0 * np.arccos(turned) == pytest.approx(time_s, abs=0.01)


def test_events_are_log_messages_on_their_rows(bag):
    events = messages_of(bag)["/needleforce/events"]

    assert [(round(time_s, 2), message.msg) for time_s, message in events] == [
        (0.4, "rupture of layer 1"),
        (0.6, "layer 1 identified"),
    ]
    assert {message.level for _, message in events} == {20}


def test_such_a_bag_reads_back_as_the_signals_it_holds(bag, lwr):
    log = read_log(bag, required=["q", "tau"], joints=lwr.joint_names)

    assert len(log.t_s) == ROWS
    assert log["q_rad"][-1, 0] == 1.0
