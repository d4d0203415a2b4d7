"""A channel in a table: its columns, its conversion to SI, and what is odd in it."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.recordings.channel_units import (
    ChannelUnit,
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


class Signal:
    """A channel: where in a table it stands, how it becomes SI, and what is odd in it.

    Args:
        table: With rows or without.
        channel: The channel.
        columns: Names of its columns, at least one.
        spec: How they were chosen; None if by their names.

    Attributes:
        channel: The channel.
        source: Its columns and their units, see `units_of_columns`.
        factors: To SI, one for each value of a row.

    Raises:
        ColumnError: There are too many columns.
        LogError: They differ in length.
        MappingError: There are more or fewer scale factors than columns.
        UnitError: See `units_of_columns`.
    """

    def __init__(
        self,
        table: Table,
        channel: Channel,
        columns: Sequence[str],
        spec: ColumnSpec | None,
    ) -> None:
        widths = [table.width(name) for name in columns]
        width = sum(widths)
        listed = ", ".join(columns)
        if width != 1 and not channel.per_joint:
            raise ColumnError(
                f"{channel.name} is one column, but {listed} gives {width}"
            )
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
        self.channel = channel
        self.source = ChannelUnit(channel.name, tuple(columns), units, scale)
        self.factors = np.repeat(si_factors, widths) * scales
        self._row_count = 0
        self._finite_count = 0  # rows with finite values
        self._large_count = 0  # among these with a value larger than is plausible
        self._size = 0.0  # the largest, in SI units; of time the median step
        self._any_finite = False
        self._faults = FaultCounts()

    @property
    def _origins(self) -> set[UnitOrigin]:
        """Whence the units of the columns are known."""
        return {unit.origin for unit in self.source.units}

    @property
    def _is_unsure(self) -> bool:
        """Whether values may be in another unit than that of a column."""
        return not self._origins.isdisjoint({UnitOrigin.ASSUMED, UnitOrigin.FORMAT})

    def read(self, table: Table) -> Array:
        """Return values of a table in SI units, shape (n,) or (n, joints)."""
        columns = [table.values(name) for name in self.source.columns]
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
            self._faults.note(
                f"{self.channel.key}: rows with NaN or infinity",
                f"row {rows[invalid_rows[0]]:.0f}",
                invalid_rows.size,
            )

        self._any_finite = self._any_finite or bool(is_finite.any())
        if self._is_unsure and self.channel.key != "t_s":
            self._update_size(values, is_finite)

        self._row_count += len(values)

    def watch_step(self, t_s: Array) -> None:
        """Note the median step of the first time stamps, shape (n,), all finite."""
        if t_s.size > 1 and self._is_unsure:
            self._size = float(np.median(np.abs(np.diff(t_s))))
            self._finite_count = 1
            self._large_count = int(self._size > self.channel.at_most.value)

    def _update_size(self, values: Array, is_finite: NDArray[np.bool_]) -> None:
        """Update the size by further values, and count the rows that are too large."""
        sizes = np.where(is_finite, np.abs(values), 0.0).reshape(len(values), -1)
        largest = sizes.max(axis=1, initial=0.0)
        self._size = max(self._size, float(largest.max(initial=0.0)))
        has_value = is_finite.reshape(sizes.shape).any(axis=1)
        self._finite_count += int(np.count_nonzero(has_value))
        self._large_count += int(np.count_nonzero(largest > self.channel.at_most.value))

    def report_not_finite(self) -> tuple[str, ...]:
        """Report rows that are not finite.

        Raises:
            LogError: There was no finite value at all.
        """
        if self._faults and not self._any_finite:
            raise LogError(
                f"{self.channel.key} has no finite value in {self._row_count} rows"
            )

        return self._faults.lines()

    def require_plausible(self) -> None:
        """Check that the values can be in the unit that was assumed.

        Raises:
            UnitError: More of the rows are too large for it than spikes would be.
        """
        max_fraction = 0.05  # fewer may be spikes
        is_large = self._large_count > max_fraction * self._finite_count
        if is_large and UnitOrigin.ASSUMED in self._origins:
            unit = self.channel.at_most.unit
            if self.channel.key == "t_s":  # logs have 1 to 10,000 rows a second
                unit = "us" if self._size >= 200.0 else unit
                unit = "ns" if self._size >= 1e5 else unit

            raise UnitError(
                f"{self._describe_size()}. The file states no unit",
                advise_unit(self.channel, self.source.columns, unit),
            )

    def report_implausible(self) -> tuple[str, ...]:
        """Report values too large for the unit that were not refused.

        They are few enough to be spikes, or the format of the file defines the unit.
        """
        # A needle that meets tissue feels more [N]; a file in kN holds such numbers.
        is_small = 0.0 < self._size < 0.05
        if is_small and self.channel.key == "force_N":
            names = describe_columns(self.source.columns)
            return (
                f"force: {names}, taken as in N, nowhere exceeds {self._size:.4g} N; "
                "the file states no unit, and may be in kN",
            )
        if not self._large_count:
            return ()

        return (f"{self._describe_size()}; rows beyond it: {self._large_count}",)

    def _describe_size(self) -> str:
        """Return what is odd about the size of the values, in words."""
        at_most = self.channel.at_most
        unit = self.channel.si_unit
        names = describe_columns(self.source.columns)
        is_time = self.channel.key == "t_s"
        quantity = "the median step of" if is_time else "the size of"
        return (
            f"{self.channel.name}: {quantity} {names}, taken as in {unit}, is "
            f"{self._size:.4g} {unit}, expected at most {at_most.value:.3g} "
            f"({at_most.reason})"
        )


def velocity_warnings(values: Mapping[str, Array]) -> tuple[str, ...]:
    """Report velocities that are zero in all rows, as drivers send that have none."""
    min_travel_rad = 1e-3  # one that moved less may have been at rest
    if not values.keys() >= {"q_rad", "dq_rad_s"} or values["dq_rad_s"].any():
        return ()

    q_rad = values["q_rad"]
    travel_rad = float(np.nan_to_num(np.abs(q_rad - q_rad[0])).max())
    if travel_rad < min_travel_rad:
        return ()

    return (
        f"dq is zero in all rows, and q moves by {travel_rad:.3g} rad: it seems not to "
        f"be sent; leave it out with --dq {LEFT_OUT}, or with "
        f'dq = "{LEFT_OUT}" in the mapping, and it is estimated from q',
    )


def require_equal_sizes(table: Table, signals: Mapping[str, Signal]) -> None:
    """Raise `LogError` if channels differ in length, or in the number of joints."""
    shapes = {
        key: (
            len(table.values(signal.source.columns[0])),
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
            f"({', '.join(signals[key].source.columns)})"
            for key, count in joint_counts.items()
        )
        raise LogError(
            f"channels differ in the number of joints: {listed}",
            "Name the columns of all joints under each channel of the `mapping`.",
        )
