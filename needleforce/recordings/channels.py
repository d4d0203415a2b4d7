"""The channels of a log, their units, and how their columns are found by name."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import islice
from math import pi
from typing import NamedTuple

import numpy as np

from needleforce.recordings.errors import ColumnError
from needleforce.recordings.table import Table

Units = Mapping[
    str, float
]  # Units that may stand in a file, with factors to SI; the first is SI

_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_ANGLE = {"rad": 1.0, "deg": pi / 180.0}
_ANGULAR_SPEED = {"rad/s": 1.0, "deg/s": pi / 180.0}
_TORQUE = {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2, "kNm": 1e3}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "inch": 0.0254}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6}
_FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": 4.4482216152605}
_CODE = {"1": 1.0}

# How people write the same unit; applied in this order.
_SPELLINGS = (
    ("µ", "u"),
    ("μ", "u"),
    ("°", "deg"),
    ("N·m", "Nm"),
    ("N.m", "Nm"),
    ("N*m", "Nm"),
)
_SPELLINGS += (("_per_", "/"), ("_", "/"))
_UNIT_PARTS = 3  # the longest unit in a name has so many parts: `mm_per_s`

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


@dataclass(frozen=True, slots=True)
class Channel:
    """One quantity of a log.

    Attributes:
        name: How mappings and options call it, such as `q`.
        key: In a `Log`, with the SI unit, such as `q_rad`.
        per_joint: One column per joint (2-D) rather than one value (1-D).
        spellings: Usual column names, without unit and number and in lower case.
        meaning: One phrase for help texts.
    """

    name: str
    key: str
    units: Units
    per_joint: bool
    spellings: tuple[str, ...]
    meaning: str

    @property
    def where(self) -> str:
        """Where a user says which columns it is; what only this package writes has
        no option.
        """
        option = f"with --{self.name.replace('_', '-')}, or "
        return f"{'' if self.name.startswith('force_') else option}under {self.name} in the mapping"

    @property
    def si_unit(self) -> str:
        """The SI unit of this channel."""
        return next(iter(self.units))


_JOINTS = (
    ("q", "q_rad", _ANGLE, "q position pos joint_position joint_positions actual_q",
     "joint positions"),
    ("dq", "dq_rad_s", _ANGULAR_SPEED,
     "dq qd qdot q_dot velocity vel joint_velocity joint_velocities actual_qd",
     "joint velocities"),
    ("tau", "tau_Nm", _TORQUE, "tau tau_j effort torque joint_torque joint_torques",
     "measured joint torques"),
    ("tau_ext", "tau_ext_Nm", _TORQUE,
     "tau_ext tau_external tau_ext_hat tau_ext_hat_filtered external_torque external_torques "
     "external_joint_torque external_joint_torques",
     "external joint torques as the robot estimates them"),
)  # fmt: skip
UNSMOOTHED = "axial_unsmoothed"
_SINGLE = (
    ("depth", "depth_m", _LENGTH, "depth z insertion_depth travel", "depth of the needle tip"),
    ("speed", "speed_m_s", _SPEED, "speed v insertion_speed", "rate of depth"),
    ("force", "force_N", _FORCE,
     f"force f fz f_z force_z axial {UNSMOOTHED} axial_force insertion_force",
     "axial force, positive when tissue pushes back"),
    ("force_std", "force_std_N", _FORCE, "force_std axial_std",
     "standard deviation of the force"),
    ("force_status", "force_status", _CODE, "force_status",
     "whether the force can be used, as `needleforce force` writes it"),
    ("force_warnings", "force_warnings", _CODE, "force_warnings",
     "what may be wrong with the force, as `needleforce force` writes it"),
)  # fmt: skip
_TIME_ROW = ("time", "t_s", _TIME, "t time timestamp time_stamp stamp", "time stamp")

CHANNELS = {
    name: Channel(name, key, units, rows is _JOINTS, tuple(spellings.split()), meaning)
    for rows in ((_TIME_ROW,), _JOINTS, _SINGLE)
    for name, key, units, spellings, meaning in rows
}
"""Every channel by the name that mappings use."""


def find_unit(text: str, units: Units) -> str | None:
    """Return the key of `units` that a text such as `mm/s`, `mm_s` or `µs` spells,
    or None.
    """
    unit = text.strip()
    for written, meant in _SPELLINGS:
        unit = unit.replace(written, meant)
    return unit if unit in units else None


# At most nine digits: longer numbers are no joint's, and counting up to them would take
# all memory.
_BRACKETED = re.compile(r"^(?P<stem>.*\S)\s*[\[(](?P<unit>[^\[\]()]+)[\])]$")
_NUMBERED = re.compile(
    r"^(?P<stem>.*?[^\d_.\[ ])(?P<mark>[_. ]?)\[?(?P<number>\d{1,9})\]?$"
)
_RANGE = re.compile(r"\{(?P<first>\d{1,9})\.\.(?P<last>\d{1,9})\}")
_ELEMENT = re.compile(r"^(?P<name>.+)\[(?P<index>\d{1,9})\]$")


class ColumnName(NamedTuple):
    """A column name taken apart.

    Attributes:
        stem: Lower case, without path, number and unit: `q` in `/robot/q_3_rad`.
        number: The trailing one (a joint's).
        unit: That the name carries.
    """

    stem: str
    family: (
        str  # the name with its number blanked; the columns of one signal have the same
    )
    number: int | None
    unit: str | None


def parse_column_name(name: str, units: Units) -> ColumnName:
    """Take a column name apart, reading as unit only a unit of the quantity looked for.

    Understands `q1`, `q_1`, `q[0]`, `q1_deg`, `q_deg_1`, `z [mm]`, `z (mm)`,
    `speed_mm_s` and a leading path such as `/joint_states/`.
    """
    rest, unit = split_unit(name.strip(), units)
    number = None
    family = name
    if match := _NUMBERED.match(rest):
        number = int(match["number"])
        start, end = match.span("number")
        family = name.replace(rest, f"{rest[:start]}#{rest[end:]}", 1)
        rest = match["stem"]
        if unit is None:
            rest, unit = split_unit(rest, units)
    return ColumnName(rest.rsplit("/", 1)[-1].strip().lower(), family, number, unit)


def split_unit(name: str, units: Units) -> tuple[str, str | None]:
    """Split a unit off the end of a name, as in `z [mm]` or `speed_mm_s`; None if it
    has none.
    """
    if (match := _BRACKETED.match(name)) and (unit := find_unit(match["unit"], units)):
        return match["stem"], unit
    for parts in range(_UNIT_PARTS, 0, -1):
        head, *tail = name.rsplit("_", parts)
        if len(tail) == parts and (unit := find_unit("_".join(tail), units)):
            return head, unit
    return name, None


Found = list[
    tuple[str, np.ndarray]
]  # names and values, in the file's unit, (n,) or (n, k)


def find_columns(table: Table, pattern: str) -> Found:
    """Return the columns that a name or pattern stands for.

    In this order: a column of exactly that name; `q{1..7}`, the numbers from 1 to 7;
    `q_*`, all columns with a number in that place; `wrench[2]`, one column (from 0) of
    a two-dimensional one; and `q_rad` for a family `q_rad_1`, `q_rad_2`, ... as this
    package writes it to CSV.

    Numbered ones come in the order of their numbers. `ColumnError` if there is no such
    column, or a number is missing in a family.
    """
    if pattern in table.columns:
        return [(pattern, table.columns[pattern])]
    if match := _RANGE.search(pattern):
        first = match["first"]
        last = match["last"]
        step = 1 if int(first) <= int(last) else -1
        width = len(first) * first.startswith("0")
        found: Found = []
        # One at a time: the first that is not there ends the search, however long the
        # range is.
        for number in range(int(first), int(last) + step, step):
            name = (
                f"{pattern[: match.start()]}{number:0{width}d}{pattern[match.end() :]}"
            )
            found += find_columns(table, name)
        return found
    if "*" in pattern:
        return _find_numbered(
            table, pattern, re.escape(pattern).replace(r"\*", r"(\d{1,9})", 1)
        )
    if match := _ELEMENT.match(pattern):
        values = table.columns.get(match["name"])
        index = int(match["index"])
        if values is None or values.ndim != 2:
            raise _not_found(table, pattern)
        if index >= values.shape[1]:
            what = f"column {match['name']!r} has the elements [0] to [{values.shape[1] - 1}]"
            raise ColumnError(f"{pattern!r}: {what}")
        return [(pattern, values[:, index])]
    return _find_numbered(
        table, pattern, rf"{re.escape(pattern)}[_. ]?\[?(\d{{1,9}})\]?"
    )


def _find_numbered(table: Table, pattern: str, expression: str) -> Found:
    numbered: dict[int, str] = {}
    for name in table.columns:
        match = re.fullmatch(expression, name)
        if match and (other := numbered.setdefault(int(match[1]), name)) != name:
            raise ColumnError(f"{pattern!r} fits both {other!r} and {name!r}; name one")
    if not numbered:
        raise _not_found(table, pattern)
    return _in_order(table, numbered, pattern)


def _in_order(table: Table, numbered: Mapping[int, str], pattern: str) -> Found:
    """Return a family of columns in the order of their numbers, which must follow
    each other.
    """
    ordered = sorted(numbered)
    numbers = range(ordered[0], ordered[-1])
    if missing := list(islice((n for n in numbers if n not in numbered), 5)):
        raise ColumnError(
            f"{pattern!r}: found the numbers {ordered[0]} to {ordered[-1]}, but not "
            f"{', '.join(map(str, missing))}; list the columns to use"
        )
    return [(numbered[number], table.columns[numbered[number]]) for number in ordered]


def _not_found(table: Table, pattern: str) -> ColumnError:
    """Return the error, with what may have been meant."""
    names = list(table.columns)
    hint = ""
    head, colon, unit = pattern.rpartition(":")
    with_unit = [
        name for name in names if re.match(rf"{re.escape(pattern)}\s*[\[(]\D", name)
    ]
    if "*" in pattern:
        hint = " The * stands for one number; all the rest of the name must be written out."
    elif colon and any(name.startswith(head) for name in names):
        hint = f" The unit {unit!r} is none of this channel's; --help lists them."
    elif close := with_unit or get_close_matches(pattern, names[:1000], n=1):
        hint = f" Did you mean {close[0]!r}?"
    reported = "".join(f" ({note})" for note in table.warnings if repr(pattern) in note)
    return ColumnError(
        f"no column {pattern!r}{reported}.{hint} Columns are: {table.describe()}"
    )


def detect_columns(table: Table, channel: Channel) -> Found:
    """Return the columns whose names say that they are this channel, in joint order, if
    any.

    `ColumnError` if several would fit, or a joint's column is missing.
    """
    named = {name: parse_column_name(name, channel.units) for name in table.columns}
    named = {
        name: parts for name, parts in named.items() if parts.stem in channel.spellings
    }
    candidates: dict[str, Found] = {}
    families: dict[str, dict[int, str]] = {}
    for name, parts in named.items():
        values = table.columns[name]
        if channel.per_joint and parts.number is not None and values.ndim == 1:
            families.setdefault(parts.family, {})[parts.number] = name
        elif channel.per_joint or values.shape[1:] in ((), (1,)):
            candidates[name] = [(name, values)]
    for family, numbered in families.items():
        candidates[family] = _in_order(table, numbered, family)
    if not channel.per_joint:
        plain = {
            name: c for name, c in candidates.items() if named[name].number is None
        }
        candidates = plain or candidates
        # `needleforce force` writes both; whoever filters further wants the one that is
        # not late.
        quick = {
            name: c for name, c in candidates.items() if named[name].stem == UNSMOOTHED
        }
        candidates = quick or candidates
    if len(candidates) > 1:
        raise ColumnError(
            f"{channel.name}: several columns would fit ({', '.join(candidates)}); say which one "
            f"{channel.where}"
        )
    return next(iter(candidates.values()), [])
