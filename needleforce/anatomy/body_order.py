"""Whether structures lie in the body as anatomy has them: left, front, head.

It needs no scan: names alone say that the left kidney lies left of the right one, the
liver right of the spleen, a lung above the bladder, the spine behind the liver.
"""

import re
from collections.abc import Iterator, Mapping
from itertools import permutations

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.segmentation import Segmentation
from needleforce.anatomy.structures import words_of

HEAD_TO_FOOT = (
    frozenset(("skull", "brain")),
    frozenset(("heart", "lung", "sternum")),
    frozenset(("liver", "spleen", "kidney", "pancreas")),
    frozenset(("bladder", "prostate", "sacrum", "hip")),
)
"""Words of structures from head to foot."""

FRONT = frozenset(("liver", "heart", "sternum", "stomach", "bladder"))
"""Words of structures in front of the spine."""

SPINE = frozenset(("vertebra", "vertebrae", "spine", "sacrum"))


def require_body_order(labels: Segmentation, *, situs_inversus: bool = False) -> None:
    """Refuse labels whose structures lie the wrong way round.

    Args:
        labels: The segmentation, in LPS.
        situs_inversus: Liver and spleen of this patient are exchanged.

    Raises:
        VolumeError: Half the pairs of structures along an axis, or more, lie the wrong
            way round, or liver and spleen do, whatever lies beside them.
    """
    min_distance_m = 5e-3  # centroids closer than this say nothing
    places_m = {
        item.anatomy.lower(): labels.centroid_m(item.name) for item in labels.structures
    }
    situs = ("liver", "spleen") if situs_inversus else ("spleen", "liver")
    pairs = set(_expected_pairs(places_m))
    if places_m.keys() >= {*situs}:
        pairs.add((0, situs[0], situs[1]))
    for axis, sides in enumerate(("left and right", "front and back", "head and feet")):
        gaps_m = {
            (first, other): float(places_m[first][axis] - places_m[other][axis])
            for of_axis, first, other in pairs
            if of_axis == axis
        }
        wrong = [names for names, gap_m in gaps_m.items() if gap_m < -min_distance_m]
        right = sum(gap_m > min_distance_m for gap_m in gaps_m.values())
        if situs in wrong or (wrong and len(wrong) >= right):
            raise VolumeError(
                f"{len(wrong)} of {right + len(wrong)} pairs of structures lie the "
                f"wrong way round, as {' and '.join(wrong[0])}: {sides} are exchanged "
                "(an axis negated, RAS taken as LPS), or the situs inversus is not "
                "what was stated"
            )


def _expected_pairs(places_m: Mapping[str, Array]) -> Iterator[tuple[int, str, str]]:
    """Yield an axis of LPS, and two names of which the first lies further along it."""
    backs = [name for name in places_m if words_of(name) & SPINE]
    for name, place_m in places_m.items():
        other = name.replace("left", "right")
        if "left" in words_of(name) and other in places_m:
            yield 0, name, other
        if backs and words_of(name) & FRONT:
            # The vertebra at its height.
            yield (
                1,
                min(backs, key=lambda one: abs(places_m[one][2] - place_m[2])),
                name,
            )
    ranks = {name: _rank(name) for name in places_m}
    vertebrae = {name: _vertebra(name) for name in places_m}
    for upper, lower in permutations(places_m, 2):
        is_higher = 0 < vertebrae[upper] < vertebrae[lower]
        if is_higher or ranks[upper] < ranks[lower]:
            yield 2, upper, lower


def _rank(name: str) -> float:
    """Return where a structure lies between head and foot; nan for others."""
    ranks = [rank for rank, one in enumerate(HEAD_TO_FOOT) if words_of(name) & one]
    return ranks[-1] if ranks else float("nan")


def _vertebra(name: str) -> int:
    """Return which vertebra is meant, counted from the head; 0 for others."""
    found = re.search(r"(?:^|[^a-z])([ctls])(\d+)", name)
    if found is None or not words_of(name) & SPINE:
        return 0
    # Above the first cervical, thoracic, lumbar and sacral one.
    return {"c": 0, "t": 7, "l": 19, "s": 24}[found[1]] + int(found[2])
