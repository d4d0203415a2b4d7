"""Layers and membranes, and the laws of tissue: ruptures, withdrawal, rest, equation
(3)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth import (
    BOVINE_CAPSULE,
    BOVINE_LIVER,
    GLOVE,
    ShaftFriction,
    Tissue,
    TissueError,
    gel,
)
from groundtruth.tissue import bristle_step

SPEED = 2.3e-3
EXIT_N = {25: 0.30, 50: 0.75, 70: 1.40}
TABLE_I_N = {25: 113.0 * SPEED, 50: 283.0 * SPEED, 70: 534.0 * SPEED}

fractions = st.floats(0.0, 1.0)


def test_tip_force_rises_to_the_exit_force():
    for layer in (gel(25), gel(70, membrane=GLOVE), BOVINE_LIVER):
        penetration = np.linspace(0.0, layer.thickness_m - layer.entry_m, 500)
        force = [layer.tip_force_N(float(p)) for p in penetration]
        assert (force[0], force[-1]) == (0.0, pytest.approx(layer.exit_force_N))
        assert (np.diff(force) > 0.0).all()
    cutting = replace(gel(50), cutting_fraction=1.0)
    forces = [cutting.tip_force_N(depth_m) for depth_m in (0.5e-3, 0.01)]

    assert forces == pytest.approx([0.75 * cutting.exit_force_N, cutting.exit_force_N])


@given(force=st.floats(0.1, 100.0), speed=st.floats(1e-4, 0.1), fraction=fractions)
def test_calibrated_friction_is_measured_one_at_reference_speed(force, speed, fraction):
    friction = ShaftFriction.calibrated(
        force_N_per_m=force,
        reference_speed_m_s=speed,
        presliding_m=1e-4,
        coulomb_fraction=fraction,
    )
    forces = [friction.sliding_N_per_m(v) for v in (speed, 0.0, -speed)]

    assert forces == [pytest.approx(force), 0.0, -forces[0]]
    assert friction.equivalent_viscous_Ns_per_m2 * speed == pytest.approx(force)


@pytest.mark.parametrize(
    ("layer", "change", "word"),
    [
        (gel(50), {"thickness_m": 0.0}, "thickness_m"),
        (gel(50), {"release_m": 0.0}, "release_m"),
        (gel(50), {"exit_force_N": 0.0}, "exit_force_N"),
        (BOVINE_LIVER, {"thickness_m": 12e-3}, "thicker"),
    ],
)
def test_what_no_tissue_has_is_refused_by_name(layer, change, word):
    with pytest.raises(TissueError, match=word):
        replace(layer, **change)


def advance(law, start_m, end_m, speed_m_s=SPEED):
    """Depths and forces along a stretch at constant speed, first sample one step in."""
    steps = max(round(abs(end_m - start_m) / (speed_m_s * 1e-3)), 1)
    depths = np.linspace(start_m, end_m, steps + 1)[1:]
    v = float(np.sign(end_m - start_m)) * speed_m_s
    return depths, [law.step(float(z), v, 1e-3) for z in depths]


def tips(forces):
    return np.array([force.tip_N for force in forces])


@given(
    bristle=st.floats(-1.0, 1.0),
    travel=st.floats(-0.1, 0.1),
    dt=st.floats(1e-6, 10.0),
    length=st.floats(1e-5, 1e-2),
    fraction=fractions,
)
def test_bristle_step_is_bounded_and_exact(bristle, travel, dt, length, fraction):
    after = bristle_step(bristle, travel, dt, length, fraction)
    once = bristle_step(bristle, travel, 1e-3, length, 0.0)
    half = bristle_step(bristle, travel / 2, 5e-4, length, 0.0)
    twice = bristle_step(half, travel / 2, 5e-4, length, 0.0)

    assert -1.0 - 1e-12 <= after <= 1.0 + 1e-12
    assert abs(bristle) > 1.0 - fraction or (after - bristle) * travel >= 0.0
    assert twice == pytest.approx(once, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("percent", TABLE_I_N)
def test_tip_force_is_released_and_withdrawal_is_friction(
    percent,
):
    layer = gel(percent)
    end_m = layer.thickness_m
    law = Tissue((layer,))
    depth_in, inward = advance(law, -2e-3, end_m + 5e-3)
    depth, outward = advance(law, end_m + 5e-3, -2e-3)
    tip = tips(inward)
    is_released = (depth_in > end_m) & (depth_in < end_m + layer.release_m)
    friction_in = np.interp(depth, depth_in, [force.friction_N for force in inward])
    axial = np.array([force.axial_N for force in outward])
    slid = depth < end_m + 3e-3
    inside = (depth > 1e-3) & (depth < end_m - 1e-3)
    per_length = axial[inside] / depth[inside]

    assert (tip.max(), depth_in[tip.argmax()], inward[-1].axial_N) == (
        pytest.approx(EXIT_N[percent], rel=0.01),
        pytest.approx(end_m, abs=1e-5),
        pytest.approx(TABLE_I_N[percent], rel=0.01),
    )
    assert (np.diff(tip[is_released]) < 0.0).all()
    assert not tip[depth_in > end_m + layer.release_m].any()
    assert axial[slid] == pytest.approx(-friction_in[slid], abs=0.01)
    assert per_length.min() == pytest.approx(per_length.max(), rel=1e-6)
    assert not np.append(tips(outward), axial[depth < 0.0]).any()


def test_reinsertion_meets_friction_only_until_the_deepest_point():
    law = Tissue((gel(70),))
    advance(law, -1e-3, 20e-3)
    advance(law, 20e-3, 5e-3)
    depth, again = advance(law, 5e-3, 22e-3)
    tip = tips(again)

    assert (tip[depth < 19.49e-3] == 0.0).all()
    assert tip[depth > 20e-3 + 1e-5].min() > 0.5
    assert (np.abs(np.diff(tip)) < 0.02).all()


@pytest.mark.slow
def test_rest_relaxes_the_force_and_travel_restores():
    layer = BOVINE_LIVER
    law = Tissue((layer,))
    _, inserted = advance(law, -1e-3, 25e-3)
    resting = [law.step(25e-3, 0.0, 1e-3) for _ in range(60_000)]
    held = resting[-1].tip_N / inserted[-1].tip_N
    _, advanced = advance(law, 25e-3, 26.5e-3)

    assert held == pytest.approx(1.0 - layer.relaxed_fraction, abs=0.02)
    assert (np.diff(tips(resting)) <= 0.0).all()
    assert advanced[-1].tip_N == pytest.approx(
        layer.tip_force_N(26.5e-3 - layer.entry_m), rel=0.02
    )


def test_membrane_delays_the_layer_and_its_friction():
    depth, forces = advance(
        Tissue((BOVINE_LIVER,)), -1e-3, BOVINE_CAPSULE.indentation_m + 3e-3
    )
    friction = np.array([force.friction_N for force in forces])
    layer = np.array([force.layer for force in forces])
    is_cut = depth >= BOVINE_CAPSULE.indentation_m
    slope = BOVINE_LIVER.friction.sliding_N_per_m(SPEED)

    assert not np.append(layer, friction)[np.tile(~is_cut, 2)].any()
    assert layer[-1] == 1
    assert tips(forces).max() == pytest.approx(1.43, rel=0.02)
    assert 0.0 < forces[-1].axial_N < 0.25 * tips(forces).max()
    assert np.diff(friction).max() < 0.05 * friction[-1]
    assert friction[-1] == pytest.approx(slope * depth[-1], rel=0.03)


def test_air_and_refused_samples_change_nothing():
    assert Tissue(()).step(0.01, 1e-3, 1e-3).axial_N == 0.0

    tissue = Tissue((gel(25),))
    twin = Tissue((gel(25),))
    for law in (tissue, twin):
        advance(law, -1e-3, 5e-3)
    for sample in ((np.nan, 0.0, 1e-3), (0.0, np.inf, 1e-3), (0.0, 0.0, 0.0)):
        with pytest.raises(TissueError, match="unchanged"):
            tissue.step(*sample)

    assert tissue.step(6e-3, SPEED, 1e-3) == twin.step(6e-3, SPEED, 1e-3)
