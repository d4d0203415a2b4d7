"""Memory of this toolkit's own identification between two samples."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.baseline import Baseline
from identification.default_tick import DefaultTick
from identification.estimate import LayerEstimate, Rupture
from identification.kink_detector import DetectorState, initial_detector
from identification.layer_ending import LayerEnding
from identification.layer_hindsight import Belief
from identification.layer_model import Information, LayerFit, layer_fit, no_information
from identification.layer_rows import NO_ROWS
from identification.membrane_search import MembraneSearch, SearchWork
from identification.rupture_look import RuptureLook
from identification.rupture_state import RuptureState
from identification.speed_lag import SpeedLag
from identification.tear import NOTHING_HELD, Held
from identification.track import Track, initial_track


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
    prior: Information
    data: Information
    points: int = 0
    pool: NDArray[np.float64] | None = None
    rows: NDArray[np.float64] = NO_ROWS
    held: Held = NOTHING_HELD


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
    belief: Belief
    end_probability: float


class Pending(NamedTuple):
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
    first: LayerEnding | None = None
    search: MembraneSearch | None = None
    search_work: SearchWork | None = None
    look: RuptureLook | None = None


class DefaultState(NamedTuple):
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

    tick: DefaultTick
    lag: SpeedLag
    baseline: Baseline
    detector: DetectorState
    track: Track
    in_contact: bool
    layer: LayerData
    fit: LayerFit
    shaft_std_N: float
    pending: Pending | None
    rupture_state: RuptureState
    layers: tuple[LayerEstimate, ...]
    traversed: tuple[Traversed, ...]
    rupture: Rupture | None
    compensated: LayerEstimate | None
    withdrawn: Rupture | None

    def after_block(self, tick: DefaultTick, lag: SpeedLag) -> "DefaultState":
        """With an emptied block; by position, which takes a third of the time of `_replace`."""
        return DefaultState(tick, lag, *self[2:])

    def after_point(self, detector: DetectorState, track: Track) -> "DefaultState":
        """With another block in detector and track; by position, as above."""
        return DefaultState(*self[:3], detector, track, *self[5:])

    @property
    def events(self) -> tuple[Rupture | None, LayerEstimate | None, Rupture | None]:
        """What the last three fields of an `Estimate` tell."""
        return self[-3:]


def untouched_layer(start_m: float) -> LayerData:
    """First layer, met at `start_m`: no friction has been gathered before it."""
    certain = np.zeros((6, 6))
    certain[0, 0] = certain[1, 1] = 1e8
    prior = Information(certain, np.zeros(6))
    return LayerData(start_m, start_m, prior, no_information())


def initial_default_state(_config: object) -> DefaultState:
    """State before the first sample."""
    return DefaultState(
        tick=DefaultTick(),
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
