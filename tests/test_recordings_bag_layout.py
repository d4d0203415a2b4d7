"""Layouts of serialised messages, against rosbags' own deserialiser."""

import numpy as np
import pytest
from bag_samples import TYPES, joint_state, message, wrench
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings.bag_storage import BagTopic
from recordings.bags.cdr_layout import learn_layout
from recordings.bags.interpolate import interpolate
from recordings.bags.message_columns import message_columns
from needleforce.recordings.errors import FormatError

texts = st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=9)
finite = st.floats(allow_nan=False)


def fields(kind):
    return dict(TYPES.fielddefs[kind][1])


def made(content):
    return bytes(TYPES.serialize_cdr(content, content.__msgtype__))


def numbers(data, layout):
    """What the places of a layout hold, by path."""
    return {
        place.path: np.frombuffer(data, place.dtype, place.length or 1, place.offset).tolist()
        for place in layout.places
    }


@given(
    names=st.lists(texts, max_size=5), lengths=st.lists(st.integers(0, 9), min_size=3, max_size=3)
)
def test_joint_states_of_any_names_and_lengths(names, lengths):
    arrays = [np.arange(float(n)) for n in lengths]
    state = joint_state(12_345_678_901, names, *arrays)
    layout = learn_layout(made(state), state.__msgtype__, fields)
    found = numbers(made(state), layout)
    assert layout.names == tuple(names)
    assert found["header", "stamp", "sec"] == [12]
    assert found["header", "stamp", "nanosec"] == [345_678_901]
    for field, values in zip(("position", "velocity", "effort"), arrays, strict=True):
        assert found.get((field,), []) == values.tolist()


@given(frame=texts, other=texts, values=st.lists(finite, min_size=6, max_size=6))
def test_a_layout_fits_messages_of_the_same_shape_and_no_others(frame, other, values):
    one = wrench(1, values[:3], values[3:])
    two = wrench(2, values[3:], values[:3])
    one.header.frame_id, two.header.frame_id = frame, other
    layout = learn_layout(made(one), one.__msgtype__, fields)
    assert layout.fits(made(one))
    assert layout.fits(made(two)) == (len(frame) == len(other))


def test_other_joint_names_are_another_layout():
    layout = learn_layout(made(joint_state(1, "ab", [1, 2])), "sensor_msgs/msg/JointState", fields)
    assert layout.fits(made(joint_state(9, "ab", [3, 4])))
    assert not layout.fits(made(joint_state(9, "ba", [3, 4])))


def test_arrays_of_messages_are_walked_over():
    status = message("diagnostic_msgs/msg/DiagnosticStatus", 1, "a", "bcd", "", [])
    pose = message(
        "trajectory_msgs/msg/JointTrajectoryPoint",
        *(np.arange(3.0) for _ in range(4)),
        message("builtin_interfaces/msg/Duration", 7, 8),
    )
    trajectory = message(
        "trajectory_msgs/msg/JointTrajectory", joint_state(1, "", []).header, ["x"], [pose, pose]
    )
    layout = learn_layout(made(trajectory), trajectory.__msgtype__, fields)
    assert layout.names == ("x",)
    assert [place.path for place in layout.places] == [
        ("header", "stamp", "sec"),
        ("header", "stamp", "nanosec"),
    ]
    learn_layout(made(status), status.__msgtype__, fields)


def test_images_are_no_signals():
    image = message(
        *("sensor_msgs/msg/Image", joint_state(1, "", []).header, 10, 10, "mono8", 0, 10),
        np.zeros(100, np.uint8),
    )
    layout = learn_layout(made(image), image.__msgtype__, fields)
    assert ("data",) not in {place.path for place in layout.places}


def test_big_endian_messages_are_read():
    content = wrench(3, (1.5, 2.5, 3.5))
    data = bytes(TYPES.serialize_cdr(content, content.__msgtype__, little_endian=False))
    found = numbers(data, learn_layout(data, content.__msgtype__, fields))
    assert found["wrench", "force", "y"] == [2.5]


@given(cut=st.integers(0, 80))
def test_a_message_that_is_too_short_is_refused(cut):
    data = made(joint_state(1, "ab", [1, 2], [3, 4], [5, 6]))
    with pytest.raises(FormatError):
        learn_layout(data[:cut], "sensor_msgs/msg/JointState", fields)


@given(data=st.binary(min_size=0, max_size=200))
def test_noise_is_refused_or_stays_inside_the_message(data):
    data = b"\0\1\0\0" + data
    try:
        layout = learn_layout(data, "sensor_msgs/msg/JointState", fields)
    except FormatError:
        return
    assert all(
        place.offset + 8 * (place.length or 0) <= len(data)
        for place in layout.places
        if place.length is not None
    )


def columns_of(topic, content):
    layout = learn_layout(made(content), content.__msgtype__, fields)
    return message_columns(BagTopic(topic, content.__msgtype__, "cdr"), layout)


def test_columns_are_called_by_topic_and_field():
    assert list(columns_of("/ft/wrench", wrench(1, (1, 2, 3))).places) == [
        "/ft/wrench/force_xyz",
        "/ft/wrench/torque_xyz",
    ]
    assert list(columns_of("/d", message("std_msgs/msg/Float64", 1.0)).places) == ["/d"]
    pose = message("geometry_msgs/msg/Pose2D", 1.0, 2.0, 3.0)
    assert list(columns_of("/p", pose).places) == ["/p/xy", "/p/theta"]
    vector = message("geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0)
    assert list(columns_of("/v", vector).places) == ["/v/xyz"]


def test_only_arrays_with_a_value_for_each_name_are_named():
    found = columns_of("/j", joint_state(1, "ab", [1, 2], [], [3]))
    assert found.named == {"/j/position"}
    assert list(found.places) == ["/j/position", "/j/effort"]


@given(
    known=st.lists(st.tuples(st.integers(0, 50), finite), min_size=1, max_size=20),
    at=st.lists(st.integers(-5, 55), min_size=1, max_size=20),
)
def test_where_stamps_agree_values_are_taken_as_they_are(known, at):
    known = dict(known)
    stamps, values = np.array(list(known)), np.array(list(known.values()))[:, None]
    found = interpolate(np.array(at), stamps, values, 10.0)[:, 0]
    for stamp, value in zip(at, found.tolist(), strict=True):
        if stamp in known:
            assert value == known[stamp]
        elif not min(known) < stamp < max(known):
            assert np.isnan(value)


def test_between_stamps_is_a_straight_line_unless_they_are_too_far_apart():
    stamps, values = np.array([0, 10, 100]), np.array([[0.0], [5.0], [50.0]])
    found = interpolate(np.array([2, 50]), stamps, values, 20.0)
    assert found[0, 0] == 1.0
    assert np.isnan(found[1, 0])
    nothing = interpolate(np.array([2]), stamps[:0], values[:0], 20.0)
    assert np.isnan(nothing).all()
