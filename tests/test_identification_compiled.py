"""What every sample asks for: the same compiled and plain, and compiled before the first sample."""

import math
from types import FunctionType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification import MULTILAYER, PUBLISHED, PUBLISHED_KV, Identifier
from identification import friction_compensation as multilayer_update
from identification import input_validation as sample_check
from identification import published_update as published_update
from identification.errors import NoRuptureError
from identification.input_validation import CheckConfig, CheckState, check_limits, check_sample
from identification.layer_model import Gaussian, layer_fit
from identification.multilayer_state import (
    Traversed,
    initial_multilayer_state,
    multilayer_coefficients,
)
from identification.published_identifier import initial_published_state, published_coefficients
from identification.slope_change_detector import filter_bank, kink_scales, kink_step
from needleforce.jit import COMPILER

LIMITS = check_limits(CheckConfig())
KERNELS = [
    check_sample,
    multilayer_update.multilayer_update,
    multilayer_update.multilayer_outputs,
    published_update.published_update,
    published_update.paper_figures,
    kink_step,
]
depth = st.floats(-5e-3, 0.1)
speed = st.floats(-0.05, 0.05)
force = st.floats(-5.0, 20.0)
step = st.floats(1e-4, 0.02)
samples = st.lists(st.tuples(depth, speed, force, step), min_size=1, max_size=20)
needs_compiler = pytest.mark.skipif(not COMPILER, reason="numba (the extra `fast`) is missing")


def plain(function):
    """What runs without a compiler, all of it, fed with lists where that takes arrays."""
    world = dict(function.py_func.__globals__)
    for name, value in world.items():
        if hasattr(value, "py_func"):
            world[name] = FunctionType(value.py_func.__code__, world, name)
    world["_readable"] = np.ndarray.tolist
    python = world[function.py_func.__name__]

    def fed(*values):
        takes_arrays = function.py_func.__name__ == "kink_step"
        return python(*(value if takes_arrays else listed(value) for value in values))

    return fed


def listed(value):
    if isinstance(value, tuple):
        return tuple(listed(part) for part in value)
    return value.tolist() if isinstance(value, np.ndarray) else value


def flat(value):
    value = listed(value)
    return [x for part in value for x in flat(part)] if isinstance(value, tuple | list) else [value]


def assert_same(compiled, python):
    for one, other in zip(flat(compiled), flat(python), strict=True):
        assert type(one) is type(other)
        assert one == other or one == pytest.approx(other, rel=1e-12, nan_ok=True)


def multilayer_state(seed, *, in_contact, layers):
    rng = np.random.default_rng(seed)
    factor = rng.standard_normal((6, 6))
    fit = layer_fit(np.abs(rng.standard_normal(6)), factor @ factor.T)
    traversed = tuple(
        Traversed(5e-3 * k, 5e-3, *rng.random(2).tolist(), Gaussian(np.zeros(6), np.eye(6)), 0.9)
        for k in range(layers)
    )
    state = initial_multilayer_state(MULTILAYER)
    layer = state.layer._replace(start_m=5e-3 * layers, tip_m=5e-3 * layers + 1e-3)
    return state._replace(
        in_contact=in_contact, fit=fit, shaft_std_N=0.1, layer=layer, traversed=traversed
    )


