"""Channels that insertions have cut, and how a needle finds and contradicts them."""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from identification.channel import ChannelFriction, count_depth_from
from identification.identifier import Snapshot as IdentifierSnapshot
from needleforce.tip_travel import TipTravel, TravelZero

NEEDLE_DIAMETER_M = 1.27e-3
"""Outer diameter of a needle of 18 gauge: as far aside its channel is met."""


MIN_LENGTH_M = 3e-3
"""Length of a channel, at least; a touch leaves none."""


EXCESS_TRAVEL_M = 1e-3
"""Travel over which the force in a channel is averaged, against noise and texture."""


class ChannelState(Enum):
    """Whether an insertion goes on in a channel that an earlier one has cut."""

    FRESH = "no earlier channel here"
    REMEMBERED = "in an earlier channel: no tip force in front of its end"
    CONTRADICTED = (
        "more force than the friction of the earlier channel, which is forgotten: the "
        "tissue has moved, or is another"
    )


class NeedleChannel(NamedTuple):
    """A channel that the needle has cut.

    Attributes:
        entry: Place of first contact and direction of the needle there, base axes.
        length_m: From the entry to the deepest point.
        entry_depth_m: Depth of the entry, as depth counted when it was cut.
        left_s: Time when it was left, see `SessionEstimate.time_s`.
        identifier: What was known then: friction, layers, depth.
    """

    entry: TravelZero
    length_m: float
    entry_depth_m: float
    left_s: float
    identifier: IdentifierSnapshot


class OldChannel(NamedTuple):
    """The channel that an insertion goes on in, as its force confirms it.

    Attributes:
        begin_m: Depth of its entry.
        end_m: Depth of its end.
        friction: How well its friction is known.
        in_air_s: Time at which the needle came to it.
        in_air: What was known then, without the channel.
        checked_m: Depth up to which the force has been compared with the friction.
        force_std_in_air_N: Standard deviation of the force in front of the entry; 0
            where the needle has not been there. The force in free air is measured
            there, so that only what the deviation grows by afterwards counts.
        excess_N: Mean force beyond the friction, over the last `EXCESS_TRAVEL_M`.
    """

    begin_m: float
    end_m: float
    friction: ChannelFriction
    in_air_s: float
    in_air: IdentifierSnapshot
    checked_m: float
    force_std_in_air_N: float = 0.0
    excess_N: float = 0.0

    def with_depths_moved(self, by_m: float) -> "OldChannel":
        """Return the channel with depths that count from another zero."""
        return self._replace(
            begin_m=self.begin_m + by_m,
            end_m=self.end_m + by_m,
            checked_m=self.checked_m + by_m,
            in_air=count_depth_from(self.in_air, by_m),
        )

    def compared(
        self, travel: TipTravel, excess_N: float, force_std_N: float
    ) -> "OldChannel":
        """Return the channel with one force more that was compared.

        Only an advance within it counts: then friction has one direction, and the tip
        touches nothing.

        Args:
            travel: Of the tip, delayed as the force is.
            excess_N: Axial force less the friction of the channel.
            force_std_N: Standard deviation of the force.
        """
        # Length at a channel's end in which the tip may meet tissue already: the depth
        # of the end is as uncertain, and the last millimetre counts as cut anew
        uncertain_m = 2e-3
        depth_m = travel.delayed_depth_m
        if depth_m <= self.begin_m:
            return self._replace(force_std_in_air_N=force_std_N)
        advance_m = depth_m - self.checked_m
        if advance_m <= 0.0 or depth_m > self.end_m - uncertain_m:
            return self
        weight = -math.expm1(-advance_m / EXCESS_TRAVEL_M)
        mean_N = self.excess_N + weight * (excess_N - self.excess_N)
        return self._replace(checked_m=depth_m, excess_N=mean_N)

    def is_contradicted(
        self,
        speed_m_s: float,
        friction_N: float,
        force_std_N: float,
        noise_std_N: float,
    ) -> bool:
        """Return whether the force is larger than the friction of the channel allows.

        Args:
            speed_m_s: Speed of the tip.
            friction_N: Friction that the channel predicts.
            force_std_N: Standard deviation of the force.
            noise_std_N: Standard deviation of its noise, which the wander of a mean is
                no larger than.
        """
        # What rubs again rubs otherwise by so much of it, one standard deviation
        friction_change_fraction = 0.1
        # Deviations above the channel's friction at which the force contradicts it
        excess_sigmas = 3.0
        variance_N2 = (
            max(force_std_N**2 - self.force_std_in_air_N**2, 0.0)
            + noise_std_N**2
            + self.friction.variance_at(speed_m_s)
            + (friction_change_fraction * friction_N) ** 2
        )
        return self.excess_N > excess_sigmas * math.sqrt(variance_N2)


def find_channel(
    channels: tuple[NeedleChannel, ...], needle: TravelZero
) -> NeedleChannel | None:
    """Return the channel that the needle is in, or comes to; the newest, None if none.

    Its line has to meet that of the channel, within a diameter at entry and end.

    Args:
        channels: Those remembered.
        needle: Where the tip is now, and the needle's direction.
    """
    # Distance from the tip to a channel's entry at which it is recognised: less than
    # the retreat that ends an insertion, so that the force in free air is measured
    # before
    ahead_m = 2e-3
    # Cosine of an angle that counts as a right one: the lines then miss each other
    min_cosine = 1e-3
    tip_m, direction = needle
    for channel in reversed(channels):
        entry_m, axis = channel.entry
        beside_m = tip_m - entry_m
        height_m = float(axis.dot(beside_m))
        if not -ahead_m <= height_m <= channel.length_m:
            continue
        slope = direction / max(float(axis.dot(direction)), min_cosine)
        to_entry_m = beside_m - height_m * slope
        to_end_m = to_entry_m + channel.length_m * (slope - axis)
        misses_m = np.linalg.norm([to_entry_m, to_end_m], axis=1)
        if misses_m.max() <= NEEDLE_DIAMETER_M:
            return channel
    return None


def add_channel(
    channels: tuple[NeedleChannel, ...], new: NeedleChannel
) -> tuple[NeedleChannel, ...]:
    """Return the channels with a new one, which replaces the one it went on in."""
    # Channels that are remembered; each is half a megabyte of a snapshot
    max_channels = 8
    kept = remove_channel(channels, new.entry, new.length_m)
    return (*kept, new)[-max_channels:]


def remove_channel(
    channels: tuple[NeedleChannel, ...], entry: TravelZero, length_m: float
) -> tuple[NeedleChannel, ...]:
    """Return the channels without those of one entry and direction.

    Args:
        channels: Those remembered.
        entry: Place and direction of the ones to remove.
        length_m: Length over which they have to agree, at most.
    """
    return tuple(
        channel
        for channel in channels
        if not _is_same(channel.entry, entry, min(channel.length_m, length_m))
    )


def _is_same(one: TravelZero, other: TravelZero, length_m: float) -> bool:
    """Return whether two lines agree within a diameter, at the beginning and end."""
    entry_m = one.start_in_base_m - other.start_in_base_m
    end_m = entry_m + length_m * (one.axis_in_base - other.axis_in_base)
    misses_m = np.linalg.norm([entry_m, end_m], axis=1)
    return bool(misses_m.max() <= NEEDLE_DIAMETER_M)
