"""What every sample asks for: the same compiled and plain, and compiled before the first sample."""

import math
from types import FunctionType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification import MULTILAYER, PUBLISHED, PUBLISHED_KV, Identifier
from identification import published_update as published
from identification.config import CheckConfig
from identification.errors import NoRuptureError
from identification.hypothesis_filter import (
    absorb,
    add_children,
    after_event,
    predict,
    regressor,
    shaft_mixture,
    weigh,
)
from identification.published_identifier import PublishedMethod, published_coefficients
from identification.sample_filter import SAMPLE_MEMORY, check_limits, take_sample
from identification.switching_update import switching_outputs, update_switching
from needleforce.jit import COMPILER

LIMITS = check_limits(CheckConfig())
KERNELS = [
    take_sample,
    update_switching,
    switching_outputs,
    regressor,
    predict,
    absorb,
    add_children,
    after_event,
    weigh,
    shaft_mixture,
    published.update_published,
    published.published_outputs,
    published.rerun_windows,
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


def flat(value):
    value = value.tolist() if isinstance(value, np.ndarray) else value
    return [x for part in value for x in flat(part)] if isinstance(value, tuple | list) else [value]


def assert_same(compiled, python, rel=1e-12):
    for one, other in zip(flat(compiled), flat(python), strict=True):
        assert type(one) is type(other)
        assert one == other or one == pytest.approx(other, rel=rel, abs=1e-12, nan_ok=True)


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
@given(samples, st.booleans(), st.booleans())
def test_the_sample_filter_is_the_same_compiled_and_plain(rows, is_spoilt, is_measured):
    fast, slow = np.zeros(SAMPLE_MEMORY), np.zeros(SAMPLE_MEMORY)
    for k, values in enumerate(rows):
        given_row = (*values[:2], math.nan, values[3]) if is_spoilt and k % 3 == 1 else values
        result = take_sample(*given_row, is_measured, fast, LIMITS)
        assert_same(result, plain(take_sample)(*given_row, is_measured, slow, LIMITS), rel=1e-9)
        assert_same(fast, slow, rel=1e-9)


@needs_compiler
@settings(deadline=None, max_examples=60)
@given(samples, st.sampled_from([PUBLISHED, PUBLISHED_KV]), st.floats(0.0, 500.0))
def test_the_published_update_is_the_same_compiled_and_plain(rows, config, cumulative):
    state = PublishedMethod(config).state._replace(cumulative_friction_Ns_per_m=cumulative)
    coefficients = published_coefficients(state, config)
    memory = state.memory[:]
    for values in rows:
        result = published.update_published(*values, memory, coefficients)
        assert_same(result, plain(published.update_published)(*values, memory, coefficients))
        memory = result[1]
        assert_same(result[2], published.published_outputs(*values[:3], memory, coefficients))


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
