"""From the alarm of a rupture to the friction of its layer: a bounded amount of work per tick.

The force drop is measured twice: over the provisional window, a millimetre after the rupture, and
over the final one. A measurement is a handful of stages, of which a tick has room for one.
"""

import math
from dataclasses import replace

import numpy as np

from identification.config import MultilayerConfig
from identification.estimate import LayerEstimate, Rupture, RuptureState, layers_traversed
from identification.friction_compensation import LayerFriction
from identification.layer_model import (
    MM,
    OWN_COULOMB,
    OWN_VISCOUS,
    STIFFNESS,
    Gaussian,
    NormalEquations,
    add_layer_prior,
    add_row,
    carried_friction,
    layer_outputs,
    model_row,
    no_information,
    posterior,
    solve_layer,
)
from identification.membrane import SearchWork, search_step
from identification.multilayer_state import (
    ForceDropMeasurement,
    LayerData,
    MultilayerState,
    RuptureCandidate,
    TraversedLayer,
)
from identification.resampling import DEPTH, Block, rows_of_track
from identification.rupture_classifier import (
    RuptureMeasurement,
    force_after,
    force_before,
    has_recovered,
    measure_end,
    rows_after,
)
from identification.slope_change_detector import (
    SCALES,
    Detection,
    block_noise_N2,
    blocks_since_change,
    filter_bank,
    restart_detector,
)

_MOST_LAYERS = 256
"""Layers kept: far more than a needle meets; the oldest go first."""
_SIGNIFICANT = 3.0
"""Standard deviations a drop must have to count in the provisional measurement."""
_REAL = 1.0
"""The same in the final one: the alarm itself was significant, only a fall that has recovered is no
rupture."""
_DROP_ERROR = 0.004
"""Relative error of the law by which the drop is extrapolated."""
_MEASURING = 4
"""Stages of a measurement that read the track."""


def raise_rupture(
    state: MultilayerState, block: Block, detection: Detection, config: MultilayerConfig
) -> MultilayerState:
    """An alarm: estimate the rupture time, set the ruptured layer aside, begin the next."""
    if state.candidate is not None:
        state = finish_measurement(measure_rupture(state, config, is_last=True), config)
    rupture, layer, fit = _rupture(state, block, detection), state.layer, state.fit
    thickness = MM * max(rupture.depth_m - layer.start_m, 0.0)
    values = np.zeros(6)
    values[:2] = fit.values[:2] + thickness * fit.values[[OWN_COULOMB, OWN_VISCOUS]]
    return state._replace(
        detector=restart_detector(state.detector),
        layer=LayerData(
            rupture.depth_m, rupture.depth_m, layer.prior, no_information(), residual=layer.residual
        ),
        fit=Gaussian(values, np.zeros((6, 6))),
        candidate=RuptureCandidate(rupture, layer, fit, False, config.provisional_window_m),
        rupture_state=RuptureState.DETECTED,
        events=state.events._replace(rupture=rupture),
    )


def _rupture(state: MultilayerState, block: Block, detection: Detection) -> Rupture:
    """The rupture at its change point, not at its alarm."""
    detector = state.detector
    span = int(filter_bank().spans[SCALES.index(detection.scale)])
    since = blocks_since_change(detector.force_N[-span:], -1.0)
    travel = float(np.sum(detector.speed_m_s[-since:])) * block.dt_s
    chance = math.erfc(detection.deviations / math.sqrt(2.0))
    return Rupture(
        layer=layers_traversed(state.layers) + 1,
        alarm_s=block.time_s,
        alarm_depth_m=block.depth_m,
        time_s=block.time_s - since * block.dt_s,
        depth_m=max(block.depth_m - travel, state.layer.start_m),
        force_N=float(detector.force_N[-1 - since]),
        speed_m_s=float(np.mean(detector.speed_m_s[-span:-since])),
        probability=1.0 - chance,
        contact_depth_m=state.contact_m,
    )


