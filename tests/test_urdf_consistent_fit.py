"""The nearest rigid body is a body, and no other body is nearer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from urdf.inertia import from_pseudo_inertia, is_consistent, nearest_body, pseudo_inertia

seeds = st.integers(0, 10**6)


def problem(seed):
    """A random answer, and a random quadratic cost spread over three decades."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(10, 10)) * np.logspace(0, -rng.uniform(0, 3), 10)
    return rng.normal(size=10), root


@given(seeds)
@settings(max_examples=50)
def test_answer_is_a_body(seed):
    assert is_consistent(nearest_body(*problem(seed)))


@given(seeds)
@settings(max_examples=50)
def test_no_body_is_nearer(seed):
    """Optimality on a cone: the gradient is orthogonal to the answer and dual to the cone."""
    solution, root = problem(seed)
    body = nearest_body(solution, root)
    gradient = root.T @ root @ (body - solution)
    scale = np.linalg.norm(root @ solution) ** 2
    assert abs(gradient @ body) < 1e-5 * scale
    directions = np.random.default_rng(seed).normal(size=(200, 4))
    slopes = [gradient @ from_pseudo_inertia(np.outer(v, v)) / (v @ v) for v in directions]
    size = np.trace(pseudo_inertia(body))
    assert min(slopes) * size > -1e-5 * scale


def test_a_body_stays_where_it_is():
    inside = from_pseudo_inertia(np.diag([0.2, 0.3, 0.4, 1.0]))
    assert nearest_body(inside, np.eye(10)) == pytest.approx(inside, abs=1e-6)


def test_directions_without_data_are_settled_all_the_same():
    """Mass and first moments alone: any inertia large enough will do, and one is found."""
    root = np.diag([1.0] * 4 + [0.0] * 6)
    answer = np.array([2.0, 0.3, -0.2, 0.5, 0, 0, 0, 0, 0, 0])
    body = nearest_body(answer, root)
    assert is_consistent(body)
    assert body[:4] == pytest.approx(answer[:4], abs=1e-4)
