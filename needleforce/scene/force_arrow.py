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

M_PER_N = 25e-3
"""Length of the arrow per newton."""

BESIDE_M = 6e-3
"""The arrow stands so far beside the needle."""

SHAFT_RADIUS_M = 1.2e-3
HEAD_RADIUS_M = 3e-3
HEAD_LENGTH_M = 5e-3

ARROW_COLOR = Color(213, 94, 0)
BAND_COLOR = Color(120, 120, 120)
BAND_WIDTH = 5.0  # pixels

MIN_SHOWN_N = 0.02
"""A smaller force has no arrow."""


class ForceArrow:
    """The arrow; it points the way in which tissue pushes the tip.

    Args:
        server: Of the page.
    """

    def __init__(self, server: Any) -> None:
        points_m = np.zeros((1, 2, 3))
        points_m[0, 1, 2] = HEAD_LENGTH_M
        self._arrow = server.scene.add_arrows(
            "/force/arrow",
            points_m,
            ARROW_COLOR,
            shaft_radius=SHAFT_RADIUS_M,
            head_radius=HEAD_RADIUS_M,
            head_length=HEAD_LENGTH_M,
        )
        self._band = server.scene.add_line_segments(
            "/force/band",
            points=points_m.astype(np.float32),
            colors=BAND_COLOR,
            thickness=BAND_WIDTH,
            thickness_units="screen",
        )

    def show(self, row: ViewRow, needle: NeedlePose) -> None:
        """Show the tip force of a row with a band of two standard deviations."""
        is_shown = bool(row.is_good) and abs(row.tip_N) >= MIN_SHOWN_N
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
    lengths_m = -M_PER_N * np.array([from_N, to_N])
    return (start_m + lengths_m[:, None] * axis)[None]
