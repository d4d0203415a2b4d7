"""The realistic tissue: ruptures, withdrawal, re-insertion, rest, and independence of the step."""

import numpy as np
import pytest

from groundtruth.errors import TissueError
from groundtruth.layers import Layer, Membrane, ShaftFriction
from groundtruth.materials import BOVINE_CAPSULE, GEL_TIP_FORCE_N, bovine_liver, gel
from groundtruth.scenarios import SCENARIOS
from groundtruth.tissue import UNLOADING_M, Tissue

SPEED = 2.3e-3
TABLE_I_N = {25: 113.0 * SPEED, 50: 283.0 * SPEED, 70: 534.0 * SPEED}


def advance(law, start_m, end_m, speed_m_s=SPEED, dt_s=1e-3):
    """Forces along a straight stretch at constant speed, first sample one step in."""
    steps = max(round(abs(end_m - start_m) / (speed_m_s * dt_s)), 1)
    depths = np.linspace(start_m, end_m, steps + 1)[1:]
    v = float(np.sign(end_m - start_m)) * speed_m_s
    return depths, [law.step(float(z), v, dt_s) for z in depths]


@pytest.mark.parametrize("percent", [25, 50, 70])
def test_friction_after_exit_is_table_i(percent):
    layer = gel(percent)
    _, forces = advance(Tissue((layer,)), -2e-3, layer.thickness_m + 5e-3)
    assert forces[-1].tip_N == 0.0
    assert forces[-1].axial_N == pytest.approx(TABLE_I_N[percent], rel=0.01)
    assert forces[-1].layer == 2


def test_stack_friction_after_exit_is_the_sum_of_table_i_layer_by_layer():
    layers = (gel(25), gel(50), gel(70))
    _, forces = advance(Tissue(layers), -2e-3, 0.105)
    assert forces[-1].layer_friction_N == pytest.approx(list(TABLE_I_N.values()), rel=0.01)
    assert forces[-1].layer == 4


@pytest.mark.parametrize("percent", [25, 50, 70])
def test_tip_force_falls_from_the_exit_force_to_zero_within_the_release(percent):
    layer = gel(percent)
    depth, forces = advance(Tissue((layer,)), -2e-3, layer.thickness_m + 2e-3)
    tip = np.array([force.tip_N for force in forces])
    assert tip.max() == pytest.approx(GEL_TIP_FORCE_N[percent], rel=0.01)
    assert depth[tip.argmax()] == pytest.approx(layer.thickness_m, abs=1e-5)
    assert (tip[depth > layer.thickness_m + layer.release_m] == 0.0).all()
    inside = (depth > layer.thickness_m) & (depth < layer.thickness_m + layer.release_m)
    assert (np.diff(tip[inside]) < 0.0).all()


def test_withdrawal_is_friction_alone_and_mirrors_the_insertion():
    layer = gel(70)
    law = Tissue((layer,))
    depth_in, inward = advance(law, -2e-3, layer.thickness_m + 5e-3)
    depth_out, outward = advance(law, layer.thickness_m + 5e-3, -2e-3)
    assert all(force.tip_N == 0.0 for force in outward)
    friction_in = np.interp(depth_out, depth_in, [force.friction_N for force in inward])
    friction_out = np.array([force.axial_N for force in outward])
    slid = depth_out < layer.thickness_m + 3e-3
    assert friction_out[slid] == pytest.approx(-friction_in[slid], abs=0.01)


def test_withdrawal_force_is_proportional_to_the_length_still_embedded():
    layer = gel(50)
    law = Tissue((layer,))
    advance(law, -2e-3, layer.thickness_m + 5e-3)
    depth, outward = advance(law, layer.thickness_m + 5e-3, -2e-3)
    axial = np.array([force.axial_N for force in outward])
    inside = (depth > 1e-3) & (depth < layer.thickness_m - 1e-3)
    per_length = -axial[inside] / depth[inside]
    assert per_length == pytest.approx(np.full_like(per_length, per_length.mean()), rel=1e-6)
    assert (axial[depth < 0.0] == 0.0).all()


