"""What is known of a log before it is read: units, channels, layouts, mappings.

Units, channels and layouts stand in `layouts.toml`; files of the same form add to it,
see `load_layouts`. A mapping says which columns of a file are which channels: in
code, in TOML, or as options.
"""

import re
import sys
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from types import MappingProxyType
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
        for kind in ("spellings", "machine_words", "words_with_unit", "preferred"):
            names = tuple(map(normalised_name, getattr(self, kind)))
            msgspec.structs.force_setattr(self, kind, names)


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


LEFT_OUT = "none"
"""Stands in place of a channel's columns if the channel is not to be read."""


class ColumnSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The columns of one channel.

    Attributes:
        columns: Name or pattern, as `q{1..7}` or `q_*`, or several, by joint; or
            `LEFT_OUT`.
        unit: In the file, of all columns or of each; None to take it from the column's
            name, else SI.
        scale: Factor for all columns, or one for each, applied after conversion to SI;
            a negative one turns a sign.
    """

    columns: str | tuple[str, ...]
    unit: str | tuple[str, ...] | None = None
    scale: float | tuple[float, ...] = 1.0

    def __post_init__(self) -> None:
        """Raise `MappingError` if a column is missing, or a scale is no factor."""
        if not self.columns or not all(self.patterns):
            raise MappingError(f"columns = {self.columns!r} names no column")

        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,)
        # A whole number may exceed floats.
        if not scales or not all(0.0 < abs(s) <= sys.float_info.max for s in scales):
            raise MappingError(
                f"scale = {self.scale!r:.60} must be finite and not zero"
            )

    @property
    def patterns(self) -> tuple[str, ...]:
        """The column names and patterns in order."""
        return (self.columns,) if isinstance(self.columns, str) else self.columns


def parse_column_spec(text: str, channel: Channel) -> ColumnSpec:
    """Read the short form: `NAMES[:UNIT][:SCALE]`, as in `fz:N:-1`.

    `NAMES` is a name, a pattern or a list separated by commas, `SCALE` a number or one
    for each column, likewise separated. What follows a colon counts as scale or unit
    only if it is one, since column names may hold colons themselves. Time stamps may be
    a sum, as in `sec:s+nanosec:ns`.

    Raises:
        MappingError: No column is named, or the scale is zero or not finite.
    """
    if channel.name == "time" and "+" in text:
        terms = [parse_column_spec(term, channel) for term in text.split("+")]
        columns = tuple(name for term in terms for name in term.patterns)
        return ColumnSpec(
            columns=columns, unit=tuple(str(term.unit or "s") for term in terms)
        )

    unit = None
    scale: tuple[float, ...] = (1.0,)
    head, colon, tail = text.rpartition(":")
    if colon:
        with suppress(ValueError):
            scale = tuple(map(float, tail.split(",")))
            text = head

    head, colon, tail = text.rpartition(":")
    if colon and (unit := channel.units.find(tail)):
        text = head

    columns = tuple(name.strip() for name in text.split(","))
    return ColumnSpec(
        columns=columns[0] if len(columns) == 1 else columns,
        unit=unit,
        scale=scale[0] if len(scale) == 1 else scale,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMapping:
    """Columns for some or all channels; others are found by their usual names.

    Attributes:
        channels: Columns by name of the channel.
        rate_hz: Samples/s of a file without time stamps; it replaces a time column.
        joints: Names of the robot's joints in the recording, in its order, by which
            signals are found and put in order; or one pattern that they fit, `left_*`.
        knowledge: Channels, units and layouts that are known.
        note: What else a user should hear of the recording.
    """

    channels: Mapping[str, ColumnSpec] = field(default_factory=dict)
    rate_hz: float | None = None
    joints: str | tuple[str, ...] = ()
    knowledge: Knowledge = field(
        default_factory=lambda: KNOWLEDGE, repr=False, compare=False
    )
    note: str = ""

    def __post_init__(self) -> None:
        """Check names, units and the rate, and write units as channels do.

        Raises:
            MappingError: One is not known, or they contradict each other.
        """
        if self.rate_hz is not None and not 0.0 < self.rate_hz <= sys.float_info.max:
            raise MappingError(f"rate_hz = {self.rate_hz!r:.60} must be positive")
        if self.rate_hz is not None and "time" in self.channels:
            raise MappingError(
                "both rate_hz and a time column are given, expected one of them"
            )
        if isinstance(self.joints, str):
            names = tuple(name.strip() for name in self.joints.split(","))
            object.__setattr__(self, "joints", names)
        if len(set(self.joints)) < len(self.joints):
            raise MappingError(f"joints = {list(self.joints)} names a joint twice")

        channels: dict[str, ColumnSpec] = {}
        for name, spec in self.channels.items():
            units = known_channel(name, self.knowledge).units
            asked = (spec.unit,) if isinstance(spec.unit, str) else spec.unit or ()
            found = tuple(units.find(unit) for unit in asked)
            if None in found:
                raise MappingError(
                    f"unit {spec.unit!r} of channel {name!r} is not known, expected: "
                    f"{', '.join(units)}"
                )

            unit = found[0] if isinstance(spec.unit, str) else found or None
            channels[name] = msgspec.structs.replace(spec, unit=unit)

        object.__setattr__(self, "channels", MappingProxyType(channels))

    def updated(self, other: "ColumnMapping") -> "ColumnMapping":
        """Return what another mapping says, and of this one what that does not say."""
        channels = {**self.channels, **other.channels}
        rate_hz = other.rate_hz
        if rate_hz is not None:
            channels.pop("time", None)
        elif "time" not in other.channels:
            rate_hz = self.rate_hz
        return replace(
            other,
            channels=channels,
            rate_hz=rate_hz,
            joints=other.joints or self.joints,
            note=other.note or self.note,
        )

    @property
    def joint_pattern(self) -> str:
        """The pattern that the joints' names fit; empty without one."""
        return self.joints[0] if len(self.joints) == 1 and "*" in self.joints[0] else ""

    @property
    def joint_order(self) -> tuple[str, ...]:
        """The joints, each by name; none where a pattern stands for them."""
        return () if self.joint_pattern else tuple(self.joints)

    @property
    def left_out(self) -> frozenset[str]:
        """The channels that are not to be read, although the file may have them."""
        return frozenset(
            name for name, spec in self.channels.items() if spec.patterns == (LEFT_OUT,)
        )


