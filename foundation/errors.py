"""The base of all errors: what came and was expected, and what may be done about it."""

from copy import copy
from typing import ClassVar, NamedTuple, Self


class NeedleforceError(Exception):
    """Base of all errors that this project raises on purpose.

    ``str(error)`` is what came and what was expected. A traceback shows the advice
    below it.

    Args:
        message: What came and what was expected.
        advice: What a caller may do about it; empty for the usual advice of the class.

    Attributes:
        usual_advice: Advice of an error of this class that is raised without one; empty
            where the message says enough.
        advice: As given, or the usual one.
    """

    usual_advice: ClassVar[str] = ""

    def __init__(self, message: str = "", advice: str = "") -> None:
        super().__init__(message)
        self.advice = advice or self.usual_advice
        if self.advice:
            self.add_note(self.advice)

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""

    def reworded(self, message: str) -> Self:
        """Return a copy of the error, with the same advice and another message."""
        error = copy(self)
        error.args = (message,)
        return error


class Suspicion(NamedTuple):
    """Something that seems to be wrong, and that was not refused.

    Attributes:
        text: What was seen, and what was expected.
        advice: What a caller may do about it; empty for a mere report.
    """

    text: str
    advice: str = ""

    def __str__(self) -> str:
        return f"{self.text}; {self.advice}" if self.advice else self.text
