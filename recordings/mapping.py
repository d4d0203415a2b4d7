"""Which columns of a file are which channels of a log."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType

from recordings.channel import CHANNELS
from recordings.column_spec import ColumnSpec
from recordings.errors import MappingError


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMapping:
    """Columns for some or all channels; channels not listed are found by their usual names.

    Attributes:
        channels: channel name (a key of `CHANNELS`) to its columns.
        rate_hz: sample rate of a file without time stamps; it replaces a time column.
    """

    channels: Mapping[str, ColumnSpec] = field(default_factory=dict)
    rate_hz: float | None = None

    def __post_init__(self) -> None:
        """Check names, units and the rate.

        Raises:
            MappingError: an unknown channel or unit, a rate that is not a positive number, or
                both a rate and a time column.
        """
        channels = {}
        for name, spec in self.channels.items():
            if name not in CHANNELS:
                raise MappingError(f"unknown channel {name!r}; channels are: {', '.join(CHANNELS)}")
            channels[name] = spec.checked_for(CHANNELS[name])
        object.__setattr__(self, "channels", MappingProxyType(channels))
        if self.rate_hz is None:
            return
        if not (isfinite(self.rate_hz) and self.rate_hz > 0.0):
            raise MappingError(f"rate_hz = {self.rate_hz} must be a positive number of samples/s")
        if "time" in channels:
            raise MappingError("both rate_hz and a time column are given; keep one of them")
