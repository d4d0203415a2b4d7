"""Friction of the joint bearings: it holds at rest, opposes motion, and looks like a force."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.signal import lfilter

from groundtruth import PLANT_MODELS, simulate
from groundtruth.bearing_friction import (
    STRIBECK_PEAK,
    BearingFriction,
    PRESLIDING_rad,
    STRIBECK_SPEED_rad_s,
)
from groundtruth.materials import gel
from groundtruth.motion import Motion, chain_strokes
from groundtruth.plant_model import TICK_s
from groundtruth.scenarios import Scenario

IDEAL = PLANT_MODELS["ideal"]
LIMIT_Nm = np.array([176.0, 176.0, 100.0, 100.0, 100.0, 38.0, 38.0])
COULOMB = 1e-3
LEVEL_Nm = COULOMB * LIMIT_Nm
STEP_s = 2.5e-4
GAIN_PER_S = 50.0


def bearings(**change):
    model = replace(IDEAL, joint_coulomb=COULOMB, **change)
    return BearingFriction(model, LIMIT_Nm, np.random.default_rng(0))


def pushed(friction, push_Nm, inertia, seconds):
    """Angles of free joints under a constant torque, Euler steps as long as the plant's."""
    q, dq, angles = np.zeros(7), np.zeros(7), []
    for _ in range(round(seconds / STEP_s)):
        # a little damping of the tissue's kind, so that the bristle does not ring for ever
        torque = push_Nm + friction.step(dq, STEP_s) - 0.5 * inertia * 40.0 * dq
        dq = dq + STEP_s * torque / inertia
        q = q + STEP_s * dq
        angles.append(q)
    return np.array(angles)


