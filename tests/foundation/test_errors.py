"""Errors with a code: message, advice, and what a traceback shows."""

import pickle
import traceback

import pytest

from foundation.errors import CodedError, ErrorCode, Suspicion, fill_advice


class DoorCode(ErrorCode):
    CLOSED = ("NF-DOOR-CLOSED", "The door is closed.", "Call `open_door`.")
    NO_KEY = ("NF-DOOR-NO-KEY", "There is no key.", "Ask {owner} for the {colour} one.")


class DoorError(CodedError, OSError):
    usual_code = DoorCode.CLOSED


class KeyMissingError(DoorError, KeyError):
    usual_code = DoorCode.NO_KEY


def test_an_error_has_the_usual_code_of_its_class_or_the_given_one():
    assert DoorError("shut").code is DoorCode.CLOSED
    assert DoorError("shut", DoorCode.NO_KEY).code is DoorCode.NO_KEY
    assert KeyMissingError("lost").code is DoorCode.NO_KEY
    assert str(DoorCode.CLOSED) == "NF-DOOR-CLOSED"
    assert DoorCode.CLOSED.area == "door"


def test_the_message_is_what_was_given_and_holds_no_advice():
    error = KeyMissingError("'a' is lost", owner="Ann", colour="red")

    assert str(error) == "'a' is lost"
    assert error.advice == "Ask Ann for the red one."
    assert str(DoorError()) == ""


def test_a_traceback_shows_the_code_and_the_advice_below_the_message():
    shown = traceback.format_exception_only(DoorError("the door is shut"))

    assert shown[0].endswith("DoorError: the door is shut\n")
    assert shown[1] == "NF-DOOR-CLOSED: Call `open_door`.\n"


def test_a_place_without_a_value_is_written_in_capitals():
    assert fill_advice("pip install {package}", {}) == "pip install PACKAGE"
    assert KeyMissingError("lost", owner="Ann").advice == "Ask Ann for the COLOUR one."


@pytest.mark.parametrize("copy_of", [lambda e: pickle.loads(pickle.dumps(e)), None])
def test_copies_keep_code_places_and_notes(copy_of):
    error = KeyMissingError("lost", DoorCode.NO_KEY, owner="Ann", colour="red")
    copied = copy_of(error) if copy_of else error.reworded("b.key: lost")

    assert type(copied) is KeyMissingError
    assert copied.code is DoorCode.NO_KEY
    assert copied.advice == "Ask Ann for the red one."
    assert copied.__notes__ == error.__notes__
    assert str(copied) == ("lost" if copy_of else "b.key: lost")
    assert str(error) == "lost"


def test_a_suspicion_reads_as_text_and_advice():
    assert str(Suspicion("it is dark")) == "it is dark"
    assert str(Suspicion("it is shut", DoorCode.CLOSED)) == (
        "it is shut; Call `open_door`."
    )
