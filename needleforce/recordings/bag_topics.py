"""Rows of a table as messages of ROS 2, to be written to a bag."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from needleforce.recordings.errors import optional_library
from needleforce.recordings.table import (
    LinkPoses,
    TableColumns,
    TableLabels,
    flat_columns,
)
from needleforce.recordings.time_stamps import NS_PER_S

JOINT_SIGNALS = ("q_rad", "dq_rad_s", "tau_Nm")
"""Position, velocity and effort of a `JointState`."""

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
LOG = "rcl_interfaces/msg/Log"

EVENT_TEXTS = {
    "rupture": "rupture of layer {}",
    "retracted": "no rupture of layer {} after all: the force came back",
    "identified_layer": "layer {} identified",
}
"""Columns that hold the number of a layer on the row of an event, and 0 elsewhere."""


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
    }
    remaining.pop("t_s", None)
    events = {name: remaining[name] for name in EVENT_TEXTS if name in remaining}
    signals = _pop_joint_signals(remaining)
    if signals:
        yield _joint_states(signals, labels, stamps_ns)
    if "q_rad" in signals and labels.link_poses is not None:
        poses = _link_poses(signals["q_rad"], labels.link_poses, stamps_ns)
        yield WrittenTopic("/tf", TF_MESSAGE, poses)
    if events:
        logs = _event_logs(events, labels.prefix, stamps_ns)
        yield WrittenTopic(f"{labels.prefix}/events", LOG, logs)

    has_sensor = all(
        name in remaining and remaining[name].shape[1:] == (3,)
        for name in ("ft_force_N", "ft_torque_Nm")
    )
    if has_sensor:
        yield _wrenches(
            "/ft_sensor/wrench",
            remaining.pop("ft_force_N"),
            remaining.pop("ft_torque_Nm"),
            _headers(stamps_ns, "ft_sensor"),
        )

    force = _pop_vector(remaining, "force")
    torque = _pop_vector(remaining, "torque")
    if force is not None:
        # A force at the tip has no torque.
        yield _wrenches(
            f"{labels.prefix}/wrench",
            force,
            np.zeros_like(force) if torque is None else torque,
            _headers(stamps_ns, labels.frame),
        )

    # Without a header: the time stamp is the one of the record.
    kind = "std_msgs/msg/Float64"
    make_number = standard_types().types[kind]
    for name, values in flat_columns(remaining).items():
        topic_name = f"{labels.prefix}/{re.sub(r'[^A-Za-z0-9_]', '_', name)}"
        yield WrittenTopic(topic_name, kind, map(make_number, values.tolist()))


def _pop_joint_signals(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Remove and return the joint signals that have as many joints as the first."""
    names = [
        name for name in JOINT_SIGNALS if name in columns and columns[name].ndim == 2
    ]
    if not names:
        return {}

    width = columns[names[0]].shape[1]
    fitting = [name for name in names if columns[name].shape[1] == width]
    return {name: columns.pop(name) for name in fitting}


def _joint_states(
    signals: dict[str, np.ndarray], labels: TableLabels, stamps_ns: Sequence[int]
) -> WrittenTopic:
    """Return joint signals, shape (n, joints), as a topic of `JointState`."""
    width = next(iter(signals.values())).shape[1]
    joint_names = list(labels.joint_names)
    if len(joint_names) != width:
        joint_names = [f"joint_{i + 1}" for i in range(width)]

    nothing = np.empty((len(stamps_ns), 0))
    numbers = (signals.get(name, nothing) for name in JOINT_SIGNALS)
    rows = zip(_headers(stamps_ns, ""), *numbers, strict=True)
    kind = "sensor_msgs/msg/JointState"
    make_state = standard_types().types[kind]
    messages = (make_state(header, joint_names, *row) for header, *row in rows)
    return WrittenTopic("/joint_states", kind, messages)


