"""The formats that tables are written in: CSV, npz, Parquet and MCAP."""

import csv
import io
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import cache, partial
from typing import Any, BinaryIO

import numpy as np

from needleforce.recordings.errors import (
    LogError,
    optional_library,
)
from needleforce.recordings.table import (
    START_KEY,
    LinkPoses,
    TableColumns,
    TableLabels,
    flat_columns,
)
from needleforce.recordings.time_stamps import NS_PER_S, to_nanoseconds

Append = Callable[[TableColumns], None]
"""Writes rows of checked columns, the same in every call."""

Writer = Callable[[BinaryIO, TableLabels, TableColumns], AbstractContextManager[Append]]
"""Begins a table of these columns, here without rows, gives what writes rows, and
finishes it."""


@contextmanager
def csv_writer(
    stream: BinaryIO, labels: TableLabels, empty: TableColumns
) -> Iterator[Append]:
    """Write a header and rows that read back bit for bit.

    The start of the clock is a comment.
    """
    header = io.StringIO()
    if labels.start_ns:
        header.write(f"# {START_KEY} = {labels.start_ns}\n")

    csv.writer(header, lineterminator="\n").writerow(flat_columns(empty))
    stream.write(header.getvalue().encode())

    def append(columns: TableColumns) -> None:
        # The shortest texts that read back to the same numbers; truth values as 0, 1.
        columns_as_text = (
            map(repr, (values * 1 if values.dtype.kind == "b" else values).tolist())
            for values in flat_columns(columns).values()
        )
        if lines := [",".join(row) for row in zip(*columns_as_text, strict=True)]:
            stream.write(("\n".join(lines) + "\n").encode())

        stream.flush()  # for readers of a file that grows

    yield append


@contextmanager
def npz_writer(
    stream: BinaryIO, labels: TableLabels, empty: TableColumns
) -> Iterator[Append]:
    """Collect rows in memory, and write the archive at the end.

    It cannot be appended to.
    """
    chunks = [empty]
    yield lambda rows: chunks.append({name: v.copy() for name, v in rows.items()})
    arrays = {name: np.concatenate([rows[name] for rows in chunks]) for name in empty}
    if labels.start_ns:
        arrays[START_KEY] = np.array(labels.start_ns, dtype=np.int64)

    # numpy.savez could not write a column called "file".
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values)


@contextmanager
def parquet_writer(
    stream: BinaryIO, labels: TableLabels, empty: TableColumns
) -> Iterator[Append]:
    """Write each chunk as a row group.

    Two-dimensional columns become numbered ones, as in CSV.
    """
    arrow = optional_library("pyarrow", "Parquet files")
    parquet = optional_library("pyarrow.parquet", "Parquet files")
    metadata = {START_KEY: str(labels.start_ns)} if labels.start_ns else {}
    schema = arrow.table(flat_columns(empty), metadata=metadata).schema
    # Closing writes the table of contents, without which the file cannot be read.
    with parquet.ParquetWriter(stream, schema, write_page_checksum=True) as writer:
        yield lambda rows: writer.write_table(arrow.table(flat_columns(rows)))


@cache
def standard_types() -> Any:
    """Return the type store of ROS's own messages.

    Raises:
        FileAccessError: rosbags is not installed.
    """
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    return library.get_typestore(library.Stores.ROS2_HUMBLE)


def _message(kind: str, *fields: Any) -> Any:
    """Return a message of one of ROS's own types."""
    return standard_types().types[kind](*fields)


def _header(stamp_ns: int, frame: str) -> Any:
    """Return the header of a message with this time stamp, in a frame."""
    stamp = _message("builtin_interfaces/msg/Time", *divmod(stamp_ns, NS_PER_S))
    return _message("std_msgs/msg/Header", stamp, frame)


Messages = Iterable[Any]
"""Of a topic, one for each row; None for a row without."""


