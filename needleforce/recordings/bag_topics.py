"""Rows of a table as messages of ROS 2, to be written to a bag."""

import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from needleforce.recordings.errors import optional_library
from needleforce.recordings.table import TableColumns, TableLabels, flat_columns
from needleforce.recordings.time_stamps import NS_PER_S


@cache
def standard_types() -> Any:
    """Return the type store of ROS's own messages.

    Raises:
        FileAccessError: rosbags is not installed.
    """
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    return library.get_typestore(library.Stores.ROS2_HUMBLE)


class WrittenTopic(NamedTuple):
    """A topic to be written.

    Attributes:
        name: Such as /joint_states.
        kind: The type of its messages.
        messages: One for each row; None for a row without.
    """

    name: str
    kind: str
    messages: Iterable[Any]


def bag_topics(
    columns: TableColumns, labels: TableLabels, stamps_ns: Sequence[int]
) -> Iterator[WrittenTopic]:
    """Yield the topics of some rows.

    `q_rad`, `dq_rad_s` and `tau_Nm` become a `JointState`; `ft_force_N` with
    `ft_torque_Nm`, and `force_x_in_...`, `torque_x_in_...` and so on, become a
    `WrenchStamped`; every other column but `t_s` becomes a `Float64` of its own.

    Args:
        columns: Of the rows, shape (n,) or (n, k).
        labels: Names of joints, frame and prefix.
        stamps_ns: Time stamps of the rows.
    """
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
    widths = {values.shape[1] for values in signals.values()}
    if len(widths) == 1:
        for name in signals:
            del remaining[name]

        messages = _joint_states(signals, labels.joint_names, stamps_ns)
        yield WrittenTopic("/joint_states", "sensor_msgs/msg/JointState", messages)
    if "q_rad" in signals and labels.link_poses is not None:
        poses = _link_poses(signals["q_rad"], labels, stamps_ns)
        yield WrittenTopic("/tf", "tf2_msgs/msg/TFMessage", poses)

    force = remaining.get("ft_force_N", np.empty(0))
    torque = remaining.get("ft_torque_Nm", np.empty(0))
    if force.shape[1:] == torque.shape[1:] == (3,):
        del remaining["ft_force_N"], remaining["ft_torque_Nm"]
        headers = _headers(stamps_ns, "ft_sensor")
        yield _wrenches("/ft_sensor/wrench", force, torque, headers)

    force = _pop_vector(remaining, "force")
    torque = _pop_vector(remaining, "torque")
    if force is not None:
        # A force at the tip has no torque.
        torque = np.zeros_like(force) if torque is None else torque
        headers = _headers(stamps_ns, labels.frame)
        yield _wrenches(f"{labels.prefix}/wrench", force, torque, headers)

    # Without a header: the time stamp is the one of the record.
    kind = "std_msgs/msg/Float64"
    make_number = standard_types().types[kind]
    for name, values in flat_columns(remaining).items():
        topic_name = f"{labels.prefix}/{re.sub(r'[^A-Za-z0-9_]', '_', name)}"
        yield WrittenTopic(topic_name, kind, map(make_number, values.tolist()))


def _headers(stamps_ns: Sequence[int], frame: str) -> Iterator[Any]:
    """Yield the headers of messages with these time stamps, in a frame."""
    types = standard_types().types
    make_time = types["builtin_interfaces/msg/Time"]
    make_header = types["std_msgs/msg/Header"]
    for stamp_ns in stamps_ns:
        yield make_header(make_time(*divmod(stamp_ns, NS_PER_S)), frame)


def _joint_states(
    signals: TableColumns, names: Sequence[str], stamps_ns: Sequence[int]
) -> Iterator[Any]:
    """Yield joint signals, shape (n, joints) each, as a `JointState` for each row."""
    make_state = standard_types().types["sensor_msgs/msg/JointState"]
    width = next(iter(signals.values())).shape[1]
    joint_names = list(names)
    if len(names) != width:
        joint_names = [f"joint_{number + 1}" for number in range(width)]

    nothing = np.empty((len(stamps_ns), 0))
    numbers = [signals.get(name, nothing) for name in ("q_rad", "dq_rad_s", "tau_Nm")]
    for header, *row in zip(_headers(stamps_ns, ""), *numbers, strict=True):
        yield make_state(header, joint_names, *row)


def _link_poses(
    q_rad: np.ndarray, labels: TableLabels, stamps_ns: Sequence[int]
) -> Iterator[Any]:
    """Yield a `TFMessage` 30 times a second, as a screen shows; None for other rows.

    Args:
        q_rad: Joint positions, shape (n, joints).
        labels: With the function that says where the links are.
        stamps_ns: Time stamps of the rows.
    """
    types = standard_types().types
    latest: int | None = None
    for position_rad, stamp_ns in zip(q_rad, stamps_ns, strict=True):
        picture = int(stamp_ns * 30.0 / NS_PER_S)
        if (
            labels.link_poses is None
            or picture == latest
            or np.isnan(position_rad).any()
        ):
            yield None
            continue

        latest = picture
        links = labels.link_poses(position_rad)
        headers = _headers([stamp_ns] * len(links.children), links.parent)
        poses = zip(links.translation_m, links.rotation_xyzw, strict=True)
        transforms = []
        for header, child, (origin, turn) in zip(
            headers, links.children, poses, strict=True
        ):
            vector = types["geometry_msgs/msg/Vector3"](*origin.tolist())
            rotation = types["geometry_msgs/msg/Quaternion"](*turn.tolist())
            pose = types["geometry_msgs/msg/Transform"](vector, rotation)
            make_stamped = types["geometry_msgs/msg/TransformStamped"]
            transforms.append(make_stamped(header, child, pose))

        yield types["tf2_msgs/msg/TFMessage"](transforms)


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
    name: str, force: np.ndarray, torque: np.ndarray, headers: Iterable[Any]
) -> WrittenTopic:
    """Return forces and torques, shape (n, 3), as a topic of `WrenchStamped`."""
    types = standard_types().types
    make_vector = types["geometry_msgs/msg/Vector3"]
    make_wrench = types["geometry_msgs/msg/Wrench"]
    kind = "geometry_msgs/msg/WrenchStamped"
    rows = zip(headers, force.tolist(), torque.tolist(), strict=True)
    messages = (
        types[kind](header, make_wrench(make_vector(*force_N), make_vector(*torque_Nm)))
        for header, force_N, torque_Nm in rows
    )
    return WrittenTopic(name, kind, messages)
