"""Robots: the shipped arms against published tables and another URDF reader; arms
from models."""

from importlib import metadata

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from benchmarks.insertion.recorded.panda import read_panda
from tests.residual.residual_signals import pose_of
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
    data = arm.create_data()
    angles = np.array(q, dtype=float)

    assert pose_of(arm, q).translation == pytest.approx(flange_m, abs=1e-5)

    gravity = pin.computeGeneralizedGravity(arm.model, data, angles)

    assert gravity == pytest.approx(gravity_Nm, abs=1e-3)
    assert np.diag(pin.crba(arm.model, data, angles)) == pytest.approx(
        inertia_kg_m2, abs=1e-4
    )


def test_kinematics_agree_with_yourdfpy(arm):
    drawing = yourdfpy.URDF.load(str(example_robot_path("lwr4plus")))
    rng = np.random.default_rng(5)
    data = arm.create_data()
    for k in range(200):
        q = rng.uniform(arm.position_lower_rad, arm.position_upper_rad)
        assert np.linalg.eigvalsh(pin.crba(arm.model, data, q))[0] > 1e-5
        if k < 20:
            drawing.update_cfg(q)
            expected = drawing.get_transform("flange", "lwr_base")
            assert pose_of(arm, q).homogeneous == pytest.approx(expected, abs=1e-9)


def test_limits_and_names_match_the_data_sheet(arm):
    upper_deg = np.degrees(arm.position_upper_rad)
    velocity_deg_s = np.degrees(arm.velocity_limit_rad_s)
    tilted = load_lwr(gravity_m_s2=[9.80665, 0, 0])

    assert arm.joint_names == tuple(f"lwr_joint_{i}" for i in range(1, 8))
    assert upper_deg == pytest.approx([170, 120, 170, 120, 170, 120, 170])
    assert arm.position_lower_rad == pytest.approx(-arm.position_upper_rad)
    assert velocity_deg_s == pytest.approx([100, 110, 100, 128, 130, 180, 180])
    assert arm.effort_limit_Nm == pytest.approx([176, 176, 100, 100, 100, 38, 38])
    assert arm.gravity_m_s2 == pytest.approx([0, 0, -9.80665])
    assert tilted.gravity_m_s2 == pytest.approx([9.80665, 0, 0])
    assert arm.tool_frame == arm.flange_frame == "flange"


def example(name, **options):
    try:
        return load_example(name, **options)
    except MissingPackageError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("name", NAMES)
def test_every_arm_loads_and_carries_a_needle(name):
    bare = example(name)
    robot = example(name, payload=NeedleTool())
    tool = NeedleTool()

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
    assert tip.translation == pytest.approx(tool.tip_in_flange_m)
    assert sensor.translation == pytest.approx([0, 0, tool.sensor_height_m])
    assert tip.rotation == pytest.approx(np.eye(3))
    assert added_kg == pytest.approx(0.304)


def test_pandas_hand_can_be_left_out():
    full = example("panda")
    bare = example("panda", without=["panda_hand"])
    with_fingers = pin.buildModelFromUrdf(str(example_robot_path("panda")))
    masses_kg = [
        pin.computeTotalMass(model) for model in (with_fingers, full.model, bare.model)
    ]

    assert full.joint_names == bare.joint_names
    assert full.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert (full.tool_frame, bare.tool_frame) == ("panda_hand_tcp", "panda_link8")
    assert masses_kg[0] == pytest.approx(masses_kg[1])
    assert masses_kg[1] - masses_kg[2] == pytest.approx(0.76, abs=0.01)


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
    expected = pin.SE3.Identity()
    for angle, (d, a, alpha) in zip(q, rows, strict=True):
        turn = pin.SE3(pin.rpy.rpyToMatrix(0, 0, angle), np.array([0, 0, d]))
        expected = (
            expected
            * turn
            * pin.SE3(pin.rpy.rpyToMatrix(alpha, 0, 0), np.array([a, 0, 0]))
        )

    assert pose_of(robot, q).homogeneous == pytest.approx(
        expected.homogeneous, abs=1e-12
    )
    assert pin.computeTotalMass(robot.model) == pytest.approx(mass)
    assert robot.effort_limit_Nm == pytest.approx(effort)


def test_unknown_names_and_missing_packages_are_explained(monkeypatch, tmp_path):
    for name in ("lwr", "ur10E", "../panda"):
        with pytest.raises(UnknownNameError, match=r", ".join(NAMES)):
            load_example(name)

    def not_found(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", not_found)
    monkeypatch.setattr("sys.prefix", str(tmp_path))

    with pytest.raises(MissingPackageError, match=r"pip install .*\[robots\]"):
        load_example("panda")
    assert load_example("ur10e").nv == 6


def test_unknown_frame_lists_the_valid_ones(lwr):
    assert lwr.model.frames[lwr.tool_frame_id].name == lwr.tool_frame == "needle_tip"
    with pytest.raises(
        UnknownNameError, match=r"no frame 'tip' .*flange, ft_sensor, needle_tip"
    ):
        lwr.frame_id("tip")

    for which in ("tool_frame", "flange_frame"):
        names = {"tool_frame": "flange", "flange_frame": "flange"} | {which: "nowhere"}
        with pytest.raises(UnknownNameError, match="'nowhere'"):
            Robot(bare_model=lwr.bare_model, **names)


def test_a_robot_is_read_only_and_a_copy(lwr):
    ranges = [f"position_{end}_rad" for end in ("lower", "upper")]
    for name in (*ranges, "velocity_limit_rad_s", "effort_limit_Nm", "gravity_m_s2"):
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
    mass_kg = pin.computeTotalMass(lwr.model)
    loaded = lwr.with_payload(heavy)

    assert pin.computeTotalMass(loaded.model) == pytest.approx(14.0503 + 2.0)
    assert pin.computeTotalMass(lwr.model) == mass_kg
    assert loaded.payload is heavy
    assert loaded.tool_frame == "needle_tip"

    bare = loaded.with_payload(None)

    assert bare.model.inertias[7].isApprox(load_lwr().model.inertias[7])
    with pytest.raises(InputError, match=r"NeedleTool .*\.payload"):
        lwr.with_payload(NeedleTool())


def test_armature_is_added_to_the_mass_diagonal(lwr):
    q = np.array([0.3, -0.4, 0.5, 1.2, -0.7, 0.9, 0.2])
    robots = (lwr, lwr.with_armature(ROTOR))
    matrices = [pin.crba(r.model, r.create_data(), q) for r in robots]

    assert matrices[1] - matrices[0] == pytest.approx(np.diag(ROTOR), abs=1e-12)

    gravity = [
        pin.computeGeneralizedGravity(r.model, r.create_data(), q) for r in robots
    ]

    assert gravity[0] == pytest.approx(gravity[1])
    assert lwr.with_armature(ROTOR).with_payload(None).model.armature == pytest.approx(
        ROTOR
    )

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
    place = robot.model.frames[robot.frame_id("tool")].placement
    flange = robot.model.frames[robot.frame_id("flange")].placement

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
    model = pin.Model(load_lwr().bare_model)
    with pytest.raises(UnknownNameError, match="wrist"):
        build_robot(model, flange_frame="wrist")
    model.inertias[3] = pin.Inertia(1.0, np.zeros(3), np.diag([0.1, 0.1, 9.0]))
    with pytest.raises(InertiaError, match="lwr_joint_3"):
        build_robot(model, flange_frame="flange")

    assert build_robot(model, flange_frame="flange", check_inertias=False).warnings
