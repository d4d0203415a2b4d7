"""Robots: the shipped arms against published tables and another URDF reader; arms
from models."""

from importlib import metadata
from unittest.mock import Mock

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from benchmarks.insertion.recorded.panda import read_panda
from tests.residual.residual_signals import gravity_of, pose_of
from urdf import (
    InertiaError,
    InputError,
    MissingPackageError,
    NeedleTool,
    Payload,
    Robot,
    UnknownNameError,
    build_robot,
    example_robot_path,
    load_example,
    load_lwr,
    load_urdf,
)

ROTOR = np.array([3.19, 3.05, 1.98, 2.05, 0.787, 0.391, 0.394])
POINT = np.array([1.0, 0, 0, 0.1, 0.02, 0, 0.02, 0, 0, 0.01])
TWISTED = (0.3, -0.4, 0.5, 1.2, -0.7, 0.9, 0.2)

# Posture: flange [m], gravity torque [Nm], diagonal of the mass matrix [kg m^2] of the
# nominal set.
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

NAMES = ["panda", "ur3", "ur5", "ur10", "xarm7", "ur5e", "ur10e", "lwr4plus"]
UR_TABLES = {
    "ur5e": (
        [0.1625, 0.1333, 0.0997, 0.0996],
        [-0.425, -0.3922],
        17.7,
        [150] * 3 + [28] * 3,
    ),
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


@pytest.mark.parametrize("q", NOMINAL)
def test_flange_gravity_and_inertia_are_the_nominal_ones(arm, q):
    flange_m, gravity_Nm, inertia_kg_m2 = NOMINAL[q]
    angles = np.array(q, dtype=float)
    mass_matrix = pin.crba(arm.model, arm.create_data(), angles)
    (gravity,) = gravity_of(arm, [angles])

    assert (pose_of(arm, q).translation, gravity, np.diag(mass_matrix)) == (
        pytest.approx(flange_m, abs=1e-5),
        pytest.approx(gravity_Nm, abs=1e-3),
        pytest.approx(inertia_kg_m2, abs=1e-4),
    )


def test_kinematics_agree_with_yourdfpy(arm):
    drawing = yourdfpy.URDF.load(str(example_robot_path("lwr4plus")))
    rng = np.random.default_rng(5)
    data = arm.create_data()
    for q in rng.uniform(arm.position_lower_rad, arm.position_upper_rad, (200, 7)):
        drawing.update_cfg(q)
        expected = drawing.get_transform("flange", "lwr_base")
        assert pose_of(arm, q).homogeneous == pytest.approx(expected, abs=1e-9)
        assert np.linalg.eigvalsh(pin.crba(arm.model, data, q))[0] > 1e-5


def test_limits_and_names_match_the_data_sheet(arm):
    upper_deg = np.degrees(arm.position_upper_rad)
    velocity_deg_s = np.degrees(arm.velocity_limit_rad_s)
    tilted = load_lwr(gravity_m_s2=[9.80665, 0, 0])
    joints = tuple(f"lwr_joint_{i}" for i in range(1, 8))

    assert (arm.joint_names, arm.tool_frame, arm.flange_frame) == (
        *(joints, "flange", "flange"),
    )
    assert np.stack([upper_deg, velocity_deg_s, arm.effort_limit_Nm]) == pytest.approx(
        np.array(
            [
                [170, 120, 170, 120, 170, 120, 170],
                [100, 110, 100, 128, 130, 180, 180],
                [176, 176, 100, 100, 100, 38, 38],
            ]
        )
    )
    assert arm.position_lower_rad == pytest.approx(-arm.position_upper_rad)
    assert np.stack([arm.gravity_m_s2, tilted.gravity_m_s2]) == pytest.approx(
        np.array([[0, 0, -9.80665], [9.80665, 0, 0]])
    )


def example(name, **options):
    try:
        return load_example(name, **options)
    except MissingPackageError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("name", NAMES)
def test_every_arm_loads_and_carries_a_needle(name):
    tool = NeedleTool()
    bare = example(name)
    robot = example(name, payload=tool)
    still_rad = np.zeros(bare.nv)
    flange = pose_of(bare, still_rad)
    tip, sensor = (
        flange.actInv(pose_of(robot, still_rad, n)) for n in ("needle_tip", "ft_sensor")
    )
    mass_matrix = pin.crba(robot.model, robot.create_data(), np.ones(robot.nv))
    added_kg = pin.computeTotalMass(robot.model) - pin.computeTotalMass(bare.model)

    assert robot.nv in (6, 7)
    assert np.linalg.eigvalsh(mass_matrix)[0] > 0
    assert (robot.flange_frame, robot.tool_frame) == (bare.tool_frame, "needle_tip")
    assert (tip.translation, tip.rotation, sensor.translation, added_kg) == (
        *(pytest.approx(tool.tip_in_flange_m), pytest.approx(np.eye(3))),
        *(pytest.approx([0, 0, tool.sensor_height_m]), pytest.approx(0.304)),
    )


def test_pandas_hand_can_be_left_out():
    full = example("panda")
    bare = example("panda", without=["panda_hand"])
    with_fingers = pin.buildModelFromUrdf(str(example_robot_path("panda")))
    mass_kg = pin.computeTotalMass(with_fingers)
    joints = tuple(f"panda_joint{i}" for i in range(1, 8))

    assert (full.joint_names, full.tool_frame) == (joints, "panda_hand_tcp")
    assert (bare.joint_names, bare.tool_frame) == (joints, "panda_link8")
    assert [mass_kg - pin.computeTotalMass(arm.model) for arm in (full, bare)] == [
        pytest.approx(0.0, abs=1e-5),
        pytest.approx(0.76, abs=0.01),
    ]


def test_a_tool_frame_is_asked_for_where_there_are_several_ends():
    example("ur10")
    with pytest.raises(UnknownNameError, match="ee_link, tool0"):
        load_urdf(example_robot_path("ur10"))


@pytest.mark.parametrize("name", UR_TABLES)
def test_the_ur_arms_are_the_maker_s_table(name):
    """Denavit-Hartenberg by hand, product of the six transforms, at random joint
    angles."""
    (d1, d4, d5, d6), (a2, a3), mass, effort = UR_TABLES[name]
    rows = [
        *((d1, 0, np.pi / 2), (0, a2, 0), (0, a3, 0)),
        *((d4, 0, np.pi / 2), (d5, 0, -np.pi / 2), (d6, 0, 0)),
    ]
    robot = load_example(name)
    q = np.random.default_rng(1).uniform(-3, 3, 6)
    flange = pin.SE3.Identity()
    for angle, (d, a, alpha) in zip(q, rows, strict=True):
        flange *= pin.SE3(pin.rpy.rpyToMatrix(0, 0, angle), np.array([0, 0, d]))
        flange *= pin.SE3(pin.rpy.rpyToMatrix(alpha, 0, 0), np.array([a, 0, 0]))
    place = pose_of(robot, q).homogeneous
    mass_kg = pin.computeTotalMass(robot.model)

    assert (place, mass_kg, robot.effort_limit_Nm) == (
        pytest.approx(flange.homogeneous, abs=1e-12),
        pytest.approx(mass),
        pytest.approx(effort),
    )


@pytest.mark.parametrize("name", ["lwr", "ur10E", "../panda"])
def test_an_unknown_arm_is_refused_with_the_known_ones(name):
    with pytest.raises(UnknownNameError, match=r", ".join(NAMES)):
        load_example(name)


def test_missing_packages_are_explained(monkeypatch, tmp_path):
    missing = Mock(side_effect=metadata.PackageNotFoundError)
    monkeypatch.setattr(metadata, "distribution", missing)
    monkeypatch.setattr("sys.prefix", str(tmp_path))

    with pytest.raises(MissingPackageError, match=r"pip install .*\[robots\]"):
        load_example("panda")
    assert load_example("ur10e").nv == 6


def test_unknown_frame_lists_the_valid_ones(lwr):
    assert lwr.model.frames[lwr.tool_frame_id].name == lwr.tool_frame == "needle_tip"
    with pytest.raises(UnknownNameError, match=r"flange, ft_sensor, needle_tip"):
        lwr.frame_id("tip")
    for tool, flange in (("nowhere", "flange"), ("flange", "nowhere")):
        with pytest.raises(UnknownNameError, match="'nowhere'"):
            Robot(bare_model=lwr.bare_model, tool_frame=tool, flange_frame=flange)


def test_a_robot_is_read_only_and_a_copy(lwr):
    for name in (
        *("position_lower_rad", "position_upper_rad", "velocity_limit_rad_s"),
        *("effort_limit_Nm", "gravity_m_s2"),
    ):
        with pytest.raises(ValueError, match="read-only"):
            getattr(lwr, name)[0] = 1.0
    model = pin.Model(lwr.bare_model)
    robot = Robot(bare_model=model, tool_frame="flange", flange_frame="flange")
    model.inertias[7] = pin.Inertia.Zero()
    model.gravity = pin.Motion.Zero()

    assert robot.model.inertias[7].mass == pytest.approx(0.2806)
    assert robot.gravity_m_s2[2] == pytest.approx(-9.80665)


def test_with_payload_replaces_and_leaves_the_original_alone(lwr):
    heavy = Payload(mass_kg=2.0, com_m=np.zeros(3), inertia_kg_m2=0.01 * np.eye(3))
    loaded = lwr.with_payload(heavy)
    bare = loaded.with_payload(None)
    masses_kg = [pin.computeTotalMass(one.model) for one in (lwr, loaded)]

    assert masses_kg == pytest.approx([14.0503 + 0.304, 14.0503 + 2.0])
    assert (loaded.payload, loaded.tool_frame) == (heavy, "needle_tip")
    assert bare.model.inertias[7].isApprox(load_lwr().model.inertias[7])
    with pytest.raises(InputError, match=r"NeedleTool .*\.payload"):
        lwr.with_payload(NeedleTool())


def test_armature_is_added_to_the_mass_diagonal(lwr):
    q = np.array(TWISTED)
    geared = lwr.with_armature(ROTOR)
    rigid, with_rotors = (pin.crba(r.model, r.create_data(), q) for r in (lwr, geared))

    assert with_rotors - rigid == pytest.approx(np.diag(ROTOR), abs=1e-12)
    assert gravity_of(geared, [q]) == pytest.approx(gravity_of(lwr, [q]))
    assert geared.with_payload(None).model.armature == pytest.approx(ROTOR)

    for rotor in ([1.0] * 6, [1.0] * 6 + [-1.0]):
        with pytest.raises(InputError, match="rotor_inertia_kg_m2"):
            lwr.with_armature(rotor)


def test_a_robot_of_a_model_has_its_limits_tool_and_payload(lwr, recordings_dir):
    model = pin.Model(load_lwr().bare_model)
    offset = np.eye(4)
    offset[:3, 3] = [0.1, 0.2, 0.3]
    robot = build_robot(
        model, flange_frame="flange", tool_placement=offset, payload=NeedleTool()
    )
    flange, place = (pose_of(robot, np.zeros(7), name) for name in ("flange", "tool"))

    assert flange.actInv(place).translation == pytest.approx([0.1, 0.2, 0.3])
    assert (robot.tool_frame, robot.flange_frame) == ("needle_tip", "tool")
    assert np.array_equal(robot.effort_limit_Nm, lwr.effort_limit_Nm)
    assert model.nframes == load_lwr().model.nframes, "a copy"

    # The Panda's published table puts the flange where the arm's data sheet does.
    panda = read_panda(recordings_dir).robot
    height_m = 0.333 + 0.316 + 0.384 - 0.107

    assert pose_of(panda, np.zeros(7), "tool").translation == pytest.approx(
        [0.088, 0, height_m]
    )


def test_a_model_that_cannot_be_is_refused_unless_asked_for():
    model = load_lwr().bare_model.copy()
    with pytest.raises(UnknownNameError, match="wrist"):
        build_robot(model, flange_frame="wrist")
    model.inertias[3] = pin.Inertia(1.0, np.zeros(3), np.diag([0.1, 0.1, 9.0]))
    with pytest.raises(InertiaError, match="lwr_joint_3"):
        build_robot(model, flange_frame="flange")

    assert build_robot(model, flange_frame="flange", check_inertias=False).warnings
