"""Random stacks: within their documented ranges, reproducible, runnable."""

import numpy as np
import pytest

from groundtruth import insert_needle, random_stack
from groundtruth.materials import TABLE_I_SPEED_M_S

STACKS = [random_stack(np.random.default_rng(seed)) for seed in range(200)]
NEEDLE_M = 0.153


def test_seed_decides_everything():
    assert random_stack(np.random.default_rng(7)) == random_stack(np.random.default_rng(7))
    assert random_stack(np.random.default_rng(7)) != random_stack(np.random.default_rng(8))


def test_all_numbers_of_layers_both_motions_and_membranes_occur():
    assert {len(stack.layers) for stack in STACKS} == {1, 2, 3, 4}
    kinds = {stack.motion.strokes[4].profile for stack in STACKS}
    assert kinds == {"cruise", "cosine"}
    with_membrane = np.mean([layer.membrane is not None for s in STACKS for layer in s.layers])
    assert with_membrane == pytest.approx(0.25, abs=0.1)


def test_needle_is_long_enough_and_goes_beyond():
    for stack in STACKS:
        assert stack.motion.deepest_m - stack.thickness_m >= 10e-3
        assert stack.motion.deepest_m < NEEDLE_M


def test_friction_is_physical_at_the_papers_speed():
    for layer in (layer for stack in STACKS for layer in stack.layers):
        assert 1.0 < layer.friction.sliding_N_per_m(TABLE_I_SPEED_M_S) < 60.0


def test_runs_are_finite_rupture_at_every_boundary_and_end_outside():
    for stack in STACKS[:6]:
        run = insert_needle(stack, rate_hz=200.0)
        boundaries = [b for b in stack.new_tissue().interfaces if b.drop_N > 0.0]
        assert np.isfinite(run.force_N).all()
        assert len(run.truth.ruptures) == len(boundaries)
        assert run.truth.axial_N[-1] == 0.0
        assert run.truth.axial_N.max() < 15.0
