"""What can go wrong in a benchmark; every message is one line for the person at the keyboard."""


class BenchmarkError(Exception):
    """Base of all errors of this package."""


class UnknownIdError(BenchmarkError, KeyError):
    """A benchmark or a plant of that name does not exist."""

    def __str__(self) -> str:
        """The message itself; a KeyError would put it in quotes."""
        return str(self.args[0])


class DataError(BenchmarkError, ValueError):
    """A recording is missing or is not what it should be."""


class ResultsError(BenchmarkError, ValueError):
    """A file of results cannot be read, written or compared."""


class UnknownMetricError(BenchmarkError, KeyError):
    """A number was measured that the catalogue of metrics does not list."""

    def __str__(self) -> str:
        """The message itself; a KeyError would put it in quotes."""
        return str(self.args[0])
