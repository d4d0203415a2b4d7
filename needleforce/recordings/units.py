"""Units of a file: which one a text spells, and what it is in SI."""

import re
from collections.abc import Mapping, Sequence

_CHARACTERS = str.maketrans(
    {"µ": "u", "μ": "u", "°": "deg", "º": "deg", "_": "/", '"': "in", "″": "in"}
)
"""Micro sign and Greek letter; degree sign and the ordinal that is taken for it."""


class Units(dict[str, float]):
    """The units of a quantity, each with its factor to SI; the first is SI.

    Args:
        entries: Of each unit its factor, then other ways to write it.
        case_matters: Spellings in lower case that are not guessed, since capitals make
            other units of them.
        words: Spellings of all quantities, in lower case, with what they mean: they may
            be parts of a quotient.

    Raises:
        ValueError: An entry does not begin with a factor.
    """

    def __init__(
        self,
        entries: Mapping[str, Sequence[float | str]],
        case_matters: Sequence[str],
        words: Mapping[str, str],
    ) -> None:
        for name, entry in entries.items():
            factor = entry[0] if entry else ""
            are_texts = all(isinstance(text, str) for text in entry[1:])
            if isinstance(factor, str) or factor <= 0.0 or not are_texts:
                raise ValueError(
                    f"{name} = {entry!r:.60}: expected the factor to SI, then other "
                    "spellings"
                )

        super().__init__({name: float(entry[0]) for name, entry in entries.items()})
        self._case_matters = frozenset(case_matters)
        self._words = words
        self._by_spelling = {_without_signs(name): name for name in entries}
        for name, (_, *others) in entries.items():
            self._by_spelling |= {_without_signs(str(text)): name for text in others}

        self._by_lower_case = {
            spelling.lower(): name for spelling, name in self._by_spelling.items()
        }

    @property
    def si(self) -> str:
        """The unit of SI."""
        return next(iter(self))

    def find(self, text: str) -> str | None:
        """Return the unit that a text such as `mm/s`, `mm_s` or `µs` spells, if any."""
        written = _without_signs(text)
        if written in self._by_spelling:
            return self._by_spelling[written]

        lower = written.lower()
        if lower in self._case_matters:
            return None
        if lower in self._by_lower_case:
            return self._by_lower_case[lower]

        parts = (self._words.get(part, part) for part in lower.split("/"))
        return self._by_lower_case.get("/".join(parts).lower())


def _without_signs(text: str) -> str:
    """Return a unit without the signs of a product, with `/` for that of a quotient."""
    written = text.strip().translate(_CHARACTERS)
    written = written.replace("/per/", "/").replace(" per ", "/")
    return re.sub(r"[·∙⋅•.*\-\s]", "", written)


def unit_in_brackets(text: str) -> str | None:
    """Return what stands in brackets, if that is all of the text."""
    match = re.match(r"^[(\[{<]\s*([^()\[\]{}<>]*?)\s*[)\]}>]$", text.strip())
    return match[1] if match else None
