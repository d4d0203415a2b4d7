"""What every sample asks for: the same compiled and plain, and compiled before the first sample."""

import math
from types import FunctionType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification import MULTILAYER, PUBLISHED, PUBLISHED_KV, Identifier
from identification import friction_compensation as ours
from identification import published_update as published
from identification.config import CheckConfig
from identification.errors import NoRuptureError
from identification.friction_compensation import LayerFriction, MultilayerCoefficients
from identification.input_validation import CheckState, check_limits, check_sample
from identification.layer_model import Gaussian
from identification.multilayer_state import (
    TraversedLayer,
    initial_multilayer_state,
    multilayer_coefficients,
)
from identification.published_identifier import PublishedMethod, published_coefficients
from identification.slope_change_detector import filter_bank, update_slope_change
from identification.travel_filter import TravelState, filter_travel
from needleforce.jit import COMPILER, jit_arguments

LIMITS = check_limits(CheckConfig())
KERNELS = [
    check_sample,
    filter_travel,
    ours.update_multilayer,
    ours.multilayer_outputs,
    published.update_published,
    published.published_outputs,
    published.rerun_windows,
    update_slope_change,
]

row = st.tuples(
    st.floats(-5e-3, 0.1), st.floats(-0.05, 0.05), st.floats(-5.0, 20.0), st.floats(1e-4, 0.02)
)
samples = st.lists(row, min_size=1, max_size=20)
needs_compiler = pytest.mark.skipif(not COMPILER, reason="numba (the extra `fast`) is missing")


def plain(function):
    """What runs without a compiler: the function and those of its file that it calls."""
    world = dict(function.py_func.__globals__)
    for name, value in world.items():
        if hasattr(value, "py_func"):
            world[name] = FunctionType(value.py_func.__code__, world, name)
    return world[function.py_func.__name__]


def uncompiled(kind, *records):
    """Named arguments as plain Python takes them."""
    return tuple(kind(*record.tolist()) for record in jit_arguments(kind, *records))


def flat(value):
    value = value.tolist() if isinstance(value, np.ndarray) else value
    return [x for part in value for x in flat(part)] if isinstance(value, tuple | list) else [value]


def assert_same(compiled, python, rel=1e-12):
    for one, other in zip(flat(compiled), flat(python), strict=True):
        assert type(one) is type(other)
        assert one == other or one == pytest.approx(other, rel=rel, abs=1e-12, nan_ok=True)


def multilayer_state(seed, *, in_contact, layers):
    rng = np.random.default_rng(seed)
    factor = rng.standard_normal((6, 6))
    state = initial_multilayer_state(MULTILAYER)
    known = Gaussian(np.zeros(6), np.eye(6))
    return state._replace(
        in_contact=in_contact,
        fit=Gaussian(np.abs(rng.standard_normal(6)), factor @ factor.T),
        shaft_std_N=0.1,
        layer=state.layer._replace(start_m=5e-3 * layers, tip_m=5e-3 * layers + 1e-3),
        traversed=tuple(
            TraversedLayer(LayerFriction(5e-3 * k, 5e-3, *rng.random(2).tolist()), known, 0.9)
            for k in range(layers)
        ),
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
    memory = CheckState()[:]
    for k, values in enumerate(rows):
        given_row = (*values[:2], math.nan, values[3]) if is_spoilt and k % 3 == 1 else values
        result = check_sample(*given_row, k % 5 > 0, memory, LIMITS)
        assert_same(result, plain(check_sample)(*given_row, k % 5 > 0, memory, LIMITS))
        memory = result[-1]


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(samples, st.booleans())
def test_the_travel_filter_is_the_same_compiled_and_plain(rows, is_told):
    memory = TravelState()[:]
    for depth_m, speed_m_s, _, dt_s in rows:
        given_row = (depth_m, speed_m_s if is_told else math.nan, dt_s, memory)
        result = filter_travel(*given_row)
        assert_same(result, plain(filter_travel)(*given_row), rel=1e-9)
        memory = result[-1]


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(samples, st.integers(0, 99), st.booleans(), st.integers(0, 3))
def test_our_update_is_the_same_compiled_and_plain(rows, seed, in_contact, layers):
    state = multilayer_state(seed, in_contact=in_contact, layers=layers)
    coefficients = multilayer_coefficients(state, MULTILAYER)
    friction = [layer.friction for layer in state.traversed]
    kinds = ((MultilayerCoefficients, coefficients), (LayerFriction, *friction))
    fast, slow = ([make(*kind) for kind in kinds] for make in (jit_arguments, uncompiled))
    memory = tuple(state.memory)
    for depth_m, speed_m_s, *others in rows:
        values = (depth_m, speed_m_s, 1e-5, *others)
        result = ours.update_multilayer(*values, memory, *fast)
        assert_same(result, plain(ours.update_multilayer)(*values, memory, *slow))
        memory = result[1]
        outputs = ours.multilayer_outputs(depth_m, speed_m_s, others[0], memory, *fast)
        assert_same(result[2], outputs)


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(samples, st.sampled_from([PUBLISHED, PUBLISHED_KV]), st.floats(0.0, 500.0))
def test_the_published_update_is_the_same_compiled_and_plain(rows, config, cumulative):
    state = PublishedMethod(config).state._replace(cumulative_friction_Ns_per_m=cumulative)
    coefficients = published_coefficients(state, config)
    memory = (tuple(state.memory.rls), *state.memory[1:])
    fast = jit_arguments(published.PublishedCoefficients, coefficients)
    slow = uncompiled(published.PublishedCoefficients, coefficients)
    for values in rows:
        result = published.update_published(*values, memory, fast)
        assert_same(result, plain(published.update_published)(*values, memory, slow))
        memory = result[1]
        assert_same(result[2], published.published_outputs(*values[:3], memory, fast))


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(st.integers(0, 999), st.integers(1, 256), st.floats(1e-3, 0.1), st.floats(1e-4, 1.0))
def test_the_detector_is_the_same_compiled_and_plain(seed, filled, noise, dt_s):
    rng, bank = np.random.default_rng(seed), filter_bank()
    learned = (noise**2 * rng.random(6), rng.integers(0, 900, 6).astype(float), rng.random(6))
    signals = noise * rng.standard_normal(256), 0.01 * rng.standard_normal(256)
    for newest in rng.random((5, 2)).tolist():
        limits = (dt_s, 3600.0, 0.03, 4.0 / dt_s)
        values = (signals, tuple(newest), filled, learned, bank.filters, bank[1:], limits)
        result, expected = update_slope_change(*values), plain(update_slope_change)(*values)
        # The filters' outputs are small differences of large forces.
        for one, other in zip(flat(result), flat(expected), strict=True):
            assert one == pytest.approx(other, rel=1e-9, abs=1e-12)
        signals, _, learned = result


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
        sample = (place, 2.5e-3, pull, 1e-3)
        assert identifier.update(*sample) == twin.update(*sample)
    assert ruptures


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
def test_without_a_rupture_there_is_none_to_undo(config):
    identifier = Identifier(config)
    for _ in range(3):
        identifier.update(0.0, 0.0, 0.0, 1e-3)
        with pytest.raises(NoRuptureError, match="no rupture"):
            identifier.undo_rupture()
