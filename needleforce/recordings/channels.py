"""What is known of a log before it is read: units, channels and layouts.

It stands in `layouts.toml`; files of the same form add to it, see `load_knowledge`.
"""

import re
import tomllib
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from math import inf
from pathlib import Path
from typing import Any

import msgspec

from needleforce.recordings.errors import (
    FileAccessError,
    FormatError,
    MappingError,
    file_errors,
    readable_path,
)

FORCE_STATUS = ("ok", "not tared", "initializing", "rejected")
"""What 0, 1, 2, ... of the column `force_status` mean; only the first is a usable
force."""

WORTHLESS = {
    "frozen": 2,
    "joint limit": 8,
    "near singular": 16,
    "model mismatch": 32,
    "tare expired": 64,
    "velocity": 128,
}
"""Bits of the column `force_warnings` that make a force worthless to an identifier."""


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


class PlausibleSize(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The largest value of a channel that is plausible for a robot or a needle.

    Attributes:
        value: In SI units; of time the largest median step.
        unit: In which a file is likely to be whose values are larger.
        reason: Why larger values are not plausible.
    """

    value: float
    unit: str
    reason: str


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
        at_most: What is plausible; by default anything.
        usual_unit: The unit that an example in an advice has.
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
    at_most: PlausibleSize = PlausibleSize(value=inf, unit="", reason="")
    usual_unit: str = ""
    name: str = ""

    def __post_init__(self) -> None:
        """Write names as those of columns are compared."""
        for field in ("spellings", "machine_words", "words_with_unit", "preferred"):
            names = tuple(map(normalised_name, getattr(self, field)))
            msgspec.structs.force_setattr(self, field, names)

        if not self.usual_unit:
            msgspec.structs.force_setattr(self, "usual_unit", self.si_unit)

    @property
    def option(self) -> str:
        """Option of the commands that names its columns.

        What only this package writes has none of its own, only an entry in the file of
        ``--mapping``.
        """
        has_option = not self.name.startswith("force_")
        return f"--{self.name.replace('_', '-') if has_option else 'mapping'}"

    @property
    def si_unit(self) -> str:
        """The SI unit of this channel."""
        return self.units.si


class Layout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A form of files, and what its columns are: a mapping with a condition.

    Attributes:
        name: For messages.
        columns: Names and patterns that must all be there.
        first_line: Pattern that the first line of the text fits.
        channels: Columns by channel, as in a mapping.
        rate_hz: Samples/s of files without time stamps.
        joints: Names of the robot's joints, as in a mapping.
        note: What else a user should hear.
        table_after: Pattern of the last line above the table.
        units_line: Pattern of the line above the header that has the columns' units.
        step_line: Pattern of the line that has the time from row to row.
        first_unit: Unit of the first column.
    """

    name: str
    columns: tuple[str, ...] = ()
    first_line: str = ""
    channels: dict[str, Any] = {}
    rate_hz: float | None = None
    joints: str | tuple[str, ...] = ()
    note: str = ""
    table_after: str = ""
    units_line: str = ""
    step_line: str = ""
    first_unit: str = ""

    def __post_init__(self) -> None:
        """Raise `ValueError` if there is no condition, or a pattern is none."""
        if not (self.columns or self.first_line):
            raise ValueError(f"layout {self.name!r} needs columns or a first_line")
        for pattern in (self.first_line, self.table_after, self.units_line):
            try:
                re.compile(pattern + self.step_line)
            except re.error as error:
                raise ValueError(f"{pattern!r} is no pattern: {error}") from error


class JointRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How text names joints: patterns of columns, fields, and what is not measured."""

    by_path: str
    by_number: str
    by_list: str
    fields: tuple[str, ...]
    not_measured: tuple[str, ...]


class MessageLayout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the fields of a type of messages are; `/` leads to fields of fields.

    Attributes:
        channels: Fields by channel.
        masses: Fields of the mass on the flange: of all, then of its parts.
    """

    channels: dict[str, str] = {}
    masses: tuple[str, ...] = ()


class _OtherUnits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Units of which no channel is made."""

    case_matters: tuple[str, ...]
    words: tuple[str, ...]
    letters: tuple[str, ...]


class Knowledge(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `layouts.toml`, with that of a user's files.

    Attributes:
        encodings: Tried where a text is not UTF.
        delimiters: Between cells.
        quantities: The units of each.
        other_units: Units of which no channel is made.
        channels: By the name that mappings use.
        joints: How text names joints.
        messages: By their type, those of bags whose fields are channels.
        conversions: By suffix: what makes a readable file of one that is not read.
        layouts: The first that fits is taken.
    """

    encodings: tuple[str, ...]
    delimiters: tuple[str, ...]
    quantities: dict[str, Units] = msgspec.field(name="units")
    other_units: _OtherUnits
    channels: dict[str, Channel]
    joints: JointRules
    messages: dict[str, MessageLayout]
    conversions: dict[str, str]
    layouts: tuple[Layout, ...]

    def is_unit(self, text: str) -> bool:
        """Return whether a text is a unit, of a channel or of anything else."""
        unit = text.strip()
        others = self.other_units
        is_other = unit in others.letters or unit.lower() in others.words
        quantities = self.quantities.items()
        return is_other or any(
            units.find(text) for name, units in quantities if name != "code"
        )

    def is_row_of_units(self, cells: Iterable[str]) -> bool:
        """Return whether a row holds units: `(s),(mm),(kN)` or `s;mm;kN`.

        Every cell is empty, in brackets or a unit, and at least one is a known unit.
        """
        filled = [cell.strip() for cell in cells if cell.strip()]
        bracketed = [unit_in_brackets(cell) for cell in filled]
        are_known = [
            self.is_unit(unit or cell)
            for cell, unit in zip(filled, bracketed, strict=True)
        ]
        are_units = (
            is_known or unit is not None
            for is_known, unit in zip(are_known, bracketed, strict=True)
        )
        return any(are_known) and all(are_units)

    def conversion_of(self, path: Path) -> str:
        """Return what makes a readable file of another; empty if nothing is known."""
        suffix = path.suffix.lower()
        if suffix == ".mat" and path.is_file():
            with path.open("rb") as file:
                suffix += file.read(10).decode("ascii", "replace")[6:]

        usual = self.conversions.get(suffix.partition(" ")[0], "")
        line = self.conversions.get(suffix, usual)
        command = line.format(name=path.name, stem=path.stem)
        is_program = command.startswith("python ")
        return f"run in its folder: {command}" if is_program else command


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
        FormatError: It is not TOML, is empty, or is longer than 4 MiB.
    """
    max_bytes = 1 << 22  # no mapping is longer; a file named by mistake may be
    try:
        with file_errors(path), readable_path(path).open("rb") as stream:
            data = stream.read(max_bytes + 1)
    except FileAccessError as error:
        message = str(error).replace("cannot read", f"cannot read the {subject}")
        raise error.reworded(message) from error

    if len(data) > max_bytes:
        raise FormatError(f"the {subject} {path} is longer than {max_bytes} bytes")

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
    content = tomllib.loads(_OWN_FILE.read_text("utf-8"))
    knowledge = _convert(content)
    for path in paths:
        try:
            content = _merged(content, read_toml(path, "layout"))
            knowledge = _convert(content)
        except FormatError as error:
            raise MappingError(str(error)) from error
        except msgspec.ValidationError as error:
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
    case_matters = content["other_units"]["case_matters"]

    def units_of(kind: type, entry: Any) -> Any:
        if not isinstance(entry, str):
            return Units(entry, case_matters, words)
        if entry not in entries:
            listed = ", ".join(entries)
            raise ValueError(f"quantity {entry!r} is none of {listed}")

        return Units(entries[entry], case_matters, words)

    channels = content["channels"].items()
    named = {name: {**channel, "name": name} for name, channel in channels}
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


_OWN_FILE = Path(__file__).with_name("layouts.toml")

KNOWLEDGE = load_knowledge()
"""What is known without a user's files."""

CHANNELS: Mapping[str, Channel] = KNOWLEDGE.channels
"""Every channel by the name that mappings use."""
