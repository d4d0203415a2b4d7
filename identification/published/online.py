"""The published method: equations (2), (3) and (7) to (12), sample by sample.

A window between two covariance resets maps the estimate linearly, theta_k = A_k
theta_{k-1} + c_k: RLS with lambda = 1 is a regularised least squares, theta = (Psi_0^-1
+ S)^-1 (Psi_0^-1 theta_prev + b) with S = sum phi phi' and b = sum phi f. A re-run over
a layer (Section III-B) needs S and b of each window, not its samples.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from foundation.arrays import Array, Matrix
from foundation.jit import compiled
from identification.config import PublishedConfig
from identification.estimate import (
    Estimate,
    LayerEstimate,
    Rupture,
    RuptureState,
    Sample,
    SampleStatus,
)

NO_WINDOWS = np.empty((0, 7))
"""Of a layer that has just begun."""


@dataclass(slots=True, kw_only=True)
class PublishedState:
    """What the method knows; every sample writes into it.

    Attributes:
        start_depth_m: Where the present layer begins [m].
        derivative_threshold_N_per_s: Fall of the force that is expected of a rupture.
        stiffness: K [N/m].
        friction: B [Ns/m^2], for `kv` [Ns/m].
        stiffness_variance: Psi_KK.
        covariance: Psi_KB.
        friction_variance: Psi_BB.
        window_s: Time since the covariance was reset [s].
        window: Sums of this window: phi phi' (3), phi f and phi v (2 each), K before
            B.
        windows: Those of the layer's windows, a row each.
        cusum_N2: Decision function of (9).
        travel_s: Time in the layer [s].
        mean_speed_m_s: Its mean speed [m/s].
        derivative_N_per_s: Filtered derivative of the force.
        force_N: The last force [N], None before the first.
        force_before_N: The one before it [N].
        waited_s: Time since the machine began to wait [s].
        predicted_N: Force that was expected of the last sample [N].
        cumulative_friction: Of the layers traversed [Ns/m].
        drop_s: How long the drop of the force is awaited [s].
        ruptures: Layers traversed.
        machine: State of the machine of Section III-C.
        ruptured: The last layer's rupture, until its friction is identified.
        ruptured_start_m: Where that layer begins [m].
        ruptured_speed_m_s: Its mean speed [m/s].
        ruptured_windows: Its windows.
        layers: Those identified.
    """

    start_depth_m: float
    derivative_threshold_N_per_s: float
    stiffness: float = 0.0
    friction: float = 0.0
    stiffness_variance: float
    covariance: float = 0.0
    friction_variance: float
    window_s: float = 0.0
    window: Array = field(default_factory=lambda: np.zeros(7))
    windows: Array = field(default_factory=lambda: NO_WINDOWS)
    cusum_N2: float = 0.0
    travel_s: float = 0.0
    mean_speed_m_s: float = 0.0
    derivative_N_per_s: float = 0.0
    force_N: float | None = None
    force_before_N: float = 0.0
    waited_s: float = 0.0
    predicted_N: float = 0.0
    cumulative_friction: float = 0.0
    drop_s: float = 0.0
    ruptures: int = 0
    machine: RuptureState = RuptureState.NO_RUPTURE
    ruptured: Rupture | None = None
    ruptured_start_m: float = 0.0
    ruptured_speed_m_s: float = 0.0
    ruptured_windows: Array = field(default_factory=lambda: NO_WINDOWS)
    layers: tuple[LayerEstimate, ...] = ()


def append_window(windows: Array, row: Array, max_windows: int) -> Array:
    """Return the windows with one more; where they are too many, two become one."""
    grown = np.vstack((windows, row))
    if len(grown) > max_windows:
        even = len(grown) // 2 * 2
        grown = np.concatenate((grown[0:even:2] + grown[1:even:2], grown[even:]))
    return grown


@compiled
def rerun_windows(
    windows: Matrix, stiffness_variance: float, friction_variance: float
) -> tuple[float, float]:
    """Return K and B of an RLS that is run over the windows of a layer, reset in each.

    Args:
        windows: Sums, a row each, see `PublishedState.window`.
        stiffness_variance: Psi_0 of K.
        friction_variance: Psi_0 of B.
    """
    stiffness = 0.0
    friction = 0.0
    p = stiffness_variance
    q = friction_variance
    for i in range(len(windows)):
        kk = windows[i, 0]
        kb = windows[i, 1]
        bb = windows[i, 2]
        kf = windows[i, 3]
        bf = windows[i, 4]
        pb = p * kb
        qb = q * kb
        first = 1.0 + q * bb
        second = 1.0 + p * kk
        excitation = max(kk * bb - kb * kb, 0.0)
        scale = 1.0 / (second + q * bb + p * q * excitation)
        own_stiffness = p * (first * kf - qb * bf) * scale
        own_friction = q * (second * bf - pb * kf) * scale
        earlier = stiffness
        stiffness = own_stiffness + first * scale * earlier - pb * scale * friction
        friction = own_friction - qb * scale * earlier + second * scale * friction
    return stiffness, friction


def find_regressor(
    config: PublishedConfig, layer_depth_m: float, speed_m_s: float
) -> tuple[float, float]:
    """Return phi: for `ml` (dz, dz v) of (3); for `kv` (dz, v) of (2)."""
    by_depth = layer_depth_m if config.model == "ml" else 1.0
    return layer_depth_m, by_depth * speed_m_s


def update_rls(
    state: PublishedState,
    config: PublishedConfig,
    layer_depth_m: float,
    speed_m_s: float,
    own_N: float,
) -> float:
    """Use one force; return the error e_k = f_k - phi_k' theta_{k-1}.

    Equations (7) and (8) with lambda = 1, written out for two columns.
    """
    k, b = find_regressor(config, layer_depth_m, speed_m_s)
    error_N = own_N - (k * state.stiffness + b * state.friction)
    stiffness_part = state.stiffness_variance * k + state.covariance * b
    friction_part = state.covariance * k + state.friction_variance * b
    scale = 1.0 + k * stiffness_part + b * friction_part
    step = error_N / scale
    state.stiffness += stiffness_part * step
    state.friction += friction_part * step
    state.stiffness_variance -= stiffness_part * stiffness_part / scale
    state.covariance -= stiffness_part * friction_part / scale
    state.friction_variance -= friction_part * friction_part / scale
    squares = (k * k, k * b, b * b)
    products = (k * own_N, b * own_N, k * speed_m_s, b * speed_m_s)
    state.window = state.window + np.array(squares + products)
    return error_N


def reset_covariance(state: PublishedState, config: PublishedConfig) -> None:
    """Set Psi to Psi_0."""
    state.stiffness_variance = float(config.var_stiffness)
    state.covariance = 0.0
    state.friction_variance = float(config.var_friction)


def begin_window(state: PublishedState, config: PublishedConfig) -> None:
    """Reset the covariance and the sums of the window."""
    reset_covariance(state, config)
    state.window_s = 0.0
    state.window = np.zeros(7)


class PublishedMethod:
    """The method of Ferro et al.

    Args:
        config: Its settings.
    """

    contact_depth_m = None

    def __init__(self, config: PublishedConfig) -> None:
        self._config = config
        self.restore(
            PublishedState(
                start_depth_m=float(config.contact_depth_m),
                derivative_threshold_N_per_s=float(config.derivative_threshold_N_per_s),
                stiffness_variance=float(config.var_stiffness),
                friction_variance=float(config.var_friction),
            )
        )

    @property
    def state(self) -> PublishedState:
        """A copy of all that the method knows; nothing changes its arrays."""
        return replace(self._state)

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers identified."""
        return self._state.layers

    def restore(self, state: PublishedState) -> None:
        """Go on from a state, which is copied."""
        self._state = replace(state)

    def doubt_zero(self, std_N: float, age_s: float) -> None:
        """The published method knows no doubt."""

    def first_estimate(self) -> Estimate:
        """Return the estimate before the first sample."""
        return self._estimate(Sample(), SampleStatus.OK)

    def _estimate(
        self,
        sample: Sample,
        status: SampleStatus,
        rupture: Rupture | None = None,
        layer: LayerEstimate | None = None,
    ) -> Estimate:
        """Return the estimate of a sample, with its events."""
        state = self._state
        speed_m_s = sample.raw_speed_m_s
        layer_depth_m = max(sample.raw_depth_m - state.start_depth_m, 0.0)
        in_contact = layer_depth_m > 0.0 or state.ruptures > 0
        traversed_N = state.cumulative_friction * speed_m_s
        _, friction_part = find_regressor(self._config, layer_depth_m, speed_m_s)
        own_N = state.friction * friction_part if in_contact else 0.0
        enhanced_N = sample.force_N - traversed_N
        return Estimate(
            time_s=sample.time_s,
            status=status,
            rupture_state=state.machine,
            in_contact=in_contact,
            layer=state.ruptures + 1 if in_contact else 0,
            enhanced_force_N=enhanced_N,
            enhanced_force_std_N=None,
            tip_force_N=enhanced_N - own_N,
            tip_force_std_N=None,
            shaft_friction_N=traversed_N + own_N,
            shaft_friction_std_N=None,
            predicted_force_N=state.predicted_N,
            stiffness_N_per_m=state.stiffness,
            stiffness_std_N_per_m=None,
            stiffness_identified=False,
            friction_Ns_per_m2=state.friction,
            friction_std_Ns_per_m2=None,
            friction_identified=False,
            cumulative_friction_Ns_per_m=state.cumulative_friction,
            cumulative_friction_std_Ns_per_m=None,
            rupture=rupture,
            identified_layer=layer,
        )

    def use(self, sample: Sample, status: SampleStatus) -> Estimate:
        """Use a sample; return what is known after it."""
        state = self._state
        config = self._config
        machine = state.machine
        self._track(sample)
        rupture = None
        layer = None
        is_new = state.machine is not machine
        if is_new and state.machine is RuptureState.DETECTED:
            rupture = self._open_layer(sample)
        elif state.window_s * config.reset_frequency_Hz >= 1.0 - 1e-9:  # rounding
            row = state.window
            state.windows = append_window(state.windows, row, config.most_windows)
            begin_window(state, config)
        is_identified = state.machine is RuptureState.FRICTION_IDENTIFIED
        if is_new and is_identified and state.ruptured is not None:
            layer = self._identify(state.ruptured, sample.force_N)
        return self._estimate(sample, status, rupture, layer)

    def _track(self, sample: Sample) -> None:
        """Update estimate, CUSUM, derivative and machine by a sample."""
        state = self._state
        config = self._config
        dt_s = sample.dt_s
        force_N = sample.force_N
        speed_m_s = sample.raw_speed_m_s
        state.force_before_N = force_N if state.force_N is None else state.force_N
        state.force_N = force_N
        layer_depth_m = sample.raw_depth_m - state.start_depth_m
        if sample.raw_depth_m <= state.start_depth_m and state.ruptures == 0:
            state.predicted_N = 0.0
            return
        is_before = state.machine in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)
        is_watching = is_before and speed_m_s >= config.least_speed_m_s
        traversed_N = state.cumulative_friction * speed_m_s
        own_N = force_N - traversed_N
        error_N = update_rls(state, config, max(layer_depth_m, 0.0), speed_m_s, own_N)
        state.window_s += dt_s
        state.travel_s += dt_s
        state.waited_s += dt_s
        excess_m_s = speed_m_s - state.mean_speed_m_s
        state.mean_speed_m_s += excess_m_s * dt_s / state.travel_s
        # Equation (9): halves of the sum and of the difference of both variances
        usual_N2 = config.sigma0_N * config.sigma0_N
        abrupt_N2 = config.sigma1_N * config.sigma1_N
        decision_N2 = state.cusum_N2 + error_N * error_N - (abrupt_N2 + usual_N2) / 2.0
        state.cusum_N2 = max(decision_N2, 0.0) if is_watching else 0.0
        memory = math.exp(-dt_s / config.derivative_time_constant_s)
        change_N = force_N - state.force_before_N
        new = (1.0 - memory) * change_N / dt_s
        state.derivative_N_per_s = memory * state.derivative_N_per_s + new
        state.predicted_N = own_N - error_N + traversed_N
        is_abrupt = state.cusum_N2 > (abrupt_N2 - usual_N2) / 2.0
        state.machine = self._next_machine_state(is_watching, is_abrupt)

    def _next_machine_state(self, is_watching: bool, is_abrupt: bool) -> RuptureState:
        """Return the state of the machine after a sample."""
        state = self._state
        if state.machine in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED):
            if is_abrupt:
                return RuptureState.DETECTED
            falls = state.derivative_N_per_s < -state.derivative_threshold_N_per_s
            is_expected = is_watching and falls
            return RuptureState.EXPECTED if is_expected else RuptureState.NO_RUPTURE
        if state.machine is RuptureState.DETECTED:
            return RuptureState.FORCE_DROP_MEASURING
        if state.machine is RuptureState.FRICTION_IDENTIFIED:
            is_reset = state.waited_s * self._config.reset_frequency_Hz >= 1.0
            return RuptureState.NO_RUPTURE if is_reset else state.machine
        has_dropped = state.waited_s >= state.drop_s
        return RuptureState.FRICTION_IDENTIFIED if has_dropped else state.machine

    def _open_layer(self, sample: Sample) -> Rupture:
        """Begin the layer behind a rupture; return the rupture."""
        config = self._config
        state = self._state
        rupture = Rupture(
            layer=state.ruptures + 1,
            alarm_s=sample.time_s,
            alarm_depth_m=sample.raw_depth_m,
            time_s=sample.time_s,
            depth_m=sample.raw_depth_m,
            force_N=state.force_before_N,
            speed_m_s=sample.raw_speed_m_s,
            probability=1.0,
            is_final=True,
            contact_depth_m=float(config.contact_depth_m),
        )
        windows = state.windows if len(state.windows) else state.window[None]
        rise_N_per_s = rupture.layer * config.derivative_rise_N_per_s
        speed_m_s = max(sample.raw_speed_m_s, config.least_speed_m_s)
        self._state = PublishedState(
            start_depth_m=sample.raw_depth_m,
            derivative_threshold_N_per_s=config.derivative_threshold_N_per_s
            + rise_N_per_s,
            stiffness_variance=float(config.var_stiffness),
            friction_variance=float(config.var_friction),
            derivative_N_per_s=state.derivative_N_per_s,
            force_N=state.force_N,
            force_before_N=state.force_before_N,
            predicted_N=state.predicted_N,
            cumulative_friction=state.cumulative_friction,
            drop_s=config.drop_travel_m / speed_m_s,
            ruptures=rupture.layer,
            machine=state.machine,
            ruptured=rupture,
            ruptured_start_m=state.start_depth_m,
            ruptured_speed_m_s=state.mean_speed_m_s,
            ruptured_windows=windows,
            layers=state.layers,
        )
        return rupture

    def _identify(self, rupture: Rupture, force_N: float) -> LayerEstimate:
        """Identify the layer that ruptured, once its force has dropped."""
        state = self._state
        config = self._config
        drop_N = rupture.force_N - force_N
        own_N = rupture.force_N - state.cumulative_friction * rupture.speed_m_s
        ratio = drop_N / own_N if own_N > 0.0 else 1.0
        # (11), and the least mean speed and thickness: (12) stays positive and finite
        elastic = min(max(ratio, 1e-3), 1.0 - 1e-3)
        mean_m_s = max(abs(state.ruptured_speed_m_s), 1e-6)
        thickness_m = max(rupture.depth_m - state.ruptured_start_m, 1e-9)
        var_stiffness = float(config.var_stiffness)
        var_friction = float(config.var_friction)
        weighted = var_friction * (1.0 - elastic) / (elastic * mean_m_s * mean_m_s)
        stiffness, friction = rerun_windows(
            state.ruptured_windows, var_stiffness, weighted
        )
        damping = friction * (thickness_m if config.model == "ml" else 1.0)
        layer = LayerEstimate(
            layer=rupture.layer,
            is_final=True,
            start_depth_m=state.ruptured_start_m,
            thickness_m=thickness_m,
            rupture=rupture,
            force_drop_N=drop_N,
            stiffness_N_per_m=stiffness,
            stiffness_identified=drop_N > 0.0,
            friction_Ns_per_m2=friction,
            friction_identified=drop_N > 0.0,
            friction_N=damping * rupture.speed_m_s,
        )
        # The friction of this layer goes out of the forces of the next one, too.
        rows = np.vstack((state.windows, state.window))
        rows[:, 3:5] -= damping * rows[:, 5:7]
        state.stiffness, state.friction = rerun_windows(
            rows, var_stiffness, var_friction
        )
        reset_covariance(state, config)
        state.window = rows[-1]
        state.windows = rows[:-1]
        state.waited_s = 0.0
        state.cumulative_friction += damping
        state.ruptured = None
        # Far more layers than a needle meets; the oldest go first.
        state.layers = (*state.layers, layer)[-256:]
        return layer
