"""All that the multi-layer method remembers between two samples: one tree of named tuples."""

import math
from typing import NamedTuple

import numpy as np

from identification.config import MultilayerConfig
from identification.estimate import (
    Array,
    Events,
    LayerEstimate,
    Rupture,
    RuptureState,
    layers_traversed,
)
from identification.friction_compensation import (
    LayerFriction,
    MultilayerCoefficients,
    MultilayerMemory,
)
from identification.layer_model import (
    COULOMB,
    IDENTIFIED_FRACTION,
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    VISCOUS,
    Gaussian,
    NormalEquations,
    no_information,
    revised,
    smoothed_layer,
)
from identification.membrane import MembraneSearch, SearchWork
from identification.resampling import NO_ROWS, Track, least_block_s
from identification.rupture_classifier import (
    AfterRows,
    ForceAfter,
    ResidualTipForce,
    RuptureMeasurement,
)
from identification.slope_change_detector import DetectorState, initial_detector


class Baseline(NamedTuple):
    """Free-air force of the last ten seconds."""

    forces_N: tuple[float, ...] = ()  # Quarter-second means, newest last
    depths_m: tuple[float, ...] = ()  # Depth at the end of each
    sum_Ns: float = 0.0  # Integral of the force over the quarter second being filled
    time_s: float = 0.0  # Length of that so far
    offset_N: float = 0.0  # Mean force before contact, the paper's r_0 seen from the force side
    variance: float = 0.0  # Mean square of the means around it [N^2]: the sensor's slow error


class LayerData(NamedTuple):
    """What has been gathered about the layer the tip is in."""

    start_m: float  # Depth at which it begins: from here on it rubs along the shaft
    tip_m: float  # Depth from which on it resists the tip: `start_m`, or its membrane's puncture
    prior: NormalEquations  # What was known of C and V when it began
    data: NormalEquations  # Normal equations of the points inside it
    points: int = 0  # Number of those points
    pool: Array | None = None  # Points not in `data` yet, summed: weighted columns of the track
    rows: Array = NO_ROWS  # The same points at a coarse resolution, see `resampling.add_layer_row`
    residual: ResidualTipForce = ResidualTipForce()  # Tip force it began with


class TraversedLayer(NamedTuple):
    """Friction of one traversed layer, for the withdrawal and for smoothing."""

    friction: LayerFriction
    posterior: Gaussian  # Of its unknowns, before the force after its rupture was known
    end_probability: float  # How likely its rupture was its end


class ForceDropMeasurement(NamedTuple):
    """A measurement under way, a stage per tick; what too few points do not show stays None."""

    is_final: bool  # Whether it settles the rupture
    stages: int = 0  # Worked off
    before: tuple[float, float] | None = None  # Force before the rupture, and its variance [N^2]
    after_rows: AfterRows | None = None  # What the force after the rupture is measured from
    after: ForceAfter | None = None  # That force
    end: RuptureMeasurement | None = None  # How the layer ended
    has_recovered: bool = False  # Whether the force is back on its old line
    fit: Gaussian | None = None  # The unknowns of the ruptured layer, none negative
    known: Gaussian | None = None  # Their posterior without the force after the rupture


class RuptureCandidate(NamedTuple):
    """A rupture alarmed whose force drop is being measured."""

    rupture: Rupture  # The alarm
    layer: LayerData  # The layer that ruptured, as it was at the alarm
    fit: Gaussian  # Its fit at the alarm
    is_provisional: bool  # Whether its layer has been identified provisionally
    next_window_m: float  # Travel since the rupture at which to measure provisionally
    first: RuptureMeasurement | None = None  # What the provisional measurement found
    search: MembraneSearch | None = None  # What was found of a membrane at the layer's end
    search_work: SearchWork | None = None  # What has been done to find it
    work: ForceDropMeasurement | None = None  # The measurement under way, if any


