"""Which columns make a channel, and in which unit and sign they stand."""

from dataclasses import dataclass
from math import isfinite

from recordings.columns.channel import Channel
from recordings.columns.units import find_unit, require_unit
from recordings.errors import MappingError


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSpec:
    """The columns of one channel.

    Attributes:
        columns: a name, a pattern such as `q{1..7}` or `q_*`, or a tuple of them, in joint order.
        unit: the unit in the file; None to take it from the column's name, else SI.
        scale: factor applied after conversion to SI, one for all columns or one each; negative
            to turn a sign.
    """

    columns: str | tuple[str, ...]
    unit: str | None = None
    scale: float | tuple[float, ...] = 1.0

    def __post_init__(self) -> None:
        """Check columns and scale.

        Raises:
            MappingError: no column is named, or a scale is zero or not finite.
        """
        if not self.columns or not all(self.patterns):
            raise MappingError(f"columns = {self.columns!r} names no column")
        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,)
        if not scales or not all(isfinite(factor) and factor != 0.0 for factor in scales):
            raise MappingError(f"scale = {self.scale!r} must be finite and not zero")

    @property
    def patterns(self) -> tuple[str, ...]:
        """The column names and patterns in order."""
        return (self.columns,) if isinstance(self.columns, str) else self.columns

    def checked_for(self, channel: Channel) -> "ColumnSpec":
        """Return this specification with its unit spelled as the channel spells it.

        Args:
            channel: the channel it is meant for.

        Returns:
            A specification whose unit is None or a key of `channel.units`.

        Raises:
            MappingError: the unit does not measure this channel.
        """
        if self.unit is None:
            return self
        unit = require_unit(self.unit, channel.units, f"channel {channel.name!r}")
        return ColumnSpec(columns=self.columns, unit=unit, scale=self.scale)


def parse_column_spec(text: str, channel: Channel) -> ColumnSpec:
    """Read the short form of the command line: `NAMES[:UNIT][:SCALE]`.

    `NAMES` is a name, a pattern or a list separated by commas. What follows a colon counts as
    scale or unit only if it is one, since column names may hold colons themselves.

    Args:
        text: such as `z:mm`, `fz:N:-1` or `q{1..7}:deg`.
        channel: the channel it is meant for.

    Returns:
        The specification.

    Raises:
        MappingError: no column is named, or the scale is zero or not finite.
    """
    names, scale = _split_scale(text)
    names, unit = _split_unit(names, channel)
    columns = tuple(name.strip() for name in names.split(","))
    return ColumnSpec(columns=columns[0] if len(columns) == 1 else columns, unit=unit, scale=scale)


def _split_scale(text: str) -> tuple[str, float]:
    head, colon, tail = text.rpartition(":")
    if not colon:
        return text, 1.0
    try:
        return head, float(tail)
    except ValueError:
        return text, 1.0


def _split_unit(text: str, channel: Channel) -> tuple[str, str | None]:
    head, colon, tail = text.rpartition(":")
    unit = find_unit(tail, channel.units) if colon else None
    return (head, unit) if unit else (text, None)
