"""The shipped LWR 4+ against published tables, an independent URDF reader, and physics."""

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from urdf import NeedleTool, Payload, example_robot_path, load_lwr

TWISTED = (0.3, -0.4, 0.5, 1.2, -0.7, 0.9, 0.2)
# Posture: flange [m], gravity torque [Nm], diagonal of the mass matrix [kg m^2] of the nominal set.
NOMINAL = {
    (0, np.pi / 2, 0, 0, 0, 0, 0): (
        (-0.868, 0, 0.310),
        (0, -47.26269, -0.40047, 13.36232, -0.40499, -0.27845, -0.00638),
        (2.81117, 2.79650, 0.01962, 0.44063, 0.00654, 0.00373, 0.00012),
    ),
    (0, 0.5, 0, -1.5, 0, 1.0, 0): (
        (-0.55740, 0, 0.42152),
        (0, -28.15809, -0.19199, 11.92495, -0.36825, -0.04476, -0.00090),
        (1.12875, 1.75089, 0.43976, 0.43082, 0.00718, 0.00373, 0.00012),
    ),
    TWISTED: (
        (0.44432, 0.37020, 0.73836),
        (0, 24.88039, 2.46595, -13.02646, 0.46121, 0.15051, 0.00480),
        (1.01529, 1.98551, 0.38546, 0.43309, 0.00710, 0.00373, 0.00012),
    ),
}


@pytest.fixture(scope="module")
def arm():
    return load_lwr()


@pytest.fixture(scope="module")
def drawing():
    path = str(example_robot_path("lwr4plus"))
    return yourdfpy.URDF.load(path, build_collision_scene_graph=True)


def pose(robot, q, frame="flange"):
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, np.array(q, dtype=float))
    return data.oMf[robot.frame_id(frame)]


@pytest.mark.parametrize("q", NOMINAL)
def test_flange_gravity_and_inertia_are_those_of_the_nominal_set(arm, q):
    flange_m, gravity_Nm, inertia_kg_m2 = NOMINAL[q]
    data, angles = arm.create_data(), np.array(q, dtype=float)
    assert pose(arm, q).translation == pytest.approx(flange_m, abs=1e-5)
    gravity = pin.computeGeneralizedGravity(arm.model, data, angles)
    assert gravity == pytest.approx(gravity_Nm, abs=1e-3)
    assert np.diag(pin.crba(arm.model, data, angles)) == pytest.approx(inertia_kg_m2, abs=1e-4)


@pytest.mark.filterwarnings("ignore::DeprecationWarning:yourdfpy")
def test_yourdfpy_finds_the_description_valid(drawing):
    assert drawing.validate()
    assert drawing.errors == []


def test_forward_kinematics_agree_with_yourdfpy(arm, drawing):
    rng = np.random.default_rng(5)
    for _ in range(20):
        q = rng.uniform(arm.position_lower_rad, arm.position_upper_rad)
        drawing.update_cfg(q)
        expected = drawing.get_transform("flange", "lwr_base")
        assert pose(arm, q).homogeneous == pytest.approx(expected, abs=1e-9)


def test_every_moving_link_is_drawn_as_high_as_the_arm_is(drawing):
    drawing.update_cfg(np.zeros(7))
    for scene in (drawing.scene, drawing.collision_scene):
        low, high = scene.bounds
        assert low[2] == pytest.approx(0.0, abs=1e-6)
        assert high[2] == pytest.approx(1.178, abs=1e-6)
        assert np.all(high[:2] - low[:2] < 0.3)
    drawn = {link.name for link in drawing.robot.links if link.visuals and link.collisions}
    assert {f"lwr_link_{i}" for i in range(1, 8)} <= drawn


def test_every_link_inertia_is_one_a_body_can_have(drawing):
    moving = [link for link in drawing.robot.links if link.inertial is not None]
    assert len(moving) == 7
    for link in moving:
        first, second, third = np.linalg.eigvalsh(link.inertial.inertia)
        assert first > 0.0
        assert first + second > third
    assert sum(link.inertial.mass for link in moving) == pytest.approx(14.0503)


def test_limits_and_names_are_those_of_the_data_sheet(arm):
    assert arm.joint_names == tuple(f"lwr_joint_{i}" for i in range(1, 8))
    assert np.degrees(arm.position_upper_rad) == pytest.approx([170, 120, 170, 120, 170, 120, 170])
    assert arm.position_lower_rad == pytest.approx(-arm.position_upper_rad)
    velocity_deg_s = [100, 110, 100, 128, 130, 180, 180]
    assert np.degrees(arm.velocity_limit_rad_s) == pytest.approx(velocity_deg_s)
    assert arm.effort_limit_Nm == pytest.approx([176, 176, 100, 100, 100, 38, 38])
    assert arm.gravity_m_s2 == pytest.approx([0, 0, -9.80665])
    assert load_lwr(gravity_m_s2=[9.80665, 0, 0]).gravity_m_s2 == pytest.approx([9.80665, 0, 0])
    assert arm.tool_frame == arm.flange_frame == "flange"
    assert arm.payload is None
    frame = arm.model.frames[arm.frame_id("flange")]
    assert frame.parentJoint == 7
    assert frame.placement.isIdentity()


def test_mass_matrix_is_positive_definite_over_the_workspace(arm):
    rng = np.random.default_rng(7)
    data = arm.create_data()
    for _ in range(200):
        q = rng.uniform(arm.position_lower_rad, arm.position_upper_rad)
        assert np.linalg.eigvalsh(pin.crba(arm.model, data, q))[0] > 1e-5


def test_needle_tool_brings_its_frames_and_its_weight(arm):
    tool = NeedleTool()
    robot = load_lwr(payload=tool)
    assert robot.tool_frame == "needle_tip"
    flange, tip, sensor = (pose(robot, TWISTED, n) for n in ("flange", "needle_tip", "ft_sensor"))
    assert flange.actInv(tip).translation == pytest.approx(tool.tip_in_flange_m)
    assert flange.actInv(sensor).translation == pytest.approx([0, 0, tool.sensor_height_m])
    assert tip.rotation == pytest.approx(flange.rotation)
    added = pin.computeTotalMass(robot.model) - pin.computeTotalMass(arm.model)
    assert added == pytest.approx(0.304)


def test_a_payload_acts_at_its_centre_of_mass(arm):
    """Gravity torque grows by J^T m g taken at the payload's centre of mass."""
    payload = Payload(mass_kg=1.3, com_m=[0.02, -0.03, 0.1], inertia_kg_m2=np.zeros((3, 3)))
    q, data, loaded = np.array(TWISTED), arm.create_data(), load_lwr(payload)
    torque = [pin.computeGeneralizedGravity(r.model, r.create_data(), q) for r in (arm, loaded)]
    pin.computeJointJacobians(arm.model, data, q)
    jacobian = pin.computeFrameJacobian(
        arm.model, data, q, arm.tool_frame_id, pin.ReferenceFrame.LOCAL
    )
    at_com = pin.SE3(np.eye(3), payload.com_m.copy()).toActionMatrixInverse() @ jacobian
    lifting = (pose(arm, q).rotation @ at_com[:3]).T @ np.array([0, 0, 1.3 * 9.80665])
    assert torque[1] - torque[0] == pytest.approx(lifting, abs=1e-9)
