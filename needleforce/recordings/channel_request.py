"""Which channels are read of a recording, and which of its columns they are."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import (
    ChannelUnit,
    detect_columns,
    find_columns,
    read_units,
    several_fit,
    split_unit,
)
from needleforce.recordings.errors import ColumnError, MappingError
from needleforce.recordings.joint_names import (
    choose_match,
    match_joints,
    names_channel,
)
from needleforce.recordings.mapping import (
    LEFT_OUT,
    ColumnMapping,
    known_channel,
    mapping_of_layout,
)
from needleforce.recordings.table import Table


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

    @property
    def requested(self) -> tuple[str, ...]:
        """The channels that are looked for: required ones first, none left out.

        Raises:
            MappingError: The mapping leaves out one that is required.
        """
        mapped = (name for name in self.named if name in self.mapping.channels)
        wanted = (*self.required, *self.optional, *mapped)
        if forgone := self.mapping.left_out & {*self.required}:
            raise MappingError(
                f"{', '.join(forgone)} = {LEFT_OUT!r} leaves out a channel that is "
                "needed; only others can be left out, such as dq"
            )

        names = wanted or tuple(name for name in self.channels if name != "time")
        return tuple(name for name in names if name not in self.mapping.left_out)

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
        """Return the channels that are there; raises as `find` does.

        Raises:
            MappingError: A channel that is looked for does not exist.
        """
        channels = [
            known_channel(name, self.mapping.knowledge) for name in self.requested
        ]
        found = {channel.name: self.find(table, channel) for channel in channels}
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
        """Return the columns of the robot's joints, or those of usual names, if any.

        Raises:
            ColumnError: Several would fit.
        """
        others = {
            name
            for name, joints in table.joint_names.items()
            if not match_joints(joints, self.robot)
        }
        if others < table.joint_names.keys():  # signals of the robot are there
            columns = {n: v for n, v in table.columns.items() if n not in others}
            table = replace(table, columns=columns)

        return self._find_by_joints(table, channel) or detect_columns(table, channel)

    def _find_by_joints(self, table: Table, channel: Channel) -> list[str]:
        """Return columns that are named after the robot's joints and a channel.

        Returns:
            Their names, in the robot's order; none if there are no such columns.

        Raises:
            ColumnError: Columns of several arms would fit.
        """
        by_stem = {
            split_unit(name.strip(), channel.units)[0]: name
            for name, values in table.columns.items()
            if values.ndim == 1 and channel.per_joint
        }
        matches = match_joints(by_stem, self.robot)
        named = [match for match in matches if names_channel(match, channel)]
        chosen = choose_match(named, self.mapping.joint_pattern, channel.name)
        return [by_stem[stem] for stem in chosen.names] if chosen else []

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
