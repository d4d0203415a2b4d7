"""The published method: equations (2), (3) and (7) to (12), sample by sample.

A window between two covariance resets maps the estimate linearly, theta_k = A_k
theta_{k-1} + c_k: RLS with lambda = 1 is a regularised least squares, theta = (Psi_0^-1
+ S)^-1 (Psi_0^-1 theta_prev + b) with S = sum phi phi' and b = sum phi f. A re-run over
a layer (Section III-B) needs S and b of each window, not its samples.
"""

import math
from dataclasses import astuple, replace

import numpy as np

from foundation.arrays import Array, Matrix
from foundation.jit import compiled, compiled_inside
from foundation.records import as_record, from_record, read_field
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
from identification.published.state import (
    DETECTED,
    EXPECTED,
    FORCE_DROP_MEASURING,
    FRICTION_IDENTIFIED,
    NO_RUPTURE,
    NO_WINDOWS,
    OF_FORCE,
    OF_SPEED,
    STATES,
    CusumConstants,
    ForceRatios,
    InitialVariances,
    Parameters,
    PublishedState,
    Regressor,
    Rls,
    RupturedLayer,
    Settings,
    Tracker,
    WindowSums,
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


@compiled
def regressor(layer_depth_m: float, speed_m_s: float, is_ml: bool) -> Regressor:
    """Return (phi_K, phi_B): for `ml` (dz, dz v) of (3); for `kv` (dz, v) of (2)."""
    return Regressor(layer_depth_m, layer_depth_m * speed_m_s if is_ml else speed_m_s)


@compiled
def update_rls(rls: Rls, phi: Regressor, force_N: float) -> float:
    """Use one force sample; return the error e_k = f_k - phi_k' theta_{k-1}.

    Equations (7) and (8) with lambda = 1, written out for two columns.
    """
    error_N = force_N - (phi.stiffness * rls.stiffness + phi.friction * rls.friction)
    stiffness_part = (
        rls.stiffness_variance * phi.stiffness + rls.covariance * phi.friction
    )
    friction_part = (
        rls.covariance * phi.stiffness + rls.friction_variance * phi.friction
    )
    scale = 1.0 + phi.stiffness * stiffness_part + phi.friction * friction_part
    step = error_N / scale
    rls.stiffness += stiffness_part * step
    rls.friction += friction_part * step
    rls.stiffness_variance -= stiffness_part * stiffness_part / scale
    rls.covariance -= stiffness_part * friction_part / scale
    rls.friction_variance -= friction_part * friction_part / scale
    return error_N


@compiled
def add_sample(
    sums: WindowSums, phi: Regressor, force_N: float, speed_m_s: float
) -> None:
    """Add one sample to the sums of its window."""
    sums.stiffness_stiffness += phi.stiffness * phi.stiffness
    sums.stiffness_friction += phi.stiffness * phi.friction
    sums.friction_friction += phi.friction * phi.friction
    sums.stiffness_force += phi.stiffness * force_N
    sums.friction_force += phi.friction * force_N
    sums.stiffness_speed += phi.stiffness * speed_m_s
    sums.friction_speed += phi.friction * speed_m_s


def cusum_constants(sigma0_N: float, sigma1_N: float) -> CusumConstants:
    """Return the constants of the CUSUM on the squared error, equation (9)."""
    usual_N2 = sigma0_N * sigma0_N
    abrupt_N2 = sigma1_N * sigma1_N
    return CusumConstants(
        drift_N2=(abrupt_N2 + usual_N2) / 2.0, threshold_N2=(abrupt_N2 - usual_N2) / 2.0
    )


@compiled_inside
def cusum_step(decision: float, error_N: float, drift: float) -> float:
    """Return the decision function g_k = max(g_{k-1} + e_k^2 - nu, 0), equation (9)."""
    return max(decision + error_N * error_N - drift, 0.0)


@compiled_inside
def derivative_step(
    derivative_N_per_s: float, change_N: float, dt_s: float, time_constant_s: float
) -> float:
    """Return df/dt after a first-order low-pass (Section III-B).

    It is exact for a force that is linear over the step.
    """
    memory = math.exp(-dt_s / time_constant_s)
    return memory * derivative_N_per_s + (1.0 - memory) * change_N / dt_s


@compiled_inside
def next_machine_state(tracker: Tracker, settings: Settings, is_watching: bool) -> int:
    """Return the state of the rupture machine after a sample, an index in `STATES`."""
    machine = tracker.machine
    if machine in (NO_RUPTURE, EXPECTED):
        if tracker.cusum_N2 > settings.cusum_threshold_N2:
            return DETECTED
        is_falling = tracker.derivative_N_per_s < -tracker.derivative_threshold_N_per_s
        return EXPECTED if is_watching and is_falling else NO_RUPTURE
    if machine == DETECTED:
        return FORCE_DROP_MEASURING
    if machine == FRICTION_IDENTIFIED:
        is_reset = tracker.waited_s * settings.reset_frequency_Hz >= 1.0
        return NO_RUPTURE if is_reset else machine
    return FRICTION_IDENTIFIED if tracker.waited_s >= tracker.drop_s else machine


@compiled
def published_outputs(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    settings: list[Settings],
    trackers: list[Tracker],
    estimates: list[Rls],
) -> Outputs:
    """Return the enhanced force f - sum(B_j d_j) v and its companions.

    The three records are lists of one each (see `foundation.records`).
    """
    tracker = trackers[0]
    rls = estimates[0]
    layer_depth_m = max(depth_m - tracker.start_depth_m, 0.0)
    in_contact = layer_depth_m > 0.0 or tracker.ruptures > 0
    layer = tracker.ruptures + 1 if in_contact else 0
    traversed_N = tracker.cumulative_friction * speed_m_s
    phi = regressor(layer_depth_m, speed_m_s, settings[0].is_ml)
    own_N = rls.friction * phi.friction if in_contact else 0.0
    enhanced_N = force_N - traversed_N
    # The published method states no standard deviations, and identifies no value of the
    # current layer.
    return (
        in_contact,
        layer,
        enhanced_N,
        None,
        enhanced_N - own_N,
        None,
        traversed_N + own_N,
        None,
        tracker.predicted_N,
        rls.stiffness,
        None,
        False,
        rls.friction,
        None,
        False,
        tracker.cumulative_friction,
        None,
    )


NOTHING = 0
"""Nothing is to be done after a sample."""
WINDOW_IS_FULL = 1
"""The reset window is full."""
STATE_HAS_CHANGED = 2
"""The rupture machine has another state; the window may be full as well."""


@compiled_inside
def update_tracker(
    dt_s: float,
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    settings: Settings,
    tracker: Tracker,
    rls: Rls,
    sums: WindowSums,
) -> None:
    """Use one sample: RLS (7) and (8), CUSUM (9), the derivative, the state machine."""
    force_before_N = tracker.force_N if tracker.has_force else force_N
    tracker.force_N = force_N
    tracker.force_before_N = force_before_N
    tracker.has_force = True
    if depth_m <= tracker.start_depth_m and tracker.ruptures == 0:
        tracker.predicted_N = 0.0
        return
    is_before_rupture = tracker.machine in (NO_RUPTURE, EXPECTED)
    is_watching = is_before_rupture and speed_m_s >= settings.min_speed_m_s
    layer_depth_m = max(depth_m - tracker.start_depth_m, 0.0)
    phi = regressor(layer_depth_m, speed_m_s, settings.is_ml)
    traversed_N = tracker.cumulative_friction * speed_m_s
    own_N = force_N - traversed_N
    error_N = update_rls(rls, phi, own_N)
    add_sample(sums, phi, own_N, speed_m_s)

    tracker.window_s += dt_s
    tracker.travel_s += dt_s
    tracker.waited_s += dt_s
    excess_m_s = speed_m_s - tracker.mean_speed_m_s
    tracker.mean_speed_m_s += excess_m_s * dt_s / tracker.travel_s
    tracker.cusum_N2 = (
        cusum_step(tracker.cusum_N2, error_N, settings.cusum_drift_N2)
        if is_watching
        else 0.0
    )
    tracker.derivative_N_per_s = derivative_step(
        tracker.derivative_N_per_s,
        force_N - force_before_N,
        dt_s,
        settings.derivative_time_constant_s,
    )
    tracker.predicted_N = own_N - error_N + traversed_N
    tracker.machine = next_machine_state(tracker, settings, is_watching)


@compiled
def update_published(
    dt_s: float,
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    settings: list[Settings],
    trackers: list[Tracker],
    estimates: list[Rls],
    windows: list[WindowSums],
) -> tuple[int, Outputs]:
    """Use one sample; return what is to be done now, and what to report otherwise.

    The last four are records, lists of one each (see `foundation.records`).
    """
    tracker = trackers[0]
    machine = tracker.machine
    update_tracker(
        dt_s,
        depth_m,
        speed_m_s,
        force_N,
        settings[0],
        tracker,
        estimates[0],
        windows[0],
    )
    due = NOTHING
    if tracker.machine != machine:
        due = STATE_HAS_CHANGED
    if tracker.window_s * settings[0].reset_frequency_Hz >= FULL_WINDOW:
        due += WINDOW_IS_FULL
    outputs = published_outputs(
        depth_m, speed_m_s, force_N, settings, trackers, estimates
    )
    return due, outputs


@compiled
def close_window(
    stiffness_variance: float,
    friction_variance: float,
    trackers: list[Tracker],
    estimates: list[Rls],
    windows: list[WindowSums],
) -> Array:
    """Reset the covariance, begin a new window; return the sums of the old one.

    They are in the order of `SUMS`, shape (7,). The three records are lists of one
    each.
    """
    rls = estimates[0]
    rls.stiffness_variance = stiffness_variance
    rls.covariance = 0.0
    rls.friction_variance = friction_variance
    trackers[0].window_s = 0.0
    sums = windows[0]
    row = np.array(
        [
            sums.stiffness_stiffness,
            sums.stiffness_friction,
            sums.friction_friction,
            sums.stiffness_force,
            sums.friction_force,
            sums.stiffness_speed,
            sums.friction_speed,
        ]
    )
    sums.stiffness_stiffness = 0.0
    sums.stiffness_friction = 0.0
    sums.friction_friction = 0.0
    sums.stiffness_force = 0.0
    sums.friction_force = 0.0
    sums.stiffness_speed = 0.0
    sums.friction_speed = 0.0
    return row


def append_window(windows: Array, row: Array, max_windows: int) -> Array:
    """Return windows with one more; beyond a maximum neighbours are added up.

    That halves their number and bounds memory in an endless layer: the re-run then
    resets half as often over that stretch. An odd last window stays alone.
    """
    grown = np.vstack((windows, row))
    if len(grown) > max_windows:
        even = len(grown) // 2 * 2
        grown = np.concatenate((grown[0:even:2] + grown[1:even:2], grown[even:]))
    grown.setflags(write=False)
    return grown


def force_ratios(
    drop_N: float,
    force_at_rupture_N: float,
    cumulative_friction_Ns_per_m: float,
    speed_m_s: float,
) -> ForceRatios:
    """Return the elastic and the friction ratio of the layer just traversed, (11).

    A drop below zero or above the whole force has no physical ratio; r_K is kept inside
    (0, 1) by a thousandth so that (12) stays positive and finite.
    """
    own_N = force_at_rupture_N - cumulative_friction_Ns_per_m * speed_m_s
    ratio = drop_N / own_N if own_N > 0.0 else 1.0
    elastic = min(max(ratio, MIN_RATIO), 1.0 - MIN_RATIO)
    return ForceRatios(elastic=elastic, friction=1.0 - elastic)


def reweighted_friction_variance(
    var_friction: float, ratios: ForceRatios, mean_speed_m_s: float
) -> float:
    """Return sigma'^2_B,0 = (1 / v^2) (r_B / r_K) sigma^2_B,0, equation (12).

    With collinear columns least squares moves the estimate along Psi phi, so that
    (B v dz) / (K dz) settles at sigma'^2_B v^2 / sigma^2_K = r_B / r_K.
    """
    return (
        var_friction
        * ratios.friction
        / (ratios.elastic * mean_speed_m_s * mean_speed_m_s)
    )


@compiled
def rerun_windows(windows: Matrix, variances: InitialVariances) -> Parameters:
    """Return the parameters after all windows, as a re-run over the samples would.

    Each window begins with covariance Psi_0 = diag(variances). Its map is written
    without an inverse of that or of S, so collinear columns and zero variances are
    harmless: theta + Psi_0 (I + S Psi_0)^-1 (b - S theta).

    Args:
        windows: Sums, columns in the order of `SUMS`, shape (n, 7).
        variances: Psi_0.
    """
    stiffness = 0.0
    friction = 0.0
    p = variances.stiffness
    q = variances.friction
    for i in range(len(windows)):
        # S = [[kk, kb], [kb, bb]], b = [kf, bf]
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
        scale = 1.0 / (second + q * bb + (p * q) * excitation)
        own_stiffness = p * (first * kf - qb * bf) * scale
        own_friction = q * (second * bf - pb * kf) * scale
        earlier = stiffness
        stiffness = own_stiffness + first * scale * earlier - pb * scale * friction
        friction = own_friction - qb * scale * earlier + second * scale * friction
    return Parameters(stiffness, friction)


class PublishedMethod:
    """The published method, sample by sample; it takes depth and speed as measured.

    Attributes:
        contact_depth_m: None: a setting, nothing that is identified.
        layers: Layers identified so far.
    """

    contact_depth_m = None
    layers: tuple[LayerEstimate, ...]

    def __init__(self, config: PublishedConfig) -> None:
        self._config = config
        cusum = cusum_constants(config.sigma0_N, config.sigma1_N)
        self._settings = as_record(
            Settings(
                is_ml=config.model == "ml",
                cusum_drift_N2=cusum.drift_N2,
                cusum_threshold_N2=cusum.threshold_N2,
                reset_frequency_Hz=config.reset_frequency_Hz,
                derivative_time_constant_s=config.derivative_time_constant_s,
                min_speed_m_s=config.least_speed_m_s,
            )
        )
        self._variances = InitialVariances(
            stiffness=float(config.var_stiffness), friction=float(config.var_friction)
        )
        self.restore(
            PublishedState(
                tracker=Tracker(
                    start_depth_m=float(config.contact_depth_m),
                    derivative_threshold_N_per_s=float(
                        config.derivative_threshold_N_per_s
                    ),
                ),
                rls=Rls(
                    stiffness_variance=self._variances.stiffness,
                    friction_variance=self._variances.friction,
                ),
            )
        )

    @property
    def state(self) -> PublishedState:
        """Everything that it remembers."""
        return PublishedState(
            tracker=from_record(Tracker, self._tracker),
            rls=from_record(Rls, self._rls),
            sums=from_record(WindowSums, self._sums),
            windows=self._windows,
            ruptured=self._ruptured,
            layers=self.layers,
        )

    def doubt_zero(self, std_N: float) -> None:
        """Do nothing: the method has no unknown zero of the force."""

    def doubt_ruptures(self, age_s: float) -> None:
        """Do nothing: the method weighs no ruptures."""

    def restore(self, state: PublishedState) -> None:
        """Resume from a state, bit for bit."""
        self._tracker = as_record(state.tracker)
        self._rls = as_record(state.rls)
        self._sums = as_record(state.sums)
        self._windows = state.windows
        self._ruptured = state.ruptured
        self.layers = state.layers
        self._rupture_state = STATES[state.tracker.machine]

    def first_estimate(self) -> Estimate:
        """Return the estimate before the first sample."""
        return self._estimate(NO_SAMPLE, SampleStatus.OK, NO_EVENTS)

    def _estimate(
        self, sample: Sample, status: SampleStatus, events: Events
    ) -> Estimate:
        """Return the estimate of a sample by what is known now."""
        outputs = published_outputs(
            sample.raw_depth_m,
            sample.raw_speed_m_s,
            sample.force_N,
            self._settings,
            self._tracker,
            self._rls,
        )
        return make_estimate(
            sample.time_s, status, self._rupture_state, outputs, events
        )

    def use(self, sample: Sample, status: SampleStatus) -> Estimate:
        """Use one sample; return the estimate after it."""
        due, outputs = update_published(
            sample.dt_s,
            sample.raw_depth_m,
            sample.raw_speed_m_s,
            sample.force_N,
            self._settings,
            self._tracker,
            self._rls,
            self._sums,
        )
        if due == NOTHING:
            return make_estimate(
                sample.time_s, status, self._rupture_state, outputs, NO_EVENTS
            )
        rupture = None
        layer = None
        is_new_state = due >= STATE_HAS_CHANGED
        self._rupture_state = STATES[read_field(self._tracker, "machine")]
        if is_new_state and self._rupture_state is RuptureState.DETECTED:
            rupture = self._open_layer(sample)
        elif due != STATE_HAS_CHANGED:
            self._windows = self._close_window(self._windows)
        is_identified = self._rupture_state is RuptureState.FRICTION_IDENTIFIED
        if is_new_state and is_identified and self._ruptured is not None:
            layer = self._identify(self._ruptured, sample.force_N)
        events = Events(rupture=rupture, identified_layer=layer)
        return self._estimate(sample, status, events)

    def _close_window(self, windows: Array) -> Array:
        """Reset the covariance; return the windows with the one that has ended."""
        row = close_window(
            self._variances.stiffness,
            self._variances.friction,
            self._tracker,
            self._rls,
            self._sums,
        )
        return append_window(windows, row, self._config.most_windows)

    def _open_layer(self, sample: Sample) -> Rupture:
        """Begin the next layer at a detected rupture, here and now (d_i, Section III).

        f(t_r) of (10) is the last force before the alarming sample, which may have
        dropped already. So may those of its whole reset window: the layer's re-run is
        without it.
        """
        config = self._config
        closed = self._close_window(NO_WINDOWS)
        tracker = from_record(Tracker, self._tracker)
        rupture = Rupture(
            layer=tracker.ruptures + 1,
            alarm_s=sample.time_s,
            alarm_depth_m=sample.raw_depth_m,
            time_s=sample.time_s,
            depth_m=sample.raw_depth_m,
            force_N=tracker.force_before_N,
            speed_m_s=sample.raw_speed_m_s,
            probability=1.0,
            is_final=True,
            contact_depth_m=float(config.contact_depth_m),
        )
        self._ruptured = RupturedLayer(
            start_depth_m=tracker.start_depth_m,
            windows=self._windows if len(self._windows) else closed,
            mean_speed_m_s=tracker.mean_speed_m_s,
            rupture=rupture,
        )
        self._windows = NO_WINDOWS
        self._rls = as_record(
            Rls(
                stiffness_variance=self._variances.stiffness,
                friction_variance=self._variances.friction,
            )
        )
        rise_N_per_s = rupture.layer * config.derivative_rise_N_per_s
        speed_m_s = max(sample.raw_speed_m_s, config.least_speed_m_s)
        self._tracker = as_record(
            replace(
                tracker,
                cusum_N2=0.0,
                travel_s=0.0,
                mean_speed_m_s=0.0,
                waited_s=0.0,
                ruptures=rupture.layer,
                start_depth_m=sample.raw_depth_m,
                derivative_threshold_N_per_s=config.derivative_threshold_N_per_s
                + rise_N_per_s,
                drop_s=config.drop_travel_m / speed_m_s,
            )
        )
        return rupture

    def _identify(self, ruptured: RupturedLayer, force_N: float) -> LayerEstimate:
        """Identify the ruptured layer after T_drop = k_v / v, (10) to (12).

        Its friction is taken out of the sums of the layer after it, so that its
        estimate goes on as if that friction had been subtracted from the rupture
        onwards.
        """
        rupture = ruptured.rupture
        tracker = from_record(Tracker, self._tracker)
        drop_N = rupture.force_N - force_N  # (10): f(t_r) - f(t_r + T_drop)
        ratios = force_ratios(
            drop_N, rupture.force_N, tracker.cumulative_friction, rupture.speed_m_s
        )
        mean_m_s = max(abs(ruptured.mean_speed_m_s), MIN_MEAN_SPEED_M_S)
        friction_variance = reweighted_friction_variance(
            self._variances.friction, ratios, mean_m_s
        )
        parameters = rerun_windows(
            ruptured.windows,
            InitialVariances(self._variances.stiffness, float(friction_variance)),
        )
        thickness_m = max(rupture.depth_m - ruptured.start_depth_m, MIN_THICKNESS_M)
        is_ml = self._config.model == "ml"
        damping = parameters.friction * (thickness_m if is_ml else 1.0)
        layer = LayerEstimate(
            layer=rupture.layer,
            is_final=True,
            start_depth_m=ruptured.start_depth_m,
            thickness_m=thickness_m,
            rupture=rupture,
            force_drop_N=drop_N,
            stiffness_N_per_m=parameters.stiffness,
            stiffness_identified=drop_N > 0.0,
            friction_Ns_per_m2=parameters.friction,
            friction_identified=drop_N > 0.0,
            friction_N=damping * rupture.speed_m_s,
        )
        self._subtract_friction(damping)
        self._tracker = as_record(
            replace(
                tracker,
                waited_s=0.0,
                cumulative_friction=tracker.cumulative_friction + damping,
            )
        )
        self._ruptured = None
        self.layers = (*self.layers, layer)[-MAX_LAYERS:]
        return layer

    def _subtract_friction(self, damping: float) -> None:
        """Correct the sums and the estimate of this layer for a friction now known."""
        sums = astuple(from_record(WindowSums, self._sums))
        windows = np.vstack((self._windows, sums))
        windows[:, OF_FORCE] -= damping * windows[:, OF_SPEED]
        windows.setflags(write=False)
        parameters = rerun_windows(windows, self._variances)
        self._rls = as_record(
            Rls(
                stiffness=parameters.stiffness,
                friction=parameters.friction,
                stiffness_variance=self._variances.stiffness,
                friction_variance=self._variances.friction,
            )
        )
        self._sums = as_record(WindowSums(*windows[-1].tolist()))
        self._windows = windows[:-1]
