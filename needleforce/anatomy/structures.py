"""Structures of a segmentation, and what their names imply."""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import NamedTuple

TABLE = "structures.csv"
"""Words in the names of structures, and what they imply.

Roles: `obstacle` stops a needle, from `risk` a needle should keep away, it may pass
what is `passable`, and `says nothing` counts only beside other words. Beside a word
that `is_soft` words of obstacles do not count: a renal pelvis is no bone. Colours are
red, green, blue of 3D Slicer's table of generic anatomy; of several the first counts.
"""


class _Words(NamedTuple):
    """What the words in names imply.

    Attributes:
        obstacles: Stop a needle.
        risks: A needle should keep away from them.
        soft: Beside them words of obstacles do not count.
        passable: A needle may pass them.
        says_nothing: Say nothing where a name has no others.
        colours: Red, green, blue by word; the first in a name counts.
    """

    obstacles: frozenset[str]
    risks: frozenset[str]
    soft: frozenset[str]
    passable: frozenset[str]
    says_nothing: frozenset[str]
    colours: Mapping[str, tuple[float, ...]]


def _read_words() -> _Words:
    """Read the table of words."""
    text = files("needleforce.anatomy").joinpath(TABLE).read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))

    def with_role(role: str) -> frozenset[str]:
        return frozenset(row["word"] for row in rows if row["role"] == role)

    return _Words(
        obstacles=with_role("obstacle"),
        risks=with_role("risk"),
        soft=frozenset(row["word"] for row in rows if row["is_soft"]),
        passable=with_role("passable"),
        says_nothing=with_role("says nothing"),
        colours={
            row["word"]: tuple(map(float, row["colour"].split()))
            for row in rows
            if row["colour"]
        },
    )


_WORDS = _read_words()


@dataclass(frozen=True)
class Structure:
    """One labelled structure of a segmentation.

    Attributes:
        name: As the segmentation has it.
        value: Of its voxels.
        colour: Red, green, blue from 0 to 1.
        is_obstacle: Bone or cartilage.
        is_risk: Lung, vessel, bowel and others that a needle should keep away from.
        volume: In which label volume it lies: segments that overlap need several.
        voxels: How many it has.
        box: Around its voxels, one slice per axis.
        kind: What coded terms of the file say that it is; empty where there are none.
    """

    name: str
    value: int
    colour: tuple[float, ...]
    is_obstacle: bool = False
    is_risk: bool = False
    volume: int = 0
    voxels: int = 0
    box: tuple[slice, ...] = ()
    kind: str = ""

    @classmethod
    def named(
        cls, name: str, value: int, volume: int = 0, kind: str = ""
    ) -> "Structure":
        """Return a structure with the colour and the hardness that its name implies.

        Args:
            name: Of the structure.
            value: Of its voxels.
            volume: In which label volume it lies.
            kind: What coded terms of the file say that it is; it is an obstacle, or at
                risk, if name or kind say so.
        """
        max_colour = 255.0  # of the table; colours of a structure are from 0 to 1
        words = _telling_words(name) | _telling_words(kind)
        colours = [colour for word, colour in _WORDS.colours.items() if word in words]
        colour = colours[0] if colours else _bluish(value)
        return cls(
            name=name,
            value=value,
            colour=tuple(number / max_colour for number in colour),
            is_obstacle=bool(words & _WORDS.obstacles),
            is_risk=bool(words & _WORDS.risks),
            volume=volume,
            kind=kind,
        )

    @property
    def anatomy(self) -> str:
        """What it is: its name, or its kind where the name says nothing known."""
        return self.name if is_known(self.name) or not self.kind else self.kind


def _bluish(number: int) -> tuple[float, ...]:
    """Return a colour for a structure whose name says nothing."""
    # Multiples of it, modulo one, lie far apart: no two numbers close by look alike.
    golden_ratio = 0.618
    shade = (golden_ratio * number) % 1.0
    return (90 + 150 * shade, 200 - 60 * shade, 240 - 150 * shade)


def words_of(name: str) -> set[str]:
    """Return the words of a structure's name, in small letters.

    They are divided by what is no letter, by digits, and by capitals behind small
    letters: ``RightRib9`` has the words right, rib and 9.
    """
    divided = re.sub(
        r"(?<=[^\W\d_])(?=\d)|(?<=\d)(?=[^\W\d_])|(?<=[a-z])(?=[A-Z])"
        r"|(?<=[A-Z])(?=[A-Z][a-z])",
        " ",
        name,
    )
    return set(re.split(r"[\W_]+", divided.lower()))


def is_known(name: str) -> bool:
    """Return whether a name says what a structure is, in words that are known here."""
    words = words_of(name)
    known = _WORDS.obstacles | _WORDS.risks | _WORDS.soft | _WORDS.passable
    return bool((words - _WORDS.says_nothing) & known)


def _telling_words(name: str) -> set[str]:
    """Return the words of a name, without those of bone in names of soft tissue."""
    words = words_of(name)
    return words - _WORDS.obstacles if words & _WORDS.soft else words
