"""Whether landmarks of the skin are in the frame of the CT, or with x and y negated.

RAS is LPS after half a turn about the axis from feet to head, so landmarks of the wrong
frame register as well, but with the patient turned over. The skin shows it, or, on a
body that is alike in front and back, names with a side and touches about the entry.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy.errors import TOUCH_LANDMARKS, RegistrationError
from needleforce.anatomy.markups import RAS_TO_LPS
from needleforce.anatomy.structures import words_of
from needleforce.anatomy.surface import Surface

MIN_NEARER_m = 0.03
"""Touches are in the other frame if there they lie so much nearer to the entry: errors
of the first registration and the choice of places make less."""


LEFT = np.array([1.0, 0.0, 0.0])
BACK = np.array([0.0, 1.0, 0.0])

SIDES = {
    "left": LEFT,
    "right": -LEFT,
    "xiphoid": -BACK,
    "sternum": -BACK,
    "navel": -BACK,
    "umbilicus": -BACK,
    "nipple": -BACK,
}
"""Directions in LPS of words in the names of landmarks."""


@dataclass(frozen=True, eq=False)
class SkinLandmarks:
    """Landmarks of the skin in the CT, and what shows in which frame they are.

    Attributes:
        points_m: As LPS, (n, 3).
        skin: Of the CT.
        names: Of the landmarks; those with a side, such as *left*, are compared with
            the body.
        touches_m: Touches of the skin around the entry, carried into the CT by these
            landmarks, (m, 3); none by default.
        entry_m: The planned entry, (3,) in LPS.
    """

    points_m: Array
    skin: Surface
    names: Sequence[str] = ()
    touches_m: Array | None = None
    entry_m: Array | None = None


def require_lps(landmarks: SkinLandmarks) -> list[str]:
    """Refuse landmarks that belong to the CT only with x and y negated.

    Returns:
        What is doubtful or could not be verified, in words.

    Raises:
        RegistrationError: So they lie nearer to the skin, on the sides that their names
            state, or the touches nearer to the planned entry; or they lie far from the
            skin either way.
    """
    # So much nearer to the skin they are in the right frame than in the wrong one.
    other_frame_ratio = 3.0
    # Landmarks so far from the skin, on average, are those of another CT.
    other_ct_m = 0.03
    max_off_skin_m = 0.012  # landmarks of the skin lie nearer to it
    # Landmarks this near to the skin are in the right frame, as far as it shows.
    min_off_skin_m = 2e-3
    off_m = _mean_distance_m(landmarks.points_m, landmarks.skin)
    other_m = _mean_distance_m(landmarks.points_m * RAS_TO_LPS, landmarks.skin)
    if off_m > max(min_off_skin_m, other_frame_ratio * other_m):
        raise _refusal(
            f"the landmarks lie {1e3 * off_m:.1f} mm from the skin of the CT on "
            f"average, and {1e3 * other_m:.1f} mm with x and y negated"
        )
    if off_m > other_ct_m:
        raise RegistrationError(
            f"the landmarks lie {1e3 * off_m:.0f} mm from the skin of the CT on "
            f"average, expected less than {1e3 * other_ct_m:.0f}: they belong to "
            "another CT, or to no points of the skin; give those of the plan's CT",
            TOUCH_LANDMARKS,
        )
    has_sides = _require_sides(landmarks)
    doubts = _check_touches(landmarks)
    if off_m > max_off_skin_m:
        doubts.append(
            f"the landmarks lie {1e3 * off_m:.0f} mm from the skin of the CT on "
            "average: whether they belong to this CT is not verified"
        )
    is_shown_by_skin = other_m > max(min_off_skin_m, other_frame_ratio * off_m)
    if not (is_shown_by_skin or has_sides or _has_touches(landmarks)):
        doubts.append(
            "whether the landmarks are in LPS is not verified: with x and y negated "
            "they lie on the skin too, and no name says left, right or navel"
        )
    return doubts


def _refusal(finding: str) -> RegistrationError:
    """Return the refusal for a finding."""
    cause = "the file says LPS and holds RAS, or the reverse"
    return RegistrationError(
        f"{finding}: {cause}; negate them (`needleforce register --negate-xy`)",
        TOUCH_LANDMARKS,
    )


def _mean_distance_m(points_m: Array, skin: Surface) -> float:
    """Return the mean distance of points (n, 3) from the skin."""
    nearest_m, _ = skin.nearest(points_m)
    return float(np.linalg.norm(points_m - nearest_m, axis=1).mean())


def _require_sides(landmarks: SkinLandmarks) -> bool:
    """Refuse landmarks that do not lie on the sides that their names state.

    Returns:
        Whether any name states one.
    """
    min_side_m = 5e-3  # landmarks nearer to the middle of the body say nothing of sides
    middle_m = 0.5 * (
        landmarks.skin.vertices_m.min(axis=0) + landmarks.skin.vertices_m.max(axis=0)
    )
    named = zip(landmarks.names, landmarks.points_m - middle_m, strict=False)
    aside_m = {
        f"{name!r}": float(offset_m @ SIDES[word])
        for name, offset_m in named
        for word in sorted(words_of(name) & SIDES.keys())
    }
    wrong = [name for name, one_m in aside_m.items() if one_m < -min_side_m]
    right = [name for name, one_m in aside_m.items() if one_m > min_side_m]
    if wrong and len(wrong) >= len(right):
        raise _refusal(
            f"landmarks {', '.join(wrong)} lie on the other side of the body than "
            "their names say"
        )
    return bool(right)


def _has_touches(landmarks: SkinLandmarks) -> bool:
    """Return whether there are touches and an entry."""
    touches_m = landmarks.touches_m
    return (
        touches_m is not None and len(touches_m) > 0 and landmarks.entry_m is not None
    )


def _check_touches(landmarks: SkinLandmarks) -> list[str]:
    """Refuse touches that lie about the entry only with x and y negated.

    Returns:
        That they lie far from it, if they do.
    """
    far_from_entry_m = 0.15  # touches about the entry lie nearer to it
    # Ratio of the two distances from the entry that touches of the other frame pass,
    # too: far from the entry `MIN_NEARER_m` alone shows little.
    nearer_ratio = 1.5
    touches_m = landmarks.touches_m
    entry_m = landmarks.entry_m
    if touches_m is None or entry_m is None or not len(touches_m):
        return []
    off_m = float(np.median(np.linalg.norm(touches_m - entry_m, axis=1)))
    other = np.linalg.norm(touches_m * RAS_TO_LPS - entry_m, axis=1)
    other_m = float(np.median(other))
    if off_m > max(nearer_ratio * other_m, other_m + MIN_NEARER_m):
        raise _refusal(
            f"by the landmarks half of the touches lie {1e3 * off_m:.0f} mm or more "
            f"from the planned entry, and {1e3 * other_m:.0f} mm with x and y negated"
        )
    if off_m > far_from_entry_m:
        return [
            f"half of the touches lie {1e3 * off_m:.0f} mm or more from the planned "
            "entry: whether they belong to this plan is not verified"
        ]
    return []
