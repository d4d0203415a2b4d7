"""Which columns of a file are which channels of a log."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType
from typing import Any

from recordings.columns.channel import CHANNELS
from recordings.columns.spec import ColumnSpec
from recordings.errors import MappingError


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMapping:
    """Columns for some or all channels; channels not listed are found by their usual names.

    Attributes:
        channels: channel name (a key of `CHANNELS`) to its columns.
        rate_hz: sample rate of a file without time stamps; it replaces a time column.
        joints: for a bag, the names of the robot's joints in the robot's order; joint signals
            are put into this order by name.
        clock: for a bag, the topic whose messages are the rows of the log.
        payload: what hangs on the robot, as the command that needs it understands it.
    """

    channels: Mapping[str, ColumnSpec] = field(default_factory=dict)
    rate_hz: float | None = None
    joints: tuple[str, ...] = ()
    clock: str | None = None
    payload: Any = None

    def __post_init__(self) -> None:
        """Check names, units and the rate.

        Raises:
            MappingError: an unknown channel or unit, a rate that is not a positive number, both a
                rate and a time column, or a joint named twice.
        """
        channels = {}
        for name, spec in self.channels.items():
            if name not in CHANNELS:
                raise MappingError(f"unknown channel {name!r}; channels are: {', '.join(CHANNELS)}")
            channels[name] = spec.checked_for(CHANNELS[name])
        object.__setattr__(self, "channels", MappingProxyType(channels))
        if len(set(self.joints)) < len(self.joints):
            raise MappingError(f"joints = {list(self.joints)} names a joint twice")
        if self.rate_hz is None:
            return
        if not (isfinite(self.rate_hz) and self.rate_hz > 0.0):
            raise MappingError(f"rate_hz = {self.rate_hz} must be a positive number of samples/s")
        if "time" in channels:
            raise MappingError("both rate_hz and a time column are given; keep one of them")