def _link_poses(
    q_rad: np.ndarray, poses: LinkPoses, stamps_ns: Sequence[int]
) -> Iterator[Any]:
    """Yield a `TFMessage` 30 times a second, as a screen shows; None for other rows.

    Args:
        q_rad: Joint positions, shape (n, joints).
        poses: Where the links are.
        stamps_ns: Time stamps of the rows.
    """
    types = standard_types().types
    make_vector = types["geometry_msgs/msg/Vector3"]
    make_rotation = types["geometry_msgs/msg/Quaternion"]
    make_transform = types["geometry_msgs/msg/Transform"]
    make_stamped = types["geometry_msgs/msg/TransformStamped"]
    latest: int | None = None
    for position_rad, stamp_ns in zip(q_rad, stamps_ns, strict=True):
        picture = int(stamp_ns * 30.0 / NS_PER_S)
        if picture == latest or not np.isfinite(position_rad).all():
            yield None
            continue

        latest = picture
        links = poses(position_rad)
        headers = _headers([stamp_ns] * len(links.children), links.parent)
        transforms = [
            make_stamped(
                header,
                child,
                make_transform(make_vector(*origin), make_rotation(*rotation)),
            )
            for header, child, origin, rotation in zip(
                headers,
                links.children,
                links.translation_m.tolist(),
                links.rotation_xyzw.tolist(),
                strict=True,
            )
        ]
        yield types[TF_MESSAGE](transforms)


def _event_logs(
    events: Mapping[str, np.ndarray], name: str, stamps_ns: Sequence[int]
) -> Iterator[Any]:
    """Yield a `Log` for rows on which something happened, None for the others.

    Args:
        events: Columns of `EVENT_TEXTS`, shape (n,).
        name: Of who reports them.
        stamps_ns: Time stamps of the rows.
    """
    types = standard_types().types
    make_time = types["builtin_interfaces/msg/Time"]
    make_log = types[LOG]
    for index, stamp_ns in enumerate(stamps_ns):
        texts = [
            EVENT_TEXTS[kind].format(int(layers[index]))
            for kind, layers in events.items()
            if layers[index] > 0
        ]
        if not texts:
            yield None
            continue

        yield make_log(
            stamp=make_time(*divmod(stamp_ns, NS_PER_S)),
            level=20,  # of what is usual
            name=name.strip("/"),
            msg="; ".join(texts),
            file="",
            function="",
            line=0,
        )


def _pop_vector(columns: dict[str, np.ndarray], quantity: str) -> np.ndarray | None:
    """Remove and return `force_x_in_...` and so on, shape (n, 3).

    Args:
        columns: By name.
        quantity: `force` or `torque`.

    Returns:
        The vectors; None if an axis is missing, and nothing is removed.
    """
    names: dict[str, str] = {}
    for name, values in columns.items():
        match = re.fullmatch(rf"{quantity}_([xyz])_in_\w+", name)
        if match and values.ndim == 1:
            names.setdefault(match[1], name)

    if len(names) < len("xyz"):
        return None

    return np.column_stack([columns.pop(names[axis]) for axis in "xyz"])


def _headers(stamps_ns: Sequence[int], frame: str) -> Iterator[Any]:
    """Return the headers of messages with these time stamps, in a frame."""
    types = standard_types().types
    make_time = types["builtin_interfaces/msg/Time"]
    make_header = types["std_msgs/msg/Header"]
    return (
        make_header(make_time(*divmod(stamp_ns, NS_PER_S)), frame)
        for stamp_ns in stamps_ns
    )


def _wrenches(
    name: str, force: np.ndarray, torque: np.ndarray, headers: Iterable[Any]
) -> WrittenTopic:
    """Return forces and torques, shape (n, 3), as a topic of `WrenchStamped`."""
    types = standard_types().types
    make_vector = types["geometry_msgs/msg/Vector3"]
    make_wrench = types["geometry_msgs/msg/Wrench"]
    kind = "geometry_msgs/msg/WrenchStamped"
    make_message = types[kind]
    forces = [make_vector(*row) for row in force.tolist()]
    torques = [make_vector(*row) for row in torque.tolist()]
    wrenches = map(make_wrench, forces, torques)
    messages = (
        make_message(header, wrench)
        for header, wrench in zip(headers, wrenches, strict=True)
    )
    return WrittenTopic(name, kind, messages)
