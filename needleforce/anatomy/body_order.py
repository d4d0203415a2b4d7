"""Whether structures lie in the body as anatomy has them: left, front, head.

It needs no scan: names alone say that the left kidney lies left of the right one, the
liver right of the spleen, a lung above the bladder, the spine behind the liver.
"""

import re
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import TYPE_CHECKING

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.structures import words_of

if TYPE_CHECKING:
    from needleforce.anatomy.labels import Labels

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


def require_body_order(labels: "Labels", *, situs_inversus: bool = False) -> None:
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
    pairs = set(_expected_pairs(places_m))
    if {"liver", "spleen"} <= places_m.keys():
        left, right = ("liver", "spleen") if situs_inversus else ("spleen", "liver")
        gap_m = places_m[left][0] - places_m[right][0]
        if gap_m < -min_distance_m:
            raise VolumeError(
                f"{left} does not lie left of {right}: left and right are "
                "exchanged, or the situs inversus is not what was stated"
            )
        if gap_m > min_distance_m:
            pairs.add((0, left, right))
    for axis, sides in enumerate(("left and right", "front and back", "head and feet")):
        gaps_m = [
            float(places_m[first][axis] - places_m[other][axis])
            for of_axis, first, other in pairs
            if of_axis == axis
        ]
        right = sum(gap_m > min_distance_m for gap_m in gaps_m)
        wrong = sum(gap_m < -min_distance_m for gap_m in gaps_m)
        if wrong and wrong >= right:
            raise VolumeError(
                f"{wrong} of {right + wrong} pairs of structures lie the wrong way "
                f"round: {sides} are exchanged (an axis negated, RAS taken as LPS)"
            )


def _expected_pairs(places_m: Mapping[str, Array]) -> Iterator[tuple[int, str, str]]:
    """Yield an axis of LPS, and two names of which the first lies further along it."""
    for name in places_m:
        other = name.replace("left", "right")
        if "left" in words_of(name) and other in places_m:
            yield 0, name, other
    ranks = {
        name: rank
        for rank, words in enumerate(HEAD_TO_FOOT)
        for name in places_m
        if words_of(name) & words
    }
    spine = {name: number for name in places_m if (number := _spine_number(name))}
    for above in (ranks, spine):
        for upper, lower in combinations(
            sorted(above, key=lambda name: above[name]), 2
        ):
            if above[upper] < above[lower]:
                yield 2, upper, lower
    backs = [name for name in places_m if words_of(name) & SPINE]
    fronts = [name for name in places_m if backs and words_of(name) & FRONT]
    for name in fronts:
        height_m = places_m[name][2]
        nearest = min(backs, key=lambda one: abs(places_m[one][2] - height_m))
        yield 1, nearest, name


def _spine_number(name: str) -> int:
    """Return which vertebra is meant, counted from the head; 0 for others."""
    found = re.search(r"(?:^|[^a-z])([ctls])(\d+)", name)
    if found is None or not words_of(name) & SPINE:
        return 0
    # Above the first cervical, thoracic, lumbar and sacral one.
    return {"c": 0, "t": 7, "l": 19, "s": 24}[found[1]] + int(found[2])
