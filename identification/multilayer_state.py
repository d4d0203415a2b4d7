"""Memory of this toolkit's own identification between two samples."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification import friction_compensation as at
from identification.estimate import LayerEstimate, Rupture, RuptureState, layers_left
from identification.force_drop import AfterRows, ForceAfter
from identification.free_air_baseline import Baseline
from identification.friction_compensation import MultilayerUpdate
from identification.input_validation import packed
from identification.layer_belief import (
    IDENTIFIED_SHARE,
    Gaussian,
    IdentifiedLayer,
    look_back,
    revised,
)
from identification.layer_model import (
    COULOMB,
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    VISCOUS,
    LayerFit,
    NormalEquations,
    layer_fit,
    no_information,
)
from identification.membrane import MembraneSearch, SearchWork
from identification.multilayer_config import MultilayerConfig
from identification.resampling import NO_ROWS, Track, initial_track, least_block_s
from identification.rupture_classifier import (
    NO_RESIDUAL_FORCE,
    ResidualTipForce,
    RuptureMeasurement,
)
from identification.slope_change_detector import DetectorState, initial_detector
from identification.speed_lag import SpeedLag

# A look at a rupture that has begun and not ended: what it has measured so far.


class ForceDropMeasurement(NamedTuple):
    """Measured a stage per tick, see `rupture_stages`; the track stays what it is meanwhile.

    What a stage could not measure, where points are too few, stays None.

    Attributes:
        is_final: Whether the rupture is settled by it.
        stages: Worked off.
        before: Force before the rupture, and its variance [N^2].
        after_rows: What the force after the rupture is measured from.
        after: That force.
        ending: How the layer ended.
        has_come_back: Whether the force is back on its old line.
        identified: The unknowns of the layer left.
    """

    is_final: bool
    stages: int = 0
    before: tuple[float, float] | None = None
    after_rows: AfterRows | None = None
    after: ForceAfter | None = None
    ending: RuptureMeasurement | None = None
    has_come_back: bool = False
    identified: IdentifiedLayer | None = None


class LayerData(NamedTuple):
    """What has been gathered about the layer the tip is in.

    Attributes:
        start_m: Depth at which it begins: from here on it rubs along the shaft.
        tip_m: Depth from which on it resists the tip: `start_m`, or its membrane's puncture.
        prior: What was known of C and V when it began.
        data: Normal equations of the points inside it.
        points: Number of those points.
        pool: Points not in `data` yet, summed: weighted columns of the track.
        rows: The same points at a coarse resolution, see `layer_rows`.
        held: Tip force it began with, see `tear`.
    """

    start_m: float
    tip_m: float
    prior: NormalEquations
    data: NormalEquations
    points: int = 0
    pool: NDArray[np.float64] | None = None
    rows: NDArray[np.float64] = NO_ROWS
    held: ResidualTipForce = NO_RESIDUAL_FORCE


class Traversed(NamedTuple):
    """Friction of one traversed layer, for the way out.

    Attributes:
        start_m: Depth at which it begins.
        thickness_m: Its thickness.
        coulomb_N: c d.
        viscous: b d [N/(mm/s)].
        belief: What was believed of it before the force after its rupture was known.
        end_probability: How likely its rupture was its end, see `tear`.
    """

    start_m: float
    thickness_m: float
    coulomb_N: float
    viscous: float
    belief: Gaussian
    end_probability: float


class RuptureCandidate(NamedTuple):
    """A rupture whose force drop is being measured.

    Attributes:
        rupture: The alarm.
        left: The layer left, as it was at the alarm.
        left_fit: Its fit at the alarm.
        is_closed: Whether an earlier look has already identified it.
        next_look_m: Travel since the rupture at which to look again.
        first: What the first look found.
        search: What was found of a membrane that the layer left ended with, None before that.
        search_work: What has been done to find it.
        look: The look that has begun and not ended, if any.
    """

    rupture: Rupture
    left: LayerData
    left_fit: LayerFit
    is_closed: bool
    next_look_m: float
    first: RuptureMeasurement | None = None
    search: MembraneSearch | None = None
    search_work: SearchWork | None = None
    look: ForceDropMeasurement | None = None


class MultilayerState(NamedTuple):
    """Immutable state of this toolkit's own identification.

    Attributes:
        tick: What every sample changes.
        lag: Lag of the measured speed behind the depth.
        baseline: Force in free air.
        detector: Kink detector.
        track: Recent past.
        in_contact: The first layer has been met.
        layer: Current layer.
        fit: Its latest fit.
        shaft_std_N: Standard deviation of the shaft friction at that fit.
        pending: Rupture being measured.
        rupture_state: State of the rupture machine.
        layers: Layers identified so far.
        traversed: Their friction, for the way out.
        rupture: Raised by this sample.
        compensated: Identified at this sample.
        withdrawn: Alarm this sample showed to be false.
    """

    tick: MultilayerUpdate
    lag: SpeedLag
    baseline: Baseline
    detector: DetectorState
    track: Track
    in_contact: bool
    layer: LayerData
    fit: LayerFit
    shaft_std_N: float
    pending: RuptureCandidate | None
    rupture_state: RuptureState
    layers: tuple[LayerEstimate, ...]
    traversed: tuple[Traversed, ...]
    rupture: Rupture | None
    compensated: LayerEstimate | None
    withdrawn: Rupture | None

    def after_block(self, tick: MultilayerUpdate, lag: SpeedLag) -> "MultilayerState":
        """With an emptied block; by position, which takes a third of the time of `_replace`."""
        return MultilayerState(tick, lag, *self[2:])

    def after_point(self, detector: DetectorState, track: Track) -> "MultilayerState":
        """With another block in detector and track; by position, as above."""
        return MultilayerState(*self[:3], detector, track, *self[5:])

    @property
    def events(self) -> tuple[Rupture | None, LayerEstimate | None, Rupture | None]:
        """What the last three fields of an `Estimate` tell."""
        return self[-3:]


def untouched_layer(start_m: float) -> LayerData:
    """First layer, met at `start_m`: no friction has been gathered before it."""
    certain = np.zeros((6, 6))
    certain[0, 0] = certain[1, 1] = 1e8
    prior = NormalEquations(certain, np.zeros(6))
    return LayerData(start_m, start_m, prior, no_information())


def initial_default_state(_config: object) -> MultilayerState:
    """State before the first sample."""
    return MultilayerState(
        tick=MultilayerUpdate(),
        lag=SpeedLag(),
        baseline=Baseline(),
        detector=initial_detector(),
        track=initial_track(),
        in_contact=False,
        layer=untouched_layer(0.0),
        fit=layer_fit(np.zeros(6), np.zeros((6, 6))),
        shaft_std_N=0.0,
        pending=None,
        rupture_state=RuptureState.NO_RUPTURE,
        layers=(),
        traversed=(),
        rupture=None,
        compensated=None,
        withdrawn=None,
    )


# What `multilayer_update` reads until the layer is fitted anew: worked out then, not every time.


class MultilayerCoefficients(NamedTuple):
    """What follows from a state and changes with the fit, a rupture or the layers only.

    Attributes:
        numbers: What `multilayer_update` takes.
        in_contact: Of the state that it was worked out from, as the next three.
        fit: See `MultilayerState`.
        pending: See `MultilayerState`.
        layers: See `MultilayerState`.
        is_due: Whether the next sample finds work to do.
    """

    numbers: Any
    in_contact: bool
    fit: LayerFit
    pending: RuptureCandidate | None
    layers: tuple[LayerEstimate, ...]
    is_due: bool

    def holds(self, state: MultilayerState) -> bool:
        """Whether it still says what holds of a state."""
        return (
            self.fit is state.fit
            and self.pending is state.pending
            and self.layers is state.layers
            and self.in_contact == state.in_contact
            and self.is_due == is_due(state)
        )


def is_due(state: MultilayerState) -> bool:
    """Whether the next sample finds work to do even if it fills no block."""
    if state.rupture is not None or state.compensated is not None or state.withdrawn is not None:
        return True
    pending = state.pending
    return pending is not None and (pending.search is None or pending.look is not None)


def multilayer_coefficients(
    state: MultilayerState, config: MultilayerConfig
) -> MultilayerCoefficients:
    """Work it out of a state."""
    numbers = [0.0] * at.TRAVERSED
    numbers[at.SMOOTHING_S] = config.speed_smoothing_s
    numbers[at.PLAY_M] = config.track_step_m
    numbers[at.PRESLIDING_M] = config.presliding_m
    numbers[at.BLOCK_S] = least_block_s(config.block_s)
    numbers[at.ONSET_M] = config.cutting_onset_m
    numbers[at.REST_SPEED] = config.rest_speed_m_s
    numbers[at.IDENTIFIED_SHARE] = IDENTIFIED_SHARE
    numbers[at.IS_DUE] = is_due(state)
    numbers[at.OFFSET_N] = state.baseline.offset_N
    _lay_out_layer(numbers, state)
    _lay_out_earlier(numbers, state)
    for layer in state.traversed:
        numbers += _shares(layer)
    return MultilayerCoefficients(
        packed(numbers), state.in_contact, state.fit, state.pending, state.layers, is_due(state)
    )


def _lay_out_layer(numbers: list[float], state: MultilayerState) -> None:
    """The layer the tip is in."""
    fit, layers = state.fit, state.layers
    numbers[at.IN_CONTACT] = state.in_contact
    if state.in_contact:
        numbers[at.LAYER] = layers_left(layers) + (open_rupture(state) is not None) + 1
    numbers[at.START_M], numbers[at.TIP_M] = state.layer.start_m, state.layer.tip_m
    numbers[at.COULOMB], numbers[at.VISCOUS] = fit.values[COULOMB], fit.values[VISCOUS]
    numbers[at.STIFFNESS] = MM * fit.values[STIFFNESS]
    numbers[at.STIFFNESS_STD] = MM * math.sqrt(fit.spread.stiffness)
    numbers[at.OWN_COULOMB] = fit.values[OWN_COULOMB]
    numbers[at.OWN_VISCOUS] = fit.values[OWN_VISCOUS]
    numbers[at.VAR_OWN_COULOMB] = fit.spread.own_coulomb
    numbers[at.VAR_OWN_BOTH] = fit.spread.own_both
    numbers[at.VAR_OWN_VISCOUS] = fit.spread.own_viscous
    numbers[at.SHAFT_STD_N] = state.shaft_std_N


def _lay_out_earlier(numbers: list[float], state: MultilayerState) -> None:
    """Friction of the layers before, which no open rupture has touched."""
    pending, layers = open_rupture(state), state.layers
    fit = state.fit if pending is None else pending.left_fit
    numbers[at.EARLIER_COULOMB] = fit.values[COULOMB]
    numbers[at.EARLIER_VISCOUS] = fit.values[VISCOUS]
    numbers[at.VAR_COULOMB] = fit.spread.coulomb
    numbers[at.VAR_BOTH] = fit.spread.both
    numbers[at.VAR_VISCOUS] = fit.spread.viscous
    # At the speed of the last rupture; before the first, at the present one.
    numbers[at.CUMULATIVE_SPEED] = MM * layers[-1].rupture.speed_m_s if layers else 0.0


def _shares(layer: Traversed) -> tuple[float, float, float, float]:
    return layer.start_m, layer.thickness_m, layer.coulomb_N, layer.viscous


def open_rupture(state: MultilayerState) -> RuptureCandidate | None:
    """The rupture alarmed whose layer is not identified yet, if any."""
    pending = state.pending
    return None if pending is None or pending.is_closed else pending


# The layers left, with what has been felt since.


def multilayer_layers(state: MultilayerState) -> tuple[LayerEstimate, ...]:
    """The layers left, as all that has been felt since tells them."""
    pending = open_rupture(state)
    fit = state.fit if pending is None else pending.left_fit
    friction = Gaussian(np.array(fit.values[:2]), fit.covariance[:2, :2])
    layers: list[LayerEstimate] = []
    for estimate, left in zip(reversed(state.layers), reversed(state.traversed), strict=True):
        belief = look_back(left.belief, left.thickness_m, friction)
        layers.append(revised(estimate, belief))
        friction = Gaussian(belief.values[:2], belief.covariance[:2, :2])
    return tuple(reversed(layers))
