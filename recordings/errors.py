"""Everything this package may raise, under one base."""


class RecordingError(Exception):
    """Base of all errors raised by `recordings`."""


class FileAccessError(RecordingError, OSError):
    """A file cannot be opened for reading or writing, or its suffix names no known format."""


class FormatError(RecordingError, ValueError):
    """A file could be opened, but nothing usable could be read from it."""


class ColumnError(RecordingError, LookupError):
    """A column was not found, or more than one would fit."""


class MappingError(RecordingError, ValueError):
    """A column mapping contradicts itself or uses unknown channels, keys or units."""


class LogError(RecordingError, ValueError):
    """Data do not form a log: lengths differ, no usable time, no finite value."""
