"""Messages that name what a caller may do, so that each caller can use its own words.

A function advises ``set torque_is_gravity_compensated=True`` where a command advises
``give --gravity-compensated``: the message is one, only the words of the advice differ.
"""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Self


class Advice(StrEnum):
    """What a caller may do about an error, in words of the Python interface.

    Packages derive their own enumerations from it.
    """


class Message(str):
    """Text, some parts of which are `Advice`.

    Attributes:
        parts: The texts and advices that the message consists of.
    """

    parts: tuple[str, ...]

    def __new__(cls, *parts: str) -> Self:
        """Join texts, advices and further messages into one message."""
        message = super().__new__(cls, "".join(parts))
        flat: list[str] = []
        for part in parts:
            flat += part.parts if isinstance(part, Message) else [part]
        message.parts = tuple(flat)
        return message

    @classmethod
    def of(cls, error: BaseException) -> "Message":
        """Return the message of an error."""
        text = error.args[0] if error.args else ""
        return text if isinstance(text, Message) else cls(str(error))

    @classmethod
    def joined(cls, separator: str, texts: Iterable[str]) -> Self:
        """Return the texts that are not empty as one message, with a separator."""
        parts: list[str] = []
        for text in filter(None, texts):
            parts += [separator, text] if parts else [text]
        return cls(*parts)

    def in_words(self, words: Mapping[Advice, str]) -> str:
        """Return the message with other words for the advices that have some."""
        return "".join(
            words.get(part, part) if isinstance(part, Advice) else part
            for part in self.parts
        )
