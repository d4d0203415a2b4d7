"""Which channels are read of a recording, and which of its columns they are."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from needleforce.recordings.channels import Channel, Layout
from needleforce.recordings.column_names import (
    NamedValues,
    detect_columns,
    find_columns,
    split_unit,
)
from needleforce.recordings.errors import ColumnError, MappingError, RecordingCode
from needleforce.recordings.joint_names import match_columns, match_joints
from needleforce.recordings.mapping import (
    LEFT_OUT,
    ColumnMapping,
    ColumnSpec,
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
    """

    mapping: ColumnMapping = field(default_factory=ColumnMapping)
    required: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()

    @property
    def channels(self) -> Mapping[str, Channel]:
        """Every channel by its name."""
        return self.mapping.knowledge.channels

    @property
    def requested(self) -> tuple[str, ...]:
        """The channels that are looked for: required ones first, none left out.

        Raises:
            MappingError: The mapping leaves out one that is required.
        """
        left_out = self.mapping.left_out
        for name in self.required:
            if name in left_out:
                raise MappingError(
                    f"{name} = {LEFT_OUT!r} leaves out a channel that is needed; only "
                    "others can be left out, such as dq"
                )

        named = (*self.required, *self.optional)
        known = tuple(
            name for name in self.mapping.knowledge.channels if name != "time"
        )
        return tuple(name for name in named or known if name not in left_out)

    def columns(self, table: Table) -> frozenset[str] | None:
        """Return the names of the columns that the channels need.

        Values are not looked at.

        Returns:
            The names; None if a required channel is not there.

        Raises:
            ColumnError: A mapped channel was not found, or is ambiguous.
        """
        request = self.with_layout(table)
        if request is not self:
            return request.columns(table)

        requested = self.requested
        # Mapped channels first: the topics they choose decide where others would be
        # ambiguous.
        names = [name for name in (*requested, "time") if name in self.mapping.channels]
        needed: set[str] = set()
        for name in dict.fromkeys((*names, *requested)):
            spec = self.mapping.channels.get(name)
            if spec is not None:
                columns = self.find_columns(table, self.channels[name])
            else:
                columns = self._detect(table, name, needed)

            if not columns and name in self.required:
                return None

            needed |= {_name_in_table(table, column.name) for column in columns}

        return frozenset(needed)

    def find_layout(self, table: Table) -> Layout | None:
        """Return the first layout that a table has; None if none is known."""
        return next(
            (
                layout
                for layout in self.mapping.knowledge.layouts
                if layout.name == table.layout
                or (layout.columns and _has_columns(table, layout.columns))
            ),
            None,
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
            if spec.columns == LEFT_OUT or _has_columns(table, spec.patterns)
        }
        channels |= self.mapping.channels
        rate_hz = self.mapping.rate_hz
        if rate_hz is not None:
            channels.pop("time", None)
        elif "time" not in self.mapping.channels:
            rate_hz = known.rate_hz

        mapping = replace(
            self.mapping,
            channels=channels,
            rate_hz=rate_hz,
            joints=self.mapping.joints or known.joints,
        )
        return self if mapping == self.mapping else replace(self, mapping=mapping)

    def find_columns(self, table: Table, channel: Channel) -> list[NamedValues]:
        """Return a channel's columns: mapped ones, usual names, or those of the joints.

        Raises:
            ColumnError: They are not there, or ambiguous.
        """
        names = self.joint_columns(table, channel)
        if names:
            return [NamedValues(name, table.columns[name]) for name in names]

        return channel_columns(table, channel, self.mapping.channels.get(channel.name))

    def joint_columns(self, table: Table, channel: Channel) -> tuple[str, ...]:
        """Return columns that are named after the robot's joints and a channel.

        Returns:
            Their names, in the robot's order; none if there are no such columns, or
            the channel is mapped or has a usual name.

        Raises:
            ColumnError: Columns of several arms would fit.
        """
        joints = self.mapping.joint_order or self.joints
        is_mapped = channel.name in self.mapping.channels
        if is_mapped or not (channel.per_joint and joints):
            return ()
        with suppress(ColumnError):  # several would fit, one for each joint perhaps
            if channel_columns(table, channel, None):
                return ()

        by_stem = {
            split_unit(name.strip(), channel.units)[0]: name
            for name, values in table.columns.items()
            if values.ndim == 1
        }
        stems = match_columns(by_stem, channel, joints, self.mapping.joint_pattern)
        return tuple(by_stem[stem] for stem in stems)

    def _detect(self, table: Table, name: str, chosen: set[str]) -> list[NamedValues]:
        """Find a channel by its usual names.

        Of several that would fit, the one beside columns already chosen is taken, else
        the one whose elements are the robot's joints.
        """
        try:
            return self.find_columns(table, self.channels[name])
        except ColumnError:
            nearby = self._columns_nearby(table, chosen)
            if nearby:
                columns = detect_columns(Table(columns=nearby), self.channels[name])
                if columns:
                    return columns

            raise

    def _columns_nearby(self, table: Table, chosen: set[str]) -> dict[str, np.ndarray]:
        """Return columns of the topics of chosen ones, else of the robot's joints."""
        topics = {column.rpartition("/")[0] for column in chosen}
        beside = {
            name: values
            for name, values in table.columns.items()
            if name.rpartition("/")[0] in topics
        }
        joints = self.mapping.joint_order or self.joints
        if beside or not joints:
            return beside

        return {
            name: table.columns[name]
            for name, joint_names in table.joint_names.items()
            if match_joints(joint_names, joints)
        }


def _has_columns(table: Table, patterns: Iterable[str]) -> bool:
    """Return whether a table has columns for all of some patterns."""
    try:
        return all(find_columns(table, pattern) for pattern in patterns)
    except ColumnError:
        return False


def _name_in_table(table: Table, name: str) -> str:
    """Return a column's name; an element such as `force_xyz[2]` has one of its own."""
    return name if name in table.columns else name.rpartition("[")[0]


def channel_columns(
    table: Table, channel: Channel, spec: ColumnSpec | None
) -> list[NamedValues]:
    """Return the columns that a specification names, else those of usual names.

    Raises:
        ColumnError: They are not there, or ambiguous.
    """
    if spec is None:
        known = table.known.get(channel.name, ())
        if len(known) > 1:
            raise ColumnError(
                f"{channel.name}: several columns would fit ({', '.join(known)})",
                RecordingCode.COLUMN,
                **channel.places,
            )

        if known:
            return [NamedValues(known[0], table.columns[known[0]])]

        return detect_columns(table, channel)

    return [
        column for pattern in spec.patterns for column in find_columns(table, pattern)
    ]
