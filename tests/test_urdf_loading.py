"""Any URDF: other arms load, and what cannot work is refused with what would be valid."""

from importlib import metadata

import numpy as np
import pinocchio as pin
import pytest

from urdf import (
    InertiaError,
    InputError,
    MissingPackageError,
    NeedleTool,
    UnknownNameError,
    UnsupportedJointError,
    UrdfFileError,
    example_robot_path,
    load_urdf,
)

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
GOOD_INERTIA = 'ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"'


def link(name, mass="1", inertia=GOOD_INERTIA):
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 0.1"/><mass value="{mass}"/>'
        f"<inertia {inertia}/></inertial></link>"
    )


def joint(name, parent, child, kind="revolute", extra=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="2"/>{extra}</joint>'
    )


@pytest.fixture
def urdf_file(tmp_path):
    """Write a two-link arm made of the given pieces and return its path."""

    def write(*pieces, head='<robot name="toy">'):
        path = tmp_path / "toy.urdf"
        path.write_text("\n".join([head, '<link name="base"/>', *pieces, "</robot>"]))
        return path

    return write


def example(name):
    try:
        return example_robot_path(name)
    except MissingPackageError as error:
        pytest.skip(str(error))


def test_panda_loads_with_its_fingers_locked():
    robot = load_urdf(example("panda"), tool_frame="panda_hand_tcp", locked_joints=FINGERS)
    assert robot.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert robot.tool_frame == "panda_hand_tcp"
    assert np.linalg.eigvalsh(pin.crba(robot.model, robot.create_data(), np.zeros(7)))[0] > 0.0


def test_locking_keeps_the_weight_of_what_is_locked():
    path = example("panda")
    free = pin.buildModelFromUrdf(str(path))
    robot = load_urdf(path, tool_frame="panda_hand_tcp", locked_joints=FINGERS)
    assert pin.computeTotalMass(robot.model) == pytest.approx(pin.computeTotalMass(free))


def test_ur10_carries_a_needle_tool():
    robot = load_urdf(example("ur10"), tool_frame="tool0", payload=NeedleTool())
    assert robot.nv == 6
    assert (robot.flange_frame, robot.tool_frame) == ("tool0", "needle_tip")
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, np.full(6, 0.4))
    tip = data.oMf[robot.frame_id("tool0")].actInv(data.oMf[robot.tool_frame_id])
    assert tip.translation == pytest.approx(NeedleTool().tip_in_flange_m)
    assert tip.rotation == pytest.approx(np.eye(3))


def test_ambiguous_tool_frame_is_asked_for():
    with pytest.raises(UnknownNameError, match=r"give tool_frame.*ee_link, tool0"):
        load_urdf(example("ur10"))


def test_the_single_last_link_is_the_default_tool_frame(urdf_file):
    robot = load_urdf(
        urdf_file(link("a"), link("b"), joint("j1", "base", "a"), joint("j2", "a", "b"))
    )
    assert robot.tool_frame == robot.flange_frame == "b"


def test_joints_lock_at_a_given_position(urdf_file):
    path = urdf_file(link("a"), link("b"), joint("j1", "base", "a"), joint("j2", "a", "b"))
    robot = load_urdf(path, locked_joints={"j2": 0.5})
    assert robot.joint_names == ("j1",)
    placement = robot.model.frames[robot.frame_id("b")].placement
    assert pin.log3(placement.rotation) == pytest.approx([0, 0.5, 0])


def test_a_continuous_joint_can_be_locked(urdf_file):
    path = urdf_file(
        link("a"), link("b"), joint("j1", "base", "a"), joint("spin", "a", "b", kind="continuous")
    )
    robot = load_urdf(path, locked_joints={"spin": 0.5})
    placement = robot.model.frames[robot.frame_id("b")].placement
    assert pin.log3(placement.rotation) == pytest.approx([0, 0.5, 0])


@pytest.mark.parametrize("kind", ["continuous", "planar", "floating", "screw"])
def test_joints_of_several_numbers_are_refused(urdf_file, kind):
    path = urdf_file(link("a"), joint("odd", "base", "a", kind=kind))
    with pytest.raises(UnsupportedJointError, match=f"'odd' is of type '{kind}'.*revolute"):
        load_urdf(path)


def test_a_mimic_joint_is_refused_unless_locked(urdf_file):
    pieces = (
        link("a"),
        link("b"),
        joint("j1", "base", "a"),
        joint("copy", "a", "b", extra='<mimic joint="j1"/>'),
    )
    with pytest.raises(UnsupportedJointError, match="'copy' mimics 'j1'"):
        load_urdf(urdf_file(*pieces))
    assert load_urdf(urdf_file(*pieces), locked_joints=["copy"]).nv == 1