def measure_rupture(
    state: MultilayerState, config: MultilayerConfig, *, is_last: bool = False
) -> MultilayerState:
    """Begin a measurement of the force drop where one is due: once provisional, once final.

    This tick works off its first stage, those until the next block the others.
    """
    candidate = state.candidate
    if candidate is None or len(state.track.points) == 0:
        return state
    travel = float(state.track.points[-1, DEPTH]) - candidate.rupture.depth_m
    is_final = is_last or travel >= config.final_window_m
    if not candidate.is_provisional:
        state = state._replace(rupture_state=RuptureState.FORCE_DROP_MEASURING)
    if is_final or (not candidate.is_provisional and travel >= candidate.next_window_m):
        return _work(state, candidate, ForceDropMeasurement(is_final), config)
    return state


def work_on_rupture(state: MultilayerState, config: MultilayerConfig) -> MultilayerState:
    """One stage of what the rupture asks for: in ticks between blocks there is time."""
    candidate = state.candidate
    if candidate is None:
        return state
    if candidate.search is None:
        return state._replace(candidate=_search(candidate, config))
    return state if candidate.work is None else _work(state, candidate, candidate.work, config)


def finish_measurement(state: MultilayerState, config: MultilayerConfig) -> MultilayerState:
    """The rest of a measurement that has begun, at once: the next block must find it ended."""
    while state.candidate is not None and state.candidate.work is not None:
        state = work_on_rupture(state, config)
    return state


def _search(candidate: RuptureCandidate, config: MultilayerConfig) -> RuptureCandidate:
    """The next stage of the search for a membrane before the rupture."""
    layer, work = candidate.layer, candidate.search_work
    if work is None:
        work = SearchWork(max(layer.start_m, layer.tip_m + config.provisional_window_m))
    found = search_step(work, layer.rows, candidate.rupture.depth_m, config)
    if isinstance(found, SearchWork):
        return candidate._replace(search_work=found)
    return candidate._replace(search=found, search_work=None)


def _work(
    state: MultilayerState,
    candidate: RuptureCandidate,
    work: ForceDropMeasurement,
    config: MultilayerConfig,
) -> MultilayerState:
    """The next stage: both sides of the rupture, whether it was one, the ruptured layer."""
    end, least = work.end, _REAL if work.is_final else _SIGNIFICANT
    if work.stages < _MEASURING:
        work = _measure(state, candidate, work, config)
    elif end is None or work.has_recovered or end.drop_N < least * end.drop_std_N:
        return _reject(state, candidate, work, config)
    elif work.fit is None:
        layer, bias_var = candidate.layer, state.baseline.variance
        fit, known = identify_layer(layer, candidate.rupture, end, bias_var, config)
        work = work._replace(fit=fit, known=known)
    else:
        return _accept(state, candidate, work, config)
    work = work._replace(stages=work.stages + 1)
    return state._replace(candidate=candidate._replace(work=work))


def _measure(
    state: MultilayerState,
    candidate: RuptureCandidate,
    work: ForceDropMeasurement,
    config: MultilayerConfig,
) -> ForceDropMeasurement:
    """One of the four stages that read the track."""
    points, rupture = state.track.points, candidate.rupture
    noise = block_noise_N2(state.detector)
    if work.stages == 0:
        return work._replace(before=force_before(points, rupture.depth_m, noise))
    if work.stages == 1:
        rows = rows_after(points, rupture.depth_m, rupture.speed_m_s, noise, config)
        return work._replace(after_rows=rows)
    if work.stages == 2:
        rows = work.after_rows
        return work if rows is None else work._replace(after_rows=None, after=force_after(rows))
    if work.before is not None and work.after is not None and candidate.search is not None:
        earlier = state.traversed[: len(state.layers) - candidate.is_provisional]
        ends = [layer.end_probability for layer in earlier]
        before, after = work.before, work.after
        end = measure_end(points, candidate.search, rupture, before, after, ends, config)
        work = work._replace(end=end)
    seen = candidate.first or work.end
    if work.is_final and seen is not None:
        is_back = has_recovered(points, rupture.depth_m, seen.drop_N, noise)
        work = work._replace(has_recovered=is_back)
    return work


