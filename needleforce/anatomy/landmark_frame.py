"""Whether landmarks of the skin are in the frame of the CT, or with x and y negated.

RAS is LPS after half a turn about the axis from feet to head, so landmarks of the wrong
frame register as well, but with the patient turned over. The skin shows it, or, on a
body that is alike in front and back, names with a side and touches about the entry.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
    # Landmarks this near to the skin are in the right frame, as far as it shows.
    min_off_skin_m = 2e-3
    max_off_skin_m = 0.012  # landmarks of the skin lie nearer to it
    other_ct_m = 0.03  # so far, on average, are those of another CT
    off_m = _mean_distance_m(landmarks.points_m, landmarks.skin)
    other_m = _mean_distance_m(landmarks.points_m * RAS_TO_LPS, landmarks.skin)
    if off_m > max(min_off_skin_m, other_frame_ratio * other_m):
        raise _refusal(f"{1e3 * off_m:.1f} mm from the skin, then {1e3 * other_m:.1f}")
    if off_m > other_ct_m:
        raise RegistrationError(
            f"the landmarks lie {1e3 * off_m:.0f} mm from the skin on average, less "
            f"than {1e3 * other_ct_m:.0f} expected: they belong to another CT"
        )
    has_sides = _require_sides(landmarks)
    doubts, has_touches = _check_touches(landmarks)
    if off_m > max_off_skin_m:
        doubts.append(
            f"the landmarks lie {1e3 * off_m:.0f} mm from the skin of the CT on "
            "average: whether they belong to this CT is not verified"
        )
    is_shown_by_skin = other_m > max(min_off_skin_m, other_frame_ratio * off_m)
    if not (is_shown_by_skin or has_sides or has_touches):
        doubts.append(
            "whether the landmarks are in LPS is not verified: with x and y negated "
            "they lie on the skin too, and no name says left, right or navel"
        )
    return doubts


def _refusal(finding: str) -> RegistrationError:
    """Return the refusal for a finding."""
    return RegistrationError(
        f"the landmarks belong to the CT only with x and y negated ({finding}): the "
        "file says LPS and holds RAS, or the reverse; `--negate-xy` negates them"
    )


def _mean_distance_m(points_m: Array, skin: Surface) -> float:
    """Return the mean distance of points (n, 3) from the skin."""
    return float(np.linalg.norm(points_m - skin.nearest(points_m)[0], axis=1).mean())


def _require_sides(landmarks: SkinLandmarks) -> bool:
    """Refuse landmarks that do not lie on the sides that their names state.

    Returns:
        Whether any name states one.
    """
    min_side_m = 5e-3  # landmarks nearer to the middle of the body say nothing of sides
    places_m = landmarks.skin.vertices_m
    middle_m = 0.5 * (places_m.min(axis=0) + places_m.max(axis=0))
    aside_m = np.array(
        [
            (point_m - middle_m) @ SIDES[word]
            for name, point_m in zip(landmarks.names, landmarks.points_m, strict=False)
            for word in words_of(name) & SIDES.keys()
        ]
    )
    wrong = int((aside_m < -min_side_m).sum())
    right = int((aside_m > min_side_m).sum())
    if wrong and wrong >= right:
        raise _refusal(f"{wrong} lie on the other side than their names say")
    return right > 0


def _check_touches(landmarks: SkinLandmarks) -> tuple[list[str], bool]:
    """Refuse touches that lie about the entry only with x and y negated.

    Returns:
        That they lie far from it, if they do; and whether there are any.
    """
    far_from_entry_m = 0.15  # touches about the entry lie nearer to it
    # Touches are in the other frame if there they lie so much nearer to the entry:
    # errors of the first registration and the choice of places make less.
    min_nearer_m = 0.03
    nearer_ratio = 1.5  # far from the entry the distance alone shows little
    touches_m = landmarks.touches_m
    entry_m = landmarks.entry_m
    if touches_m is None or entry_m is None or not len(touches_m):
        return [], False
    off_m = float(np.median(np.linalg.norm(touches_m - entry_m, axis=1)))
    other = np.linalg.norm(touches_m * RAS_TO_LPS - entry_m, axis=1)
    other_m = float(np.median(other))
    if off_m > max(nearer_ratio * other_m, other_m + min_nearer_m):
        raise _refusal(
            f"the entry is {1e3 * off_m:.0f} mm from touches, then {1e3 * other_m:.0f}"
        )
    far = (
        f"half of the touches lie {1e3 * off_m:.0f} mm or more from the planned entry: "
        "whether they belong to this plan is not verified"
    )
    return [far] * (off_m > far_from_entry_m), True