def test_reinsertion_meets_friction_only_until_the_deepest_point():
    law = Tissue((gel(70),))
    advance(law, -1e-3, 20e-3)
    advance(law, 20e-3, 5e-3)
    depth, again = advance(law, 5e-3, 22e-3)
    tip = np.array([force.tip_N for force in again])
    assert (tip[depth < 20e-3 - UNLOADING_M - 1e-5] == 0.0).all()
    assert tip[depth > 20e-3 + 1e-5].min() > 0.5
    assert (np.abs(np.diff(tip)) < 0.02).all()


@pytest.mark.parametrize("name", [name for name, item in SCENARIOS.items() if item.layers])
def test_tip_force_never_pulls_and_friction_never_drives(name):
    case = SCENARIOS[name]
    t = np.arange(0.0, case.motion.duration_s, 2e-3)
    law = case.new_tissue()
    z, v = case.motion.position_m(t), case.motion.speed_m_s(t)
    forces = [law.step(a, b, 2e-3) for a, b in zip(z.tolist(), v.tolist(), strict=True)]
    assert min(force.tip_N for force in forces) >= 0.0
    assert all(f.axial_N == pytest.approx(f.tip_N + f.friction_N, abs=1e-12) for f in forces)
    friction = np.array([force.friction_N for force in forces])
    power = friction * v
    # Presliding stores a little energy and returns it while the shaft turns round.
    turning_m = 3.0 * max(layer.friction.presliding_m for layer in case.layers)
    steady = np.abs(z - z.max()) > turning_m
    assert (power[steady] >= -1e-15).all()
    assert power.sum() > 0.0


def test_a_closed_cycle_inside_tissue_dissipates():
    law = Tissue((gel(70),))
    advance(law, -1e-3, 30e-3)
    work = 0.0
    for turn in range(6):
        start, end = (30e-3, 29.7e-3) if turn % 2 == 0 else (29.7e-3, 30e-3)
        depth, forces = advance(law, start, end, dt_s=1e-3)
        if turn >= 2:
            step = depth[1] - depth[0]
            work += step * sum(force.friction_N for force in forces)
    assert work > 0.0


@pytest.mark.parametrize("name", ["stack-glove-constant", "liver-constant", "abdomen-sinusoidal"])
def test_law_does_not_depend_on_the_step(name):
    case = SCENARIOS[name]
    axial = {}
    for substeps in (1, 4):
        dt = 1e-3 / substeps
        t = case.motion.tare_end_s + np.arange(0.0, 30.0, dt)
        law = case.new_tissue()
        z, v = case.motion.position_m(t), case.motion.speed_m_s(t)
        forces = [law.step(a, b, dt).axial_N for a, b in zip(z.tolist(), v.tolist(), strict=True)]
        axial[substeps] = np.array(forces[::substeps])
    count = min(map(len, axial.values()))
    assert axial[4][:count] == pytest.approx(axial[1][:count], abs=2e-4)


def test_rest_relaxes_the_tip_force_and_travel_restores_it():
    layer = bovine_liver()
    law = Tissue((layer,))
    _, before = advance(law, -1e-3, 25e-3)
    resting = [law.step(25e-3, 0.0, 1e-3) for _ in range(60_000)]
    held = resting[-1].tip_N / before[-1].tip_N
    assert held == pytest.approx(1.0 - layer.relaxed_share, abs=0.02)
    assert (np.diff([force.tip_N for force in resting]) <= 0.0).all()
    _, after = advance(law, 25e-3, 26.5e-3)
    assert after[-1].tip_N == pytest.approx(layer.tip_force_N(26.5e-3 - layer.entry_m), rel=0.02)


def test_liver_at_rest_holds_the_share_the_recordings_show():
    """De Jong 2017: at 85 mm the force falls to 0.37 (0.25-0.5) of itself within a minute."""
    friction = bovine_liver().friction
    thick = Layer(
        name="liver",
        thickness_m=0.2,
        exit_force_N=0.01,
        cutting_share=0.1,
        stiffening=0.0,
        release_m=5e-4,
        relaxed_share=bovine_liver().relaxed_share,
        friction=friction,
    )
    law = Tissue((thick,))
    _, moving = advance(law, 0.0, 85e-3, speed_m_s=5e-3)
    for _ in range(60_000):
        held = law.step(85e-3, 0.0, 1e-3)
    assert 0.85 < moving[-1].axial_N < 0.95
    assert 0.25 < held.axial_N / moving[-1].axial_N < 0.5
    assert held.axial_N > 0.3


