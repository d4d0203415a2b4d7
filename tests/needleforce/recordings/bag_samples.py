"""Bags as robots record them, whole or growing, and mappings in one line, for tests."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from needleforce.recordings import ColumnMapping, ColumnSpec

TYPES = get_typestore(Stores.ROS2_HUMBLE)
START_NS = 1_700_000_000_123_456_789
STEP_NS = 1_000_003


def message(kind, *values):
    """Make a message of a standard type."""
    return TYPES.types[kind](*values)


def header(stamp_ns, frame=""):
    """Make a header."""
    stamp = message("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))
    return message("std_msgs/msg/Header", stamp, frame)


def joint_state(stamp_ns, names, position, velocity=(), effort=()):
    """Make a JointState."""
    numbers = [
        np.array(values, dtype=np.float64) for values in (position, velocity, effort)
    ]
    return message(
        "sensor_msgs/msg/JointState", header(stamp_ns), list(names), *numbers
    )


def wrench(stamp_ns, force, torque=(0.0, 0.0, 0.0)):
    """Make a WrenchStamped."""
    parts = (
        message("geometry_msgs/msg/Vector3", *map(float, v)) for v in (force, torque)
    )
    inner = message("geometry_msgs/msg/Wrench", *parts)
    return message("geometry_msgs/msg/WrenchStamped", header(stamp_ns, "ft"), inner)


def number(value):
    """Make a Float64."""
    return message("std_msgs/msg/Float64", float(value))


def text(value):
    """Make a String."""
    return message("std_msgs/msg/String", value)


def write_bag(folder, rows, *, storage="mcap", compression=None):
    """Write messages: rows of topic, time of recording in ns, message. Return the
    folder."""
    bag = Writer(folder, version=8, storage_plugin=StoragePlugin[storage.upper()])
    if compression is not None:
        bag.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)

    connections = {}
    with bag:
        for topic, log_ns, content in rows:
            kind = content.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=TYPES)

            bag.write(connections[topic], log_ns, TYPES.serialize_cdr(content, kind))

    return Path(folder)


def insertion_rows(count, names=("a", "b", "c")):
    """Make joint states, a wrench and now and then a depth and a text, as an arm
    publishes them."""
    for k in range(count):
        t_ns = START_NS + k * STEP_NS
        position = [k + 0.1 * i for i in range(len(names))]
        effort = [2.0 * value for value in position]
        yield (
            "/joint_states",
            t_ns + 500,
            joint_state(t_ns, names, position, (), effort),
        )
        yield "/ft/wrench", t_ns + 700, wrench(t_ns, (0.0, 1.0, -float(k)))
        if k % 10 == 0:
            yield "/depth_mm", t_ns + 800, number(k)
            yield "/log", t_ns + 900, text(f"tick {k}")


def data_file(folder):
    """Return the file of messages in a bag's folder."""
    (path,) = [path for path in Path(folder).iterdir() if path.name != "metadata.yaml"]
    return path


def mapped(rate_hz=None, **channels):
    """A mapping of channels to columns, given as a `ColumnSpec` or as its `columns`."""
    specs = {
        name: spec if isinstance(spec, ColumnSpec) else ColumnSpec(columns=spec)
        for name, spec in channels.items()
    }
    return ColumnMapping(channels=specs, rate_hz=rate_hz)
