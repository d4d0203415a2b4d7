"""Going on in a channel that the needle has cut before.

What an identifier knew when the needle left its channel holds for the next insertion
into it: the friction along the channel, its layers, and how deep it is. In front of
its end the tip touches nothing.
"""

import math
from dataclasses import replace
from typing import NamedTuple

from identification.identifier import Snapshot
from identification.mixture.block import MM_PER_M
from identification.mixture.force_model import MEMBRANE, OFFSET, Assumptions
from identification.mixture.method import MixtureMethodState
from identification.published.online import PublishedState
from identification.sample_check import CheckState
from identification.travel_filter import TravelState


class ChannelFriction(NamedTuple):
    """Uncertainty of the friction along a channel, c + v s at the speed s.

    Attributes:
        coulomb_variance_N2: Variance of c.
        covariance: Covariance of c and v [N²/(mm/s)].
        viscous_variance: Variance of v [N²/(mm/s)²].
        offset_variance_N2: Variance of the force in free air.
    """

    coulomb_variance_N2: float
    covariance: float
    viscous_variance: float
    offset_variance_N2: float

    def variance_at(self, speed_m_s: float) -> float:
        """Return the variance of friction and force in free air at a speed [N²]."""
        speed_mm_s = MM_PER_M * speed_m_s
        viscous = speed_mm_s * (2.0 * self.covariance)
        viscous += speed_mm_s**2 * self.viscous_variance
        return max(self.coulomb_variance_N2 + viscous + self.offset_variance_N2, 0.0)


def has_cut(snapshot: Snapshot) -> bool:
    """Return whether the needle has cut tissue, and not only pushed a membrane.

    It is never known of the published method.
    """
    state = snapshot.state
    if not isinstance(state, MixtureMethodState) or not state.posterior.in_contact:
        return False
    _, _, log_weights, assumptions, _ = state.mixture
    likeliest = Assumptions(*assumptions[log_weights.argmax()].tolist())
    return likeliest.medium != MEMBRANE or likeliest.ruptures > 0.0


def read_friction(channel: Snapshot) -> ChannelFriction | None:
    """Return how well the friction along a channel is known, None if it is not at all.

    Args:
        channel: State of the identifier when the needle left the channel.
    """
    state = channel.state
    if not isinstance(state, MixtureMethodState):
        return None
    shaft = state.posterior.shaft
    return ChannelFriction(
        coulomb_variance_N2=shaft.coulomb_variance,
        covariance=shaft.covariance,
        viscous_variance=shaft.viscous_variance,
        offset_variance_N2=state.posterior.offset_variance,
    )


def count_depth_from(snapshot: Snapshot, moved_m: float) -> Snapshot:
    """Return a state whose depths count from another zero.

    Args:
        snapshot: State of an identifier.
        moved_m: Depth of a place from the new zero less its depth from the old one.
    """
    check = replace(
        snapshot.check,
        depth_m=snapshot.check.depth_m + moved_m,
        removed_m=snapshot.check.removed_m + moved_m,
    )
    return snapshot._replace(check=check, last=snapshot.last.without_events())


def continue_channel(
    channel: Snapshot, present: Snapshot, moved_m: float, passed_s: float
) -> Snapshot:
    """Return the state of an identifier in front of a channel that it knows.

    Args:
        channel: State when the needle left the channel.
        present: State in free air, in front of the channel: gives the force there.
        moved_m: Depth of a place now less its depth then: depth counts from elsewhere.
        passed_s: Time since the needle left the channel.
    """
    return channel._replace(
        check=CheckState(
            time_s=channel.check.time_s + passed_s,
            usual_dt_s=present.check.usual_dt_s,
            removed_m=channel.check.removed_m + moved_m,
        ),
        travel=TravelState(),
        state=_with_offset(channel, present),
        last=channel.last.without_events(),
    )


def _with_offset(
    channel: Snapshot, present: Snapshot
) -> PublishedState | MixtureMethodState:
    """Return a channel's state with the force in free air that is measured now.

    Since the channel was left the sensor may have drifted, or have been tared. Where
    that force is not known it stays as it was then.
    """
    state = channel.state
    in_air = present.state
    if not (
        isinstance(state, MixtureMethodState)
        and isinstance(in_air, MixtureMethodState)
        and not in_air.posterior.in_contact
    ):
        return state
    offset_std_N = math.sqrt(max(in_air.posterior.offset_variance, 0.0))
    if not 0.0 < offset_std_N <= 0.1:  # a tenth of what a needle rubs with
        return state
    offset_N = in_air.posterior.offset
    means, *others = state.mixture
    means = means.copy()
    means[:, OFFSET] += offset_N - state.posterior.offset
    return replace(
        state,
        mixture=(means, *others),
        posterior=replace(state.posterior, offset=offset_N),
    )
