"""The robot's joints among the names of a recording, up to a common prefix or suffix.

A recording says `left_panda_joint1`, `panda_1/joint1` or `joint1_position` where the
robot's description says `panda_joint1`.
"""

import re
from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from os.path import commonprefix
from typing import NamedTuple

from needleforce.recordings.channels import Channel
from needleforce.recordings.errors import ColumnError


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
    and suffix; else what remains of these without a prefix that they have in common.

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

    # Characters are meant, not parts of a path.
    prefix = commonprefix(list(joints))  # noqa: RUF071
    starts = [0, *(place.end() for place in re.finditer(r"[^A-Za-z0-9]", prefix))]
    for start in starts:
        names = [joint[start:] for joint in joints]
        first = rf"(.*(?<![A-Za-z0-9])|){re.escape(names[0])}((?![A-Za-z0-9]).*)"
        around = filter(None, (re.fullmatch(first, name) for name in sorted(known)))
        matches = [
            JointMatch(tuple(f"{head}{each}{tail}" for each in names), f"{head}*{tail}")
            for head, tail in (match.groups() for match in around)
        ]
        fitting = [match for match in matches if known.issuperset(match.names)]
        if fitting and not names[0].isdigit():
            return fitting

    return []


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
        if all(fnmatchcase(name, pattern or "*") for name in match.names)
    ]
    if not matches or len(fitting) == 1:
        return fitting[0] if fitting else None

    listed = " and ".join(f"{each.pattern} ({each.names[0]}, ...)" for each in matches)
    prefix = matches[0].pattern.partition("*")[0]
    raise ColumnError(
        f"{where}: the robot's joints may be {listed}; expected one of them",
        f"Choose one with `joints` in the `mapping`, such as `('{prefix}*',)`.",
    )


def names_channel(match: JointMatch, channel: Channel) -> bool:
    """Return whether what stands around the joints' names says which channel it is."""
    others = {"desired", "command", "commanded", "cmd", "target", "goal", "reference"}
    if channel.name != "tau_ext":
        others |= {"ext", "external"}

    words = [word for word in re.split(r"[^a-z0-9]", match.pattern.lower()) if word]
    runs = {
        "_".join(words[start:end])
        for start in range(len(words))
        for end in range(start + 1, len(words) + 1)
    }
    return others.isdisjoint(words) and not runs.isdisjoint(channel.spellings)
