"""Structures of a segmentation, and what their names imply."""

import re
from dataclasses import dataclass

OBSTACLES = frozenset(
    [
        "bone",
        "bones",
        "rib",
        "ribs",
        "ribcage",
        "costal",
        "cartilage",
        "cartilages",
        "vertebra",
        "vertebrae",
        "vertebral",
        "spine",
        "sacrum",
        "coccyx",
        "hip",
        "femur",
        "patella",
        "tibia",
        "fibula",
        "sternum",
        "scapula",
        "scapulae",
        "clavicula",
        "clavicle",
        "humerus",
        "radius",
        "ulna",
        "pelvis",
        "skull",
        "cranium",
        "mandible",
        "maxilla",
        "manubrium",
        "xiphoid",
        "ilium",
        "ischium",
        "pubis",
        "calcaneus",
        "talus",
        "tooth",
        "teeth",
    ]
)
"""Words in the names of structures that stop a needle."""

RISKS = frozenset(
    [
        "lung",
        "pleura",
        "trachea",
        "heart",
        "atrial",
        "aorta",
        "artery",
        "arteries",
        "vein",
        "veins",
        "vena",
        "cava",
        "vessel",
        "vessels",
        "brachiocephalic",
        "bowel",
        "intestine",
        "duodenum",
        "colon",
        "rectum",
        "stomach",
        "esophagus",
        "oesophagus",
        "gallbladder",
        "bladder",
        "ureter",
        "cord",
        "nerve",
        "brain",
    ]
)
"""Words in the names of structures that a needle should keep away from."""

SOFT = frozenset(("renal", "kidney", "artery", "vein", "muscle", "nerve"))
"""Words beside which the words of obstacles do not count: a renal pelvis is no bone."""

PASSABLE = frozenset(("soft", "skin", "prostate", "thyroid", "breast"))
"""Words of what a needle may pass, without a colour of their own."""

SAYS_NOTHING = frozenset(("tissue", "organ", "structure"))
"""Words that say nothing where a name has no others."""

_COLOURS = {
    " ".join(sorted(OBSTACLES)): (241, 214, 145),
    "liver": (221, 130, 101),
    "spleen": (157, 108, 162),
    "kidney adrenal": (185, 102, 83),
    "gallbladder": (139, 150, 98),
    "stomach": (216, 132, 105),
    "pancreas": (249, 180, 111),
    "lung": (197, 165, 145),
    "aorta artery": (216, 101, 79),
    "vein vena cava vessel": (0, 151, 206),
    "bowel duodenum colon bladder": (205, 167, 142),
    "gluteus iliopsoas autochthon muscle lean": (192, 104, 88),
    "fat": (230, 220, 70),
    "body skin": (177, 122, 101),
    "lesion tumor tumour mass": (144, 238, 144),
}
"""By words in names; red, green, blue of 3D Slicer's table of generic anatomy."""

GOLDEN_RATIO = 0.618
"""Multiples of it, modulo one, lie far apart: no two numbers close by look alike."""

MAX_COLOUR = 255.0
"""Of the table above; colours of a structure are from 0 to 1."""


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
        words = _telling_words(name) | _telling_words(kind)
        colours = [
            colour for key, colour in _COLOURS.items() if words & set(key.split())
        ]
        colour = colours[0] if colours else _bluish(value)
        return cls(
            name=name,
            value=value,
            colour=tuple(number / MAX_COLOUR for number in colour),
            is_obstacle=bool(words & OBSTACLES),
            is_risk=bool(words & RISKS),
            volume=volume,
            kind=kind,
        )

    @property
    def anatomy(self) -> str:
        """What it is: its name, or its kind where the name says nothing known."""
        return self.name if is_known(self.name) or not self.kind else self.kind


def _bluish(number: int) -> tuple[float, ...]:
    """Return a colour for a structure whose name says nothing."""
    shade = (GOLDEN_RATIO * number) % 1.0
    return (90 + 150 * shade, 200 - 60 * shade, 240 - 150 * shade)


def words_of(name: str) -> set[str]:
    """Return the words of a structure's name, in small letters."""
    return set(re.split(r"[\W_]+", name.lower()))


def is_known(name: str) -> bool:
    """Return whether a name says what a structure is, in words that are known here."""
    words = words_of(name) - SAYS_NOTHING
    coloured = {word for key in _COLOURS for word in key.split()}
    return bool(words & (coloured | RISKS | SOFT | PASSABLE))


def _telling_words(name: str) -> set[str]:
    """Return the words of a name, without those of bone in names of soft tissue."""
    words = words_of(name)
    return words - OBSTACLES if words & SOFT else words
