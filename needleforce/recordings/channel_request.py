"""Which channels are read of a recording, and which of its columns they are."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from needleforce.recordings.channels import Channel, Layout
from needleforce.recordings.column_names import (
    detect_columns,
    find_columns,
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
    def requested(self) -> tuple[str, ...]:
        """The channels that are looked for: required ones first, none left out.

        Raises:
            MappingError: One does not exist, or the mapping leaves out one that is
                required.
        """
        mapped = (name for name in self.named if name in self.mapping.channels)
        named = (*self.required, *self.optional, *mapped)
        for name in named:
            known_channel(name, self.mapping.knowledge)
        if forgone := self.mapping.left_out & {*self.required}:
            raise MappingError(
                f"{', '.join(forgone)} = {LEFT_OUT!r} leaves out a channel that is "
                "needed; only others can be left out, such as dq"
            )

        names = named or tuple(name for name in self.channels if name != "time")
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
            found["time"] = request.find(table, self.channels["time"])
        if not found.keys() >= {*self.required}:
            return None

        return frozenset(
            name if name in table.columns else name.rpartition("[")[0]
            for columns in found.values()
            for name in columns
        )

    def find_all(self, table: Table) -> dict[str, list[str]]:
        """Return the columns of the channels that are there; raises as `find` does."""
        channels = [self.channels[name] for name in self.requested]
        found = {channel.name: self.find(table, channel) for channel in channels}
        return {name: columns for name, columns in found.items() if columns}

    def find(self, table: Table, channel: Channel) -> list[str]:
        """Return the names of a channel's columns; none if no name looks like it.

        They are the mapped ones, those of usual names, or those of the joints.

        Raises:
            ColumnError: They are not there, or ambiguous.
        """
        spec = self.mapping.channels.get(channel.name)
        if spec is not None:
            patterns = spec.patterns
            return [name for each in patterns for name in find_columns(table, each)]

        table = self._table_of_robot(table)
        try:
            columns = detect_columns(table, channel)
        except ColumnError as error:  # several would fit, one for each joint perhaps
            columns = self._find_by_joints(table, channel)
            wanted = ", ".join(self.joints) if channel.per_joint else ""
            if not columns and wanted:
                text = f"{error}; expected columns of the joints {wanted}"
                raise error.reworded(text) from error
            if not columns:
                raise

        return columns or self._find_by_joints(table, channel)

    def _table_of_robot(self, table: Table) -> Table:
        """Return a table without the joints of others, if it has all of the robot's."""
        joints = self.mapping.joint_order or self.joints
        others = {
            name
            for name, each in table.joint_names.items()
            if not match_joints(each, joints)
        }
        if others == table.joint_names.keys():
            return table

        columns = {n: v for n, v in table.columns.items() if n not in others}
        return replace(table, columns=columns)

    def _find_by_joints(self, table: Table, channel: Channel) -> list[str]:
        """Return columns that are named after the robot's joints and a channel.

        Returns:
            Their names, in the robot's order; none if there are no such columns.

        Raises:
            ColumnError: Columns of several arms would fit.
        """
        joints = self.mapping.joint_order or self.joints
        if not channel.per_joint:
            return []

        by_stem = {
            split_unit(name.strip(), channel.units)[0]: name
            for name, values in table.columns.items()
            if values.ndim == 1
        }
        matches = match_joints(by_stem, joints)
        named = [match for match in matches if names_channel(match, channel)]
        chosen = choose_match(named, self.mapping.joint_pattern, channel.name)
        return [by_stem[stem] for stem in chosen.names] if chosen else []

    def in_joint_order(self, table: Table) -> Table:
        """Return a table whose columns of joints are in the order that is asked for.

        Raises:
            ColumnError: None of them has all of the robot's joints, or several arms
                would fit.
        """
        robot = self.mapping.joint_order or self.joints
        groups = {
            n: each for n, each in table.joint_names.items() if n in table.columns
        }
        if not groups or not robot:
            return table

        columns = dict(table.columns)
        joint_names = dict(table.joint_names)
        notes: dict[str, None] = {}
        is_found = False
        for name, joints in groups.items():
            where = table.clocks.get(name, name)
            matches = match_joints(joints, robot)
            chosen = choose_match(matches, self.mapping.joint_pattern, where)
            if chosen is None:
                continue

            is_found = True
            order = [joints.index(joint) for joint in chosen.names]
            columns[name] = columns[name][:, order]
            joint_names[name] = chosen.names
            if chosen.names != robot:
                taken = f"{chosen.names[0]}, ... ({chosen.pattern})"
                note = f"{where}: {taken} were taken for the robot's {robot[0]}, ..."
                notes[note] = None

        if not is_found:
            name, joints = next(iter(groups.items()))
            raise ColumnError(
                f"{name} has the joints {', '.join(joints)}; expected "
                f"{', '.join(robot)}",
                "Name them in the robot's order, with `joints` in the `mapping` or "
                f"`--joints {','.join(joints)}`.",
            )

        return replace(
            table,
            columns=columns,
            joint_names=joint_names,
            warnings=(*table.warnings, *notes),
        )

    def find_layout(self, table: Table) -> Layout | None:
        """Return the first layout that a table has; None if none is known."""
        layouts = self.mapping.knowledge.layouts
        return next(
            (each for each in layouts if _has_columns(table, each.columns)), None
        )

    def with_layout(self, table: Table) -> "ChannelRequest":
        """Return the request with what the layout of a table says; the mapping wins.

        Of the layout's channels those are taken that the table has.
        """
        layout = self.find_layout(table)
        if layout is None:
            return self

        known = mapping_of_layout(layout, self.mapping.knowledge)
        channels = {
            name: spec
            for name, spec in known.channels.items()
            if spec.patterns == (LEFT_OUT,) or _has_columns(table, spec.patterns)
        }
        channels |= self.mapping.channels
        rate_hz = self.mapping.rate_hz
        if rate_hz is not None:
            channels.pop("time", None)
        elif "time" not in self.mapping.channels:
            rate_hz = known.rate_hz

        joints = self.mapping.joints or known.joints
        mapping = replace(
            self.mapping, channels=channels, rate_hz=rate_hz, joints=joints
        )
        return replace(self, mapping=mapping)


def _has_columns(table: Table, patterns: Iterable[str]) -> bool:
    """Return whether a table has columns for all of some patterns."""
    try:
        return all(find_columns(table, pattern) for pattern in patterns)
    except ColumnError:
        return False
