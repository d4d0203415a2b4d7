"""Messages become columns: their names, joints, vectors, and signals between their stamps."""

import numpy as np
import pytest
from bag_samples import TYPES, joint_state, message, wrench
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_idl, get_typestore

from needleforce.recordings import FormatError
from needleforce.recordings.bag_storage import BagTopic
from needleforce.recordings.bag_topics import TopicDecoder, interpolate

texts = st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=9)
finite = st.floats(allow_nan=False)
JOINT_STATE = "sensor_msgs/msg/JointState"


def made(content, **options):
    return bytes(TYPES.serialize_cdr(content, content.__msgtype__, **options))


def decoded(content, topic="/x", **options):
    decoder = TopicDecoder(BagTopic(topic, content.__msgtype__, "cdr"))
    return decoder.decode(made(content, **options))


@given(
    names=st.lists(texts, max_size=5), lengths=st.lists(st.integers(0, 9), min_size=3, max_size=3)
)
def test_joint_states_of_any_names_and_lengths(names, lengths):
    arrays = [np.arange(float(n)) for n in lengths]
    found = decoded(joint_state(12_345_678_901, names, *arrays), "/j")
    is_named = all(names) and len(set(names)) == len(names)
    assert found.names == (tuple(names) if is_named else ())
    assert found.stamp_ns == 12_345_678_901
    for field, values in zip(("position", "velocity", "effort"), arrays, strict=True):
        assert list(found.values.get(f"/j/{field}", [])) == values.tolist()
        assert (f"/j/{field}" in found.named) == (0 < len(values) == len(found.names))


def test_arrays_of_messages_and_images_are_no_signals():
    header = joint_state(1, "", []).header
    numbers = [np.arange(3.0) for _ in range(4)]
    time = message("builtin_interfaces/msg/Duration", 7, 8)
    point = message("trajectory_msgs/msg/JointTrajectoryPoint", *numbers, time)
    trajectory = message("trajectory_msgs/msg/JointTrajectory", header, ["x"], [point, point])
    assert decoded(trajectory).values == {}
    assert decoded(trajectory).names == ("x",)
    image = message(
        *("sensor_msgs/msg/Image", header, 10, 10, "mono8", 0, 10), np.zeros(100, np.uint8)
    )
    assert "/x/data" not in decoded(image).values


def test_big_endian_messages_are_read():
    found = decoded(wrench(3, (1.5, 2.5, 3.5)), little_endian=False)
    assert found.values["/x/force_xyz"] == (1.5, 2.5, 3.5)


@given(cut=st.integers(0, 80))
def test_a_message_that_is_too_short_is_refused(cut):
    data = made(joint_state(1, "ab", [1, 2], [3, 4], [5, 6]))
    with pytest.raises(FormatError):
        TopicDecoder(BagTopic("/j", JOINT_STATE, "cdr")).decode(data[:cut])


@given(data=st.binary(min_size=0, max_size=200))
def test_noise_is_refused_or_gives_numbers(data):
    try:
        found = TopicDecoder(BagTopic("/j", JOINT_STATE, "cdr")).decode(b"\0\1\0\0" + data)
    except FormatError:
        return
    assert all(len(values) for values in found.values.values())


def test_columns_are_called_by_topic_and_field():
    for topic, content, names in (
        ("/ft", wrench(1, (1, 2, 3)), ["/ft/force_xyz", "/ft/torque_xyz"]),
        ("/d", message("std_msgs/msg/Float64", 1.0), ["/d"]),
        ("/p", message("geometry_msgs/msg/Pose2D", 1.0, 2.0, 3.0), ["/p/xy", "/p/theta"]),
        ("/v", message("geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0), ["/v/xyz"]),
    ):
        assert list(decoded(content, topic).values) == names


def test_a_type_may_be_defined_in_idl():
    text = "module a { module msg { struct X { double depth; sequence<double> q; }; }; };"
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_idl(text))
    data = types.serialize_cdr(types.types["a/msg/X"](0.5, np.array([1.0, 2.0])), "a/msg/X")
    mark = "=" * 80 + "\nIDL: a/msg/X\n"
    for definition in (text, mark + text):
        found = TopicDecoder(BagTopic("/x", "a/msg/X", "cdr", definition, True)).decode(data)
        assert found.values["/x/depth"] == 0.5
        assert found.values["/x/q"].tolist() == [1.0, 2.0]


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
    assert np.isnan(interpolate(np.array([2]), stamps[:0], values[:0], 20.0)).all()
