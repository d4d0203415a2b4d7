"""Names that a user gives to the structures of a segmentation: ``--structures``."""

from collections.abc import Collection, Mapping
from pathlib import Path

from needleforce.anatomy import Labels
from needleforce.anatomy.structures import is_known
from needleforce.cli.terminal import CommandError

StructureNames = Path | Mapping[str, str] | None
"""A JSON file with names, or names by those in the segmentation."""

KINDS = (
    "bone, rib, cartilage, vertebra, lung, vessel, bowel, liver, kidney, spleen, "
    "muscle, fat, lesion, or soft, which a needle may pass"
)
"""Kinds that messages offer."""


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
        name, _, kind = (piece.strip() for piece in part.partition("="))
        if not name or not is_known(kind) or name in names:
            raise CommandError(
                f"--structures {text}: {part.strip()!r} is not NAME=KIND, with a name "
                f"that does not stand in it twice and a known kind: {KINDS}; a JSON "
                "file takes names that contain a comma"
            )
        names[name] = kind
    return names


def require_known_names(
    labels: Labels, confirmed: Collection[str], *, has_asked: bool
) -> None:
    """Refuse names that say nothing, of which nobody has said whether to pass them.

    Args:
        labels: The segmentation.
        confirmed: Names that the user has said something of.
        has_asked: Some structures were named that must stay clear; without any, one at
            least must be known as an obstacle or as one at risk.

    Raises:
        CommandError: There are such names; it lists them.
    """
    is_warned = {
        each.name: each.is_obstacle or each.is_risk for each in labels.structures
    }
    unknown = [
        item.name
        for item in labels.structures
        if not (is_warned[item.name] or is_known(item.anatomy))
        and item.name not in confirmed
    ]
    if not (any(is_warned.values()) or has_asked):
        unknown = unknown or list(is_warned)
    if unknown:
        raise CommandError(
            f"names that do not say what they are: {', '.join(unknown)}; expected for "
            "each --avoid NAME (must stay clear), --passable NAME (the needle may pass "
            f"it) or --structures {unknown[0]}=KIND, of {KINDS}"
        )