def bag_topics(
    columns: TableColumns, labels: TableLabels, stamps_ns: Sequence[int]
) -> dict[str, Messages]:
    """Return the messages of some rows by their topic.

    `q_rad`, `dq_rad_s` and `tau_Nm` become a `JointState`; `ft_force_N` with
    `ft_torque_Nm`, and `force_x_in_...`, `torque_x_in_...` and so on, become a
    `WrenchStamped`; every other column but `t_s` becomes a `Float64` of its own. The
    description of the robot is in the first row.

    Args:
        columns: Of the rows, shape (n,) or (n, k).
        labels: Names of joints, frame and prefix.
        stamps_ns: Time stamps of the rows.
    """
    topics: dict[str, Messages] = {}
    if labels.robot_description:
        text = _message("std_msgs/msg/String", labels.robot_description)
        rows = range(len(stamps_ns))
        topics["/robot_description"] = (None if row else text for row in rows)

    remaining = {
        name: np.array(values, dtype=np.float64, order="C")
        for name, values in columns.items()
        if name != "t_s"
    }
    signals = {
        name: remaining[name]
        for name in ("q_rad", "dq_rad_s", "tau_Nm")  # of position, velocity, effort
        if name in remaining and remaining[name].ndim == 2
    }
    if len({values.shape[1] for values in signals.values()}) == 1:
        topics["/joint_states"] = _joint_states(signals, labels.joint_names, stamps_ns)
        remaining = {n: v for n, v in remaining.items() if n not in signals}
    if "q_rad" in signals and labels.link_poses is not None:
        topics["/tf"] = _link_poses(signals["q_rad"], labels.link_poses, stamps_ns)

    force = remaining.get("ft_force_N", np.empty(0))
    torque = remaining.get("ft_torque_Nm", np.empty(0))
    if force.shape[1:] == torque.shape[1:] == (3,):
        del remaining["ft_force_N"], remaining["ft_torque_Nm"]
        topics["/ft_sensor/wrench"] = _wrenches("ft_sensor", stamps_ns, force, torque)

    force = _pop_vector(remaining, "force")
    torque = _pop_vector(remaining, "torque")
    if force is not None:
        # A force at the tip has no torque.
        torque = np.zeros_like(force) if torque is None else torque
        name = f"{labels.prefix}/wrench"
        topics[name] = _wrenches(labels.frame, stamps_ns, force, torque)

    # Without a header: the time stamp is the one of the record.
    for name, values in flat_columns(remaining).items():
        topic = f"{labels.prefix}/{re.sub(r'[^A-Za-z0-9_]', '_', name)}"
        if topic in topics:
            raise LogError(f"two columns would become the topic {topic}: rename one")
        number = partial(_message, "std_msgs/msg/Float64")
        topics[topic] = map(number, values.tolist())

    return topics


def _joint_states(
    signals: TableColumns, names: Sequence[str], stamps_ns: Sequence[int]
) -> Messages:
    """Return joint signals, shape (n, joints) each, as a `JointState` for each row."""
    width = next(iter(signals.values())).shape[1]
    numbered = [f"joint_{number}" for number in range(1, width + 1)]
    joint_names = list(names) if len(names) == width else numbered
    nothing = np.empty((len(stamps_ns), 0))
    numbers = [signals.get(name, nothing) for name in ("q_rad", "dq_rad_s", "tau_Nm")]
    return (
        _message("sensor_msgs/msg/JointState", _header(stamp_ns, ""), joint_names, *row)
        for stamp_ns, *row in zip(stamps_ns, *numbers, strict=True)
    )


def _link_poses(
    q_rad: np.ndarray, link_poses: LinkPoses, stamps_ns: Sequence[int]
) -> Messages:
    """Yield a `TFMessage` 30 times a second, as a screen shows; None for other rows.

    Args:
        q_rad: Joint positions, shape (n, joints).
        link_poses: Says where the links are.
        stamps_ns: Time stamps of the rows.
    """
    latest = -1
    for position_rad, stamp_ns in zip(q_rad, stamps_ns, strict=True):
        picture = int(stamp_ns * 30.0 / NS_PER_S)
        if picture == latest or np.isnan(position_rad).any():
            yield None
            continue

        latest = picture
        links = link_poses(position_rad)
        header = _header(stamp_ns, links.parent)
        poses = zip(
            links.children,
            links.translation_m.tolist(),
            links.rotation_xyzw.tolist(),
            strict=True,
        )
        transforms = [
            _message(
                "geometry_msgs/msg/TransformStamped",
                header,
                child,
                _message(
                    "geometry_msgs/msg/Transform",
                    _message("geometry_msgs/msg/Vector3", *origin_m),
                    _message("geometry_msgs/msg/Quaternion", *turn),
                ),
            )
            for child, origin_m, turn in poses
        ]
        yield _message("tf2_msgs/msg/TFMessage", transforms)


