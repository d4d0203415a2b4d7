"""The published method: equations (2), (3) and (7) to (12), sample by sample.

A window between two covariance resets maps the estimate linearly, theta_k = A_k
theta_{k-1} + c_k: RLS with lambda = 1 is a regularised least squares, theta = (Psi_0^-1
+ S)^-1 (Psi_0^-1 theta_prev + b) with S = sum phi phi' and b = sum phi f. A re-run over
a layer (Section III-B) needs S and b of each window, not its samples.
"""

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from foundation.arrays import Array, Matrix
from foundation.jit import compiled
from identification.config import PublishedConfig
from identification.estimate import (
    NO_EVENTS,
    NO_SAMPLE,
    Estimate,
    Events,
    LayerEstimate,
    Outputs,
    Rupture,
    RuptureState,
    Sample,
    SampleStatus,
    make_estimate,
)

FULL_WINDOW = 1.0 - 1e-9
"""Length of a reset window in periods, but for rounding."""
MAX_LAYERS = 256
"""Layers kept, far more than a needle meets; the oldest go first."""
MIN_RATIO = 1e-3
"""Least elastic and least friction ratio: (12) must stay positive and finite."""
MIN_THICKNESS_M = 1e-9
"""Least thickness of a layer, against a division by zero."""
MIN_MEAN_SPEED_M_S = 1e-6
"""Least mean speed in a layer in (12), against a division by zero."""
MAX_CORRELATION = 1.002
"""Squared correlation of an estimate that rounding may leave."""
OF_FORCE = slice(3, 5)
OF_SPEED = slice(5, 7)
"""Columns of a window: phi phi' (3), phi f and phi v (2 each), K before B."""
NO_WINDOWS = np.empty((0, 7))
NO_WINDOWS.setflags(write=False)


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
        window: Sums of this window, see `OF_SPEED`.
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

    GROWING: ClassVar[tuple[str, ...]] = ("windows", "ruptured_windows")

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

    def find_damage(self) -> str:
        """Return why it is impossible, or an empty text; for `check_state`."""
        product = self.stiffness_variance * self.friction_variance
        is_indefinite = min(self.stiffness_variance, self.friction_variance) < 0.0
        if is_indefinite or self.covariance**2 > MAX_CORRELATION * product:
            return "stiffness_variance, covariance, friction_variance are indefinite"
        rows = (self.windows, self.ruptured_windows)
        if not all(one.shape[1:] == (7,) and one.flags.c_contiguous for one in rows):
            return "its windows have another shape or order in memory"
        return ""


def append_window(windows: Array, row: Array, max_windows: int) -> Array:
    """Return the windows with one more; where they are too many, two become one."""
    grown = np.vstack((windows, row))
    if len(grown) > max_windows:
        even = len(grown) // 2 * 2
        grown = np.concatenate((grown[0:even:2] + grown[1:even:2], grown[even:]))
    grown.setflags(write=False)
    return grown


