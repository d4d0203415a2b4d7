"""Messages: one text for every caller, with each caller's words for the advice."""

import pickle

from foundation.advice import Advice, Message


class DoorAdvice(Advice):
    PUSH = "push()"
    KNOCK = "knock()"


CLOSED = Message("it is closed: ", DoorAdvice.PUSH, " or ", DoorAdvice.KNOCK)


def test_message_reads_as_its_parts():
    assert CLOSED == "it is closed: push() or knock()"


def test_callers_words_replace_advices_only():
    words: dict[Advice, str] = {DoorAdvice.PUSH: "lean on it"}

    assert CLOSED.in_words(words) == "it is closed: lean on it or knock()"
    assert Message("push() is a word here").in_words(words) == "push() is a word here"


def test_joined_and_nested_messages_keep_their_advices():
    message = Message.joined("; ", ["late", "", Message("door: ", CLOSED)])

    assert message == "late; door: it is closed: push() or knock()"

    said = message.in_words({DoorAdvice.KNOCK: "ring"})

    assert said == "late; door: it is closed: push() or ring"


def test_errors_give_their_message():
    assert Message.of(ValueError(CLOSED)).parts == CLOSED.parts
    assert Message.of(ValueError("plain")).parts == ("plain",)
    assert Message.of(ValueError()) == ""


def test_pickled_message_keeps_its_advices():
    copy = pickle.loads(pickle.dumps(CLOSED))
    assert copy.parts == CLOSED.parts
