"""Well-known arms by name: they load as they come, and their numbers are the makers'."""

from importlib import metadata

import numpy as np
import pinocchio as pin
import pytest

from urdf import (
    MissingPackageError,
    NeedleTool,
    UnknownNameError,
    example_robot_path,
    load_example,
    load_lwr,
    load_urdf,
)

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
NAMES = ["panda", "ur3", "ur5", "ur10", "xarm7", "ur5e", "ur10e", "lwr4plus"]


def example(name, **options):
    try:
        return load_example(name, **options)
    except MissingPackageError as error:
        pytest.skip(str(error))


def tool_pose(robot, q=None):
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, np.zeros(robot.nv) if q is None else q)
    return data.oMf[robot.tool_frame_id]


@pytest.mark.parametrize("name", NAMES)
def test_every_arm_loads_as_it_comes_and_carries_a_needle(name):
    bare, robot = example(name), example(name, payload=NeedleTool())
    assert robot.nv in (6, 7)
    assert np.linalg.eigvalsh(pin.crba(robot.model, robot.create_data(), np.ones(robot.nv)))[0] > 0
    assert (robot.flange_frame, robot.tool_frame) == (bare.tool_frame, "needle_tip")
    tip = tool_pose(bare).actInv(tool_pose(robot))
    assert tip.translation == pytest.approx(NeedleTool().tip_in_flange_m)
    assert tip.rotation == pytest.approx(np.eye(3))


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


def test_panda_by_its_file_is_the_same():
    arm = example("panda")
    path = example_robot_path("panda")
    robot = load_urdf(path, tool_frame="panda_hand_tcp", locked_joints=FINGERS)
    assert robot.model == arm.model


def test_ambiguous_tool_frame_is_asked_for():
    example("ur10")
    with pytest.raises(UnknownNameError, match=r"give tool_frame.*ee_link, tool0"):
        load_urdf(example_robot_path("ur10"))


UR_TABLES = {
    "ur5e": ([0.1625, 0.1333, 0.0997, 0.0996], [-0.425, -0.3922], 17.7, [150] * 3 + [28] * 3),
    "ur10e": (
        [0.1807, 0.17415, 0.11985, 0.11655],
        [-0.6127, -0.57155],
        29.104,
        [330, 330, 150, 56, 56, 56],
    ),
}


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
    pose = pin.SE3.Identity()
    for angle, (d, a, alpha) in zip(q, rows, strict=True):
        turn = pin.SE3(pin.rpy.rpyToMatrix(0, 0, angle), np.array([0, 0, d]))
        pose = pose * turn * pin.SE3(pin.rpy.rpyToMatrix(alpha, 0, 0), np.array([a, 0, 0]))
    assert tool_pose(robot, q).homogeneous == pytest.approx(pose.homogeneous, abs=1e-12)
    assert pin.computeTotalMass(robot.model) == pytest.approx(mass)
    assert robot.effort_limit_Nm == pytest.approx(effort)


def test_the_lwr_is_one_of_them():
    assert load_example("lwr4plus").model == load_lwr().model


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