def test_membrane_holds_back_the_layer_until_its_puncture():
    law = Tissue((bovine_liver(),))
    depth, forces = advance(law, -1e-3, BOVINE_CAPSULE.indentation_m + 3e-3)
    tip = np.array([force.tip_N for force in forces])
    intact = depth < BOVINE_CAPSULE.indentation_m
    assert all(force.layer == 0 for force, still in zip(forces, intact, strict=True) if still)
    assert all(
        force.friction_N == 0.0 for force, whole in zip(forces, intact, strict=True) if whole
    )
    assert tip.max() == pytest.approx(1.43, rel=0.02)
    assert forces[-1].layer == 1
    assert forces[-1].axial_N < 0.25 * tip.max()
    assert forces[-1].friction_N > 0.0


def test_shaft_enters_the_punctured_layer_gradually():
    law = Tissue((bovine_liver(),))
    depth, forces = advance(law, -1e-3, BOVINE_CAPSULE.indentation_m + 3e-3)
    friction = np.array([force.friction_N for force in forces])
    slope = bovine_liver().friction.sliding_N_per_m(SPEED)
    assert np.diff(friction).max() < 0.05 * friction[-1]
    assert friction[-1] == pytest.approx(slope * depth[-1], rel=0.03)


def test_intact_membrane_springs_back():
    law = Tissue((bovine_liver(),))
    _, pushed = advance(law, -1e-3, 8e-3)
    _, back = advance(law, 8e-3, 4e-3)
    assert pushed[-1].tip_N > back[-1].tip_N > 0.0
    assert back[-1].tip_N == pytest.approx(BOVINE_CAPSULE.force_N(4e-3), rel=0.02)


def test_inner_membrane_releases_both_forces_at_once():
    glove = Membrane(puncture_N=1.0, indentation_m=3e-3, hardening=0.5, release_m=5e-4)
    law = Tissue((gel(25), gel(50, membrane=glove)))
    boundary = law.interfaces[1]
    assert boundary.drop_N == pytest.approx(gel(25).exit_force_N + 1.0)
    depth, forces = advance(law, -1e-3, boundary.onset_m + 2e-3)
    tip = np.array([force.tip_N for force in forces])
    assert tip.max() == pytest.approx(boundary.drop_N, rel=0.01)
    assert depth[tip.argmax()] == pytest.approx(boundary.onset_m, abs=1e-5)


def test_reset_forgets_the_channel():
    law = Tissue((gel(70),))
    _, first = advance(law, -1e-3, 20e-3)
    law.reset()
    _, second = advance(law, -1e-3, 20e-3)
    assert [force.axial_N for force in first] == [force.axial_N for force in second]


def test_free_air_gives_no_force():
    law = Tissue(())
    assert law.step(0.01, 1e-3, 1e-3).axial_N == 0.0
    assert law.interfaces == ()


@pytest.mark.parametrize(
    "sample",
    [
        (float("nan"), 0.0, 1e-3),
        (0.0, float("inf"), 1e-3),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, -1e-3),
        (0.0, 0.0, float("nan")),
    ],
)
def test_unusable_sample_is_refused_and_leaves_the_state(sample):
    law = Tissue((gel(25),))
    advance(law, -1e-3, 5e-3)
    before = law.state
    with pytest.raises(TissueError, match="state is unchanged"):
        law.step(*sample)
    assert law.state is before


def test_sliding_friction_is_odd_in_speed():
    friction = ShaftFriction(
        coulomb_N_per_m=10.0,
        viscous_Ns_per_m2=1000.0,
        presliding_m=1e-4,
        reference_speed_m_s=SPEED,
    )
    assert friction.sliding_N_per_m(-SPEED) == -friction.sliding_N_per_m(SPEED)
    assert friction.sliding_N_per_m(0.0) == 0.0