def test_a_robot_without_joints_is_refused(urdf_file):
    path = urdf_file(link("a"), joint("weld", "base", "a", kind="fixed"))
    with pytest.raises(UnsupportedJointError, match="no joint that moves"):
        load_urdf(path, tool_frame="a")


@pytest.mark.parametrize(
    ("mass", "inertia", "message"),
    [
        ("-1", GOOD_INERTIA, "mass is -1 kg"),
        ("0", GOOD_INERTIA, "mass is 0 kg but its moments are not"),
        ("1e10", GOOD_INERTIA, "not finite or above"),
        ("1", GOOD_INERTIA.replace('ixx="0.01"', 'ixx="-0.01"'), "not positive definite"),
        ("1", GOOD_INERTIA.replace('ixy="0"', 'ixy="0.02"'), "not positive definite"),
        ("1", GOOD_INERTIA.replace('izz="0.01"', 'izz="0.05"'), "triangle inequality"),
    ],
)
def test_inertia_no_body_can_have_is_refused(urdf_file, mass, inertia, message):
    path = urdf_file(link("a", mass, inertia), joint("j1", "base", "a"))
    with pytest.raises(InertiaError, match=f"link 'a': .*{message}"):
        load_urdf(path)


def test_unphysical_links_can_be_let_through(urdf_file):
    bad = GOOD_INERTIA.replace('izz="0.01"', 'izz="0.05"')
    path = urdf_file(link("a", "1", bad), joint("j1", "base", "a"))
    assert load_urdf(path, check_inertias=False).nv == 1


def test_a_joint_that_moves_nothing_is_refused(urdf_file):
    path = urdf_file(
        link("a"), '<link name="b"/>', joint("j1", "base", "a"), joint("idle", "a", "b")
    )
    with pytest.raises(InertiaError, match="move no inertia: idle"):
        load_urdf(path)


def test_a_missing_file_or_a_folder_is_refused(tmp_path):
    with pytest.raises(UrdfFileError, match="no such file"):
        load_urdf(tmp_path / "none.urdf")
    with pytest.raises(UrdfFileError, match="no such file"):
        load_urdf(tmp_path)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "binary.urdf"
    path.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(UrdfFileError, match="cannot be read as text"):
        load_urdf(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed XML"),
        ("<robot name='toy'><link name='a'/>", "not well-formed XML"),
        ("<sdf/>", "root element is <sdf>"),
        (
            '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>',
            "is a xacro file",
        ),
        ("<robot name='toy'><link name='a'><inertial/></link></robot>", "needs <mass>"),
        (f"<robot name='toy'>{link('a', mass='heavy')}</robot>", '<mass value="heavy"> is not one number'),
        (f"<robot name='toy'>{link('a', inertia='')}</robot>", "needs <inertia>.*ixx"),
        (f"<robot name='toy'>{joint('j', 'ghost', 'a')}</robot>", "not a valid URDF"),
    ],
)
def test_malformed_files_are_refused_with_the_reason(tmp_path, text, message):
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    with pytest.raises(UrdfFileError, match=message):
        load_urdf(path)


def test_unknown_names_are_answered_with_the_known(urdf_file):
    path = urdf_file(link("a"), joint("j1", "base", "a"))
    with pytest.raises(UnknownNameError, match=r"cannot lock 'j9'.*joints: j1"):
        load_urdf(path, locked_joints=["j9"])
    with pytest.raises(UnknownNameError, match=r"no frame 'tool'.*base, j1, a"):
        load_urdf(path, tool_frame="tool")


def test_locked_joints_must_be_names_and_numbers(urdf_file):
    path = urdf_file(link("a"), joint("j1", "base", "a"))
    with pytest.raises(InputError, match="expected a list of names"):
        load_urdf(path, locked_joints="j1")
    with pytest.raises(InputError, match="position of 'j1' is nan"):
        load_urdf(path, locked_joints={"j1": np.nan})


def test_a_tool_does_not_hide_a_frame_of_the_robot(urdf_file):
    path = urdf_file(link("needle_tip"), joint("j1", "base", "needle_tip"))
    with pytest.raises(UnknownNameError, match="'needle_tip', but robot 'toy' has one"):
        load_urdf(path, payload=NeedleTool())


def test_an_unknown_example_robot_is_answered_with_the_known():
    with pytest.raises(UnknownNameError, match="panda, ur3, ur5, ur10"):
        example_robot_path("lwr")


def test_missing_example_package_says_how_to_install(monkeypatch, tmp_path):
    def not_found(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", not_found)
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    with pytest.raises(MissingPackageError, match="pip install example-robot-data"):
        example_robot_path("panda")
