"""Whether structures lie in the body as anatomy has them: left, front, head.

It needs no scan: names alone say that the left kidney lies left of the right one, the
liver right of the spleen, a lung above the bladder, the spine behind the liver.
"""

import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import VolumeError
from needleforce.anatomy.structures import words_of

if TYPE_CHECKING:
    from needleforce.anatomy.labels import Labels

MIN_DISTANCE_m = 5e-3
"""Centroids closer than this say nothing."""

LEFT = 0
BACK = 1
HEAD = 2
"""Axes of LPS: x to the left, y to the back, z to the head."""

HEAD_TO_FOOT = (
    ("skull", "brain"),
    ("heart", "lung", "sternum"),
    ("liver", "spleen", "kidney", "pancreas"),
    ("bladder", "prostate", "sacrum", "hip"),
)
"""Words of structures from head to foot."""

FRONT = ("liver", "heart", "sternum", "stomach", "bladder")
"""Words of structures in front of the spine."""

SPINE = frozenset(("vertebra", "vertebrae", "spine", "sacrum"))

EXCHANGED = {
    LEFT: "left and right are exchanged (a mirrored array, or RAS taken as LPS)",
    BACK: "front and back are exchanged (an axis negated, or RAS taken as LPS)",
    HEAD: "head and feet are exchanged (an axis negated)",
}


class _Order(NamedTuple):
    """Two structures, and how they lie to each other.

    Attributes:
        first: Name of the one that lies further along the axis.
        second: Name of the other.
        axis: Of LPS.
        distance_m: By how much it does, negative where it does not.
    """

    first: str
    second: str
    axis: int
    distance_m: float

    @property
    def is_situs(self) -> bool:
        """Whether it is that of liver and spleen."""
        return {self.first, self.second} == {"liver", "spleen"} and self.axis == LEFT


def require_body_order(labels: "Labels", *, situs_inversus: bool = False) -> None:
    """Refuse labels whose structures lie the wrong way round.

    Args:
        labels: The segmentation, in LPS.
        situs_inversus: Liver and spleen of this patient are exchanged.

    Raises:
        VolumeError: Half the pairs of structures along an axis, or more, lie the wrong
            way round.
    """
    centroids_m = {
        item.anatomy.lower(): labels.centroid_m(item.name) for item in labels.structures
    }
    orders = [
        *_left_of_right(centroids_m),
        *_spleen_left_of_liver(centroids_m, situs_inversus=situs_inversus),
        *_head_above_foot(centroids_m),
        *_spine_behind(centroids_m),
    ]
    for axis, reason in EXCHANGED.items():
        along = [
            order
            for order in orders
            if order.axis == axis and abs(order.distance_m) > MIN_DISTANCE_m
        ]
        wrong = [order for order in along if order.distance_m < 0.0]
        if all(order.is_situs for order in wrong):
            continue  # judged below
        if wrong and 2 * len(wrong) >= len(along):
            _refuse(wrong, len(along), reason)
    _require_situs(orders, situs_inversus=situs_inversus)


def _refuse(wrong: list[_Order], count: int, reason: str) -> None:
    """Refuse labels, naming the pair that is furthest the wrong way round."""
    worst = min(wrong, key=lambda order: order.distance_m)
    where = ("left of", "behind", "above")[worst.axis]
    raise VolumeError(
        f"{worst.first} does not lie {where} {worst.second}, {len(wrong)} of {count} "
        f"such pairs of structures are wrong: {reason}",
        "Export labels and scan again with their directions; where the "
        "patient's organs are exchanged, state the situs inversus.",
    )


def _require_situs(orders: list[_Order], *, situs_inversus: bool) -> None:
    """Refuse liver and spleen on the wrong sides, whatever lies beside them."""
    for order in orders:
        if order.is_situs and order.distance_m < -MIN_DISTANCE_m:
            reason = EXCHANGED[LEFT] + ", or this is a situs inversus, to be stated"
            if situs_inversus:
                reason = "a situs inversus was stated, and this is none"
            raise VolumeError(
                f"{order.first} does not lie left of {order.second}: {reason}",
                "Export labels and scan again with their directions; where "
                "the patient's organs are exchanged, state the situs "
                "inversus.",
            )


def _left_of_right(centroids_m: Mapping[str, Array]) -> Iterator[_Order]:
    """Yield pairs of names that differ in left and right."""
    for name, centroid_m in centroids_m.items():
        if "left" in words_of(name):
            other = name.replace("left", "right")
            if other in centroids_m and other != name:
                distance_m = float(centroid_m[LEFT] - centroids_m[other][LEFT])
                yield _Order(name, other, LEFT, distance_m)


def _spleen_left_of_liver(
    centroids_m: Mapping[str, Array], *, situs_inversus: bool
) -> Iterator[_Order]:
    """Yield spleen and liver, or the reverse in a situs inversus."""
    if "liver" in centroids_m and "spleen" in centroids_m:
        left, right = ("liver", "spleen") if situs_inversus else ("spleen", "liver")
        distance_m = float(centroids_m[left][LEFT] - centroids_m[right][LEFT])
        yield _Order(left, right, LEFT, distance_m)


def _head_above_foot(centroids_m: Mapping[str, Array]) -> Iterator[_Order]:
    """Yield structures of which one lies nearer to the head, and vertebrae."""
    groups = [
        [name for name in centroids_m if words_of(name) & set(words) - {"gallbladder"}]
        for words in HEAD_TO_FOOT
    ]
    vertebrae = sorted(
        (number, name)
        for name in centroids_m
        if (number := _vertebra_number(name)) is not None
    )
    pairs = [
        (upper, lower)
        for k, group in enumerate(groups)
        for upper in group
        for below in groups[k + 1 :]
        for lower in below
    ]
    names = [name for _, name in vertebrae]
    pairs += list(pairwise(names))
    for upper, lower in pairs:
        distance_m = float(centroids_m[upper][HEAD] - centroids_m[lower][HEAD])
        yield _Order(upper, lower, HEAD, distance_m)


def _vertebra_number(name: str) -> int | None:
    """Return how many vertebrae lie above one by its name; None for others."""
    if not words_of(name) & SPINE:
        return None
    found = re.search(r"(?:^|[^a-z])([ctls])(\d+)", name.lower())
    if found is None:
        return None
    region, number = found.groups()
    # Above the first cervical, thoracic, lumbar and sacral one.
    above = {"c": 0, "t": 7, "l": 19, "s": 24}
    return above[region] + int(number)


def _spine_behind(centroids_m: Mapping[str, Array]) -> Iterator[_Order]:
    """Yield the spine and what lies in front of it."""
    spine = [name for name in centroids_m if words_of(name) & SPINE]
    if not spine:
        return
    for name, centroid_m in centroids_m.items():
        if not words_of(name) & set(FRONT):
            continue
        heights_m = [abs(centroids_m[one][HEAD] - centroid_m[HEAD]) for one in spine]
        nearest = spine[int(np.argmin(heights_m))]
        distance_m = float(centroids_m[nearest][BACK] - centroid_m[BACK])
        yield _Order(nearest, name, BACK, distance_m)