@pytest.mark.parametrize("share", [0.5, 0.95, 1.4])
def test_a_joint_at_rest_holds_a_load_below_the_peak_without_creeping(share):
    angles = pushed(bearings(), share * LEVEL_Nm, inertia=1.0, seconds=20.0)
    assert np.abs(angles).max() < 20.0 * PRESLIDING_rad
    np.testing.assert_allclose(angles[-1], angles[len(angles) // 2], atol=1e-3 * PRESLIDING_rad)


def test_a_load_above_the_peak_breaks_loose():
    angles = pushed(bearings(), 1.6 * LEVEL_Nm, inertia=0.01, seconds=2.0)
    assert (angles[-1] > 100.0 * PRESLIDING_rad).all()


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(
    ("speed", "level"),
    [(1e-3, STRIBECK_PEAK), (STRIBECK_SPEED_rad_s, 1.0 + 0.5 / np.e), (1.0, 1.0)],
)
def test_sliding_friction_is_against_the_motion_at_the_level_of_its_speed(speed, level, direction):
    friction, dq = bearings(), np.full(7, direction * speed)
    for _ in range(round(20.0 * PRESLIDING_rad / (speed * STEP_s)) + 2):
        torque = friction.step(dq, STEP_s)
    np.testing.assert_allclose(torque, -direction * level * LEVEL_Nm, rtol=1e-3)


def test_a_bearing_driven_to_and_fro_takes_energy_out():
    friction, time = bearings(), np.arange(0.0, 4.0, STEP_s)
    for amplitude in (0.2 * PRESLIDING_rad, 5.0 * PRESLIDING_rad):
        dq = np.outer(amplitude * 2.0 * np.pi * np.cos(2.0 * np.pi * time), np.ones(7))
        torque = np.array([friction.step(row, STEP_s) for row in dq])
        work = STEP_s * (torque * dq)[len(time) // 2 :].sum(axis=0)
        assert (work < 0.0).all()


def test_sizes_of_single_joints_are_drawn_within_the_stated_factor():
    dq = np.ones(7)  # fast sliding, at once beyond presliding
    share = np.array(
        [
            -BearingFriction(
                replace(IDEAL, joint_coulomb=COULOMB, size_spread=2.0), LIMIT_Nm, rng
            ).step(dq, 1.0)
            / LEVEL_Nm
            for rng in map(np.random.default_rng, range(60))
        ]
    )
    assert 0.5 <= share.min() < 0.55
    assert 1.9 < share.max() <= 2.0
    assert np.median(share) == pytest.approx(1.0, rel=0.1)


def in_and_out():
    """One thin gel, 9 s."""
    moves = [("rest", 0.5, 0.0), ("quintic", 2.0, 0.01), ("cruise", 3.0, 0.016)]
    moves += [("rest", 0.5, 0.0), ("cruise", 3.0, -0.016), ("rest", 0.5, 0.0)]
    strokes = chain_strokes(-0.014, moves, ramp_fraction=0.2)
    names = ("tare_end_s", "insertion_end_s", "withdrawal_start_s", "withdrawal_end_s")
    ends = dict(zip(names, (stroke.end_s for stroke in strokes[1:5]), strict=True))
    layer = replace(gel(70), thickness_m=8e-3)
    motion = Motion(strokes=strokes, **ends)
    return Scenario(id="short", title="one thin gel", layers=(layer,), motion=motion)


@pytest.fixture(scope="module")
def run():
    patch = pytest.MonkeyPatch()
    patch.setitem(PLANT_MODELS, "ideal", replace(IDEAL, joint_coulomb=2e-4))
    yield simulate(in_and_out())
    patch.undo()


def filtered(torque_Nm):
    decay = np.exp(-GAIN_PER_S * TICK_s)
    return lfilter([1.0 - decay], [1.0, -decay], torque_Nm, axis=0)


def residual(run):
    """Momentum residual of the torque sensor's signal, by the rigid model of the true arm."""
    truth, model = run.truth, run.robot.model
    data = model.createData()
    rows = list(zip(truth.q_rad, truth.dq_rad_s, strict=True))
    momentum = np.array([pin.crba(model, data, q) @ dq for q, dq in rows])
    rate = np.array(
        [
            pin.computeCoriolisMatrix(model, data, q, dq).T @ dq
            - pin.computeGeneralizedGravity(model, data, q)
            for q, dq in rows
        ]
    )
    assert np.array_equal(run.signals.tau_Nm, truth.tau_Nm)
    return filtered(
        np.diff(momentum, axis=0) / TICK_s - truth.tau_Nm[:-1] - 0.5 * (rate[1:] + rate[:-1])
    )


def test_friction_opposes_the_links_motion_and_the_needle_keeps_its_path(run):
    truth = run.truth
    power = truth.joint_friction_Nm * truth.dq_rad_s
    # around a reversal the bristles give back what they stored
    assert power.sum(axis=0).max() < 0.0
    assert np.mean(power[np.abs(truth.speed_m_s) > 1e-3] <= 0.0) > 0.95
    wanted = run.scenario.motion.position_m(truth.t_s)
    assert np.abs(truth.depth_m - wanted).max() < 1e-4


def test_an_observer_takes_friction_for_an_external_torque(run):
    truth = run.truth
    seen, external = residual(run), filtered(truth.external_torque_Nm[:-1])
    friction = filtered(truth.joint_friction_Nm[:-1])
    assert np.abs(friction).max() > 0.02
    np.testing.assert_allclose(seen, external + friction, atol=1e-4)


def test_in_air_friction_looks_like_tissue_that_pushes_back_and_pulls_on_the_way_out(run):
    """Axial force of the residual by the pseudo-inverse of the transposed Jacobian."""
    truth, robot = run.truth, run.robot
    seen, data = residual(run), robot.create_data()

    def resistance_N(k):
        jacobian = pin.computeFrameJacobian(
            robot.model, data, truth.q_rad[k], robot.tool_frame_id, pin.LOCAL
        )
        return -(np.linalg.pinv(jacobian.T) @ seen[k])[2]

    inward, outward = np.searchsorted(truth.t_s, (1.5, run.scenario.motion.withdrawal_end_s - 0.7))
    assert truth.axial_N[[inward, outward]].tolist() == [0.0, 0.0]
    assert resistance_N(inward) > 0.05
    assert resistance_N(outward) < -0.05
