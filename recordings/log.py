"""A recording whose channels are known: SI units, one time stamp per row."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from recordings.clock.time_stamps import check_time_stamps
from recordings.columns.finite_watch import FiniteWatch
from recordings.errors import ColumnError, LogError
from recordings.tables.table import FloatArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """Time stamps and named channels of equal length.

    Rows are kept as recorded. Backward or repeated stamps and non-finite values are told in
    `warnings`; the online steps skip them.

    Attributes:
        t_s: time stamps in s, shape (n,), finite, read-only; the file's clock, not rebased.
        channels: name with SI unit (`q_rad`, `dq_rad_s`, `tau_Nm`, `tau_ext_Nm`, `depth_m`,
            `speed_m_s`, `force_N`) to values, shape (n,) or (n, joints), read-only.
        warnings: what is wrong with the recording, one sentence each.
        start_ns: the instant of t_s = 0 on the clock that stamped the file, see `Table`.
    """

    t_s: FloatArray
    channels: Mapping[str, FloatArray]
    warnings: tuple[str, ...] = ()
    start_ns: int = 0

    def __post_init__(self) -> None:
        """Copy, freeze and check the data; add what is wrong with them to `warnings`.

        Raises:
            LogError: no channel, not numbers, wrong shapes or lengths, time not finite or never
                advancing, or a channel without a single finite value.
        """
        t_s = read_only("t_s", self.t_s)
        channels = {name: read_only(name, values) for name, values in self.channels.items()}
        if not channels:
            raise LogError("a log needs at least one channel beside time")
        _check_time(t_s)
        warnings = [*self.warnings, *check_time_stamps(t_s)]
        for name, values in channels.items():
            _check_shape(name, values, t_s.size)
            watch = FiniteWatch(name)
            watch.update(values)
            warnings += watch.warnings()
        object.__setattr__(self, "t_s", t_s)
        object.__setattr__(self, "channels", MappingProxyType(channels))
        object.__setattr__(self, "warnings", tuple(dict.fromkeys(warnings)))

    def __len__(self) -> int:
        """Return the number of rows."""
        return self.t_s.size

    def __contains__(self, name: object) -> bool:
        """Return whether the log has this channel."""
        return name in self.channels

    def __getitem__(self, name: str) -> FloatArray:
        """Return a channel's values.

        Raises:
            ColumnError: the log has no such channel.
        """
        if name not in self.channels:
            raise ColumnError(
                f"the log has no channel {name!r}; it has: {', '.join(self.channels)}"
            )
        return self.channels[name]


def _check_time(t_s: FloatArray) -> None:
    if t_s.ndim != 1 or not t_s.size:
        raise LogError(f"t_s has shape {t_s.shape}; expected (n,) with n > 0")
    bad = np.flatnonzero(~np.isfinite(t_s))
    if bad.size:
        raise LogError(f"t_s: rows that are not finite: {bad.size} (first: row {bad[0] + 1})")


def _check_shape(name: str, values: FloatArray, rows: int) -> None:
    if values.ndim not in (1, 2) or values.shape[0] != rows:
        raise LogError(
            f"{name} has shape {values.shape}; expected ({rows},) or ({rows}, k), as t_s has "
            f"{rows} stamps"
        )