def _pop_vector(columns: dict[str, np.ndarray], quantity: str) -> np.ndarray | None:
    """Remove and return `force_x_in_...` and so on, shape (n, 3).

    Args:
        columns: By name.
        quantity: `force` or `torque`.

    Returns:
        The vectors; None if an axis is missing, and nothing is removed.
    """
    pattern = re.compile(rf"{quantity}_([xyz])_in_\w+")
    matches = filter(None, map(pattern.fullmatch, columns))
    names = {match[1]: match[0] for match in matches}
    if len(names) < len("xyz"):
        return None

    return np.column_stack([columns.pop(names[axis]) for axis in "xyz"])


def _wrenches(
    frame: str, stamps_ns: Sequence[int], force: np.ndarray, torque: np.ndarray
) -> Messages:
    """Return forces and torques, shape (n, 3), as a `WrenchStamped` for each row."""
    rows = zip(stamps_ns, force.tolist(), torque.tolist(), strict=True)
    return (
        _message(
            "geometry_msgs/msg/WrenchStamped",
            _header(stamp_ns, frame),
            _message(
                "geometry_msgs/msg/Wrench",
                _message("geometry_msgs/msg/Vector3", *force_N),
                _message("geometry_msgs/msg/Vector3", *torque_Nm),
            ),
        )
        for stamp_ns, force_N, torque_Nm in rows
    )


@contextmanager
def mcap_writer(
    stream: BinaryIO, labels: TableLabels, empty: TableColumns
) -> Iterator[Append]:
    """Write one MCAP file, compressed, with checksums.

    Each row becomes a message on each topic.

    Raises:
        LogError: There is no time stamp `t_s`, or one that no message can carry.
    """
    types = standard_types()
    library = optional_library("mcap.writer", "MCAP files")
    # Rows that come at once make a chunk, or several of 64 KiB.
    bag = library.Writer(stream, chunk_size=1 << 16, enable_data_crcs=True)
    bag.start(profile="ros2", library="needleforce")

    @cache
    def channel_of(topic: str, kind: str) -> int:
        definition, _ = types.generate_msgdef(kind, ros_version=2)
        schema = bag.register_schema(kind, "ros2msg", definition.encode())
        return bag.register_channel(topic, "cdr", schema)

    def append(columns: TableColumns) -> None:
        nonlocal labels
        stamps_ns = _message_stamps_ns(columns, labels)
        topics = bag_topics(columns, labels, stamps_ns)
        for stamp_ns, *messages in zip(stamps_ns, *topics.values(), strict=True):
            for topic, message in zip(topics, messages, strict=True):
                if message is not None:
                    kind = message.__msgtype__
                    data = types.serialize_cdr(message, kind)
                    channel = channel_of(topic, kind)
                    bag.add_message(channel, stamp_ns, data, stamp_ns)

        if stamps_ns:
            labels = replace(labels, robot_description="")

        bag.flush()  # for readers of a file that grows, and if this process is killed

    yield append
    bag.finish()  # writes the index


def _message_stamps_ns(columns: TableColumns, labels: TableLabels) -> list[int]:
    """Return the time stamps of rows as messages carry them.

    Raises:
        LogError: There are none, or one is not finite or before zero.
    """
    t_s = columns.get("t_s")
    stamps_ns = [-1]
    if t_s is not None and t_s.ndim == 1 and np.isfinite(t_s).all():
        stamps_ns = to_nanoseconds(t_s, labels.start_ns).tolist()
    if min(stamps_ns, default=0) < 0:
        raise LogError(
            "a bag needs a column t_s with a finite time stamp from zero on in every "
            f"row; there is {list(columns)}",
        )

    return stamps_ns


WRITERS: Mapping[str, Writer] = {
    ".csv": csv_writer,
    ".npz": npz_writer,
    ".parquet": parquet_writer,
    ".mcap": mcap_writer,
}
"""Writers by the suffix of a file."""
