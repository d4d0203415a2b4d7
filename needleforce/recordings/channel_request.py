"""Which channels are read of a recording, which columns they are, in which units.

Parts of a name, patterns of names and usual names; then a request for channels, which
finds its columns with them. No number in a name has more than nine digits: longer ones
are no joint's, and counting up to them would take all memory.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import groupby, pairwise, product
from typing import NamedTuple

import numpy as np

from needleforce.recordings.channels import (
    LEFT_OUT,
    Channel,
    ColumnMapping,
    ColumnSpec,
    Units,
    known_channel,
    mapping_of_layout,
    normalised_name,
)
from needleforce.recordings.errors import ColumnError, MappingError, UnitError
from needleforce.recordings.joint_names import (
    choose_match,
    match_joints,
    names_channel,
)
from needleforce.recordings.table import Table

ASSUMED = "assumed"
"""Origin of the SI unit of a column for which nothing states one."""

_BRACKETED_UNIT = re.compile(
    r"^(?P<stem>.*\S)\s*[\[({<](?P<unit>[^\[\](){}<>]+)[\])}>]$"
)


class ColumnName(NamedTuple):
    """The parts of a column name.

    Attributes:
        stem: Lower case, without path, number and unit: `q` in `/robot/q_3_rad`.
        family: The name with its number blanked, the same for the columns of a signal.
        number: The trailing one (a joint's); None without one.
        unit: That the name carries; None without one.
    """

    stem: str
    family: str
    number: int | None
    unit: str | None


def parse_column_name(name: str, units: Units) -> ColumnName:
    """Split a column name into its parts.

    Only a unit of the quantity looked for is read as one. Understands `q1`, `q_1`,
    `q[0]`, `q1_deg`, `q_deg_1`, `joint 1 position`, `z [mm]`, `z (mm)`, `z/mm`, `z mm`,
    `z in mm`, `speed_mm_s` and a leading path such as `/joint_states/`; before a number
    also one with dots, as in `state.q[0]`, and a word for a joint, as in `position.a1`.
    """
    stem, unit = split_unit(name.strip(), units)
    number = None
    family = name
    last = re.match(r"^(.*?[^\d_.\[ ])[_. ]?\[?(\d{1,9})\]?$", stem)
    a_joint = r"(?:joint|axis|actuator|motor|ax|j|a)"
    joint = rf"(?i)^({a_joint}[_. ]?)(\d{{1,2}})[_./ ]+([^\d\W].*)$"
    first = re.match(joint, stem.rsplit("/", 1)[-1])
    if last:
        number = int(last[2])
        start, end = last.span(2)
        family = name.replace(stem, f"{stem[:start]}#{stem[end:]}", 1)
        named = re.sub(rf"(?i)[_. /]{a_joint}$", "", last[1])
        stem = named.rsplit(".", 1)[-1]
        if unit is None:
            stem, unit = split_unit(stem, units)
    elif first:
        number = int(first[2])
        family = name.replace(first[1] + first[2], f"{first[1]}#", 1)
        stem = first[3]

    return ColumnName(normalised_name(stem.rsplit("/", 1)[-1]), family, number, unit)


def split_unit(name: str, units: Units) -> tuple[str, str | None]:
    """Split a unit, if there is one, off the end of a name such as `speed_mm_s`."""
    parts: list[Sequence[str]] = []
    if match := _BRACKETED_UNIT.match(name):
        parts.append(match.groups())
    if not name.startswith("/"):  # a path such as /arm/m is no quotient
        places = [match.span() for match in re.finditer("/", name)]
        parts += [(name[:start], name[end:]) for start, end in places]
    for separator, count in product("_ ", (3, 2, 1)):  # the longest is mm_per_s
        head, *tail = name.rsplit(separator, count)
        if len(tail) == count and head.strip():
            parts.append((head, separator.join(tail)))
    for head, tail in parts:
        if unit := units.find(tail):
            return re.sub(r"[\s,:]+(?:in)?[\s,:]*$", "", head), unit

    return name, None


def written_unit(name: str) -> str | None:
    """Return what stands in brackets at the end of a name, whether it is a unit or not.

    `wrench[2]` has an element there, and no unit.
    """
    match = _BRACKETED_UNIT.match(name.strip())
    return None if match is None or match["unit"].isdigit() else match["unit"].strip()


def find_columns(table: Table, pattern: str) -> list[str]:
    """Return the names of the columns that a name or pattern stands for.

    In this order: a column of exactly that name; `wrench[2]`, one column (from 0) of a
    two-dimensional one; `q{1..7}`, the numbers from 1 to 7; `q_*`, all columns with a
    number in that place; and `q_rad` for a family `q_rad_1`, `q_rad_2`, ... as this
    package writes it to CSV. `*/` at the beginning stands for any path, or none.
    Numbered ones come in the order of their numbers.

    Raises:
        ColumnError: There is no such column, two have one number, or one is missing.
    """
    with suppress(KeyError):
        table.values(pattern)
        return [pattern]

    path = r"(?:.*/)?" if pattern.startswith("*/") else ""
    text = pattern.removeprefix("*/")
    expression = rf"{path}{re.escape(text)}(?:[_. ]?\[?(\d{{1,9}})\]?)?"
    place = re.search(r"\{(\d{1,9})\.\.(\d{1,9})\}|\*", text)
    if place:
        head = re.escape(text[: place.start()])
        expression = rf"{path}{head}(\d{{1,9}}){re.escape(text[place.end() :])}"

    span = range(int(place[1]), int(place[2]) + 1) if place and place[1] else None
    numbered: dict[int, str] = {}
    for match in filter(None, map(re.compile(expression).fullmatch, table.columns)):
        number = int(match[1] or -1)
        if span is not None and number not in span:
            continue
        if (other := numbered.setdefault(number, match[0])) != match[0]:
            raise ColumnError(f"{pattern!r} fits both {other!r} and {match[0]!r}")

    if -1 in numbered:
        return [numbered[-1]]
    if not numbered or (span and {span[0], span[-1]} - numbered.keys()):
        raise ColumnError(f"no column {pattern!r}. Columns are: {table.describe()}")

    return _in_order(numbered, pattern)


def _in_order(numbered: Mapping[int, str], pattern: str) -> list[str]:
    """Return a family of columns by their numbers; `ColumnError` if one is missing."""
    ordered = sorted(numbered)
    for number, following in pairwise(ordered):
        if following != number + 1:
            raise ColumnError(
                f"{pattern!r}: found the numbers {ordered[0]} to {ordered[-1]}, but "
                f"not {number + 1}"
            )

    return [numbered[number] for number in ordered]


def detect_columns(table: Table, channel: Channel) -> list[str]:
    """Return the columns whose names say that they are this channel, in joint order.

    Preferred names come before usual ones, these before the words of testing machines,
    and last come names that say it only beside a unit. Columns are one array, or a
    family of numbered columns; for a channel of one value one without a number, if
    there is one.

    Returns:
        Their names; none if no name says so.

    Raises:
        ColumnError: Several would fit, or a joint's column is missing.
    """
    names = {name: parse_column_name(name, channel.units) for name in table.columns}
    for name in table.seconds:  # in brackets it may say how times are written
        text = re.sub(r"(?<=\S)\s*\([^()]*\)$", "", name.strip())
        names[name] = parse_column_name(text, channel.units)

    stems = {name: parts.stem for name, parts in names.items()}
    with_unit = {n: s for n, s in stems.items() if names[n].unit or n in table.units}
    tiers = (
        (stems, channel.preferred),
        (stems, channel.spellings),
        (stems, channel.machine_words),
        (with_unit, channel.words_with_unit),
    )
    fitting = ([n for n in stem_of if stem_of[n] in words] for stem_of, words in tiers)
    found = next(filter(None, fitting), [])
    families: dict[str, dict[int, str]] = {}
    for name in found:
        parts = names[name]
        is_single = table.columns[name].ndim == 1
        if channel.per_joint and is_single and parts.number is not None:
            families.setdefault(parts.family, {})[parts.number] = name
        elif channel.per_joint or is_single:
            families[name] = {0: name}

    candidates = {name: _in_order(each, name) for name, each in families.items()}
    if not channel.per_joint:
        plain = {n: [n] for n in candidates if names[n].number is None}
        candidates = plain or candidates
    if len(candidates) > 1:
        raise several_fit(channel, candidates)

    return next(iter(candidates.values()), [])


def several_fit(channel: Channel, names: Iterable[str]) -> ColumnError:
    """Return the error for a channel that several columns would fit."""
    return ColumnError(
        f"{channel.name}: several columns would fit ({', '.join(names)})"
    )


class ChannelUnit(NamedTuple):
    """The unit in which a channel is read.

    Attributes:
        channel: Its name, such as `q`.
        columns: Its columns, by joint.
        units: Of each column, as keys of the channel's units.
        origins: Whence the unit of each column is known: header, row of units, mapping,
            format of the file, or `ASSUMED`.
        scale: Factor or factors of the mapping, applied after the conversion to SI.
    """

    channel: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    origins: tuple[str, ...]
    scale: float | tuple[float, ...] = 1.0

    def __str__(self) -> str:
        """Return columns, units and their origin in one line."""
        facts = zip(self.units, self.origins, self.columns, strict=True)
        parts = [
            f"{describe_columns([name for *_, name in group])} in {unit} ({origin})"
            for (unit, origin), group in groupby(facts, lambda fact: fact[:2])
        ]
        scales = np.atleast_1d(np.array(self.scale))
        if np.any(scales != 1.0):
            parts.append(f"times {', '.join(f'{scale:g}' for scale in scales)}")

        return "; ".join(parts)


def read_units(
    table: Table, channel: Channel, columns: Sequence[str], spec: ColumnSpec | None
) -> ChannelUnit:
    """Return in which unit each column of a channel is read.

    Args:
        table: With rows or without.
        channel: The channel.
        columns: Of the channel.
        spec: What the mapping says of them; None if nothing.

    Raises:
        MappingError: It has units for another number of columns.
        UnitError: The file contradicts itself or the mapping, or states a unit that is
            none of the channel's.
    """
    spec = spec or ColumnSpec(columns=tuple(columns))
    asked = spec.unit if isinstance(spec.unit, tuple) else (spec.unit,) * len(columns)
    if len(asked) != len(columns):
        raise MappingError(
            f"{channel.name}: {len(asked)} units for {len(columns)} columns, expected "
            "one for all or one for each"
        )

    has_factor = spec.scale != 1.0
    found = [
        _unit_of_column(table, channel, name, unit, has_factor=has_factor)
        for name, unit in zip(columns, asked, strict=True)
    ]
    units, origins = zip(*found, strict=True)
    return ChannelUnit(channel.name, tuple(columns), units, origins, spec.scale)


def _unit_of_column(
    table: Table, channel: Channel, name: str, asked: str | None, *, has_factor: bool
) -> tuple[str, str]:
    """Return the unit of one of a channel's columns, and whence it is known.

    It is the mapping's, else that in the row of units or in the name, else SI. A factor
    may stand for the conversion from a unit that no channel has, such as a percentage.
    """
    # Messages of a bag define their unit: joint states, and forces and torques.
    is_vector = re.search(r"/(?:force|torque)_xyz(?:\[\d\])?$", name) is not None
    is_typed = is_vector or name in table.joint_names
    if name in table.seconds or (is_typed and not asked):
        return channel.units.si, "format of the file"

    in_header = parse_column_name(name, channel.units).unit or written_unit(name)
    texts = {"row of units": table.units.get(name), "header": in_header}
    stated = {
        channel.units.find(text) or text: origin
        for origin, text in texts.items()
        if text is not None
    }
    are_known = stated.keys() <= channel.units.keys()
    said = stated | ({asked: "mapping"} if asked else {})
    if are_known and (len(said) == 1 or asked in stated):
        return (asked, "mapping") if asked else next(iter(said.items()))
    if not stated or (has_factor and not are_known):
        return asked or channel.units.si, "mapping" if stated else ASSUMED

    listed = " and ".join(f"{unit!r} ({origin})" for unit, origin in said.items())
    raise UnitError(
        f"{channel.name}: column {name!r} is in {listed}; expected one of "
        f"{', '.join(channel.units)}"
    )


def describe_columns(columns: Sequence[str]) -> str:
    """Return the columns of a channel in words: one name, or the first and the last."""
    return columns[0] if len(columns) == 1 else f"{columns[0]} to {columns[-1]}"


@dataclass(frozen=True, slots=True)
class ChannelRequest:
    """Channels, and which columns they are; of a bag only these are read.

    A recording that has all of the robot's joints by name is put into their order, or
    into that of `mapping.joints`, if it has some.

    Attributes:
        mapping: Which columns are which channels, where their names do not say so.
        required: Channels that must be there.
        optional: Channels read if they are there; with neither given, all are.
        joints: Names of the robot's joints, in its order.
        named: Channels read if the mapping names their columns.
    """

    mapping: ColumnMapping = field(default_factory=ColumnMapping)
    required: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    named: tuple[str, ...] = ()

    @property
    def channels(self) -> Mapping[str, Channel]:
        """Every channel by its name."""
        return self.mapping.knowledge.channels

    @property
    def robot(self) -> tuple[str, ...]:
        """The joints that are looked for, in the robot's order."""
        return self.mapping.joint_order or self.joints

    def columns(self, table: Table) -> frozenset[str] | None:
        """Return the names of the columns that the channels need.

        Values are not looked at.

        Returns:
            The names; None if a required channel is not there.

        Raises:
            ColumnError: A mapped channel was not found, or is ambiguous.
        """
        request = self.with_layout(table)
        found = request.find_all(table)
        if "time" in request.mapping.channels:
            found["time"] = request.find_time(table)
        if not found.keys() >= {*self.required}:
            return None

        return frozenset(
            name if name in table.columns else name.rpartition("[")[0]
            for unit in found.values()
            for name in unit.columns
        )

    def find_all(self, table: Table) -> dict[str, ChannelUnit]:
        """Return the channels that are looked for and there; raises as `find` does.

        Raises:
            MappingError: A channel that is looked for does not exist, or the mapping
                leaves out one that is required.
        """
        if forgone := self.mapping.left_out & {*self.required}:
            raise MappingError(
                f"{', '.join(forgone)} = {LEFT_OUT!r} leaves out a channel that is "
                "needed; only others can be left out, such as dq"
            )

        mapped = (name for name in self.named if name in self.mapping.channels)
        wanted = (*self.required, *self.optional, *mapped)
        found = {
            name: self.find(table, known_channel(name, self.mapping.knowledge))
            for name in wanted or [each for each in self.channels if each != "time"]
            if name not in self.mapping.left_out
        }
        return {name: unit for name, unit in found.items() if unit is not None}

    def find(self, table: Table, channel: Channel) -> ChannelUnit | None:
        """Return the columns of a channel and their units; None without such columns.

        Raises:
            ColumnError: Mapped columns are not there, or several would fit.
            MappingError: There are units for another number of columns.
            UnitError: The file contradicts itself or the mapping.
        """
        spec = self.mapping.channels.get(channel.name)
        columns = (
            self._find_unmapped(table, channel)
            if spec is None
            else [name for each in spec.patterns for name in find_columns(table, each)]
        )
        return read_units(table, channel, columns, spec) if columns else None

    def find_time(self, table: Table) -> ChannelUnit:
        """Return the column of time stamps, or those whose sum they are.

        Raises:
            ColumnError: There is none, or a pattern fits several.
        """
        unit = self.find(table, self.channels["time"])
        spec = self.mapping.channels.get("time")
        if unit is None:
            columns = f"{table.describe()}{table.left_out()}"
            raise ColumnError(
                f"no time column found. Columns are: {columns}",
                "Name it under `time` in the `mapping`, or give `rate_hz`.",
            )
        if spec is not None and len(unit.columns) > len(spec.patterns):
            raise several_fit(self.channels["time"], unit.columns)

        return unit

    def _find_unmapped(self, table: Table, channel: Channel) -> list[str]:
        """Return the columns that are named after the robot's joints and a channel.

        Returns:
            Their names, in the robot's order; without such columns those of usual
            names; none if there are none.

        Raises:
            ColumnError: Several would fit, as of several arms.
        """
        others = {
            name
            for name, joints in table.joint_names.items()
            if not match_joints(joints, self.robot)
        }
        if others < table.joint_names.keys():  # signals of the robot are there
            columns = {n: v for n, v in table.columns.items() if n not in others}
            table = replace(table, columns=columns)

        by_stem = {
            split_unit(name.strip(), channel.units)[0]: name
            for name, values in table.columns.items()
            if values.ndim == 1 and channel.per_joint
        }
        matches = match_joints(by_stem, self.robot)
        named = [match for match in matches if names_channel(match, channel)]
        if chosen := choose_match(named, self.mapping.joint_pattern, channel.name):
            return [by_stem[stem] for stem in chosen.names]

        return detect_columns(table, channel)

    def in_joint_order(self, table: Table) -> Table:
        """Return a table whose columns of joints are in the order that is asked for.

        Raises:
            ColumnError: None of them has all of the robot's joints, or several arms
                would fit.
        """
        columns = dict(table.columns)
        groups = {n: each for n, each in table.joint_names.items() if n in columns}
        ordered: dict[str, tuple[str, ...]] = {}
        notes: dict[str, None] = {}
        for name, joints in groups.items():
            where = table.clocks.get(name, name)
            matches = match_joints(joints, self.robot)
            chosen = choose_match(matches, self.mapping.joint_pattern, where)
            if chosen is None:
                continue

            ordered[name] = chosen.names
            columns[name] = columns[name][:, [joints.index(n) for n in chosen.names]]
            if chosen.names != self.robot:
                taken = f"{chosen.names[0]}, ... ({chosen.pattern}) were taken"
                notes[f"{where}: {taken} for the robot's {self.robot[0]}, ..."] = None

        if self.robot and groups and not ordered:
            name, joints = next(iter(groups.items()))
            raise ColumnError(
                f"{name} has the joints {', '.join(joints)}; expected "
                f"{', '.join(self.robot)}",
                "Name them in the robot's order, with `joints` in the `mapping` or "
                f"`--joints {','.join(joints)}`.",
            )

        return replace(
            table,
            columns=columns,
            joint_names={**table.joint_names, **ordered},
            warnings=(*table.warnings, *notes),
        )

    def with_layout(self, table: Table) -> "ChannelRequest":
        """Return the request with what the layout of a table says; the mapping wins.

        It is the first that the table has; of its channels those are taken that are
        there.
        """
        knowledge = self.mapping.knowledge
        for layout in knowledge.layouts:
            if _has_columns(table, layout.columns):
                known = mapping_of_layout(layout, knowledge)
                channels = {
                    name: spec
                    for name, spec in known.channels.items()
                    if spec.columns == LEFT_OUT or _has_columns(table, spec.patterns)
                }
                known = replace(known, channels=channels)
                return replace(self, mapping=known.updated(self.mapping))

        return self


def _has_columns(table: Table, patterns: Iterable[str]) -> bool:
    """Return whether a table has columns for all of some patterns."""
    try:
        return all(find_columns(table, pattern) for pattern in patterns)
    except ColumnError:
        return False