@needs_compiler
@pytest.mark.parametrize("function", KERNELS)
def test_nothing_is_left_to_compile_at_the_first_sample(function):
    for config in (MULTILAYER, PUBLISHED):
        identifier, before = Identifier(config), len(function.signatures)
        assert before == 1
        for k in range(50):
            identifier.update(1e-5 * k, 0.01, 0.1 if k % 7 else math.nan, 1e-3)
        assert len(function.signatures) == before


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(samples, st.booleans())
def test_the_check_is_the_same_compiled_and_plain(rows, is_spoilt):
    memory = CheckState().plain
    for k, row in enumerate(rows):
        given_row = (*row[:2], math.nan, row[3]) if is_spoilt and k % 3 == 1 else row
        result = check_sample(*given_row, memory, LIMITS)
        assert_same(result, plain(check_sample)(*given_row, memory, LIMITS))
        memory = result[-1]


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(samples, st.integers(0, 99), st.booleans(), st.integers(0, 3))
def test_our_tick_is_the_same_compiled_and_plain(rows, seed, in_contact, layers):
    state = multilayer_state(seed, in_contact=in_contact, layers=layers)
    numbers, fields = multilayer_coefficients(state, MULTILAYER).numbers, state.tick.plain
    for row in rows:
        result = multilayer_update.multilayer_update(*row, fields, numbers)
        assert_same(result, plain(multilayer_update.multilayer_update)(*row, fields, numbers))
        fields = result[1]
        told = plain(multilayer_update.multilayer_outputs)(*row[:3], fields, numbers)
        assert_same(result[2], told)


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(samples, st.sampled_from([PUBLISHED, PUBLISHED_KV]), st.floats(0.0, 500.0))
def test_the_published_tick_is_the_same_compiled_and_plain(rows, config, cumulative):
    state = initial_published_state(config)._replace(cumulative_friction_Ns_per_m=cumulative)
    numbers, fields = published_coefficients(state, config).numbers, state.tick.plain
    for row in rows:
        result = published_update.published_update(*row, fields, numbers)
        assert_same(result, plain(published_update.published_update)(*row, fields, numbers))
        fields = result[1]
        assert_same(result[2], plain(published_update.paper_figures)(*row[:3], fields, numbers))


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(st.integers(0, 999), st.integers(1, 256), st.floats(1e-3, 0.1), st.floats(1e-4, 1.0))
def test_the_detector_is_the_same_compiled_and_plain(seed, filled, noise, dt_s):
    rng = np.random.default_rng(seed)
    kernels, figures = filter_bank(), np.array([x for scale in kink_scales() for x in scale])
    learned = (noise**2 * rng.random(6), rng.integers(0, 900, 6).astype(float), rng.random(1))
    signals = noise * rng.standard_normal(256), 0.01 * rng.standard_normal(256)
    for newest in rng.random((5, 2)).tolist():
        limits = (dt_s, 3600.0, 0.03, 4.0 / dt_s)
        values = (signals, tuple(newest), filled, learned, kernels.all, figures, limits)
        result = kink_step(*values)
        expected = plain(kink_step)(*values)
        # The filters' outputs are small differences of large forces.
        for one, other in zip(flat(result), flat(expected), strict=True):
            assert one == pytest.approx(other, rel=1e-9, abs=1e-12)
        signals, _, learned = result


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), force, speed, st.integers(0, 99))
def test_the_parts_are_the_same_compiled_and_plain(x, y, value, rate, seed):
    rng = np.random.default_rng(seed)
    rls, sums = (x, y, 4.0, 0.1, 9.0), tuple(rng.random(7).tolist())
    state = multilayer_state(seed, in_contact=True, layers=3)
    numbers = multilayer_coefficients(state, MULTILAYER).numbers
    fields = (0.0, 0.0, 0.0, 0.0, x, 0.0, rate, 0.01)
    calls = [
        (published_update.rls_step, (rls, (x, y), value, 1.0)),
        (published_update.add_sample, (sums, (x, y), value, rate)),
        (published_update.cusum_step, (abs(x), value, 0.01)),
        (published_update.derivative_step, (x, value, 1e-3, 0.2)),
        (published_update.regressor, (x, rate, True)),
        (published_update.is_window_full, (abs(x), 40.0)),
        (multilayer_update.follow_depth, (x, y, 2e-5)),
        (multilayer_update.bristle_step, (x, rate, 3e-4)),
        (multilayer_update.shaft_friction, (1e-2 * x, value, fields, numbers)),
        (multilayer_update._embedded_shares, (1e-2 * x, numbers)),
        (multilayer_update._per_speed, (abs(rate) + 1e-4, (x, y), (1.0, 0.2, 0.5))),
        (sample_check._skipped, (CheckState().plain, 1e-3)),
        (sample_check._motion_check, (x, rate, 1e-3, CheckState().plain, LIMITS)),
    ]
    for function, values in calls:
        assert_same(function(*values), plain(function)(*values))


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
def test_an_undone_rupture_has_never_been(config):
    identifier, ruptures = Identifier(config), []
    for k in range(8000):
        place = 2.5e-6 * k - 2e-3
        pull = max(place, 0.0) * (60.0 if place < 0.01 else 20.0)
        before = identifier.snapshot()
        found = identifier.update(place, 2.5e-3, pull + 2e-3 * math.sin(1e3 * k), 1e-3)
        if found.rupture is None:
            continue
        ruptures.append(found.rupture)
        identifier.undo_rupture()
        twin = Identifier(config)
        twin.restore(before)
        assert identifier.snapshot().last == before.last
        assert identifier.update(place, 2.5e-3, pull, 1e-3) == twin.update(
            place, 2.5e-3, pull, 1e-3
        )
    assert ruptures


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
def test_without_a_rupture_there_is_none_to_undo(config):
    identifier = Identifier(config)
    for _ in range(3):
        identifier.update(0.0, 0.0, 0.0, 1e-3)
        with pytest.raises(NoRuptureError, match="no rupture"):
            identifier.undo_rupture()
