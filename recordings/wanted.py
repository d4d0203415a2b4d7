"""What a command wants from a recording; a format that holds much reads only that."""

from dataclasses import dataclass, field

from recordings.channel import CHANNELS
from recordings.column_spec import ColumnSpec
from recordings.detect_columns import detect_columns
from recordings.find_columns import find_columns
from recordings.mapping import ColumnMapping
from recordings.table import Table


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
        for name in dict.fromkeys((*names, *self._time())):
            spec = self.mapping.channels.get(name)
            found = _columns(table, name, spec)
            if not found and name in self.required:
                return None
            needed |= found
        return frozenset(needed)

    def _time(self) -> tuple[str, ...]:
        return ("time",) if "time" in self.mapping.channels else ()


def _columns(table: Table, name: str, spec: ColumnSpec | None) -> set[str]:
    if spec is None:
        found = detect_columns(table, CHANNELS[name])
    else:
        found = tuple(c for pattern in spec.patterns for c in find_columns(table, pattern))
    names = {column.name for column in found}
    # An element such as `force_xyz[2]` is found under its own name.
    return {name if name in table.columns else name.rpartition("[")[0] for name in names}
