"""Which topics of a bag are read, and how their messages become rows."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from recordings.bags.survey import BagSurvey, SurveyedTopic
from recordings.columns.wanted import Wanted
from recordings.errors import ColumnError, FormatError
from recordings.tables.table import Table

_AS_MANY = 0.9
"""A topic with this share of another's messages counts as equally fast."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagPlan:
    """What is read.

    Attributes:
        columns: topic to the columns read from it.
        clock: the topic whose messages are the rows.
        joints: topic to the order of its joints, for topics that name joints.
        notes: what was assumed.
    """

    columns: Mapping[str, frozenset[str]]
    clock: str
    joints: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...]


def survey_table(survey: BagSurvey) -> Table:
    """Return all columns of a bag without rows, to look columns up by name.

    Raises:
        FormatError: no topic holds numbers that can be read.
    """
    widths = {
        name: width for found in survey.topics.values() for name, width in found.columns.items()
    }
    if not widths:
        told = "; ".join(
            f"{name} ({found.topic.kind}) {found.fault or 'holds no numbers'}"
            for name, found in survey.topics.items()
        )
        raise FormatError(f"{survey.path} holds no topic with numbers: {told}")
    joints = {name: tuple(found.joints) for found in survey.topics.values() for name in found.named}
    return Table(
        columns={n: np.empty((0,) if k is None else (0, k)) for n, k in widths.items()},
        joint_names=joints,
        warnings=tuple(
            f"{name!r}: {found.topic.kind} {found.fault}"
            for name, found in survey.topics.items()
            if found.fault
        ),
    )


def plan_bag(survey: BagSurvey, wanted: Wanted, needed: frozenset[str]) -> BagPlan:
    """Decide what to read.

    Args:
        survey: the bag.
        wanted: may name clock and joints.
        needed: the columns to read.

    Raises:
        ColumnError: the clock's topic or a joint of the mapping is not in the bag.
    """
    topics = {
        name: frozenset(found.columns.keys() & needed)
        for name, found in survey.topics.items()
        if found.columns.keys() & needed
    }
    clock = wanted.mapping.clock
    if clock is None:
        clock = _fastest({name: survey.topics[name].count for name in topics})
    elif clock not in survey.topics or survey.topics[clock].fault:
        raise ColumnError(
            f"clock = {clock!r} is no topic that can be read; topics are: "
            f"{', '.join(survey.topics)}"
        )
    topics.setdefault(clock, frozenset())
    joints, notes = {}, []
    for name in topics:
        joints[name], told = _joints(survey.topics[name], wanted)
        notes += told
    others = [name for name in topics if name != clock]
    # One message more or less is no other rate, only where the recording begins or ends.
    if any(abs(survey.topics[name].count - survey.topics[clock].count) > 1 for name in others):
        rates = ", ".join(f"{name} ({survey.topics[name].rate_hz:.4g} Hz)" for name in others)
        notes.append(
            f"rows are the messages of {clock} ({survey.topics[clock].rate_hz:.4g} Hz); "
            f"interpolated to their stamps: {rates}"
        )
    return BagPlan(columns=topics, clock=clock, joints=joints, notes=tuple(notes))


def _fastest(counts: Mapping[str, int]) -> str:
    """Return the topic with most messages; a few that were lost shall not make a difference."""
    most = max(counts.values())
    return next(name for name, count in counts.items() if count >= _AS_MANY * most)


def _joints(found: SurveyedTopic, wanted: Wanted) -> tuple[tuple[str, ...], list[str]]:
    """Return the order of a topic's joints, and what was assumed."""
    here, name = tuple(found.joints), found.topic.name
    if not here:
        return (), []
    if missing := [joint for joint in wanted.mapping.joints if joint not in here]:
        raise ColumnError(
            f"joints of the mapping that {name} does not have: {', '.join(missing)}; "
            f"it has: {', '.join(here)}"
        )
    order = wanted.mapping.joints or wanted.joints
    if not order or set(order) <= set(here):
        return order or here, []
    return here, [
        f"{name} has the joints {', '.join(here)}, the robot {', '.join(order)}; the order of the "
        "bag was kept, name another one with joints in the mapping"
    ]
