"""What is known of a log before it is read: units, channels and layouts.

It stands in `layouts.toml`; files of the same form add to it, see `load_knowledge`.
"""

import re
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path
from typing import Annotated, Any

import msgspec

from needleforce.recordings.errors import (
    FormatError,
    MappingError,
    file_errors,
    readable_path,
)


class Units(dict[str, float]):
    """The units of a quantity, each with its factor to SI; the first is SI.

    Args:
        entries: Of each unit its factor, then other ways to write it.
        case_matters: Spellings in lower case whose capitals make other units.
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
        super().__init__()
        self._case_matters = case_matters
        self._words = words
        self._by_spelling: dict[str, str] = {}
        for name, entry in entries.items():
            factor, *others = entry or ("",)
            if isinstance(factor, str) or factor <= 0.0:
                raise ValueError(f"{name} = {entry!r:.60}: expected a factor to SI")

            self[name] = float(factor)
            spellings = map(_without_signs, (name, *map(str, others)))
            self._by_spelling |= dict.fromkeys(spellings, name)

        self._by_lower_case = {
            text.lower(): name for text, name in self._by_spelling.items()
        }

    @property
    def si(self) -> str:
        """The unit of SI."""
        return next(iter(self))

    def find(self, text: str) -> str | None:
        """Return the unit that a text such as `mm/s`, `mm_s` or `µs` spells, if any."""
        written = _without_signs(text)
        lower = written.lower()
        if written in self._by_spelling or lower in self._case_matters:
            return self._by_spelling.get(written)

        parts = (self._words.get(part, part) for part in lower.split("/"))
        quotient = self._by_lower_case.get("/".join(parts).lower())
        return self._by_lower_case.get(lower, quotient)


def _without_signs(text: str) -> str:
    """Return a unit without the signs of a product, with `/` for that of a quotient."""
    signs = {"µ": "u", "μ": "u", "°": "deg", "º": "deg", "_": "/", '"': "in"}
    written = text.strip().translate(str.maketrans(signs))
    written = written.replace("/per/", "/").replace(" per ", "/")
    return re.sub(r"[·∙⋅•.*\-\s]", "", written)


class Channel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One quantity of a log, as `layouts.toml` has it.

    Attributes:
        key: Its name in a `Log`, with the SI unit, such as `q_rad`.
        units: That may stand in a file, with factors to SI.
        meaning: One phrase for help texts.
        spellings: Usual column names, without unit and number and in lower case.
        per_joint: One column per joint (2-D) rather than one value (1-D).
        machine_words: What testing machines and other languages call it; these count
            where no column has a usual name.
        words_with_unit: Names that say it only beside one of its units, as
            `Position (mm)` does; these count last.
        preferred: Names that come before the others where a file has several.
        at_most: The largest plausible value, in SI units; of time the median step.
        name: How mappings and options call it, such as `q`.
    """

    key: str
    units: Units = msgspec.field(name="quantity")
    meaning: str
    spellings: tuple[str, ...] = msgspec.field(name="names")
    per_joint: bool = False
    machine_words: tuple[str, ...] = msgspec.field(name="words", default=())
    words_with_unit: tuple[str, ...] = msgspec.field(name="with_unit", default=())
    preferred: tuple[str, ...] = msgspec.field(name="prefer", default=())
    at_most: float = inf
    name: str = ""

    def __post_init__(self) -> None:
        """Write names as those of columns are compared."""
        for field in ("spellings", "machine_words", "words_with_unit", "preferred"):
            names = tuple(map(normalised_name, getattr(self, field)))
            msgspec.structs.force_setattr(self, field, names)


