"""Column mappings in one line, for tests."""

from needleforce.recordings import ColumnMapping, ColumnSpec


def mapped(rate_hz=None, **channels):
    """A mapping of channels to columns, given as a `ColumnSpec` or as its `columns`."""
    specs = {
        name: spec if isinstance(spec, ColumnSpec) else ColumnSpec(columns=spec)
        for name, spec in channels.items()
    }
    return ColumnMapping(channels=specs, rate_hz=rate_hz)
