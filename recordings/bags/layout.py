"""Which topics and standard messages hold the columns of a table in a bag."""

import re
from collections.abc import Mapping
from typing import NamedTuple

from recordings.bags.cdr_layout import Path
from recordings.tables.checked_columns import Columns
from recordings.tables.labels import Labels

TIME = "t_s"
JOINT_STATES = "/joint_states"
FT_WRENCH, FT_FRAME = "/ft_sensor/wrench", "ft_sensor"
_JOINT_SIGNALS = {"position": "q_rad", "velocity": "dq_rad_s", "effort": "tau_Nm"}
_FT_SIGNALS = {"force": "ft_force_N", "torque": "ft_torque_Nm"}
_COMPONENT = re.compile(r"(force|torque)_([xyz])_in_\w+")
_XYZ = "xyz"

Source = tuple[str, int | None]
"""A column, and which of its elements; None for all of them, or for the only one."""


class OutTopic(NamedTuple):
    """A topic to write, one message for each row.

    Attributes:
        name: the topic.
        kind: type of its messages.
        values: field path to what stands there.
        lengths: field path to length, for arrays.
        names: joint names.
        frame: `header.frame_id`.
    """

    name: str
    kind: str
    values: Mapping[Path, Source]
    lengths: Mapping[Path, int]
    names: tuple[str, ...] = ()
    frame: str = ""


def bag_layout(columns: Columns, labels: Labels) -> list[OutTopic]:
    """Decide which topics are written.

    `q_rad`, `dq_rad_s` and `tau_Nm` become a `JointState`; `ft_force_N` with `ft_torque_Nm`, and
    `force_x_in_...`, `torque_x_in_...` and so on, become a `WrenchStamped`; every other column
    becomes a `Float64` of its own.

    Args:
        columns: what is written; `t_s` becomes the time stamps.
        labels: names of joints, frame and topics.
    """
    left = [name for name in columns if name != TIME]
    topics: list[OutTopic] = []
    for make in (_joint_states, _ft_wrench, _wrench):
        topic, taken = make(columns, labels)
        if topic is not None:
            topics.append(topic)
            left = [name for name in left if name not in taken]
    return topics + [topic for name in left for topic in _numbers(name, columns, labels)]


def _joint_states(columns: Columns, labels: Labels) -> tuple[OutTopic | None, set[str]]:
    here = {f: n for f, n in _JOINT_SIGNALS.items() if n in columns and columns[n].ndim == 2}
    if not here:
        return None, set()
    width = columns[next(iter(here.values()))].shape[1]
    here = {field: name for field, name in here.items() if columns[name].shape[1] == width}
    names = labels.joint_names
    if len(names) != width:
        names = tuple(f"joint_{i + 1}" for i in range(width))
    topic = OutTopic(
        name=JOINT_STATES,
        kind="sensor_msgs/msg/JointState",
        values={(field,): (name, None) for field, name in here.items()},
        lengths={(field,): width for field in here},
        names=names,
    )
    return topic, set(here.values())


def _ft_wrench(columns: Columns, _: Labels) -> tuple[OutTopic | None, set[str]]:
    if not all(
        name in columns and columns[name].shape[1:] == (3,) for name in _FT_SIGNALS.values()
    ):
        return None, set()
    sources: dict[tuple[str, str], Source] = {
        (field, xyz): (name, i) for field, name in _FT_SIGNALS.items() for i, xyz in enumerate(_XYZ)
    }
    return _wrench_topic(FT_WRENCH, sources, FT_FRAME), set(_FT_SIGNALS.values())


def _wrench(columns: Columns, labels: Labels) -> tuple[OutTopic | None, set[str]]:
    sources: dict[tuple[str, str], Source] = {}
    for name, values in columns.items():
        if values.ndim == 1 and (match := _COMPONENT.fullmatch(name)):
            sources.setdefault((match[1], match[2]), (name, None))
    if not all(("force", xyz) in sources for xyz in _XYZ):
        return None, set()
    topic = _wrench_topic(f"{labels.prefix}/wrench", sources, labels.frame)
    return topic, {name for name, _ in sources.values()}


def _wrench_topic(name: str, sources: Mapping[tuple[str, str], Source], frame: str) -> OutTopic:
    values = {("wrench", *path): source for path, source in sources.items()}
    return OutTopic(name, "geometry_msgs/msg/WrenchStamped", values, {}, (), frame)


def _numbers(name: str, columns: Columns, labels: Labels) -> list[OutTopic]:
    """A number without a header: its time stamp is the one of the record."""
    topic = f"{labels.prefix}/{re.sub(r'[^A-Za-z0-9_]', '_', name)}"
    if columns[name].ndim == 1:
        return [_number(topic, (name, None))]
    return [_number(f"{topic}_{i + 1}", (name, i)) for i in range(columns[name].shape[1])]


def _number(topic: str, source: Source) -> OutTopic:
    return OutTopic(topic, "std_msgs/msg/Float64", {("data",): source}, {})
