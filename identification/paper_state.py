"""Memory of the published method between two samples."""

from typing import NamedTuple

from identification.estimate import LayerEstimate, Rupture
from identification.rls import RlsState
from identification.rupture_state import RuptureState
from identification.window_history import WindowHistory
from identification.window_sums import WindowSums


class Traverse(NamedTuple):
    """What is gathered while one layer is traversed.

    Attributes:
        start_depth_m: Depth at which the layer begins.
        windows: Sums of its closed reset windows.
        travel_s: Time spent in it.
        mean_speed_m_s: Average speed in it.
    """

    start_depth_m: float
    windows: WindowHistory = WindowHistory()
    travel_s: float = 0.0
    mean_speed_m_s: float = 0.0


class FoundLayer(NamedTuple):
    """A layer identified whose friction is not subtracted yet.

    Attributes:
        layer: What was found.
        damping_Ns_per_m: Its share B_i d_i of the cumulative friction.
    """

    layer: LayerEstimate
    damping_Ns_per_m: float


class PaperState(NamedTuple):
    """Immutable state of `paper_step`.

    Attributes:
        rls: Current estimate and covariance.
        window: Sums since the last covariance reset.
        window_s: Time since the last covariance reset.
        traverse: The layer the tip is in.
        left: The layer just left, while its force drop is being measured.
        rupture: The rupture of that layer.
        rupture_state: State of the rupture machine.
        decision: g_k of equation (9).
        derivative_N_per_s: Filtered force derivative.
        last_force_N: Previous force sample, None at the start.
        waited_s: Time since the detection.
        cumulative_friction_Ns_per_m: Sum of B_j d_j over compensated layers.
        layers: Layers identified so far.
        predicted_N: phi' theta + B_d v before the sample was absorbed.
        found: The layer just left once it is identified, until the next sample.
        compensated: The layer whose friction is subtracted from this sample on, if any.
    """

    rls: RlsState
    traverse: Traverse
    window: WindowSums = WindowSums()
    window_s: float = 0.0
    left: Traverse | None = None
    rupture: Rupture | None = None
    rupture_state: RuptureState = RuptureState.NO_RUPTURE
    decision: float = 0.0
    derivative_N_per_s: float = 0.0
    last_force_N: float | None = None
    waited_s: float = 0.0
    cumulative_friction_Ns_per_m: float = 0.0
    layers: tuple[LayerEstimate, ...] = ()
    predicted_N: float = 0.0
    found: FoundLayer | None = None
    compensated: LayerEstimate | None = None
