"""Memory of the published method between two samples."""

from typing import NamedTuple

from identification.estimate import LayerEstimate, Rupture
from identification.paper_tick import PaperTick
from identification.rupture_state import RuptureState
from identification.window_history import WindowHistory


class LeftLayer(NamedTuple):
    """A layer just left, while its force drop is being measured.

    Attributes:
        start_depth_m: Depth at which it begins.
        windows: Sums of its reset windows.
        mean_speed_m_s: Average speed in it.
        rupture: How it ended.
    """

    start_depth_m: float
    windows: WindowHistory
    mean_speed_m_s: float
    rupture: Rupture


class FoundLayer(NamedTuple):
    """A layer identified whose friction is not subtracted yet.

    Attributes:
        layer: What was found.
        damping_Ns_per_m: Its share B_i d_i of the cumulative friction.
    """

    layer: LayerEstimate
    damping_Ns_per_m: float


class PaperState(NamedTuple):
    """Immutable state of the published method.

    Attributes:
        tick: What every sample changes.
        start_depth_m: Depth at which the current layer begins.
        windows: Sums of its closed reset windows.
        left: The layer just left, until its friction is subtracted.
        rupture_state: State of the rupture machine.
        cumulative_friction_Ns_per_m: Sum of B_j d_j over compensated layers.
        layers: Layers identified so far.
        found: The layer just left once it is identified, until the next sample.
        rupture: Raised by this sample.
        compensated: The layer whose friction is subtracted from this sample on, if any.
    """

    tick: PaperTick
    start_depth_m: float
    windows: WindowHistory = WindowHistory()
    left: LeftLayer | None = None
    rupture_state: RuptureState = RuptureState.NO_RUPTURE
    cumulative_friction_Ns_per_m: float = 0.0
    layers: tuple[LayerEstimate, ...] = ()
    found: FoundLayer | None = None
    rupture: Rupture | None = None
    compensated: LayerEstimate | None = None

    @property
    def events(self) -> tuple[Rupture | None, LayerEstimate | None, None]:
        """What the last three fields of an `Estimate` tell; this method withdraws nothing."""
        return self.rupture, self.compensated, None
