"""Metrics of a force reading, on readings whose error is known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from benchmarks import UnknownMetricError
from benchmarks.force_metrics import force_lag_s, wrench_metrics
from benchmarks.methods import ForceReading
from benchmarks.rows import Measurement
from benchmarks.signals import ForceTruth

T = np.arange(0.0, 20.0, 1e-3)


def saw(t):
    """A force that climbs and ruptures, zero before 5 s."""
    return np.where(t < 5.0, 0.0, np.mod(t, 5.0) * 0.3)


def reading(axial, std=0.1):
    return ForceReading(
        source="virtual", method="default", axial_N=axial, std_N=np.full(len(axial), std)
    )


def truth(axial, start=2.0, end=18.0):
    return ForceTruth(t_s=T, depth_m=T, axial_N=axial, zeroed_s=1.0, start_s=start, end_s=end)


def measured(axial, true, **kw):
    return {item.metric: item.value for item in wrench_metrics(reading(axial, **kw), truth(true))}


@given(delay=st.floats(-0.05, 0.5), offset=st.floats(-1.0, 1.0))
def test_a_delay_is_found_whatever_the_offset(delay, offset):
    found = force_lag_s(T, np.interp(T - delay, T, saw(T)) + offset, saw(T))
    assert found == pytest.approx(delay, abs=1e-4)


def test_the_lag_of_a_first_order_filter_is_about_its_time_constant():
    """On a ramp it is the time constant, on a step less: ruptures count for more than ramps."""
    decay = np.exp(-1e-3 / 0.1)
    late = lfilter([1.0 - decay], [1.0, -decay], saw(T))
    assert 0.06 < force_lag_s(T, late, saw(T)) < 0.1


def test_too_little_data_or_a_force_that_never_changes_has_no_lag():
    for size in (0, 1, 300):
        assert math.isnan(force_lag_s(T[:size], T[:size], T[:size]))
    assert math.isnan(force_lag_s(T, saw(T), np.zeros(len(T))))
    assert "wrench_lag_ms" not in measured(np.sin(T), np.zeros(len(T)))


def test_a_constant_error_is_a_bias_without_lag():
    found = measured(saw(T) + 0.05, saw(T))
    assert found["wrench_rmse_N"] == pytest.approx(0.05)
    assert found["wrench_bias_N"] == pytest.approx(0.05)
    assert found["wrench_lag_ms"] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(("sigmas", "share"), [(1.0, 0.6827), (2.0, 0.9545)])
def test_coverage_counts_what_lies_within_twice_the_stated_deviation(sigmas, share):
    noise = np.random.default_rng(0).normal(scale=0.2, size=len(T))
    found = measured(saw(T) + noise, saw(T), std=0.1 * sigmas)
    assert found["wrench_coverage_2sigma"] == pytest.approx(share, abs=0.01)


def test_only_the_judged_part_counts():
    wild = saw(T) + np.where((T < 2.0) | (T > 18.0), 100.0, 0.0)
    assert measured(wild, saw(T))["wrench_rmse_N"] == 0.0
    wild[10_000] = np.nan  # in the judged part it does not hide
    assert math.isnan(measured(wild, saw(T))["wrench_rmse_N"])


def test_nothing_judged_is_not_a_number_rather_than_perfect():
    never = truth(saw(T), start=30.0, end=40.0)
    found = {item.metric: item.value for item in wrench_metrics(reading(saw(T)), never)}
    assert all(math.isnan(value) for value in found.values())
    assert "wrench_rmse_N" in found


def test_a_reading_is_a_read_only_copy():
    axial = np.zeros(3)
    kept = reading(axial)
    axial[0] = 1.0
    assert kept.axial_N[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        kept.std_N[0] = 1.0


def test_a_measurement_takes_its_unit_from_the_catalogue():
    row = Measurement("ft", "default", "wrench_lag_ms", 3.0).row("gel-25-constant", "degraded", 4)
    assert (row.unit, row.seed, row.source, row.value) == ("ms", 4, "ft", 3.0)

    with pytest.raises(UnknownMetricError, match="no metric"):
        Measurement("ft", "default", "luck", 3.0).row("gel-25-constant", "degraded", 4)
