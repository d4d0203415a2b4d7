"""The force at the tip as an arrow beside the needle, with its standard deviation."""

from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.scene.nodes import (
    Color,
    NeedlePose,
    rotation_of_axis,
)
from needleforce.scene.state_ring import ViewRow

BESIDE_M = 6e-3
"""The arrow stands so far beside the needle."""

ARROW_COLOR = Color(213, 94, 0)
BAND_COLOR = Color(120, 120, 120)


class ForceArrow:
    """The arrow; it points the way in which tissue pushes the tip.

    Args:
        server: Of the page.
    """

    def __init__(self, server: Any) -> None:
        points_m = np.zeros((1, 2, 3))
        head_length_m = 5e-3
        points_m[0, 1, 2] = head_length_m
        self._arrow = server.scene.add_arrows(
            "/force/arrow",
            points_m,
            ARROW_COLOR,
            shaft_radius=1.2e-3,
            head_radius=3e-3,
            head_length=head_length_m,
        )
        self._band = server.scene.add_line_segments(
            "/force/band",
            points=points_m.astype(np.float32),
            colors=BAND_COLOR,
            thickness=5.0,
            thickness_units="screen",
        )

    def show(self, row: ViewRow, needle: NeedlePose) -> None:
        """Show the tip force of a row with a band of two standard deviations."""
        # A smaller force has no arrow: it would be shorter than its head is wide.
        is_shown = bool(row.is_good) and abs(row.tip_N) >= 0.02
        self._arrow.visible = is_shown
        self._band.visible = is_shown
        if not is_shown:
            return
        side = rotation_of_axis(needle.axis)[:, 0]
        start_m = needle.tip_m + BESIDE_M * side
        ends_N = row.tip_N + 2.0 * row.tip_std_N * np.array([-1.0, 1.0])
        self._arrow.points = _along(start_m, needle.axis, 0.0, row.tip_N)
        beside_m = start_m + 0.5 * BESIDE_M * side
        self._band.points = _along(beside_m, needle.axis, ends_N[0], ends_N[1]).astype(
            np.float32
        )


def _along(start_m: Array, axis: Array, from_N: float, to_N: float) -> Array:
    """Return a segment that stands for forces against the needle, shape (1, 2, 3)."""
    m_per_N = 25e-3
    lengths_m = -m_per_N * np.array([from_N, to_N])
    return (start_m + lengths_m[:, None] * axis)[None]
