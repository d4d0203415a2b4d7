"""What `paper_tick` reads until a layer ends or the rupture machine moves: worked out then."""

from typing import Any, NamedTuple

from identification import paper_tick as at
from identification.cusum import cusum_constants
from identification.estimate import LayerEstimate, layers_left
from identification.packed import packed
from identification.paper_config import PaperConfig
from identification.paper_state import LeftLayer, PaperState
from identification.rupture_state import MUTED, RuptureState


class PaperStanding(NamedTuple):
    """What follows from a state and seldom changes.

    Attributes:
        numbers: What `paper_tick` takes.
        rupture_state: Of the state that it was worked out from, as the next two.
        left: See `PaperState`.
        layers: See `PaperState`.
        is_due: Whether the next sample finds work to do.
    """

    numbers: Any
    rupture_state: RuptureState
    left: LeftLayer | None
    layers: tuple[LayerEstimate, ...]
    is_due: bool

    def holds(self, state: PaperState) -> bool:
        """Whether it still says what holds of a state."""
        return (
            self.rupture_state is state.rupture_state
            and self.left is state.left
            and self.layers is state.layers
            and self.is_due == is_due(state)
        )


def is_due(state: PaperState) -> bool:
    """Whether the next sample finds work to do: around a rupture, every one does."""
    is_quiet = state.rupture_state in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)
    return not is_quiet or state.found is not None or state.compensated is not None


def paper_standing(state: PaperState, config: PaperConfig) -> PaperStanding:
    """Work it out of a state; beta grows at each detection."""
    numbers = [0.0] * at.PLACES
    left = layers_left(state.layers) + (state.left is not None)
    rise = left * config.derivative_rise_N_per_s
    numbers[at.LEAST_SPEED] = config.least_speed_m_s
    numbers[at.DRIFT], numbers[at.THRESHOLD] = cusum_constants(config.sigma0_N, config.sigma1_N)
    numbers[at.BETA] = config.derivative_threshold_N_per_s + rise
    numbers[at.DERIVATIVE_S] = config.derivative_time_constant_s
    numbers[at.RESET_HZ] = config.reset_frequency_Hz
    numbers[at.IS_ML] = config.model == "ml"
    numbers[at.START_M] = state.start_depth_m
    numbers[at.IS_INSIDE] = left > 0
    numbers[at.LAYER] = left + 1
    numbers[at.CUMULATIVE] = state.cumulative_friction_Ns_per_m
    numbers[at.IS_MUTED] = state.rupture_state in MUTED
    numbers[at.IS_EXPECTED] = state.rupture_state is RuptureState.EXPECTED
    numbers[at.IS_DUE] = is_due(state)
    return PaperStanding(
        packed(numbers), state.rupture_state, state.left, state.layers, is_due(state)
    )
