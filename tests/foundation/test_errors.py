"""Errors: message, advice, and what a traceback shows."""

import pickle
import traceback

import pytest

from identification import Suspicion
from needleforce import NeedleforceError


class DoorError(NeedleforceError, OSError):
    usual_advice = "Call `open_door`."


class KeyMissingError(DoorError, KeyError):
    usual_advice = "Ask for the key."


@pytest.mark.parametrize(
    ("said", "text", "advice"),
    [
        (DoorError("shut"), "shut", "Call `open_door`."),
        (DoorError("shut", "Push."), "shut", "Push."),
        (DoorError(), "", "Call `open_door`."),
        (KeyMissingError("lost"), "lost", "Ask for the key."),
        (KeyMissingError("'a' is lost", "Ask Ann."), "'a' is lost", "Ask Ann."),
        (NeedleforceError("odd"), "odd", ""),
        (Suspicion("it is dark"), "it is dark", ""),
        (Suspicion("it is shut", "Push."), "it is shut; Push.", "Push."),
    ],
)
def test_text_is_what_was_given_and_advice_beside_it_or_that_of_the_class(
    said, text, advice
):
    assert (str(said), said.advice) == (text, advice)


def test_a_traceback_shows_the_advice_below_the_message():
    shown = traceback.format_exception_only(DoorError("the door is shut"))

    assert shown == [
        f"{__name__}.DoorError: the door is shut\n",
        "Call `open_door`.\n",
    ]


@pytest.mark.parametrize("copy_of", [lambda e: pickle.loads(pickle.dumps(e)), None])
def test_copies_keep_advice_and_notes(copy_of):
    error = KeyMissingError("lost", "Ask Ann.")
    copied = copy_of(error) if copy_of else error.reworded("b.key: lost")

    assert (type(copied), copied.advice, copied.__notes__, str(copied)) == (
        KeyMissingError,
        "Ask Ann.",
        error.__notes__,
        "lost" if copy_of else "b.key: lost",
    )
    assert str(error) == "lost"
