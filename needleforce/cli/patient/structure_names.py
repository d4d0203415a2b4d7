"""Names that a user gives to the structures of a segmentation: ``--structures``."""

from collections.abc import Collection, Mapping
from pathlib import Path

from needleforce.anatomy import Labels
from needleforce.anatomy.structures import is_known
from needleforce.cli.terminal import CommandError

StructureNames = Path | Mapping[str, str] | None
"""A JSON file with names, or names by those in the segmentation."""

KINDS = (
    "bone",
    "rib",
    "cartilage",
    "vertebra",
    "lung",
    "vessel",
    "bowel",
    "liver",
    "kidney",
    "spleen",
    "muscle",
    "fat",
    "lesion",
    "soft",
)
"""Kinds that messages offer; `soft` is what a needle may pass."""


def parse_structures(text: str | None) -> StructureNames:
    """Return what ``--structures`` says: a file, or ``NAME=KIND,...``.

    Raises:
        CommandError: A part has no `=`, a name stands twice, or a kind is not known.
    """
    if text is None:
        return None
    if "=" not in text or Path(text).is_file():
        return Path(text)
    names: dict[str, str] = {}
    for part in text.split(","):
        name, equals, kind = (piece.strip() for piece in part.partition("="))
        if not (name and equals and kind):
            raise CommandError(
                f"--structures {text}: {part.strip()!r} is not NAME=KIND, with commas "
                "between several; a JSON file takes names that contain a comma"
            )
        if name in names:
            raise CommandError(f"--structures {text}: {name} stands in it twice")
        if not is_known(kind):
            raise CommandError(
                f"--structures {text}: {kind!r} is no known kind; expected one of "
                f"{', '.join(KINDS)}, or a name with such a word (rib_left_7)"
            )
        names[name] = kind
    return names


def require_known_names(labels: Labels) -> None:
    """Refuse a segmentation of which no structure is known by its name.

    Raises:
        CommandError: None is known as an obstacle or as one at risk.
    """
    if not any(item.is_obstacle or item.is_risk for item in labels.structures):
        raise CommandError(describe_unknown_names(labels))


def require_confirmed_names(labels: Labels, confirmed: Collection[str]) -> None:
    """Refuse names that say nothing, of which nobody has said whether to pass them.

    Args:
        labels: The segmentation.
        confirmed: Names that the user has said something of.

    Raises:
        CommandError: There are such names; it lists them.
    """
    unknown = [
        item.name
        for item in labels.structures
        if not (is_known(item.anatomy) or item.is_obstacle or item.is_risk)
        and item.name not in confirmed
    ]
    if unknown:
        raise CommandError(
            f"names that do not say what they are: {', '.join(unknown)}; expected for "
            "each --avoid NAME (must stay clear), --passable NAME (the needle may pass "
            f"it) or --structures {unknown[0]}=KIND"
        )


def describe_unknown_names(labels: Labels) -> str:
    """Return which names were found, and how they are mapped."""
    names = [item.name for item in labels.structures]
    unknown = [item.name for item in labels.structures if not is_known(item.anatomy)]
    text = (
        "no structure is known as bone, vessel or another at risk by its name: there "
        f"are {', '.join(names)}. "
    )
    if unknown:
        pairs = zip(unknown, KINDS, strict=False)
        example = ",".join(f"{name}={kind}" for name, kind in pairs)
        text += (
            "--structures NAME=KIND,... says what they are, as in --structures "
            f'"{example}", or a JSON file with names; '
        )
    return f"{text}--avoid names what must stay clear"
