"""The robot's joints among the names of a recording, up to a common prefix or suffix.

A recording says `left_panda_joint1`, `panda_1/joint1` or `joint1_position` where the
robot's description says `panda_joint1`.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from fnmatch import fnmatchcase
from os.path import commonprefix
from typing import NamedTuple

from needleforce.recordings.channels import Channel, JointRules
from needleforce.recordings.errors import ColumnError
from needleforce.recordings.mapping import ColumnMapping

_SEPARATOR = re.compile(r"[^A-Za-z0-9]")


class JointMatch(NamedTuple):
    """Names of a recording that are the robot's joints.

    Attributes:
        names: In the robot's order.
        pattern: What they have in common, with a star for what differs.
    """

    names: tuple[str, ...]
    pattern: str


def match_joints(found: Collection[str], joints: Sequence[str]) -> list[JointMatch]:
    """Return the names of a recording that are the robot's joints, if any are.

    They are equal to the joints' names; else they contain these with a common prefix
    and suffix; else what remains of these without a prefix or suffix that they have in
    common.

    Args:
        found: Names in the recording; of more than 2000 none is searched for.
        joints: The robot's joints, in its order.

    Returns:
        One match; none if not all joints are there; several for several arms.
    """
    known = set(found)
    if not joints or len(known) > 2000:
        return []
    if set(joints) <= known:
        return [JointMatch(tuple(joints), "*")]

    for names in _shortened(joints):
        matches = dict.fromkeys(_matches_of(known, names))
        if matches:
            return list(matches)

    return []


def _matches_of(known: set[str], names: Sequence[str]) -> Iterator[JointMatch]:
    """Yield the names that have a common prefix and suffix around all of some names."""
    first = re.compile(rf"(?<![A-Za-z0-9]){re.escape(names[0])}(?![A-Za-z0-9])")
    for name in sorted(known):
        for place in first.finditer(name):
            prefix = name[: place.start()]
            suffix = name[place.end() :]
            matched = tuple(f"{prefix}{joint}{suffix}" for joint in names)
            if set(matched) <= known:
                yield JointMatch(matched, f"{prefix}*{suffix}")


def _shortened(joints: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield the joints' names, and shorter ones that still tell them apart."""
    # Characters are meant, not parts of a path.
    prefix = commonprefix(list(joints))  # noqa: RUF071
    suffix = commonprefix([name[::-1] for name in joints])[::-1]  # noqa: RUF071
    starts = [0, *(place.end() for place in _SEPARATOR.finditer(prefix))]
    ends = [0, *(len(suffix) - place.start() for place in _SEPARATOR.finditer(suffix))]
    for start in starts:
        for end in sorted(ends):
            names = tuple(name[start : len(name) - end] for name in joints)
            if any(name.isdigit() or not name for name in names):
                continue

            yield names
            yield tuple(re.sub(r"_(?=\d)", "", name) for name in names)
            yield tuple(re.sub(r"(?<=[A-Za-z])(?=\d)", "_", name) for name in names)


def choose_match(
    matches: Sequence[JointMatch], pattern: str, where: str
) -> JointMatch | None:
    """Return the match that a pattern fits; None if there is none at all.

    Args:
        matches: What would fit the robot's joints.
        pattern: Of all names of the one that is meant; empty for any.
        where: In which the names stand, for the message.

    Raises:
        ColumnError: Several would fit, as of two arms, or none fits the pattern.
    """
    fitting = [
        match
        for match in matches
        if not pattern or all(fnmatchcase(name, pattern) for name in match.names)
    ]
    if not matches or len(fitting) == 1:
        return fitting[0] if fitting else None

    listed = " and ".join(
        f"{match.pattern} ({match.names[0]}, ...)" for match in matches
    )
    prefix, _, suffix = matches[0].pattern.partition("*")
    prefixes = {match.pattern.partition("*")[0] for match in matches}
    pattern = f"{prefix}*" if len(prefixes) > 1 else f"*{suffix}"
    raise ColumnError(
        f"{where}: the robot's joints may be {listed}; expected one of them",
        f"Choose one with `joints` in the `mapping`, such as `('{pattern}',)`.",
    )


def names_channel(match: JointMatch, channel: Channel, rules: JointRules) -> bool:
    """Return whether what stands around the joints' names says which channel it is."""
    words = [word for word in _SEPARATOR.split(match.pattern.lower()) if word]
    runs = {
        "_".join(words[start:end])
        for start in range(len(words))
        for end in range(start + 1, len(words) + 1)
    }
    is_external = channel.name != "tau_ext" and bool({"ext", "external"} & {*words})
    is_other = is_external or not set(rules.not_measured).isdisjoint(words)
    return not is_other and not runs.isdisjoint(channel.spellings)


def order_joints(
    name: str, joints: Sequence[str], mapping: ColumnMapping, robot: Sequence[str]
) -> tuple[tuple[str, ...], list[str]]:
    """Return the order of joints: the mapping's, the robot's, or the recording's.

    And what was assumed, one sentence each.

    Args:
        name: Of the topic or column, for messages.
        joints: That the recording names, in its order; none if it names none.
        mapping: In which order the robot has them, or which pattern they fit.
        robot: The robot's joints, where the mapping does not say.

    Raises:
        ColumnError: The recording lacks a joint of the mapping, or has joints of
            several arms that would fit.
    """
    missing = [joint for joint in mapping.joint_order if joint not in joints]
    if joints and missing:
        raise ColumnError(
            f"joints of the mapping that {name} does not have: "
            f"{', '.join(missing)}; it has: {', '.join(joints)}"
        )

    order = tuple(mapping.joint_order or robot)
    if not joints or not order:
        return tuple(joints), []

    matches = match_joints(joints, order)
    chosen = choose_match(matches, mapping.joint_pattern, name)
    if chosen is None:
        return tuple(joints), [
            f"{name} has the joints {', '.join(joints)}, the robot {', '.join(order)}; "
            "the order of the recording was kept, name another one with joints in the "
            "mapping"
        ]

    note = (
        f"{name}: the joints {chosen.names[0]}, ... ({chosen.pattern}) were taken for "
        f"the robot's {order[0]}, ..."
    )
    return chosen.names, [] if chosen.names == order else [note]