def known_channel(name: str, knowledge: Knowledge) -> Channel:
    """Return the channel of a name; `MappingError` if there is none."""
    if name not in knowledge.channels:
        raise MappingError(
            f"unknown channel {name!r}; channels are: {', '.join(knowledge.channels)}"
        )

    return knowledge.channels[name]


def mapping_of_layout(layout: Layout, knowledge: Knowledge) -> ColumnMapping:
    """Return what the columns of a layout are; `MappingError` if that is not valid."""
    content = {**layout.channels, "rate_hz": layout.rate_hz, "joints": layout.joints}
    note = f"{layout.name}: {layout.note}" if layout.note else ""
    try:
        return replace(_mapping_of(content, knowledge), note=note)
    except MappingError as error:
        raise MappingError(f"layout {layout.name!r}: {error}") from error


def _mapping_of(content: Mapping[str, Any], knowledge: Knowledge) -> ColumnMapping:
    """Return a mapping from content of TOML; `MappingError` if that is not valid."""
    top_keys = {"rate_hz", "joints"}
    channels: dict[str, ColumnSpec] = {}
    name = "$"
    try:
        top = {key: content[key] for key in top_keys & content.keys()}
        mapping = msgspec.convert(top, ColumnMapping)
        for name, entry in content.items():
            if name in top_keys:
                continue

            channel = known_channel(name, knowledge)
            if isinstance(entry, str):
                channels[name] = parse_column_spec(entry, channel)
            else:
                spec = entry if isinstance(entry, dict) else {"columns": entry}
                channels[name] = msgspec.convert(spec, ColumnSpec)
    except (msgspec.ValidationError, OverflowError) as error:
        raise MappingError(f"{name}: {error}") from error

    return replace(mapping, channels=channels, knowledge=knowledge)


def load_layouts(*paths: str | Path) -> Knowledge:
    """Return what is known of logs, with files of the form of `layouts.toml` added.

    Args:
        paths: TOML files; of two that say different things the later one counts.

    Raises:
        FileAccessError: One cannot be read.
        MappingError: One is not TOML, or has an entry that is not valid.
    """
    content = SHIPPED
    for path in paths:
        try:
            content = _merged(content, read_toml(path, "layout"))
            _convert(content)
        except (FormatError, msgspec.ValidationError) as error:
            raise MappingError(f"{path}: {error}") from error
    knowledge = _convert(content)
    # A layout may use channels that a later file defines.
    for layout in knowledge.layouts:
        mapping_of_layout(layout, knowledge)
    return knowledge


SHIPPED = tomllib.loads(Path(__file__).with_name("layouts.toml").read_text("utf-8"))
"""Content of the file of layouts that comes with the package."""

KNOWLEDGE = _convert(SHIPPED)
"""What is known without a user's files."""

CHANNELS: Mapping[str, Channel] = KNOWLEDGE.channels
"""Every channel by the name that mappings use."""


def load_mapping(path: str | Path, knowledge: Knowledge = KNOWLEDGE) -> ColumnMapping:
    """Read a column mapping from a TOML file.

    Each channel is a table with `columns` and, if needed, `unit` and `scale`, or only
    the columns (`depth = "z"`, also `depth = "z:mm:-1"`). At the top may stand
    `rate_hz` and `joints`, see `ColumnMapping`, and `payload`, which is for commands.

    Raises:
        FileAccessError: the file cannot be read.
        MappingError: it is not TOML, or a channel, key, unit or value in it is not
            valid.
    """
    try:
        content = read_toml(path, "mapping")
        content.pop("payload", None)
        return _mapping_of(content, knowledge)
    except (FormatError, MappingError) as error:
        raise MappingError(f"{path}: {error}") from error
