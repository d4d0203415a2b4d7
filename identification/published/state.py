"""What the published method remembers, and the values that travel with it."""

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from identification.estimate import LayerEstimate, Rupture, RuptureState

MAX_CORRELATION = 1.002
"""Largest square of a correlation in a restored covariance: 1, but for rounding."""

STATES = tuple(RuptureState)
"""In the order of the numbers that compiled code gives them."""
NO_RUPTURE = STATES.index(RuptureState.NO_RUPTURE)
EXPECTED = STATES.index(RuptureState.EXPECTED)
DETECTED = STATES.index(RuptureState.DETECTED)
FORCE_DROP_MEASURING = STATES.index(RuptureState.FORCE_DROP_MEASURING)
FRICTION_IDENTIFIED = STATES.index(RuptureState.FRICTION_IDENTIFIED)


class Regressor(NamedTuple):
    """Columns of the force model: f = phi_K K + phi_B B.

    Attributes:
        stiffness: phi_K.
        friction: phi_B.
    """

    stiffness: float
    friction: float


class Parameters(NamedTuple):
    """Parameters of the layer that the tip is in.

    Attributes:
        stiffness: K [N/m].
        friction: B, [Ns/m^2] for `ml`, [Ns/m] for `kv`.
    """

    stiffness: float
    friction: float


class InitialVariances(NamedTuple):
    """Psi_0, to which the covariance is reset; it is diagonal.

    Attributes:
        stiffness: sigma^2_K,0.
        friction: sigma^2_B,0.
    """

    stiffness: float
    friction: float


@dataclass(slots=True)
class Rls:
    """Estimate of the recursive least squares and its covariance Psi.

    Attributes:
        stiffness: K [N/m].
        friction: B, [Ns/m^2] for `ml`, [Ns/m] for `kv`.
        stiffness_variance: Psi[0, 0].
        covariance: Psi[0, 1].
        friction_variance: Psi[1, 1].
    """

    stiffness: float = 0.0
    friction: float = 0.0
    stiffness_variance: float = 0.0
    covariance: float = 0.0
    friction_variance: float = 0.0


@dataclass(slots=True)
class WindowSums:
    """Sums over the samples between two covariance resets, f without known friction.

    The last two allow, with `kv`, a later change of the cumulative friction.

    Attributes:
        stiffness_stiffness: Of phi_K^2.
        stiffness_friction: Of phi_K phi_B.
        friction_friction: Of phi_B^2.
        stiffness_force: Of phi_K f.
        friction_force: Of phi_B f.
        stiffness_speed: Of phi_K v.
        friction_speed: Of phi_B v.
    """

    stiffness_stiffness: float = 0.0
    stiffness_friction: float = 0.0
    friction_friction: float = 0.0
    stiffness_force: float = 0.0
    friction_force: float = 0.0
    stiffness_speed: float = 0.0
    friction_speed: float = 0.0


class CusumConstants(NamedTuple):
    """Constants of the CUSUM on the squared error, equation (9).

    Attributes:
        drift_N2: nu.
        threshold_N2: gamma.
    """

    drift_N2: float
    threshold_N2: float


class ForceRatios(NamedTuple):
    """Parts of the force of a layer just traversed, equation (11); their sum is 1.

    Attributes:
        elastic: r_K.
        friction: r_B.
    """

    elastic: float
    friction: float


SUMS = tuple(field.name for field in fields(WindowSums))
"""Names of the columns of an array of windows; its rows are `WindowSums`."""
OF_FORCE = slice(SUMS.index("stiffness_force"), SUMS.index("friction_force") + 1)
"""The columns that hold the force."""
OF_SPEED = slice(SUMS.index("stiffness_speed"), SUMS.index("friction_speed") + 1)
"""The columns that hold the speed in its place."""
NO_WINDOWS = np.empty((0, len(SUMS)))
"""Of a layer without closed windows."""
NO_WINDOWS.setflags(write=False)


