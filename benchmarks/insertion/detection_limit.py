"""How early a rupture can be heard: the matched filter at the signals' own noise.

The run is simulated a second time, with the same seed, but the boundary holds. Both
runs have the same noise, so their difference is the exact response of every signal to
the rupture. Who knows that response hears it at

    d(t)² = sum over the signals of |L⁻¹ s(t)|²

with s the response up to t and L the Cholesky factor of the noise's covariance: no
method is earlier at the same rate of false alarms (Kay, Fundamentals of Statistical
Signal Processing II, 4.4). At d = 6 one decision in 1e9 is false.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from benchmarks.insertion.methods import Identified
from benchmarks.insertion.ruptures import is_visible, match
from benchmarks.jobs import Figure, Source, make_figures
from foundation.arrays import Array
from groundtruth import Run, Rupture, Scenario, simulate
from groundtruth.layers import CUTTING_ONSET_M

HEARD_SIGMAS = 6.0
"""d at which a rupture counts as heard."""
CORRELATED_SAMPLES = 250
"""Length of the noise's autocorrelation, and the longest response."""


def hold_boundary(scenario: Scenario, rupture: Rupture) -> Scenario:
    """Return a scenario in which a rupture has hardly begun when it should be heard.

    The travel of the release is as long as the layer allows, some hundred times its
    own: within the response 2 % of the force are released.
    """
    layers = list(scenario.layers)
    below = rupture.layer
    if below < len(layers) and layers[below].membrane is not None:
        layer = layers[below]
        assert layer.membrane is not None
        left_m = layer.thickness_m - layer.entry_m - CUTTING_ONSET_M - layer.release_m
        membrane = replace(layer.membrane, release_m=0.99 * left_m)
        layers[below] = replace(layer, membrane=membrane)
    else:
        layer = layers[below - 1]
        left_m = layer.thickness_m - layer.entry_m - CUTTING_ONSET_M
        if layer.membrane is not None:
            left_m -= layer.membrane.release_m
        layers[below - 1] = replace(layer, release_m=0.99 * left_m)
    return replace(scenario, layers=tuple(layers))


def sum_evidence(noise: Array, response: Array) -> Array:
    """Return d(t)² of one signal, shape (m,).

    Args:
        noise: Without a rupture, shape (n,); what a parabola explains is no noise.
        response: To the rupture, from its onset on, shape (m,).
    """
    instants = np.arange(noise.size)
    noise = noise - np.polyval(np.polyfit(instants, noise, 2), instants)
    lags = range(response.size)
    correlation = np.array(
        [np.mean(noise[: noise.size - lag] * noise[lag:]) for lag in lags]
    )
    correlation *= np.hanning(2 * response.size)[response.size :]
    # What few samples know of long lags must not make the matrix singular.
    correlation[0] *= 1.001
    factor = cholesky(toeplitz(correlation), lower=True)
    return np.cumsum(solve_triangular(factor, response, lower=True) ** 2)


def find_limit_s(run: Run, held: Run, rupture: Rupture, source: Source) -> float:
    """Return how long after its onset a rupture can be heard.

    It is nan where that is longer than the response.

    Args:
        run: The insertion by an arm.
        held: The same without the rupture.
        rupture: One of the run's.
        source: Which signals: ``ft``, the axial force at the needle's base;
            ``virtual``, the torques of all joints.
    """
    # The sample before the onset: the release begins between two samples.
    onset = int(np.searchsorted(run.truth.t_s, rupture.onset_s)) - 1
    contact = int(np.searchsorted(run.truth.t_s, run.truth.contact_s))
    heard = slice(onset, onset + CORRELATED_SAMPLES)
    air = slice(max(contact - 8 * CORRELATED_SAMPLES, 0), contact)
    if source == "ft":
        readings = run.signals.ft_wrench[:, 2:3]
        noise = readings[air]
        response = (held.signals.ft_wrench[:, 2:3] - readings)[heard]
    else:
        noise = (run.signals.tau_Nm - run.truth.tau_Nm)[air]
        response = (held.signals.tau_Nm - run.signals.tau_Nm)[heard]
    squares = np.sum([*map(sum_evidence, noise.T, response.T)], axis=0)
    is_heard = squares >= HEARD_SIGMAS**2
    after_s = run.truth.t_s[heard] - rupture.onset_s
    return float(after_s[is_heard][0]) if is_heard.any() else math.nan


def measure_limits(run: Run, items: Sequence[Identified]) -> Iterator[Figure]:
    """Yield the limits of a run's ruptures, and how much later its alarms are.

    Medians over the ruptures, and the worst ratio of a delay to its limit; nothing
    without a visible rupture.

    Args:
        run: The insertion by an arm.
        items: What a method made of each source.
    """
    ruptures = [rupture for rupture in run.truth.ruptures if is_visible(rupture)]
    held = [
        simulate(hold_boundary(run.scenario, rupture), run.plant, run.seed)
        for rupture in ruptures
    ]
    for item in items:
        limits_s = {
            rupture.onset_s: find_limit_s(run, other, rupture, item.source)
            for rupture, other in zip(ruptures, held, strict=True)
        }
        found, _, _ = match(run.truth.ruptures, item.alarms)
        ratios = [
            (alarm.alarm_s - rupture.onset_s) / limits_s[rupture.onset_s]
            for rupture, alarm in found
            if rupture.onset_s in limits_s
        ]
        if ratios:
            values = {
                "rupture_limit_ms": 1e3 * float(np.median([*limits_s.values()])),
                "rupture_over_limit": float(np.median(ratios)),
                "rupture_over_limit_worst": max(ratios),
            }
            yield from make_figures(values, item.source, item.method)
