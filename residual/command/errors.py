"""What a user of the command got wrong, in one line."""

from residual.errors import ResidualError


class CommandError(ResidualError, ValueError):
    """An option, a file named by one, or a log that does not fit the robot."""