def identify_layer(
    layer: LayerData,
    rupture: Rupture,
    end: RuptureMeasurement,
    bias_var: float,
    config: MultilayerConfig,
) -> tuple[Gaussian, Gaussian]:
    """Batch refit of the layer with both sides of its rupture as measurements.

    The force before is tip and friction together, the force after is friction alone (unless the
    rupture was partial): their difference is (10), K d = f_drop. With small noise the answer is
    that of the re-weighting (12); here it comes with a covariance.

    Returns:
        See `ForceDropMeasurement.fit` and `ForceDropMeasurement.known`.
    """
    boundary, thickness = end.boundary, _thickness_m(layer, end, config)
    speed, onset = boundary.speed_m_s, config.cutting_onset_m
    tip = max(boundary.depth_m - layer.tip_m, config.track_step_m)
    before = model_row(thickness, tip, speed, 1.0, onset)
    # Friction of the layers before, as expected when this one began.
    matrix = layer.prior.matrix[:2, :2] + 1e-9 * np.eye(2)
    own = boundary.force_N - float(before[:2] @ np.linalg.solve(matrix, layer.prior.vector[:2]))
    # Without one law a spring or another layer is in the data.
    known = layer.prior.plus(layer.data) if end.is_one_law else layer.prior
    known = add_layer_prior(known, own, thickness, speed, config, layer.residual)
    known = add_row(known, before, boundary.force_N, boundary.force_var + bias_var)
    # After the puncture of a membrane the next layer springs back along the shaft: it rubs on the
    # length that had been pushed in. Which fraction of its slope that is, the prior guesses here.
    slope = end.next_slope_N_per_mm
    rubbing = end.pushed_in_mm * slope
    uncertain = math.hypot(
        config.friction_fraction_std * rubbing,
        config.friction_fraction * slope * MM * boundary.std_m,
    )
    row = model_row(thickness, 0.0, rupture.speed_m_s, 1.0, onset)
    value = end.friction_N - config.friction_fraction * rubbing
    fit = solve_layer(add_row(known, row, value, _after_var(end, bias_var) + uncertain**2))
    return fit, posterior(known)


def _thickness_m(layer: LayerData, end: RuptureMeasurement, config: MultilayerConfig) -> float:
    return max(end.boundary.depth_m - layer.start_m, config.track_step_m)


def _after_var(end: RuptureMeasurement, bias_var: float) -> float:
    """Variance of the force after the rupture as a measurement of friction [N^2]."""
    return end.friction_var + bias_var + (_DROP_ERROR * end.drop_N) ** 2


def _revised(rupture: Rupture, end: RuptureMeasurement, *, is_final: bool) -> Rupture:
    """The rupture as known after a measurement."""
    return replace(rupture, is_final=is_final, tear_probability=1.0 - end.end_probability)


def _accept(
    state: MultilayerState,
    candidate: RuptureCandidate,
    work: ForceDropMeasurement,
    config: MultilayerConfig,
) -> MultilayerState:
    """Close the layer; the final measurement replaces what the provisional one found."""
    end, fit, known = work.end, work.fit, work.known
    if end is None or fit is None or known is None:
        return state
    layer, rupture = candidate.layer, _revised(candidate.rupture, end, is_final=work.is_final)
    thickness, speed = _thickness_m(layer, end, config), rupture.speed_m_s
    estimate = LayerEstimate(
        layer=rupture.layer,
        is_final=work.is_final,
        start_depth_m=layer.start_m,
        thickness_m=thickness,
        rupture=rupture,
        force_drop_N=end.drop_N,
        force_drop_std_N=end.drop_std_N,
        **layer_outputs(fit, thickness, speed),
    )
    own = (MM * thickness * fit.values[[OWN_COULOMB, OWN_VISCOUS]]).tolist()
    friction = LayerFriction(layer.start_m, thickness, *own)
    traversed = TraversedLayer(friction, known, end.end_probability)
    next_layer = _next_layer(carried_friction(known, thickness), end, rupture, state, config)
    next_fit = _next_fit(carried_friction(fit, thickness), end.next_slope_N_per_mm, speed, config)
    if not candidate.is_provisional:
        state = state._replace(rupture_state=RuptureState.FRICTION_IDENTIFIED)
    keep = len(state.layers) - candidate.is_provisional
    later = candidate._replace(is_provisional=True, first=end, work=None)
    return state._replace(
        layer=next_layer,
        fit=next_fit,
        shaft_std_N=_shaft_std_N(next_fit, speed),
        candidate=None if work.is_final else later,
        layers=(*state.layers[:keep], estimate)[-_MOST_LAYERS:],
        traversed=(*state.traversed[:keep], traversed)[-_MOST_LAYERS:],
        events=state.events._replace(identified_layer=estimate),
    )