@dataclass(slots=True)
class Settings:
    """What every sample needs of the configuration.

    Attributes:
        is_ml: Whether the model is the multi-layer one, equation (3).
        cusum_drift_N2: nu of (9).
        cusum_threshold_N2: gamma of (9).
        reset_frequency_Hz: f_CR.
        derivative_time_constant_s: Of the derivative's low-pass.
        min_speed_m_s: Below it no rupture is detected.
    """

    is_ml: bool
    cusum_drift_N2: float
    cusum_threshold_N2: float
    reset_frequency_Hz: float
    derivative_time_constant_s: float
    min_speed_m_s: float


@dataclass(slots=True)
class Tracker:
    """What samples and ruptures change, apart from the closed windows.

    Attributes:
        window_s: Time since the last covariance reset.
        cusum_N2: g_k of (9).
        travel_s: Time in the layer.
        mean_speed_m_s: Mean speed in the layer.
        derivative_N_per_s: Filtered derivative of the force.
        force_N: The last force.
        has_force: Whether there is one.
        force_before_N: The force before the last one.
        waited_s: Time since the detection.
        predicted_N: phi' theta + B_d v before the last sample was used.
        start_depth_m: Start of the layer.
        cumulative_friction: Sum of B_j d_j [Ns/m].
        derivative_threshold_N_per_s: beta.
        drop_s: T_drop.
        ruptures: How many were detected.
        machine: State of the rupture machine, an index in `STATES`.
    """

    window_s: float = 0.0
    cusum_N2: float = 0.0
    travel_s: float = 0.0
    mean_speed_m_s: float = 0.0
    derivative_N_per_s: float = 0.0
    force_N: float = 0.0
    has_force: bool = False
    force_before_N: float = 0.0
    waited_s: float = 0.0
    predicted_N: float = 0.0
    start_depth_m: float = 0.0
    cumulative_friction: float = 0.0
    derivative_threshold_N_per_s: float = 0.0
    drop_s: float = 0.0
    ruptures: int = 0
    machine: int = NO_RUPTURE


def find_window_damage(windows: Array) -> str:
    """Return what keeps compiled code from reading an array of windows, if anything."""
    shape = windows.shape
    if shape[1:] == NO_WINDOWS.shape[1:] and windows.flags.c_contiguous:
        return ""
    return f"its windows have the shape {shape} or another order in memory"


class RupturedLayer(NamedTuple):
    """A layer that has ruptured, while its force drop is being measured.

    Attributes:
        start_depth_m: Depth at which it begins.
        windows: Sums of its reset windows, shape (n, 7).
        mean_speed_m_s: Average speed in it.
        rupture: How it ended.
    """

    start_depth_m: float
    windows: Array
    mean_speed_m_s: float
    rupture: Rupture

    def find_damage(self) -> str:
        """Return what is wrong with a restored state, if anything."""
        return find_window_damage(self.windows)


class PublishedState(NamedTuple):
    """Everything that the published method remembers; nothing changes it.

    Attributes:
        tracker: What samples and ruptures change.
        rls: Estimate of the current layer.
        sums: Sums of the reset window that is being filled.
        windows: Sums of the closed reset windows of the current layer, shape (n, 7).
        ruptured: The last layer, until its friction is subtracted.
        layers: Layers identified so far.
    """

    tracker: Tracker
    rls: Rls
    sums: WindowSums = WindowSums()
    windows: Array = NO_WINDOWS
    ruptured: RupturedLayer | None = None
    layers: tuple[LayerEstimate, ...] = ()

    GROWING = ("windows",)

    def find_damage(self) -> str:
        """Return what is wrong with a restored state, if anything."""
        if self.tracker.machine not in range(len(STATES)):
            return f"its tracker is in no state {self.tracker.machine!r:.80}"
        smaller = min(self.rls.stiffness_variance, self.rls.friction_variance)
        product = self.rls.stiffness_variance * self.rls.friction_variance
        if smaller < 0.0 or self.rls.covariance**2 > MAX_CORRELATION * product:
            return "the covariance of its rls is not positive semi-definite"
        return find_window_damage(self.windows)
