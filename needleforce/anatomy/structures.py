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
        "mandible",
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
        "duodenum",
        "colon",
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
    """

    name: str
    value: int
    colour: tuple[float, ...]
    is_obstacle: bool = False
    is_risk: bool = False
    volume: int = 0
    voxels: int = 0
    box: tuple[slice, ...] = ()

    @classmethod
    def named(cls, name: str, value: int, volume: int = 0) -> "Structure":
        """Return a structure with the colour and the hardness that its name implies."""
        words = words_of(name)
        if words & SOFT:
            words -= OBSTACLES
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
        )


def _bluish(number: int) -> tuple[float, ...]:
    """Return a colour for a structure whose name says nothing."""
    shade = (GOLDEN_RATIO * number) % 1.0
    return (90 + 150 * shade, 200 - 60 * shade, 240 - 150 * shade)


def words_of(name: str) -> set[str]:
    """Return the words of a structure's name, in small letters."""
    return set(re.split(r"[\W_]+", name.lower()))
