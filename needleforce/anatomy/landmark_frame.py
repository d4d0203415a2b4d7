"""Whether landmarks of the skin are in the frame of the CT, or with x and y negated.

RAS is LPS after half a turn about the axis from feet to head, so landmarks of the wrong
frame register as well, but with the patient turned over. The skin shows it, or, on a
body that is alike in front and back, names with a side and touches about the entry.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.anatomy.errors import RegistrationError
from needleforce.anatomy.markups import RAS_TO_LPS
from needleforce.anatomy.structures import words_of
from needleforce.anatomy.surface import Surface

SIDES = {
    "left": np.array([1.0, 0.0, 0.0]),
    "right": np.array([-1.0, 0.0, 0.0]),
    **dict.fromkeys(
        ("xiphoid", "sternum", "navel", "umbilicus", "nipple"),
        np.array([0.0, -1.0, 0.0]),
    ),
}
"""Directions in LPS of words in the names of landmarks."""


def require_lps(
    points_m: Array,
    skin: Surface,
    names: Sequence[str] = (),
    *,
    touches_m: ArrayLike = (),
    entry_m: Array | None = None,
) -> list[str]:
    """Refuse landmarks that belong to the CT only with x and y negated.

    Args:
        points_m: Landmarks of the skin as LPS, (n, 3).
        skin: Of the CT.
        names: Of the landmarks; those with a side, such as *left*, are compared with
            the body.
        touches_m: Touches of the skin around the entry, carried into the CT by these
            landmarks, (m, 3).
        entry_m: The planned entry, (3,) in LPS, with which touches are compared.

    Returns:
        What is doubtful or could not be verified, in words.

    Raises:
        RegistrationError: So they lie nearer to the skin, on the sides that their names
            state, or the touches nearer to the planned entry; or they lie far from the
            skin either way.
    """
    # So much nearer to the skin they are in the right frame than in the wrong one.
    other_frame_ratio = 3.0
    # Landmarks this near to the skin are in the right frame, as far as it shows.
    min_off_skin_m = 2e-3
    max_off_skin_m = 0.012  # landmarks of the skin lie nearer to it
    other_ct_m = 0.03  # so far, on average, are those of another CT
    far_from_entry_m = 0.15  # touches about the entry lie nearer to it
    off_m, other_m = (
        np.linalg.norm(one_m - skin.nearest(one_m)[0], axis=1).mean()
        for one_m in (points_m, points_m * RAS_TO_LPS)
    )
    if off_m > max(min_off_skin_m, other_frame_ratio * other_m):
        raise _refusal(f"{1e3 * off_m:.1f} mm from the skin, then {1e3 * other_m:.1f}")
    if off_m > other_ct_m:
        raise RegistrationError(
            f"the landmarks lie {1e3 * off_m:.0f} mm from the skin on average, less "
            f"than {1e3 * other_ct_m:.0f} expected: they belong to another CT"
        )
    has_sides = _require_sides(points_m, skin, names)
    off_entry_m = _require_touches(np.asarray(touches_m), entry_m)
    is_shown_by_skin = other_m > max(min_off_skin_m, other_frame_ratio * off_m)
    is_shown = is_shown_by_skin or has_sides or np.isfinite(off_entry_m)
    doubts = {
        f"half of the touches lie {1e3 * off_entry_m:.0f} mm or more from the planned "
        "entry: whether they belong to this plan": off_entry_m > far_from_entry_m,
        f"the landmarks lie {1e3 * off_m:.0f} mm from the skin of the CT on average: "
        "whether they belong to this CT": off_m > max_off_skin_m,
        "whether the landmarks are in LPS, as with x and y negated they lie on the "
        "skin too, and no name says left, right or navel,": not is_shown,
    }
    return [f"{what} is not verified" for what, is_open in doubts.items() if is_open]


def _refusal(finding: str) -> RegistrationError:
    """Return the refusal for a finding."""
    return RegistrationError(
        f"the landmarks belong to the CT only with x and y negated ({finding}): the "
        "file says LPS and holds RAS, or the reverse; `--negate-xy` negates them"
    )


def _require_sides(points_m: Array, skin: Surface, names: Sequence[str]) -> bool:
    """Refuse landmarks that do not lie on the sides that their names state.

    Returns:
        Whether any name states one.
    """
    min_side_m = 5e-3  # landmarks nearer to the middle of the body say nothing of sides
    middle_m = 0.5 * (skin.vertices_m.min(axis=0) + skin.vertices_m.max(axis=0))
    aside_m = [
        (point_m - middle_m) @ SIDES[word]
        for name, point_m in zip(names, points_m, strict=False)
        for word in words_of(name) & SIDES.keys()
    ]
    wrong = sum(one_m < -min_side_m for one_m in aside_m)
    right = sum(one_m > min_side_m for one_m in aside_m)
    if wrong and wrong >= right:
        raise _refusal(f"{wrong} lie on the other side than their names say")
    return right > 0


def _require_touches(touches_m: Array, entry_m: Array | None) -> float:
    """Refuse touches that lie about the entry only with x and y negated.

    Returns:
        How far they lie from it, in the median; nan where there are none.
    """
    # Touches are in the other frame if there they lie so much nearer to the entry:
    # errors of the first registration and the choice of places make less.
    min_nearer_m = 0.03
    nearer_ratio = 1.5  # far from the entry the distance alone shows little
    if entry_m is None or not len(touches_m):
        return float("nan")
    off_m, other_m = (
        float(np.median(np.linalg.norm(one_m - entry_m, axis=1)))
        for one_m in (touches_m, touches_m * RAS_TO_LPS)
    )
    if off_m > max(nearer_ratio * other_m, other_m + min_nearer_m):
        raise _refusal(
            f"the entry is {1e3 * off_m:.0f} mm from touches, then {1e3 * other_m:.0f}"
        )
    return off_m