@compiled
def rerun_windows(
    windows: Matrix, stiffness_variance: float, friction_variance: float
) -> tuple[float, float]:
    """Return K and B of an RLS that is run over the windows of a layer, reset in each.

    Args:
        windows: Sums, a row each, see `OF_SPEED`.
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


class PublishedMethod:
    """The method of Ferro et al.

    Args:
        config: Its settings.
    """

    contact_depth_m = None

    def __init__(self, config: PublishedConfig) -> None:
        self._config = config
        self._is_ml = config.model == "ml"
        usual_N2 = config.sigma0_N * config.sigma0_N
        abrupt_N2 = config.sigma1_N * config.sigma1_N
        self._drift_N2 = (abrupt_N2 + usual_N2) / 2.0  # nu of (9)
        self._threshold_N2 = (abrupt_N2 - usual_N2) / 2.0
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
        """A copy of all that the method knows."""
        return replace(self._state, window=self._state.window.copy())

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers identified."""
        return self._state.layers

    def restore(self, state: PublishedState) -> None:
        """Go on from a state, which is copied."""
        self._state = replace(state, window=np.array(state.window))

    def doubt_zero(self, std_N: float) -> None:
        """The published method knows no doubt."""

    def doubt_ruptures(self, age_s: float) -> None:
        """The published method knows no doubt."""

    def first_estimate(self) -> Estimate:
        """Return the estimate before the first sample."""
        return self._estimate(NO_SAMPLE, SampleStatus.OK, NO_EVENTS)

    def _regressor(self, layer_depth_m: float, speed_m_s: float) -> tuple[float, float]:
        """Return phi: for `ml` (dz, dz v) of (3); for `kv` (dz, v) of (2)."""
        return layer_depth_m, layer_depth_m * speed_m_s if self._is_ml else speed_m_s

    def _estimate(
        self, sample: Sample, status: SampleStatus, events: Events
    ) -> Estimate:
        """Return the estimate of a sample."""
        state = self._state
        speed_m_s = sample.raw_speed_m_s
        layer_depth_m = max(sample.raw_depth_m - state.start_depth_m, 0.0)
        in_contact = layer_depth_m > 0.0 or state.ruptures > 0
        layer = state.ruptures + 1 if in_contact else 0
        traversed_N = state.cumulative_friction * speed_m_s
        _, friction_part = self._regressor(layer_depth_m, speed_m_s)
        own_N = state.friction * friction_part if in_contact else 0.0
        enhanced_N = sample.force_N - traversed_N
        forces = (enhanced_N, None, enhanced_N - own_N, None, traversed_N + own_N, None)
        stiffness = (state.predicted_N, state.stiffness, None, False)
        friction = (state.friction, None, False, state.cumulative_friction, None)
        outputs: Outputs = (in_contact, layer, *forces, *stiffness, *friction)
        return make_estimate(sample.time_s, status, state.machine, outputs, events)

    def use(self, sample: Sample, status: SampleStatus) -> Estimate:
        """Use a sample; return what is known after it."""
        state = self._state
        machine = state.machine
        self._track(sample)
        rupture = None
        layer = None
        is_new = state.machine is not machine
        if is_new and state.machine is RuptureState.DETECTED:
            rupture = self._open_layer(sample)
        elif state.window_s * self._config.reset_frequency_Hz >= FULL_WINDOW:
            state.windows = self._close_window(state.windows)
        is_identified = state.machine is RuptureState.FRICTION_IDENTIFIED
        if is_new and is_identified and state.ruptured is not None:
            layer = self._identify(state.ruptured, sample.force_N)
        events = Events(rupture=rupture, identified_layer=layer)
        return self._estimate(sample, status, events)

    def _track(self, sample: Sample) -> None:
        """Update estimate, CUSUM, derivative and machine by a sample."""
        state = self._state
        config = self._config
        dt_s = sample.dt_s
        force_N = sample.force_N
        depth_m = sample.raw_depth_m
        speed_m_s = sample.raw_speed_m_s
        state.force_before_N = force_N if state.force_N is None else state.force_N
        state.force_N = force_N
        if depth_m <= state.start_depth_m and state.ruptures == 0:
            state.predicted_N = 0.0
            return
        is_before = state.machine in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)
        is_watching = is_before and speed_m_s >= config.least_speed_m_s
        layer_depth_m = max(depth_m - state.start_depth_m, 0.0)
        traversed_N = state.cumulative_friction * speed_m_s
        own_N = force_N - traversed_N
        error_N = self._update_rls(layer_depth_m, speed_m_s, own_N)
        state.window_s += dt_s
        state.travel_s += dt_s
        state.waited_s += dt_s
        excess_m_s = speed_m_s - state.mean_speed_m_s
        state.mean_speed_m_s += excess_m_s * dt_s / state.travel_s
        decision_N2 = state.cusum_N2 + error_N * error_N - self._drift_N2
        state.cusum_N2 = max(decision_N2, 0.0) if is_watching else 0.0
        memory = math.exp(-dt_s / config.derivative_time_constant_s)
        change_N = force_N - state.force_before_N
        new = (1.0 - memory) * change_N / dt_s
        state.derivative_N_per_s = memory * state.derivative_N_per_s + new
        state.predicted_N = own_N - error_N + traversed_N
        state.machine = self._next_machine_state(is_watching=is_watching)

    def _update_rls(
        self, layer_depth_m: float, speed_m_s: float, own_N: float
    ) -> float:
        """Use one force; return the error e_k = f_k - phi_k' theta_{k-1}.

        Equations (7) and (8) with lambda = 1, written out for two columns.
        """
        state = self._state
        k, b = self._regressor(layer_depth_m, speed_m_s)
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
        state.window += (
            *(k * k, k * b, b * b),
            *(k * own_N, b * own_N, k * speed_m_s, b * speed_m_s),
        )
        return error_N

    def _next_machine_state(self, *, is_watching: bool) -> RuptureState:
        """Return the state of the machine after a sample."""
        state = self._state
        if state.machine in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED):
            if state.cusum_N2 > self._threshold_N2:
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

    def _close_window(self, windows: Array) -> Array:
        """Reset the covariance; return the windows with the one that ends."""
        state = self._state
        self._reset_covariance()
        state.window_s = 0.0
        row = state.window
        state.window = np.zeros(7)
        return append_window(windows, row, self._config.most_windows)

    def _reset_covariance(self) -> None:
        self._state.stiffness_variance = float(self._config.var_stiffness)
        self._state.covariance = 0.0
        self._state.friction_variance = float(self._config.var_friction)

    def _open_layer(self, sample: Sample) -> Rupture:
        """Begin the layer behind a rupture; return the rupture."""
        config = self._config
        state = self._state
        closed = self._close_window(NO_WINDOWS)
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
        state.ruptured = rupture
        state.ruptured_start_m = state.start_depth_m
        state.ruptured_speed_m_s = state.mean_speed_m_s
        state.ruptured_windows = state.windows if len(state.windows) else closed
        state.windows = NO_WINDOWS
        state.stiffness = state.friction = 0.0
        state.cusum_N2 = state.travel_s = state.mean_speed_m_s = state.waited_s = 0.0
        state.ruptures = rupture.layer
        state.start_depth_m = sample.raw_depth_m
        rise_N_per_s = rupture.layer * config.derivative_rise_N_per_s
        state.derivative_threshold_N_per_s = (
            config.derivative_threshold_N_per_s + rise_N_per_s
        )
        speed_m_s = max(sample.raw_speed_m_s, config.least_speed_m_s)
        state.drop_s = config.drop_travel_m / speed_m_s
        return rupture

    def _identify(self, rupture: Rupture, force_N: float) -> LayerEstimate:
        """Identify the layer that ruptured, once its force has dropped."""
        state = self._state
        drop_N = rupture.force_N - force_N
        own_N = rupture.force_N - state.cumulative_friction * rupture.speed_m_s
        ratio = drop_N / own_N if own_N > 0.0 else 1.0
        elastic = min(max(ratio, MIN_RATIO), 1.0 - MIN_RATIO)  # (11)
        mean_m_s = max(abs(state.ruptured_speed_m_s), MIN_MEAN_SPEED_M_S)
        var_stiffness = float(self._config.var_stiffness)
        var_friction = float(self._config.var_friction)
        weighted = var_friction * (1.0 - elastic) / (elastic * mean_m_s * mean_m_s)
        stiffness, friction = rerun_windows(
            state.ruptured_windows, var_stiffness, weighted
        )
        thickness_m = max(rupture.depth_m - state.ruptured_start_m, MIN_THICKNESS_M)
        damping = friction * (thickness_m if self._is_ml else 1.0)
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
        rows[:, OF_FORCE] -= damping * rows[:, OF_SPEED]
        state.stiffness, state.friction = rerun_windows(
            rows, var_stiffness, var_friction
        )
        self._reset_covariance()
        state.window = rows[-1].copy()
        state.windows = rows[:-1]
        state.windows.setflags(write=False)
        state.waited_s = 0.0
        state.cumulative_friction += damping
        state.ruptured = None
        state.layers = (*state.layers, layer)[-MAX_LAYERS:]
        return layer
