"""The shipped arms against published tables, makers' tables, another URDF reader, and physics."""

from importlib import metadata

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from urdf import (
    MissingPackageError,
    NeedleTool,
    Payload,
    UnknownNameError,
    example_robot_path,
    load_example,
    load_lwr,
    load_urdf,
)

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

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
NAMES = ["panda", "ur3", "ur5", "ur10", "xarm7", "ur5e", "ur10e", "lwr4plus"]
UR_TABLES = {
    "ur5e": ([0.1625, 0.1333, 0.0997, 0.0996], [-0.425, -0.3922], 17.7, [150] * 3 + [28] * 3),
    "ur10e": (
        [0.1807, 0.17415, 0.11985, 0.11655],
        [-0.6127, -0.57155],
        29.104,
        [330, 330, 150, 56, 56, 56],
    ),
}


@pytest.fixture(scope="module")
def arm():
    return load_lwr()


@pytest.fixture(scope="module")
def drawing():
    path = str(example_robot_path("lwr4plus"))
    return yourdfpy.URDF.load(path, build_collision_scene_graph=True)


def pose(robot, q, frame=None):
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, np.array(q, dtype=float))
    return data.oMf[robot.frame_id(frame or robot.tool_frame)]


@pytest.mark.parametrize("q", NOMINAL)
def test_flange_gravity_and_inertia_are_those_of_the_nominal_set(arm, q):
    flange_m, gravity_Nm, inertia_kg_m2 = NOMINAL[q]
    data, angles = arm.create_data(), np.array(q, dtype=float)
    assert pose(arm, q).translation == pytest.approx(flange_m, abs=1e-5)
    gravity = pin.computeGeneralizedGravity(arm.model, data, angles)
    assert gravity == pytest.approx(gravity_Nm, abs=1e-3)
    assert np.diag(pin.crba(arm.model, data, angles)) == pytest.approx(inertia_kg_m2, abs=1e-4)


@pytest.mark.filterwarnings("ignore::DeprecationWarning:yourdfpy")
def test_yourdfpy_finds_the_description_valid_and_the_arm_as_high_as_it_is(drawing):
    assert drawing.validate()
    assert drawing.errors == []
    drawing.update_cfg(np.zeros(7))
    for scene in (drawing.scene, drawing.collision_scene):
        low, high = scene.bounds
        assert low[2] == pytest.approx(0.0, abs=1e-6)
        assert high[2] == pytest.approx(1.178, abs=1e-6)
        assert np.all(high[:2] - low[:2] < 0.3)
    drawn = {link.name for link in drawing.robot.links if link.visuals and link.collisions}
    assert {f"lwr_link_{i}" for i in range(1, 8)} <= drawn
    moving = [link for link in drawing.robot.links if link.inertial is not None]
    assert len(moving) == 7
    assert sum(link.inertial.mass for link in moving) == pytest.approx(14.0503)
    for link in moving:
        first, second, third = np.linalg.eigvalsh(link.inertial.inertia)
        assert first > 0.0
        assert first + second > third


def test_kinematics_agree_with_yourdfpy_and_inertia_is_positive_over_the_workspace(arm, drawing):
    rng, data = np.random.default_rng(5), arm.create_data()
    for k in range(200):
        q = rng.uniform(arm.position_lower_rad, arm.position_upper_rad)
        assert np.linalg.eigvalsh(pin.crba(arm.model, data, q))[0] > 1e-5
        if k < 20:
            drawing.update_cfg(q)
            expected = drawing.get_transform("flange", "lwr_base")
            assert pose(arm, q).homogeneous == pytest.approx(expected, abs=1e-9)


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


# Well-known arms by name.


def example(name, **options):
    try:
        return load_example(name, **options)
    except MissingPackageError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("name", NAMES)
