"""Which channels are read of a recording, and which of its columns they are."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from needleforce.recordings.channels import Channel, Layout
from needleforce.recordings.column_names import (
    detect_columns,
    find_columns,
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
            MappingError: One does not exist, or the mapping leaves out one that is
                required.
        """
        known = tuple(name for name in self.channels if name != "time")
        named = (*self.required, *self.optional)
        for name in named:
            if name not in known:
                raise MappingError(
                    f"unknown channel {name!r}; channels are: {', '.join(known)}"
                )

        left_out = self.mapping.left_out
        for name in self.required:
            if name in left_out:
                raise MappingError(
                    f"{name} = {LEFT_OUT!r} leaves out a channel that is needed; only "
                    "others can be left out, such as dq"
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
            columns = self._find_nearby(table, self.channels[name], needed)
            if not columns and name in self.required:
                return None

            needed |= {
                column if column in table.columns else column.rpartition("[")[0]
                for column in columns
            }

        return frozenset(needed)

    def find(self, table: Table, channel: Channel) -> list[str]:
        """Return the names of a channel's columns; none if no name looks like it.

        They are the mapped ones, those of usual names, or those of the joints.

        Raises:
            ColumnError: They are not there, or ambiguous.
        """
        spec = self.mapping.channels.get(channel.name)
        if spec is not None:
            return [
                name
                for pattern in spec.patterns
                for name in find_columns(table, pattern)
            ]

        known = table.known.get(channel.name, ())
        if len(known) > 1:
            raise several_fit(channel, known)

        return (
            list(known)
            or self.find_by_joints(table, channel)
            or detect_columns(table, channel)
        )

    def find_by_joints(self, table: Table, channel: Channel) -> list[str]:
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
            return []
        with suppress(ColumnError):  # several would fit, one for each joint perhaps
            if table.known.get(channel.name) or detect_columns(table, channel):
                return []

        by_stem = {
            split_unit(name.strip(), channel.units)[0]: name
            for name, values in table.columns.items()
            if values.ndim == 1
        }
        rules = self.mapping.knowledge.joints
        matches = [
            match
            for match in match_joints(by_stem, joints)
            if names_channel(match, channel, rules)
        ]
        chosen = choose_match(matches, self.mapping.joint_pattern, channel.name)
        return [by_stem[stem] for stem in chosen.names] if chosen else []

    def _find_nearby(
        self, table: Table, channel: Channel, chosen: set[str]
    ) -> list[str]:
        """Find a channel; of several that would fit, one beside columns chosen before.

        Else it is the one whose elements are the robot's joints.
        """
        try:
            return self.find(table, channel)
        except ColumnError:
            nearby = self._columns_nearby(table, chosen)
            is_mapped = channel.name in self.mapping.channels
            if nearby and not is_mapped:
                columns = detect_columns(Table(columns=nearby), channel)
                if columns:
                    return columns

            raise

    def _columns_nearby(self, table: Table, chosen: set[str]) -> dict[str, np.ndarray]:
        """Return columns of the topics of chosen ones, else of the robot's joints."""
        topics = {column.rpartition("/")[0] for column in chosen}
        joints = self.mapping.joint_order or self.joints
        beside = {
            name for name in table.columns if name.rpartition("/")[0] in topics
        } or {
            name
            for name, joint_names in table.joint_names.items()
            if match_joints(joint_names, joints)
        }
        return {
            name: values for name, values in table.columns.items() if name in beside
        }

    def find_layout(self, table: Table) -> Layout | None:
        """Return the first layout that a table has; None if none is known."""
        for layout in self.mapping.knowledge.layouts:
            is_named = bool(table.layout) and layout.name == table.layout
            if is_named or (layout.columns and _has_columns(table, layout.columns)):
                return layout

        return None

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


def _has_columns(table: Table, patterns: Iterable[str]) -> bool:
    """Return whether a table has columns for all of some patterns."""
    try:
        return all(find_columns(table, pattern) for pattern in patterns)
    except ColumnError:
        return False