class Layout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A form of files, and what its columns are: a mapping with a condition.

    Attributes:
        name: For messages.
        columns: Names and patterns that must all be there.
        channels: Columns by channel, as in a mapping.
        rate_hz: Samples/s of files without time stamps.
        joints: Names of the robot's joints, as in a mapping.
        note: What else a user should hear.
    """

    name: str
    columns: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    channels: dict[str, Any] = {}
    rate_hz: float | None = None
    joints: str | tuple[str, ...] = ()
    note: str = ""


class Knowledge(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `layouts.toml`, with that of a user's files.

    Attributes:
        quantities: The units of each.
        case_matters: Spellings of units whose capitals make another unit of them.
        other_units: Units of which no channel is made.
        missing_values: Numbers that stand for no value, in the file's unit.
        channels: By the name that mappings use.
        layouts: The first that fits is taken.
    """

    quantities: dict[str, Units] = msgspec.field(name="units")
    case_matters: tuple[str, ...]
    other_units: tuple[str, ...]
    missing_values: tuple[float, ...]
    channels: dict[str, Channel]
    layouts: tuple[Layout, ...]

    def is_unit(self, text: str) -> bool:
        """Return whether a text is a unit, of a channel or of anything else."""
        is_other = text in self.other_units or text.lower() in self.other_units
        return is_other or any(
            units.find(text)
            for name, units in self.quantities.items()
            if name != "code"
        )


def normalised_name(name: str) -> str:
    """Return a name in lower case without accents, with `_` between its words.

    Words end at spaces, hyphens and capitals: `Axial-Force` and `axialForce` are alike.
    """
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    decomposed = unicodedata.normalize("NFKD", words)
    letters = "".join(c for c in decomposed if not unicodedata.combining(c))
    return re.sub(r"[\s\-_]+", "_", letters.lower()).strip("_:.%")


def read_toml(path: str | Path, subject: str) -> dict[str, Any]:
    """Return the content of a TOML file, at least one key.

    Args:
        path: Of the file.
        subject: What it is, for messages.

    Raises:
        FileAccessError: It cannot be read.
        FormatError: It is not TOML, or is empty.
    """
    with file_errors(path, f"read the {subject}"):
        data = readable_path(path).read_bytes()

    try:
        content = tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise FormatError(f"the {subject} {path} is not valid TOML: {error}") from error

    if not content:
        raise FormatError(f"the {subject} {path} is empty")

    return content


def load_knowledge(*paths: str | Path) -> Knowledge:
    """Return what is known of logs, with what further files of the same form add.

    Args:
        paths: TOML files; of two that say different things the later one counts.

    Raises:
        FileAccessError: One cannot be read.
        MappingError: One is not TOML, or has an entry that is not valid.
    """
    content = tomllib.loads(Path(__file__).with_name("layouts.toml").read_text("utf-8"))
    knowledge = _convert(content)
    for path in paths:
        try:
            content = _merged(content, read_toml(path, "layout"))
            knowledge = _convert(content)
        except (FormatError, msgspec.ValidationError) as error:
            raise MappingError(f"{path}: {error}") from error

    return knowledge


def _convert(content: Mapping[str, Any]) -> Knowledge:
    """Return the content of `layouts.toml`; `ValidationError` if it is not valid."""
    entries = content["units"]
    words = {
        str(spelling).lower(): name
        for units in entries.values()
        for name, entry in units.items()
        for spelling in entry[1:]
    }

    def units_of(kind: type, entry: Any) -> Any:
        if isinstance(entry, str) and entry not in entries:
            raise ValueError(f"quantity {entry!r} is none of {', '.join(entries)}")

        spelled = entries[entry] if isinstance(entry, str) else entry
        return Units(spelled, content["case_matters"], words)

    named = {
        name: {**channel, "name": name} for name, channel in content["channels"].items()
    }
    return msgspec.convert({**content, "channels": named}, Knowledge, dec_hook=units_of)


def _merged(old: Any, new: Any) -> Any:
    """Return old content with new content added; new texts come before old ones."""
    if isinstance(old, dict) and isinstance(new, dict):
        common = {key: _merged(old[key], new[key]) for key in old.keys() & new.keys()}
        return old | new | common
    if isinstance(old, list) and isinstance(new, list):
        # A unit has one factor, at the beginning.
        has_factor = bool(new) and isinstance(new[0], int | float)
        return [*new, *(old[1:] if has_factor else old)]

    return new


KNOWLEDGE = load_knowledge()
"""What is known without a user's files."""

CHANNELS: Mapping[str, Channel] = KNOWLEDGE.channels
"""Every channel by the name that mappings use."""
