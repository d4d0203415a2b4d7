"""What a command wants from a recording; a format that holds much reads only that."""

from dataclasses import dataclass, field

from recordings.columns.channel import CHANNELS
from recordings.columns.detect import detect_columns
from recordings.columns.find import FoundColumn, find_columns
from recordings.columns.mapping import ColumnMapping
from recordings.errors import ColumnError
from recordings.tables.table import Table


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """Channels, and which columns they are.

    Attributes:
        mapping: see `read_log`.
        required: see `read_log`.
        optional: see `read_log`.
        joints: the robot's joints in its order; a recording that names joints, and has all of
            these, is put into this order. `mapping.joints` goes before.
    """

    mapping: ColumnMapping = field(default_factory=ColumnMapping)
    required: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()

    def columns(self, table: Table) -> frozenset[str] | None:
        """Return the columns of a table that the wanted channels need.

        Args:
            table: names and widths are looked at, not values.

        Returns:
            Their names; None if a required channel is not there.

        Raises:
            ColumnError: a mapped channel was not found, or is ambiguous.
        """
        names = (*self.required, *self.optional) or tuple(CHANNELS)
        needed: set[str] = set()
        mapped = [name for name in (*names, "time") if name in self.mapping.channels]
        # Mapped channels first: the topics they choose decide where others would be ambiguous.
        for name in dict.fromkeys((*mapped, *names)):
            found = self._columns(table, name, needed)
            if not found and name in self.required:
                return None
            needed |= found
        return frozenset(needed)

    def _columns(self, table: Table, name: str, chosen: set[str]) -> set[str]:
        spec = self.mapping.channels.get(name)
        if spec is None:
            found = _detected(table, name, chosen, {*(self.mapping.joints or self.joints)})
        else:
            found = tuple(c for pattern in spec.patterns for c in find_columns(table, pattern))
        names = {column.name for column in found}
        # An element such as `force_xyz[2]` is found under its own name.
        return {name if name in table.columns else name.rpartition("[")[0] for name in names}


def _detected(
    table: Table, name: str, chosen: set[str], joints: set[str]
) -> tuple[FoundColumn, ...]:
    """Find a channel by its usual names.

    Of several that would fit, one beside chosen columns, else one that has the robot's joints.
    """
    try:
        return detect_columns(table, CHANNELS[name])
    except ColumnError:
        parents = {column.rpartition("/")[0] for column in chosen}
        beside = {n: v for n, v in table.columns.items() if n.rpartition("/")[0] in parents}
        if not beside and joints:
            named = table.joint_names
            beside = {n: table.columns[n] for n in named if joints <= set(named[n])}
        if not beside:
            raise
        if found := detect_columns(Table(columns=beside), CHANNELS[name]):
            return found
        raise
