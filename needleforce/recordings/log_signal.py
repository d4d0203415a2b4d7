"""A channel in a table: its columns, its conversion to SI, and what is odd in it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.recordings.channel_units import (
    ChannelUnit,
    ColumnUnit,
    UnitOrigin,
    advise_unit,
    describe_columns,
    units_of_columns,
)
from needleforce.recordings.channels import Channel
from needleforce.recordings.errors import (
    ColumnError,
    FaultCounts,
    LogError,
    MappingError,
    UnitError,
)
from needleforce.recordings.mapping import LEFT_OUT, ColumnSpec
from needleforce.recordings.table import Table


@dataclass(slots=True, eq=False)
class Signal:
    """A channel: where in a table it stands, how it becomes SI, and what is odd in it.

    Attributes:
        channel: The channel.
        columns: Names of its columns.
        units: Of the columns, and whence they are known.
        factors: To SI, one for each value of a row.
        scale: Factor or factors of the mapping, which these contain.
        row_count: Rows watched so far.
        finite_count: Rows with finite values among them.
        large_count: Rows among these with a value larger than is plausible.
        size: The largest magnitude in SI units, of time the median step.
        any_finite: Whether there was a finite value so far.
        faults: Rows that are not finite.
    """

    channel: Channel
    columns: tuple[str, ...]
    units: tuple[ColumnUnit, ...]
    factors: Array
    scale: float | tuple[float, ...] = 1.0
    row_count: int = 0
    finite_count: int = 0
    large_count: int = 0
    size: float = 0.0
    any_finite: bool = False
    faults: FaultCounts = field(default_factory=FaultCounts)

    @property
    def channel_unit(self) -> ChannelUnit:
        """The unit in which the channel is read, for a summary."""
        return ChannelUnit(self.channel.name, self.columns, self.units, self.scale)

    @property
    def _origins(self) -> set[UnitOrigin]:
        """Whence the units of the columns are known."""
        return {unit.origin for unit in self.units}

    @property
    def _is_unsure(self) -> bool:
        """Whether values may be in another unit than that of a column."""
        return not self._origins.isdisjoint({UnitOrigin.ASSUMED, UnitOrigin.FORMAT})

    def read(self, table: Table, rows: slice) -> Array:
        """Return values of a table in SI units, shape (n,) or (n, joints)."""
        columns = [table.values(name)[rows] for name in self.columns]
        values = np.column_stack(columns) * self.factors
        return values if self.channel.per_joint else values[:, 0]

    def watch(self, values: Array, rows: Array) -> None:
        """Note what is odd in further rows; the step of time is that of the first.

        Args:
            values: Of the rows, shape (n,) or (n, k).
            rows: Their numbers in the file, shape (n,).
        """
        is_finite = np.isfinite(values)
        if not is_finite.all():
            axes = tuple(range(1, values.ndim))
            invalid_rows = np.flatnonzero(~is_finite.all(axis=axes))
            self.faults.note(
                f"{self.channel.key}: rows with NaN or infinity",
                f"row {rows[invalid_rows[0]]:.0f}",
                invalid_rows.size,
            )

        self.any_finite = self.any_finite or bool(is_finite.any())
        if self._is_unsure and self.channel.key != "t_s":
            self._update_size(values, is_finite)

        self.row_count += len(values)

    def watch_step(self, t_s: Array) -> None:
        """Note the median step of the first time stamps, shape (n,), all finite."""
        if t_s.size > 1 and self._is_unsure:
            self.size = float(np.median(np.abs(np.diff(t_s))))
            self.finite_count = 1
            self.large_count = int(self.size > self.channel.at_most.value)

    def _update_size(self, values: Array, is_finite: NDArray[np.bool_]) -> None:
        """Update the size by further values, and count the rows that are too large."""
        sizes = np.where(is_finite, np.abs(values), 0.0).reshape(len(values), -1)
        largest = sizes.max(axis=1, initial=0.0)
        self.size = max(self.size, float(largest.max(initial=0.0)))
        has_value = is_finite.reshape(sizes.shape).any(axis=1)
        self.finite_count += int(np.count_nonzero(has_value))
        self.large_count += int(np.count_nonzero(largest > self.channel.at_most.value))

    def report_not_finite(self) -> tuple[str, ...]:
        """Report rows that are not finite.

        Raises:
            LogError: There was no finite value at all.
        """
        if self.faults and not self.any_finite:
            raise LogError(
                f"{self.channel.key} has no finite value in {self.row_count} rows"
            )

        return self.faults.lines()

    def require_plausible(self) -> None:
        """Check that the values can be in the unit that was assumed.

        Raises:
            UnitError: More of the rows are too large for it than spikes would be.
        """
        max_fraction = 0.05  # fewer may be spikes
        is_large = self.large_count > max_fraction * self.finite_count
        if is_large and UnitOrigin.ASSUMED in self._origins:
            unit = self.channel.at_most.unit
            if self.channel.key == "t_s":  # logs have 1 to 10,000 rows a second
                unit = "us" if self.size >= 200.0 else unit
                unit = "ns" if self.size >= 1e5 else unit

            raise UnitError(
                f"{self._describe_size()}. The file states no unit",
                advise_unit(self.channel, self.columns, unit),
            )

    def report_implausible(self) -> tuple[str, ...]:
        """Report values too large for the unit that were not refused.

        They are few enough to be spikes, or the format of the file defines the unit.
        """
        # A needle that meets tissue feels more [N]; a file in kN holds such numbers.
        is_small = 0.0 < self.size < 0.05
        if is_small and self.channel.key == "force_N":
            return (
                f"force: {describe_columns(self.columns)}, taken as in N, nowhere "
                f"exceeds {self.size:.4g} N; the file states no unit, and may be in kN",
            )
        if not self.large_count:
            return ()

        return (f"{self._describe_size()}; rows beyond it: {self.large_count}",)

    def _describe_size(self) -> str:
        """Return what is odd about the size of the values, in words."""
        at_most = self.channel.at_most
        unit = self.channel.si_unit
        names = describe_columns(self.columns)
        is_time = self.channel.key == "t_s"
        quantity = "the median step of" if is_time else "the size of"
        return (
            f"{self.channel.name}: {quantity} {names}, taken as in {unit}, is "
            f"{self.size:.4g} {unit}, expected at most {at_most.value:.3g} "
            f"({at_most.reason})"
        )


class VelocityWatch:
    """Notices velocities that are zero in all rows, as drivers send that have none."""

    def __init__(self) -> None:
        self._first_rad: Array | None = None
        self._travel_rad = 0.0
        self._is_sent = False

    def update(self, values: Mapping[str, Array]) -> None:
        """Look at further rows; channels by key, of shape (n, joints)."""
        if not values.keys() >= {"q_rad", "dq_rad_s"} or self._is_sent:
            return

        q_rad = values["q_rad"]
        self._is_sent = bool(values["dq_rad_s"].any())
        if self._is_sent or not len(q_rad):
            return

        first_rad = q_rad[0].copy() if self._first_rad is None else self._first_rad
        self._first_rad = first_rad
        travel_rad = np.abs(q_rad - first_rad)
        finite_rad = travel_rad[np.isfinite(travel_rad)]
        self._travel_rad = max(self._travel_rad, float(finite_rad.max(initial=0.0)))

    def warnings(self) -> tuple[str, ...]:
        """Report, at the end, zeros in all rows of an arm that has moved."""
        min_travel_rad = 1e-3  # one that moved less may have been at rest
        if self._is_sent or self._travel_rad < min_travel_rad:
            return ()

        return (
            f"dq is zero in all rows, and q moves by {self._travel_rad:.3g} rad: it "
            f"seems not to be sent; leave it out with --dq {LEFT_OUT}, or with "
            f'dq = "{LEFT_OUT}" in the mapping, and it is estimated from q',
        )


def make_signal(
    table: Table, channel: Channel, columns: Sequence[str], spec: ColumnSpec | None
) -> Signal:
    """Return the signal of a channel; its units are those of `units_of_columns`.

    Args:
        table: With rows or without.
        channel: The channel.
        columns: Names of its columns, at least one.
        spec: How they were chosen; None if by their names.

    Raises:
        ColumnError: There are too many columns.
        LogError: They differ in length.
        MappingError: There are more or fewer scale factors than columns.
        UnitError: See `units_of_columns`.
    """
    widths = [table.width(name) for name in columns]
    width = sum(widths)
    listed = ", ".join(columns)
    if width != 1 and not channel.per_joint:
        raise ColumnError(f"{channel.name} is one column, but {listed} gives {width}")
    if len({len(table.values(name)) for name in columns}) > 1:
        raise LogError(f"{channel.name}: the columns {listed} differ in length")

    scale = 1.0 if spec is None else spec.scale
    scales = np.atleast_1d(np.array(scale, dtype=np.float64))
    if scales.size not in (1, width):
        raise MappingError(
            f"{channel.name}: {scales.size} scale factors for {width} columns, "
            f"expected one or {width}"
        )

    units = units_of_columns(table, channel, columns, spec)
    si_factors = np.array([channel.units[column.unit] for column in units])
    factors = np.repeat(si_factors, widths) * scales
    return Signal(channel, tuple(columns), units, factors, scale)


def require_equal_sizes(table: Table, signals: Mapping[str, Signal]) -> None:
    """Raise `LogError` if channels differ in length, or in the number of joints."""
    shapes = {
        key: (
            len(table.values(signal.columns[0])),
            *([signal.factors.size] if signal.channel.per_joint else []),
        )
        for key, signal in signals.items()
    }
    if len({shape[0] for shape in shapes.values()}) > 1:
        lengths = ", ".join(f"{key} {shape[0]}" for key, shape in shapes.items())
        transposed = [
            f"; {key} has {shape[0]} rows of {shape[1]}: is it transposed?"
            for key, shape in shapes.items()
            if len(shape) == 2 and shape[0] < shape[1]
        ]
        raise LogError(
            f"channels differ in length, in rows: {lengths}{''.join(transposed)}"
        )

    joint_counts = {key: shape[1] for key, shape in shapes.items() if len(shape) == 2}
    if len(set(joint_counts.values())) > 1:
        listed = "; ".join(
            f"{signals[key].channel.name} has {count} "
            f"({', '.join(signals[key].columns)})"
            for key, count in joint_counts.items()
        )
        raise LogError(
            f"channels differ in the number of joints: {listed}",
            "Name the columns of all joints under each channel of the `mapping`.",
        )
