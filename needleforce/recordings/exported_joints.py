"""Joints by name in text that was exported from ROS topics.

A message of joint states holds names, positions, velocities and efforts. Tools that
export it to text write one column for each joint, in one of these ways:

- the joint's name within the column's: `/joint_states/elbow/position`;
- numbers in the columns' names, and the joints' names in columns of text beside them:
  `field.name0` with `field.position0`;
- the same with all names as a list in one column of text: `name` with `position_0`.

These columns become one of two dimensions with the joints' names, as in a bag.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

FIELDS = ("position", "velocity", "effort")
"""Fields of a message of joint states, with one value for each joint."""

_NAMED = re.compile(
    rf"^(?P<topic>/?(?:.*/)?)(?P<joint>[^/]+)/(?P<field>{'|'.join(FIELDS)})$"
)
_NUMBERED_NAMES = re.compile(r"^(?P<head>(?:.*[./])?)name_?\[?(?P<number>\d{1,3})\]?$")
_LIST_OF_NAMES = re.compile(r"^(?P<head>(?:.*[./])?)name$")
_QUOTED = re.compile(r"'([^']+)'|\"([^\"]+)\"")


class JointGroup(NamedTuple):
    """Columns that are one field of a message of joint states.

    Attributes:
        column: Name of the column that they become.
        members: Their names, in the order of the joints.
        joints: Names of the joints.
        sources: Columns of text that state these names.
    """

    column: str
    members: tuple[str, ...]
    joints: tuple[str, ...]
    sources: tuple[str, ...] = ()


def find_joint_groups(
    names: Sequence[str], texts: Mapping[str, str]
) -> list[JointGroup]:
    """Return the groups of columns that hold joints whose names the file states.

    Args:
        names: Of all columns of numbers.
        texts: Of each column of text, what its first row holds.
    """
    return [
        *_groups_by_path(names),
        *_groups_by_number(names, texts),
        *_groups_by_list(names, texts),
    ]


def group_columns(
    columns: Mapping[str, np.ndarray], groups: Iterable[JointGroup]
) -> dict[str, np.ndarray]:
    """Return columns (n,) with those of each group as one (n, k), in its place."""
    column_of = {member: group for group in groups for member in group.members}
    grouped: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        group = column_of.get(name)
        if group is None:
            grouped[name] = values
        elif group.column not in grouped:
            members = [columns[member] for member in group.members]
            grouped[group.column] = np.stack(members, axis=1)

    return grouped


def _groups_by_path(names: Sequence[str]) -> list[JointGroup]:
    """Return the groups of names such as `/joint_states/elbow/position`."""
    joints_of: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        if match := _NAMED.match(name):
            joints = joints_of.setdefault((match["topic"], match["field"]), {})
            joints[match["joint"]] = name

    return [
        JointGroup(topic + field, tuple(joints.values()), tuple(joints))
        for (topic, field), joints in joints_of.items()
        if len(joints) > 1
    ]


def _groups_by_number(
    names: Sequence[str], texts: Mapping[str, str]
) -> list[JointGroup]:
    """Return the groups of `field.position0`, whose joint `field.name0` states."""
    sources_of: dict[str, dict[str, str]] = {}
    for name in texts:
        if match := _NUMBERED_NAMES.match(name):
            sources_of.setdefault(match["head"], {})[match["number"]] = name

    groups: list[JointGroup] = []
    for head, source_of in sources_of.items():
        sources = tuple(source_of.values())
        joints = tuple(texts[name] for name in sources)
        for field in FIELDS:
            members = _numbered_members(names, head, field, tuple(source_of))
            if members:
                column = head.replace(".", "/") + field
                groups.append(JointGroup(column, members, joints, sources))

    return groups


def _groups_by_list(names: Sequence[str], texts: Mapping[str, str]) -> list[JointGroup]:
    """Return the groups of `position_0`, whose joints the text of `name` lists."""
    groups: list[JointGroup] = []
    for name, text in texts.items():
        match = _LIST_OF_NAMES.match(name)
        joints = tuple("".join(quoted) for quoted in _QUOTED.findall(text))
        if match is None or len(joints) < 2:
            continue

        head = match["head"]
        numbers = [str(number) for number in range(len(joints))]
        for field in FIELDS:
            members = _numbered_members(names, head, field, numbers)
            if members and not _numbered_members(
                names, head, field, [str(len(joints))]
            ):
                column = head.replace(".", "/") + field
                groups.append(JointGroup(column, members, joints, (name,)))

    return groups


def _numbered_members(
    names: Sequence[str], head: str, field: str, numbers: Sequence[str]
) -> tuple[str, ...]:
    """Return the names of a field's columns by their numbers; none if one lacks."""
    known = set(names)
    members: list[str] = []
    for number in numbers:
        spellings = (
            f"{head}{field}{number}",
            f"{head}{field}_{number}",
            f"{head}{field}[{number}]",
        )
        found = [name for name in spellings if name in known]
        if not found:
            return ()

        members.append(found[0])

    return tuple(members)
