"""Errors with a code: what went wrong stands apart from what may be done about it.

A message says what came and what was expected. What to do depends on who reads it: a
function's caller sets ``torque_is_gravity_compensated=True``, a command's user gives
``--gravity-compensated``. So each error has a code; the code brings the advice for
callers of the library, and the command line looks its own up by the code.
"""

from copy import copy
from enum import Enum
from typing import ClassVar, NamedTuple, Self


class _Placeholders(dict[str, str]):
    """Values of the places in an advice; one without a value is written in capitals."""

    def __missing__(self, place: str) -> str:
        return place.upper()


class ErrorCode(Enum):
    """Kinds of errors; each package derives an enumeration of its own.

    A member is ``(label, meaning, cure)``.

    Attributes:
        label: Stable name, ``NF-AREA-KIND``: what a user searches for.
        meaning: What has happened, in one sentence.
        cure: What a caller of the library may do; names of the API stand in backticks,
            ``{place}`` for what an error fills in.
    """

    def __init__(self, label: str, meaning: str, cure: str) -> None:
        self.label = label
        self.meaning = meaning
        self.cure = cure

    def __str__(self) -> str:
        return self.label

    @property
    def area(self) -> str:
        """The second part of the label: the package, or what it is about."""
        return self.label.split("-")[1].lower()


def fill_advice(advice: str, places: dict[str, str]) -> str:
    """Return an advice with its places filled in; unknown ones become capitals."""
    return advice.format_map(_Placeholders(places))


class Alternative(NamedTuple):
    """Another cause that would explain an error as well.

    Attributes:
        code: Kind of the cause, which brings the advice.
        places: What the ``{place}`` in the advice stand for.
    """

    code: ErrorCode
    places: dict[str, str]


class CodedError(Exception):
    """Base of all errors that this project raises on purpose.

    ``str(error)`` is what came and what was expected. A traceback shows the code and
    the advice below it.

    Args:
        message: What came and what was expected.
        code: Kind of the error; None for the usual one of the class.
        places: What the ``{place}`` in an advice stand for in this error.

    Attributes:
        usual_code: Code of an error of this class that is raised without one.
        code: Kind of the error.
        places: As given.
        alternatives: Causes that would explain it as well, each with an advice.
    """

    usual_code: ClassVar[ErrorCode]
    alternatives: tuple[Alternative, ...] = ()

    def __init__(
        self, message: str = "", code: ErrorCode | None = None, **places: str
    ) -> None:
        super().__init__(message)
        self.code = code or self.usual_code
        self.places = places
        self.add_note(f"{self.code}: {self.advice}")

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""

    @property
    def advice(self) -> str:
        """What a caller of the library may do."""
        advices = [fill_advice(self.code.cure, self.places)]
        advices += [fill_advice(one.code.cure, one.places) for one in self.alternatives]
        return " Or: ".join(advices)

    def reworded(self, message: str) -> Self:
        """Return a copy of the error, of the same code, with another message."""
        error = copy(self)
        error.args = (message,)
        return error


class Suspicion(NamedTuple):
    """Something that seems to be wrong, and that was not refused.

    Attributes:
        text: What was seen, and what was expected.
        code: Kind of the suspicion; None for a mere report.
    """

    text: str
    code: ErrorCode | None = None

    def __str__(self) -> str:
        return self.text if self.code is None else f"{self.text}; {self.code.cure}"


class StateCode(ErrorCode):
    """Kinds of errors about saved states and snapshots."""

    DAMAGED = (
        "NF-STATE-DAMAGED",
        "A saved state is damaged: a value, a shape or the hash cannot be.",
        "Take an older snapshot, or start and tare anew.",
    )
    FILE = (
        "NF-STATE-FILE",
        "The file is not one that this package wrote as a state.",
        "Give a file that `write_snapshot` wrote.",
    )
    VERSION = (
        "NF-STATE-VERSION",
        "The state was written by another version of the package.",
        "Resume it with the package that wrote it.",
    )
    KIND = (
        "NF-STATE-KIND",
        "The state is of another kind of object than the one that reads it.",
        "Restore it with an object of the class whose `snapshot` was taken.",
    )
    OTHER = (
        "NF-STATE-OTHER",
        "The snapshot is of another robot, or of other settings.",
        "Build the object with the robot and the settings of the snapshot, "
        "then `restore` it.",
    )