class MultilayerState(NamedTuple):
    """All that the multi-layer method remembers; immutable."""

    detector: DetectorState  # Of slope changes
    layer: LayerData  # Current layer
    fit: Gaussian  # Its latest fit
    shaft_std_N: float = 0.0  # Standard deviation of the shaft friction at that fit
    memory: MultilayerMemory = MultilayerMemory()  # What every sample changes
    baseline: Baseline = Baseline()  # Force in free air
    track: Track = Track()  # Recent past
    in_contact: bool = False  # The first layer has been met
    contact_m: float = 0.0  # Depth at which it was
    candidate: RuptureCandidate | None = None  # Rupture being measured
    rupture_state: RuptureState = RuptureState.NO_RUPTURE
    layers: tuple[LayerEstimate, ...] = ()  # Layers identified so far
    traversed: tuple[TraversedLayer, ...] = ()  # Their friction
    events: Events = Events()  # Of this sample

    @property
    def known_layers(self) -> tuple[LayerEstimate, ...]:
        """The layers traversed, smoothed by all data since."""
        fit = self.earlier_fit
        friction = Gaussian(fit.values[:2], fit.covariance[:2, :2])
        layers: list[LayerEstimate] = []
        for estimate, each in zip(reversed(self.layers), reversed(self.traversed), strict=True):
            smoothed = smoothed_layer(each.posterior, each.friction.thickness_m, friction)
            layers.append(revised(estimate, smoothed))
            friction = Gaussian(smoothed.values[:2], smoothed.covariance[:2, :2])
        return tuple(reversed(layers))

    @property
    def is_due(self) -> bool:
        """Whether the next sample finds work to do even if it fills no block."""
        if any(self.events):
            return True
        candidate = self.candidate
        return candidate is not None and (candidate.search is None or candidate.work is not None)

    @property
    def open_rupture(self) -> RuptureCandidate | None:
        """The rupture alarmed whose layer is not identified yet, if any."""
        candidate = self.candidate
        return None if candidate is None or candidate.is_provisional else candidate

    @property
    def earlier_fit(self) -> Gaussian:
        """Fit of the layer whose C and V no open rupture has touched."""
        open_rupture = self.open_rupture
        return self.fit if open_rupture is None else open_rupture.fit

    @property
    def sources(self) -> tuple[object, ...]:
        """What `multilayer_coefficients` and the friction traversed follow from."""
        return self.fit, self.earlier_fit, self.layers, self.in_contact, self.is_due


def first_layer(start_m: float) -> LayerData:
    """First layer, met at `start_m`: no friction has been gathered before it."""
    certain = np.zeros((6, 6))
    certain[0, 0] = certain[1, 1] = 1e8
    prior = NormalEquations(certain, np.zeros(6))
    return LayerData(start_m, start_m, prior, no_information())


def initial_multilayer_state(_config: MultilayerConfig) -> MultilayerState:
    """State before the first sample."""
    unknown = Gaussian(np.zeros(6), np.zeros((6, 6)))
    return MultilayerState(initial_detector(), first_layer(0.0), unknown)


def multilayer_coefficients(
    state: MultilayerState, config: MultilayerConfig
) -> MultilayerCoefficients:
    """What `update_multilayer` reads of a state."""
    values, spread = state.fit.values.tolist(), state.fit.covariance.tolist()
    fit, layers = state.earlier_fit, state.layers
    earlier, earlier_spread = fit.values.tolist(), fit.covariance.tolist()
    layer = layers_traversed(layers) + (state.open_rupture is not None) + 1
    return MultilayerCoefficients(
        smoothing_s=config.speed_smoothing_s,
        deadband_m=config.track_step_m,
        presliding_m=config.presliding_m,
        block_s=least_block_s(config.block_s),
        onset_m=config.cutting_onset_m,
        rest_speed_m_s=config.rest_speed_m_s,
        identified_fraction=IDENTIFIED_FRACTION,
        is_due=state.is_due,
        in_contact=state.in_contact,
        layer=layer if state.in_contact else 0,
        offset_N=state.baseline.offset_N,
        start_m=state.layer.start_m,
        tip_m=state.layer.tip_m,
        coulomb=values[COULOMB],
        viscous=values[VISCOUS],
        stiffness_N_per_m=MM * values[STIFFNESS],
        stiffness_std_N_per_m=MM * math.sqrt(spread[STIFFNESS][STIFFNESS]),
        own_coulomb=values[OWN_COULOMB],
        own_viscous=values[OWN_VISCOUS],
        var_own_coulomb=spread[OWN_COULOMB][OWN_COULOMB],
        var_own_both=spread[OWN_COULOMB][OWN_VISCOUS],
        var_own_viscous=spread[OWN_VISCOUS][OWN_VISCOUS],
        shaft_std_N=state.shaft_std_N,
        earlier_coulomb=earlier[COULOMB],
        earlier_viscous=earlier[VISCOUS],
        var_coulomb=earlier_spread[COULOMB][COULOMB],
        var_both=earlier_spread[COULOMB][VISCOUS],
        var_viscous=earlier_spread[VISCOUS][VISCOUS],
        # At the speed of the last rupture; before the first, at the present one.
        cumulative_speed=MM * layers[-1].rupture.speed_m_s if layers else 0.0,
    )
