"""What a user of the command line may do about an error.

An error of a package brings advice for callers of the library. ``advice.csv`` holds
what the command says in its place, and `live` and `view`, which tare by themselves;
``{place}`` stands for what differs from error to error. Advice without a row names
nothing of the library, and serves both.
"""

import csv
import re
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from foundation.errors import NeedleforceError, Suspicion


class _Row(NamedTuple):
    """A row of the table: an advice of the library, and what is said instead.

    Attributes:
        pattern: Of the library's advice.
        command: Of a command.
        watching: Of `live` and `view`; empty where it is that of a command.
    """

    pattern: re.Pattern[str]
    command: str
    watching: str


@cache
def _read_rows() -> tuple[_Row, ...]:
    """Return the rows of the table."""
    text = files("needleforce.cli").joinpath("advice.csv").read_text("utf-8")
    return tuple(
        _Row(
            re.compile(
                re.sub(r"\\{(\w+)\\}", r"(?P<\1>.+)", re.escape(row["library"])),
            ),
            row["command"],
            row["watching"],
        )
        for row in csv.DictReader(text.splitlines())
    )


def advise(advice: str, *, is_watching: bool = False) -> str:
    """Return an advice of the library as a user of the command follows it.

    Args:
        advice: As an error brings it.
        is_watching: Whether the command tares by itself.
    """
    for row in _read_rows():
        match = row.pattern.fullmatch(advice)
        if match is not None:
            places = match.groupdict()
            if "channel" in places:
                places["option"] = _option_of(places["channel"])
            text = row.watching if is_watching and row.watching else row.command
            return text.format(**places)
    return advice.rstrip(".")


def _option_of(channel: str) -> str:
    """Return the option that names a channel's columns.

    What only this package writes has an entry in the file of ``--mapping`` instead.
    """
    has_option = not channel.startswith("force_")
    return f"--{channel.replace('_', '-') if has_option else 'mapping'}"


def describe_error(error: NeedleforceError, *, is_watching: bool = False) -> str:
    """Return an error in one line: what came and was expected, what to do."""
    text = _as_sentence(str(error))
    advice = advise(error.advice, is_watching=is_watching)
    return f"{text} {advice}" if advice else text.removesuffix(".")


def describe_suspicion(suspicion: Suspicion) -> str:
    """Return a suspicion in one line, with what a user of the command may do."""
    if not suspicion.advice:
        return suspicion.text
    return f"{_as_sentence(suspicion.text)} {advise(suspicion.advice)}"


def _as_sentence(text: str) -> str:
    """Return a text that ends as a sentence does."""
    text = text.rstrip()
    return text if text.endswith((".", "?", "!")) else f"{text}."