def test_every_arm_loads_as_it_comes_and_carries_a_needle(name):
    bare, robot, tool = example(name), example(name, payload=NeedleTool()), NeedleTool()
    assert robot.nv in (6, 7)
    assert np.linalg.eigvalsh(pin.crba(robot.model, robot.create_data(), np.ones(robot.nv)))[0] > 0
    assert (robot.flange_frame, robot.tool_frame) == (bare.tool_frame, "needle_tip")
    flange, rest = pose(bare, np.zeros(bare.nv)), np.zeros(bare.nv)
    tip, sensor = (flange.actInv(pose(robot, rest, n)) for n in ("needle_tip", "ft_sensor"))
    assert tip.translation == pytest.approx(tool.tip_in_flange_m)
    assert sensor.translation == pytest.approx([0, 0, tool.sensor_height_m])
    assert tip.rotation == pytest.approx(np.eye(3))
    added = pin.computeTotalMass(robot.model) - pin.computeTotalMass(bare.model)
    assert added == pytest.approx(0.304)


def test_panda_has_its_hand_on_unless_it_is_left_out():
    full, bare = example("panda"), example("panda", without=["panda_hand"])
    assert full.joint_names == bare.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert (full.tool_frame, bare.tool_frame) == ("panda_hand_tcp", "panda_link8")
    with_fingers = pin.buildModelFromUrdf(str(example_robot_path("panda")))
    masses = [pin.computeTotalMass(model) for model in (with_fingers, full.model, bare.model)]
    assert masses[0] == pytest.approx(masses[1])
    assert masses[1] - masses[2] == pytest.approx(0.76, abs=0.01)
    one_finger = example("panda", without=["panda_leftfinger"], tool_frame="panda_hand")
    assert masses[1] - pin.computeTotalMass(one_finger.model) == pytest.approx(0.015)


def test_an_arm_by_its_file_is_the_same():
    arm, path = example("panda"), example_robot_path("panda")
    robot = load_urdf(path, tool_frame="panda_hand_tcp", locked_joints=FINGERS)
    assert robot.model == arm.model
    assert load_example("lwr4plus").model == load_lwr().model
    with pytest.raises(UnknownNameError, match=r"give tool_frame.*ee_link, tool0"):
        load_urdf(example_robot_path("ur10"))


@pytest.mark.parametrize("name", UR_TABLES)
def test_the_ur_arms_are_the_maker_s_table(name):
    """Denavit-Hartenberg by hand, product of the six transforms, at random joint angles."""
    (d1, d4, d5, d6), (a2, a3), mass, effort = UR_TABLES[name]
    rows = [
        *((d1, 0, np.pi / 2), (0, a2, 0), (0, a3, 0)),
        *((d4, 0, np.pi / 2), (d5, 0, -np.pi / 2), (d6, 0, 0)),
    ]
    robot = load_example(name)
    q = np.random.default_rng(1).uniform(-3, 3, 6)
    expected = pin.SE3.Identity()
    for angle, (d, a, alpha) in zip(q, rows, strict=True):
        turn = pin.SE3(pin.rpy.rpyToMatrix(0, 0, angle), np.array([0, 0, d]))
        expected = expected * turn * pin.SE3(pin.rpy.rpyToMatrix(alpha, 0, 0), np.array([a, 0, 0]))
    assert pose(robot, q).homogeneous == pytest.approx(expected.homogeneous, abs=1e-12)
    assert pin.computeTotalMass(robot.model) == pytest.approx(mass)
    assert robot.effort_limit_Nm == pytest.approx(effort)


@pytest.mark.parametrize("name", ["lwr", "ur10E", "../panda"])
def test_an_unknown_name_is_answered_with_the_known(name):
    with pytest.raises(UnknownNameError, match=r", ".join(NAMES)):
        load_example(name)


def test_a_missing_package_is_named_with_its_install_line(monkeypatch, tmp_path):
    def not_found(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", not_found)
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    with pytest.raises(MissingPackageError, match="; pip install example-robot-data"):
        load_example("panda")
    assert load_example("ur10e").nv == 6
