"""Tissue that breathes freely: what is not known is not stated as known."""

from dataclasses import replace

import numpy as np
import pytest

from groundtruth import insert_needle, random_stack
from groundtruth.motion import constant_motion
from groundtruth.scenarios import TissueMotion, Wave
from identification import Identifier, TissueWarning


def breathing(breath_m, hz, speed_m_s, seed):
    """The identifier after an insertion into tissue that breathes, and its estimates.

    The breath is from peak to peak; 0 for none.
    """
    stack = random_stack(np.random.default_rng(seed))
    depth_m = min(sum(layer.thickness_m for layer in stack.layers) + 5e-3, 40e-3)
    motion = constant_motion(
        speed_m_s=speed_m_s, depth_m=depth_m, standoff_m=5e-3 + breath_m
    )
    waves = (Wave(0.5 * breath_m, hz, 1.0),) if breath_m else ()
    tissue_motion = TissueMotion(waves=waves) if waves else None
    scenario = replace(stack, motion=motion, tissue_motion=tissue_motion)
    run = insert_needle(scenario, seed=seed, rate_hz=250.0)
    identifier = Identifier()
    rows = (run.t_s > run.tare_end_s) & (run.t_s < motion.withdrawal_start_s)
    columns = zip(
        run.depth_m[rows].tolist(),
        run.speed_m_s[rows].tolist(),
        run.force_N[rows].tolist(),
        strict=True,
    )
    estimates = [identifier.update(*sample, 4e-3) for sample in columns]
    frictions_N = -run.truth.axial_N[rows].min()
    return identifier, estimates, frictions_N


@pytest.mark.slow
@pytest.mark.parametrize(
    ("breath_m", "hz", "speed_m_s", "seed"),
    [(7e-3, 0.25, 2e-3, 2), (15e-3, 0.22, 3e-3, 7)],
)
def test_no_layer_is_final_in_tissue_that_breathes_and_friction_is_in_doubt(
    breath_m, hz, speed_m_s, seed
):
    identifier, estimates, friction_N = breathing(breath_m, hz, speed_m_s, seed)
    last = estimates[-1]

    assert TissueWarning.TISSUE_MOVES in last.warnings
    assert not any(layer.is_final for layer in identifier.layers)
    assert not last.friction_identified
    # The pull of the tissue is friction of the whole shaft, less what acts otherwise.
    assert last.shaft_friction_std_N > 0.5 * friction_N
    for layer in identifier.layers:
        assert layer.friction_std_N > 0.3 * friction_N
        assert not layer.friction_identified
        assert not layer.stiffness_identified


def test_tissue_at_rest_does_not_move():
    identifier, estimates, _ = breathing(0.0, 0.25, 4e-3, 2)

    assert all(not estimate.warnings for estimate in estimates)
    assert any(layer.is_final for layer in identifier.layers)
