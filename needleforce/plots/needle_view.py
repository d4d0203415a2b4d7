"""How a needle sees the patient: directions of slices, and the sides they point to."""

from typing import NamedTuple

import numpy as np

from foundation.arrays import Array


class NeedleView(NamedTuple):
    """Directions of slices along and across a needle in the patient (LPS).

    Attributes:
        axis: Of the needle, shape (3,).
        side: Across it, shape (3,).
        up: To the head as far as it can be; to the back for a needle along the body.
    """

    axis: Array
    side: Array
    up: Array

    @classmethod
    def along(cls, axis: Array) -> "NeedleView":
        """Return the view along a direction in LPS, shape (3,)."""
        head = np.array([0.0, 0.0, 1.0])
        back = np.array([0.0, 1.0, 0.0])
        towards = back if abs(axis @ head) > 0.9 else head
        up = towards - (towards @ axis) * axis
        up = up / np.linalg.norm(up)
        return cls(axis, np.cross(axis, up), up)


def patient_side(direction: Array) -> str:
    """Return the letter of the patient's side that a direction mostly points to.

    Left, right, posterior, anterior, head or feet, as on the pictures of a scanner.

    Args:
        direction: In LPS, shape (3,).
    """
    largest = int(np.argmax(np.abs(direction)))
    letters = "LPH" if direction[largest] > 0.0 else "RAF"
    return letters[largest]
