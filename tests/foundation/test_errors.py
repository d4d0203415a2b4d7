"""Errors: message, advice, and what a traceback shows."""

import pickle
import traceback

import pytest

from foundation.errors import NeedleforceError, Suspicion


class DoorError(NeedleforceError, OSError):
    usual_advice = "Call `open_door`."


class KeyMissingError(DoorError, KeyError):
    usual_advice = "Ask for the key."


def test_an_error_has_the_advice_given_or_that_of_its_class():
    assert DoorError("shut").advice == "Call `open_door`."
    assert DoorError("shut", "Push.").advice == "Push."
    assert KeyMissingError("lost").advice == "Ask for the key."
    assert NeedleforceError("odd").advice == ""


def test_the_message_is_what_was_given_and_holds_no_advice():
    assert str(KeyMissingError("'a' is lost", "Ask Ann.")) == "'a' is lost"
    assert str(DoorError()) == ""


def test_a_traceback_shows_the_advice_below_the_message():
    shown = traceback.format_exception_only(DoorError("the door is shut"))

    assert shown[0].endswith("DoorError: the door is shut\n")
    assert shown[1] == "Call `open_door`.\n"


@pytest.mark.parametrize("copy_of", [lambda e: pickle.loads(pickle.dumps(e)), None])
def test_copies_keep_advice_and_notes(copy_of):
    error = KeyMissingError("lost", "Ask Ann.")
    copied = copy_of(error) if copy_of else error.reworded("b.key: lost")

    assert type(copied) is KeyMissingError
    assert copied.advice == "Ask Ann."
    assert copied.__notes__ == error.__notes__
    assert str(copied) == ("lost" if copy_of else "b.key: lost")
    assert str(error) == "lost"


def test_a_suspicion_reads_as_text_and_advice():
    assert str(Suspicion("it is dark")) == "it is dark"
    assert str(Suspicion("it is shut", "Push.")) == "it is shut; Push."
