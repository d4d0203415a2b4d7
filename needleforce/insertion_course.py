"""Where an insertion begins and ends, from the needle's place alone.

In free air a turn, a retreat followed by an advance, or a move aside ends an insertion;
a move aside that no tissue allows ends it anywhere.
"""

import math
from typing import NamedTuple

from foundation.arrays import Vector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import dot
from identification.channel import count_depth_from
from identification.estimate import LayerEstimate
from needleforce.needle_channels import NEEDLE_DIAMETER_M, ChannelState, OldChannel
from needleforce.tip_travel import (
    Needle,
    TravelZero,
    place_beside_line,
    place_tip,
    tip_speed,
)

MAX_TURN_COSINE = math.cos(math.radians(3.0))
"""Cosine of the turn in free air from which on depth counts along the new axis: its
projection on the old one is off by a part in a thousand there."""


LEFT_M = 1.5 * NEEDLE_DIAMETER_M
"""Distance from its channel from which on the needle in free air has left it: more than
that within which it meets one, lest it alternates."""

FAR_TURN_RAD = math.radians(20.0)
"""Turn that no needle does in tissue."""

FAR_TURN_COSINE = math.cos(FAR_TURN_RAD)
"""Cosine of that turn."""

ASIDE_M = 3e-3
"""Move aside that begins another approach, and that no needle does in tissue, ..."""

ASIDE_PER_TRAVEL = math.tan(FAR_TURN_RAD)
"""... unless it is no more than such a turn about the entry makes of the travel."""


class InsertionProgress(NamedTuple):
    """Course of an insertion, from the approach on.

    Attributes:
        line: Place of the tip and direction of the needle when tissue was met; before,
            where the approach began.
        line_depth_m: Depth of that place.
        is_met: Whether tissue has been met.
        deepest_m: Largest depth so far.
        highest_m: Smallest depth since the deepest point.
        layers_before: Layers of the insertion before, which are reported until tissue
            is met.
        channel_state: Whether it goes on in an earlier channel.
        channel: That channel; None where there is none.
    """

    line: TravelZero
    line_depth_m: float = 0.0
    is_met: bool = False
    deepest_m: float = 0.0
    highest_m: float = 0.0
    layers_before: tuple[LayerEstimate, ...] = ()
    channel_state: ChannelState = ChannelState.FRESH
    channel: OldChannel | None = None

    def moved_to(self, depth_m: float) -> "InsertionProgress":
        """Return the course with the tip at a depth."""
        if depth_m > self.deepest_m:
            return self._replace(deepest_m=depth_m, highest_m=depth_m)
        if depth_m < self.highest_m:
            return self._replace(highest_m=depth_m)
        return self

    def has_retreated(self, depth_m: float, contact_m: float | None) -> bool:
        """Return whether the needle has gone back in free air and advances again.

        Args:
            depth_m: Depth of the tip.
            contact_m: Depth of first contact; None where tissue has not been met.
        """
        # Advance after a retreat with which the next approach begins
        advance_m = 0.5e-3
        # Retreat in free air that ends an insertion or an approach: more than tissue
        # rises with the needle that leaves it
        retreat_m = 3e-3
        last_m = self.deepest_m if contact_m is None else contact_m
        is_back = self.highest_m < last_m - retreat_m
        return is_back and depth_m > self.highest_m + advance_m

    def with_depths_moved(self, by_m: float) -> "InsertionProgress":
        """Return the same course with depths that count from another zero."""
        channel = self.channel
        if channel is not None:
            channel = channel._replace(
                begin_m=channel.begin_m + by_m,
                end_m=channel.end_m + by_m,
                checked_m=channel.checked_m + by_m,
                in_air=count_depth_from(channel.in_air, by_m),
            )
        return self._replace(
            line_depth_m=self.line_depth_m + by_m,
            deepest_m=self.deepest_m + by_m,
            highest_m=self.highest_m + by_m,
            channel=channel,
        )


@compiled_inside
def has_moved_aside(height_m: float, aside_m: float, cosine: float) -> bool:
    """Return whether the needle has moved as none does in tissue.

    Args:
        height_m: From the beginning of its line to the tip, along the line.
        aside_m: Distance of the tip from the line.
        cosine: Of the angle between the line and the needle.
    """
    largest_m = max(ASIDE_M, ASIDE_PER_TRAVEL * abs(height_m))
    return aside_m > largest_m or cosine < FAR_TURN_COSINE


NeedleMotion = tuple[float, float, bool, bool, bool]
"""What `follow_needle` returns: a plain tuple, which its one caller unpacks at once; a
named one would cost it a microsecond."""


@compiled
def follow_needle(
    axis: Vector, line_start: Vector, line_axis: Vector, needle: Needle, dq: Vector
) -> NeedleMotion:
    """Return how the needle moves, and whether it has left the line of its insertion.

    Args:
        axis: Direction of depth in base axes, length one, shape (3,).
        line_start: Beginning of the line in the base [m], shape (3,).
        line_axis: Direction of the line in base axes, length one, shape (3,).
        needle: `residual.ToolKinematics.needle`.
        dq: Joint velocities [rad/s], shape (n,).

    Returns:
        Position of the tip along the direction of depth [m]; its speed along the needle
        [m/s]; whether the needle has turned away from the direction of depth; whether
        it `has_moved_aside`; whether the tip is beside its channel.
    """
    tip = place_tip(needle)
    place = place_beside_line(tip, line_start, line_axis)
    return (
        dot(axis, tip.position_m),
        tip_speed(tip, needle, dq),
        dot(axis, tip.direction) < MAX_TURN_COSINE,
        has_moved_aside(place.height_m, place.aside_m, place.cosine),
        place.aside_m > LEFT_M,
    )
