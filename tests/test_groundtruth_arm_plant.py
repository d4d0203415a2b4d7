import mujoco
import numpy as np
import pinocchio as pin
import pytest

from groundtruth.arm_plant import ArmPlant, TICK_s, TissueContact, arm_mjcf, lwr_bodies
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.tissue import TissueForce
from urdf import NeedleTool

GRAVITY = 9.80665
DOWN = np.array([0.1677, 0.4453, 0.3109, -1.4346, -0.1379, 1.2831, 0.0482])
PUSH_N = 2.5


class Push:
    """Tissue that pushes back with a constant force, whatever the needle does."""

    layers = (object(),)
    interfaces = ()

    def __init__(self, force_N):
        self.force_N = force_N

    def step(self, depth_m, speed_m_s, dt_s):
        return TissueForce(self.force_N, self.force_N, 0.0, 1, (0.0,))


def bodies_of(level):
    return lwr_bodies(NeedleTool(), PLANT_MODELS[level], np.random.default_rng(3))


def plant_with(bodies, force_N):
    contact = TissueContact(
        law=Push(force_N),
        surface_in_base_m=np.zeros(3),
        axis_in_base=np.array([0.0, 0.0, -1.0]),
    )
    return ArmPlant(bodies, contact)


def tip_push(bodies, q, force_N):
    """Joint torque of a force along the needle, against it."""
    jacobian = pin.computeFrameJacobian(
        bodies.robot.model, bodies.robot.create_data(), q, bodies.robot.tool_frame_id
    )
    return jacobian.T @ np.array([0.0, 0.0, -force_N, 0.0, 0.0, 0.0])


def tick_at_rest(bodies, q, force_N):
    model = bodies.model()
    gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
    plant = plant_with(bodies, force_N)
    plant.place(q, np.zeros(7))
    plant.tick(gravity - tip_push(bodies, q, force_N))
    return plant


@pytest.mark.parametrize("level", PLANT_MODELS)
def test_mujoco_and_pinocchio_agree_on_the_dynamics(level):
    bodies = bodies_of(level)
    model = bodies.model()
    physics = mujoco.MjModel.from_xml_string(arm_mjcf(bodies, TICK_s))
    state = mujoco.MjData(physics)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q, dq, ddq = rng.uniform(-1.5, 1.5, (3, 7))
        state.qpos, state.qvel, state.qacc = q, dq, ddq
        mujoco.mj_inverse(physics, state)
        expected = pin.rnea(model, model.createData(), q, dq, ddq)
        np.testing.assert_allclose(state.qfrc_inverse, expected, atol=1e-9)


def test_physics_has_nothing_but_rigid_bodies():
    physics = mujoco.MjModel.from_xml_string(arm_mjcf(bodies_of("degraded"), TICK_s))
    assert physics.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    assert not physics.jnt_limited.any()
    for loss in (physics.dof_damping, physics.dof_armature, physics.dof_frictionloss):
        assert not loss.any()
    assert physics.ngeom == 0


@pytest.mark.parametrize("level", PLANT_MODELS)
def test_ft_sensor_at_rest_reads_the_weight_beyond_it(level):
    bodies = bodies_of(level)
    needle = bodies.needle
    rng = np.random.default_rng(2)
    for q in (DOWN, *rng.uniform(-1.5, 1.5, (5, 7))):
        plant = tick_at_rest(bodies, q, 0.0)
        data = bodies.robot.create_data()
        pin.framesForwardKinematics(bodies.robot.model, data, q)
        sensor = data.oMf[bodies.robot.frame_id("ft_sensor")]
        weight = sensor.rotation.T @ np.array([0.0, 0.0, -GRAVITY * needle.mass])
        expected = [*weight, *np.cross(needle.lever, weight)]
        np.testing.assert_allclose(plant.ft_wrench, expected, atol=1e-9)


def test_hanging_needle_pulls_the_sensor_outward():
    plant = tick_at_rest(bodies_of("ideal"), DOWN, 0.0)
    assert plant.ft_wrench[2] == pytest.approx(0.068 * GRAVITY, abs=1e-6)


def test_tissue_that_pushes_back_lowers_the_reading_by_its_force():
    bodies = bodies_of("ideal")
    pushed = tick_at_rest(bodies, DOWN, PUSH_N).ft_wrench
    free = tick_at_rest(bodies, DOWN, 0.0).ft_wrench
    np.testing.assert_allclose(pushed - free, [0, 0, -PUSH_N, 0, 0, 0], atol=1e-6)


def test_tissue_force_acts_on_the_joints_through_the_tip():
    bodies = bodies_of("clean")
    plant = tick_at_rest(bodies, DOWN, PUSH_N)
    np.testing.assert_allclose(plant.dq_rad_s, 0.0, atol=1e-12)
    np.testing.assert_allclose(
        -PUSH_N * plant.axial_jacobian, tip_push(bodies, plant.q_rad, PUSH_N), atol=1e-9
    )
    assert plant.mean_axial_N == PUSH_N


def test_pushed_arm_without_counter_torque_moves_back_out():
    bodies = bodies_of("ideal")
    model = bodies.model()
    plant = plant_with(bodies, PUSH_N)
    plant.place(DOWN, np.zeros(7))
    before = plant.depth_m
    for _ in range(50):
        plant.tick(pin.computeGeneralizedGravity(model, model.createData(), plant.q_rad.copy()))
    assert plant.depth_m < before - 1e-4


# The Jacobian of the tick's start serves the whole tick: push times lever times turn is 3e-5 Nm
# when the arm is as slow as in tissue.
@pytest.mark.parametrize(("speed_rad_s", "push_N"), [(0.5, 0.0), (0.02, PUSH_N)])
def test_a_held_torque_changes_momentum_by_its_impulse(speed_rad_s, push_N):
    bodies = bodies_of("degraded")
    model = bodies.model()
    data = model.createData()
    rng = np.random.default_rng(4)
    plant = plant_with(bodies, push_N)

    def momentum_and_rate():
        q, dq = plant.q_rad.copy(), plant.dq_rad_s.copy()
        momentum = pin.crba(model, data, q) @ dq
        coriolis = pin.computeCoriolisMatrix(model, data, q, dq).T @ dq
        return momentum, coriolis - pin.computeGeneralizedGravity(model, data, q)

    plant.place(rng.uniform(-1.0, 1.0, 7), speed_rad_s * rng.uniform(-1.0, 1.0, 7))
    torque = pin.computeGeneralizedGravity(model, data, plant.q_rad.copy())
    before, rate_before = momentum_and_rate()
    jacobian_before = plant.axial_jacobian
    plant.tick(torque)
    after, rate_after = momentum_and_rate()
    external = -push_N * 0.5 * (jacobian_before + plant.axial_jacobian)
    mean = torque + 0.5 * (rate_before + rate_after) + external
    np.testing.assert_allclose((after - before) / TICK_s, mean, atol=3e-5)
