"""The robot's joints among the names of a recording, up to a common prefix or suffix.

A recording says `left_panda_joint1`, `panda_1/joint1` or `joint1_position` where the
robot's description says `panda_joint1`.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from fnmatch import fnmatchcase
from itertools import takewhile
from typing import NamedTuple

from needleforce.recordings.channels import Channel
from needleforce.recordings.errors import ColumnError, RecordingCode

MAX_NAMES = 2000
"""So many names are searched for joints."""

_SEPARATOR = re.compile(r"[^A-Za-z0-9]")
_NOT_MEASURED = {
    "desired",
    "command",
    "commanded",
    "cmd",
    "target",
    "goal",
    "reference",
}
_EXTERNAL = {"ext", "external"}


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
        found: Names in the recording.
        joints: The robot's joints, in its order.

    Returns:
        One match; none if not all joints are there; several for several arms.
    """
    known = set(found)
    if not joints or len(known) > MAX_NAMES:
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
    prefix = _common_start(joints)
    suffix = _common_start([name[::-1] for name in joints])[::-1]
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


def _common_start(names: Sequence[str]) -> str:
    """Return the characters with which all names begin."""
    columns = zip(*names, strict=False)
    equal = takewhile(lambda characters: len(set(characters)) == 1, columns)
    return "".join(characters[0] for characters in equal)


def _distinctive_pattern(matches: list[JointMatch]) -> str:
    """Return the part of the first pattern in which it differs from the others."""
    prefix, _, suffix = matches[0].pattern.partition("*")
    prefixes = {match.pattern.partition("*")[0] for match in matches}
    return f"{prefix}*" if len(prefixes) > 1 else f"*{suffix}"


def choose_match(
    matches: list[JointMatch], pattern: str, where: str
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
    raise ColumnError(
        f"{where}: the robot's joints may be {listed}; expected one of them",
        RecordingCode.ARMS,
        pattern=_distinctive_pattern(matches),
    )


def match_columns(
    found: Collection[str], channel: Channel, joints: Sequence[str], pattern: str
) -> tuple[str, ...]:
    """Return columns that have the names of the joints and of a channel in theirs.

    Args:
        found: Names of columns, without units.
        channel: The channel that is looked for.
        joints: The robot's joints, in its order.
        pattern: See `choose_match`.

    Returns:
        The names, in the robot's order; none if there are no such columns.
    """
    matches = [
        match for match in match_joints(found, joints) if _names_channel(match, channel)
    ]
    chosen = choose_match(matches, pattern, channel.name)
    return () if chosen is None else chosen.names


def _names_channel(match: JointMatch, channel: Channel) -> bool:
    """Return whether what stands around the joints' names says which channel it is."""
    words = [word for word in _SEPARATOR.split(match.pattern.lower()) if word]
    runs = {
        "_".join(words[start:end])
        for start in range(len(words))
        for end in range(start + 1, len(words) + 1)
    }
    is_other = not _NOT_MEASURED.isdisjoint(words) or (
        channel.name != "tau_ext" and not _EXTERNAL.isdisjoint(words)
    )
    return not is_other and not runs.isdisjoint(channel.spellings)
