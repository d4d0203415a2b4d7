"""A log: channels in SI units, with one time stamp per row."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from foundation.arrays import Array
from needleforce.recordings.channel_units import ChannelUnit
from needleforce.recordings.errors import ColumnError, LogError
from needleforce.recordings.table import read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """Time stamps and named channels of equal length.

    Rows are kept as recorded. Backward or repeated stamps and non-finite values are
    reported in the `warnings` of a log that was read; the online steps skip them.
    Channels have names with their SI unit: `q_rad`, `dq_rad_s`, `tau_Nm`, `tau_ext_Nm`,
    `depth_m`, `speed_m_s`, `force_N`. Arrays are read-only.

    Attributes:
        t_s: Time stamps, shape (n,), finite; on the file's clock, not rebased.
        channels: By name, shape (n,) or (n, joints).
        warnings: What is wrong with the recording, one sentence each.
        start_ns: The instant of t_s = 0, see `Table`.
        units: In which unit of the file each channel was read, and whence that is
            known.
    """

    t_s: Array
    channels: Mapping[str, Array]
    warnings: tuple[str, ...] = ()
    start_ns: int = 0
    units: tuple[ChannelUnit, ...] = ()

    def __post_init__(self) -> None:
        """Copy, freeze and check the data.

        Raises:
            LogError: There is no channel, something is no array of numbers of the right
                shape, or time is not finite.
        """
        t_s = read_only("t_s", self.t_s)
        channels = {
            name: read_only(name, values) for name, values in self.channels.items()
        }
        if not channels:
            raise LogError("a log needs at least one channel beside time")
        if t_s.ndim != 1 or not t_s.size:
            raise LogError(f"t_s has shape {t_s.shape}; expected (n,) with n > 0")

        invalid_rows = np.flatnonzero(~np.isfinite(t_s))
        if invalid_rows.size:
            raise LogError(
                f"t_s: rows that are not finite: {invalid_rows.size} "
                f"(first: row {invalid_rows[0] + 1})"
            )

        for name, values in channels.items():
            if values.ndim not in (1, 2) or values.shape[0] != t_s.size:
                raise LogError(
                    f"{name} has shape {values.shape}; expected ({t_s.size},) or "
                    f"({t_s.size}, k), as t_s has {t_s.size} stamps"
                )

        object.__setattr__(self, "t_s", t_s)
        object.__setattr__(self, "channels", MappingProxyType(channels))

    def __len__(self) -> int:
        """Return the number of rows."""
        return self.t_s.size

    def __contains__(self, name: object) -> bool:
        """Return whether there is a channel of this name."""
        return name in self.channels

    def __getitem__(self, name: str) -> Array:
        """Return a channel's values; `ColumnError` if the log has no such channel."""
        if name in self.channels:
            return self.channels[name]

        raise ColumnError(
            f"the log has no channel {name!r}; it has: {', '.join(self.channels)}"
        )
