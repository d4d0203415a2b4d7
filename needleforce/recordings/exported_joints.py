"""Joints by name in text that was exported from ROS topics.

A message of joint states holds names, positions, velocities and efforts. Tools that
export it to text write one column for each joint, in one of the ways that `[joints]`
in `layouts.toml` lists. These columns become one of two dimensions with the joints'
names, as in a bag.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from needleforce.recordings.channels import JointRules


class JointGroup(NamedTuple):
    """Columns that are one field of a message of joint states.

    Attributes:
        column: Name of the column that they become.
        members: Their names, by joint.
        sources: Columns of text that state these names.
    """

    column: str
    members: Mapping[str, str]
    sources: tuple[str, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(self.members)


def find_joint_groups(
    names: Sequence[str], texts: Mapping[str, str], rules: JointRules
) -> list[JointGroup]:
    """Return the groups of columns that hold joints whose names the file states.

    Args:
        names: Of all columns of numbers.
        texts: Of each column of text, what its first row holds.
        rules: How names of columns are made.
    """
    return [
        *_groups_by_path(names, rules),
        *(
            group
            for head, joints in _named_joints(texts, rules).items()
            for group in _groups_by_number(names, head, joints, rules)
        ),
    ]


def group_columns(
    columns: Mapping[str, np.ndarray], groups: Iterable[JointGroup]
) -> dict[str, np.ndarray]:
    """Return columns (n,) with those of each group as one (n, k), in its place."""
    group_of = {name: group for group in groups for name in group.members.values()}
    grouped: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        group = group_of.get(name)
        if group is None:
            grouped[name] = values
        elif group.column not in grouped:
            members = [columns[member] for member in group.members.values()]
            grouped[group.column] = np.stack(members, axis=1)

    return grouped


def _groups_by_path(names: Sequence[str], rules: JointRules) -> list[JointGroup]:
    """Return the groups of names such as `/joint_states/elbow/position`."""
    members_of: dict[str, dict[str, str]] = {}
    for name in names:
        if match := re.match(rules.by_path, name):
            column = match["head"] + match["field"]
            members_of.setdefault(column, {})[match["joint"]] = name

    return [
        JointGroup(column, members)
        for column, members in members_of.items()
        if len(members) > 1
    ]


class _NamedJoints(NamedTuple):
    """Names of joints by their number, and the columns of text that state them."""

    joint_of: dict[str, str]
    sources: tuple[str, ...]


def _named_joints(
    texts: Mapping[str, str], rules: JointRules
) -> dict[str, _NamedJoints]:
    """Return the joints that columns of text name, by what stands before `name`."""
    named: dict[str, _NamedJoints] = {}
    for name, text in texts.items():
        listed = re.findall(r"['\"]([^'\"]+)['\"]", text)
        if match := re.match(rules.by_number, name):
            known = named.get(match["head"], _NamedJoints({}, ()))
            joint_of = {**known.joint_of, match["number"]: text}
            named[match["head"]] = _NamedJoints(joint_of, (*known.sources, name))
        elif len(listed) > 1 and (match := re.match(rules.by_list, name)):
            joint_of = {str(number): joint for number, joint in enumerate(listed)}
            named[match["head"]] = _NamedJoints(joint_of, (name,))

    return named


def _groups_by_number(
    names: Sequence[str], head: str, joints: _NamedJoints, rules: JointRules
) -> Iterator[JointGroup]:
    """Yield the groups of `position0`, ... whose numbers are those of named joints."""
    for field in rules.fields:
        expression = rf"{re.escape(head + field)}_?\[?(\d{{1,3}})\]?"
        column_of = {
            match[1]: name
            for name in names
            if (match := re.fullmatch(expression, name))
        }
        if column_of and column_of.keys() == joints.joint_of.keys():
            members = {joint: column_of[n] for n, joint in joints.joint_of.items()}
            column = head.replace(".", "/") + field
            yield JointGroup(column, members, joints.sources)