def _shaft_std_N(fit: Gaussian, speed_m_s: float) -> float:
    row = np.array([1.0, MM * speed_m_s])
    return math.sqrt(max(float(row @ fit.covariance[:2, :2] @ row), 0.0))


def _next_layer(
    friction: Gaussian,
    end: RuptureMeasurement,
    rupture: Rupture,
    state: MultilayerState,
    config: MultilayerConfig,
) -> LayerData:
    """What is known when the next layer begins: the friction carried into it, and the force then.

    With a membrane that force contains some of the layer's own friction: what it identifies
    reveals later how much.
    """
    matrix, vector = np.zeros((6, 6)), np.zeros(6)
    matrix[:2, :2] = np.linalg.inv(friction.covariance + 1e-12 * np.eye(2))
    vector[:2] = matrix[:2, :2] @ friction.values
    row = model_row(end.pushed_in_mm / MM, 0.0, rupture.speed_m_s, 1.0, config.cutting_onset_m)
    edge = config.friction_fraction * end.next_slope_N_per_mm * MM * end.boundary.std_m
    variance = _after_var(end, state.baseline.variance) + edge**2
    prior = add_row(NormalEquations(matrix, vector), row, end.friction_N, variance)
    undisturbed_m = rupture.depth_m + config.provisional_window_m
    return LayerData(
        end.boundary.depth_m,
        rupture.depth_m,
        prior,
        no_information(),
        rows=rows_of_track(state.track.points, undisturbed_m, config.row_m),
        residual=end.residual,
    )


def _next_fit(
    friction: Gaussian, slope_N_per_mm: float, speed_m_s: float, config: MultilayerConfig
) -> Gaussian:
    """Fit with which the next layer begins; K, c and b are the prior of a layer of that slope."""
    values, covariance = np.zeros(6), np.zeros((6, 6))
    values[:2], covariance[:2, :2] = friction
    own = config.friction_fraction * slope_N_per_mm
    coulomb = config.coulomb_fraction(speed_m_s)
    viscous = (1.0 - coulomb) * own / (MM * max(speed_m_s, config.rest_speed_m_s))
    values[STIFFNESS:] = slope_N_per_mm - own, coulomb * own, viscous
    return Gaussian(values, covariance)


def _reject(
    state: MultilayerState,
    candidate: RuptureCandidate,
    work: ForceDropMeasurement,
    config: MultilayerConfig,
) -> MultilayerState:
    """No rupture was seen: retract it, keep what was found provisionally, or measure later."""
    if work.has_recovered or (work.is_final and not candidate.is_provisional):
        kept = len(state.layers) - candidate.is_provisional
        return state._replace(
            layer=candidate.layer,
            fit=candidate.fit,
            candidate=None,
            rupture_state=RuptureState.NO_RUPTURE,
            layers=state.layers[:kept],
            traversed=state.traversed[:kept],
            events=state.events._replace(retracted=replace(candidate.rupture, probability=0.0)),
        )
    if work.is_final:
        last = state.layers[-1]
        last = replace(last, is_final=True, rupture=replace(last.rupture, is_final=True))
        return state._replace(candidate=None, layers=(*state.layers[:-1], last))
    next_window_m = candidate.next_window_m + config.provisional_window_m
    return state._replace(candidate=candidate._replace(next_window_m=next_window_m, work=None))
