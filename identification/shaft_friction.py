"""Friction along the shaft, split where the enhanced force needs it."""

from typing import NamedTuple

from identification.default_config import DefaultConfig
from identification.default_state import DefaultState
from identification.layer_model import COULOMB, MM, OWN_COULOMB, OWN_VISCOUS, VISCOUS
from identification.sample import Sample


class ShaftFriction(NamedTuple):
    """Friction of the needle's shaft, positive when it resists insertion.

    Attributes:
        earlier_N: Of the layers traversed and identified; the enhanced force goes without it.
        own_N: Of the current layer, and of one just left that is not identified yet.
    """

    earlier_N: float
    own_N: float


def shaft_friction(
    state: DefaultState, sample: Sample, force_N: float, config: DefaultConfig
) -> ShaftFriction:
    """Friction at one sample.

    On the way out the embedded length shrinks layer by layer, and a tip drawn back by more than
    a needle diameter touches nothing: all force is friction then.

    Args:
        state: State with a layer in contact.
        sample: The sample.
        force_N: Its force less the free-air offset.
        config: Settings.
    """
    bristle, speed, depth_m = state.bristle, MM * state.speed_m_s, sample.depth_m
    fit, start_m, pending = state.fit.values, state.layer.start_m, state.pending
    if depth_m < start_m and state.traversed:
        coulomb_share, viscous_share = _embedded_shares(state, depth_m)
    else:
        coulomb_share = viscous_share = 1.0
    known = fit if pending is None or pending.is_closed else pending.left_fit.values
    earlier = bristle * coulomb_share * known[COULOMB] + speed * viscous_share * known[VISCOUS]
    if depth_m < state.deepest_m - config.cutting_onset_m:
        return ShaftFriction(earlier, force_N - earlier)
    total = bristle * coulomb_share * fit[COULOMB] + speed * viscous_share * fit[VISCOUS]
    depth = MM * max(depth_m - start_m, 0.0)
    own = depth * (bristle * fit[OWN_COULOMB] + speed * fit[OWN_VISCOUS])
    return ShaftFriction(earlier, total - earlier + own)


def _embedded_shares(state: DefaultState, depth_m: float) -> tuple[float, float]:
    """Share of the cumulative Coulomb and viscous friction still on the shaft."""
    coulomb = viscous = all_coulomb = all_viscous = 1e-12
    for layer in state.traversed:
        share = min(max(depth_m - layer.start_m, 0.0) / layer.thickness_m, 1.0)
        coulomb += share * layer.coulomb_N
        viscous += share * layer.viscous
        all_coulomb += layer.coulomb_N
        all_viscous += layer.viscous
    return coulomb / all_coulomb, viscous / all_viscous
