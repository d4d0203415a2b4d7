"""Perturbed worlds: drawn from the seed, and what they change."""

import numpy as np
import pytest

from benchmarks.insertion.perturbations import (
    GROUPS,
    MIXED,
    PERTURBATIONS,
    perturbed,
)
from benchmarks.insertion.robustness import perturbed_needle
from groundtruth import scenario
from tests.benchmarks.benchmark_cases import gel_slice

BRIEF = gel_slice(25, thickness_m=10e-3, speed_m_s=10e-3)
ARM_ONLY = {name for group in ("pushes", "torque", "tare") for name in GROUPS[group]}
"""Of these the needle without an arm feels nothing."""


@pytest.mark.parametrize("name", [*PERTURBATIONS, MIXED])
def test_a_perturbation_depends_on_the_seed_and_changes_something(name):
    chosen = scenario("stack-constant")
    world, names = perturbed(name, chosen, 1)
    plain, _ = perturbed("none", chosen, 1)

    assert (world, names) == perturbed(name, chosen, 1)
    assert (world == plain) == (name == "none")

    # Plants and a tare at rest have no size to draw.
    if name not in (*GROUPS["plants"], "tare-at-rest"):
        assert world != perturbed(name, chosen, 2)[0]
    # Whatever the hand does, it goes as deep, and the tare is done in free air.
    motion = world.scenario.motion

    reached_m = (motion.deepest_m, motion.position_m(motion.tare_end_s))
    assert reached_m == pytest.approx((chosen.motion.deepest_m, -5e-3))
    assert name not in ARM_ONLY or world.scenario.layers == chosen.layers


@pytest.mark.slow
def test_truth_is_relative_to_the_moving_tissue():
    still_signal, still_truth = perturbed_needle("none", BRIEF, 3)
    moved_signal, moved_truth = perturbed_needle("breathing", BRIEF, 3)
    difference_m = np.abs(moved_truth.depth_m - still_truth.depth_m)
    (rupture,) = moved_truth.ruptures
    onset_m = np.interp(rupture.onset_s, moved_truth.t_s, moved_truth.depth_m)

    assert np.allclose(still_signal.depth_m, moved_signal.depth_m, atol=1e-4)
    assert 0.5e-3 < difference_m.max() < 3e-3
    assert onset_m == pytest.approx(rupture.onset_m, abs=5e-5)
