"""Any URDF: what loads, and what cannot work is refused with what would be valid."""

import os
import re

import numpy as np
import pinocchio as pin
import pytest

from urdf import (
    InertiaError,
    InputError,
    NeedleTool,
    Payload,
    UnknownNameError,
    UnsupportedJointError,
    UrdfFileError,
    description,
    load_urdf,
    xml_reader,
)

ORIGIN = '<origin xyz="0 0 0.1"/>'
MASS = '<mass value="1"/>'
INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'


def link(name, *parts):
    parts = parts or (ORIGIN, MASS, INERTIA)
    return f'<link name="{name}"><inertial>{"".join(parts)}</inertial></link>'


def joint(name, parent, child, kind="revolute", extra=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child '
        f'link="{child}"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" '
        f'velocity="2"/>{extra}</joint>'
    )


@pytest.fixture
def urdf_file(tmp_path):
    """Write an arm made of the given pieces, `base` first, and return its path."""

    def write(*pieces, head='<robot name="toy">'):
        path = tmp_path / "toy.urdf"
        path.write_text("\n".join([head, '<link name="base"/>', *pieces, "</robot>"]))
        return path

    return write


ONE_LINK = (link("a"), joint("j1", "base", "a"))
TWO_LINKS = (link("a"), link("b"), joint("j1", "base", "a"), joint("j2", "a", "b"))


def placement(robot, frame):
    return robot.model.frames[robot.frame_id(frame)].placement


def test_the_last_link_is_the_default_tool_frame(
    urdf_file,
):
    mesh = '<visual><geometry><mesh filename="nowhere.stl"/></geometry></visual>'
    robot = load_urdf(urdf_file(*TWO_LINKS, f"<gazebo><a>{mesh}</a></gazebo>"))

    assert robot.nv == 2
    assert robot.tool_frame == robot.flange_frame == "b"


@pytest.mark.parametrize("kind", ["planar", "floating", "screw", "mimic"])
def test_joints_without_one_number_must_be_locked(urdf_file, kind):
    odd = joint("odd", "a", "b", kind=kind)
    message = f"'odd' is of type '{kind}'.*revolute"
    if kind == "mimic":
        odd = joint("odd", "a", "b", extra='<mimic joint="j1"/>')
        message = "'odd' mimics 'j1'"
    path = urdf_file(*TWO_LINKS[:3], odd)

    with pytest.raises(UnsupportedJointError, match=message):
        load_urdf(path)

    robot = load_urdf(path, locked_joints={"odd": 0.5})

    assert robot.joint_names == ("j1",)
    if kind == "mimic":
        assert pin.log3(placement(robot, "b").rotation) == pytest.approx([0, 0.5, 0])


def test_links_left_out_go_with_their_children(urdf_file):
    path = urdf_file(
        joint("finger_joint", "hand", "finger", kind="continuous"),
        *(link(name) for name in ("finger", "hand", "a")),
        joint("hand_joint", "a", "hand", kind="fixed"),
        joint("j1", "base", "a"),
    )
    robot = load_urdf(path, without=["hand"])

    assert robot.joint_names == ("j1",)
    assert robot.frame_names == ("universe", "base", "j1", "a")
    assert pin.computeTotalMass(robot.model) == pytest.approx(1.0)
    assert load_urdf(path, without=("finger", "hand")).tool_frame == "a"


def test_a_tool_is_placed_anywhere_on_a_link(urdf_file):
    turned = pin.SE3(pin.rpy.rpyToMatrix(0, np.pi / 2, 0), np.array([0, 0.3, 0]))
    matrix = np.diag([-1.0, -1, 1, 1])
    moved = pin.SE3(np.eye(3), np.array([0.1, 0, 0.2])).homogeneous
    for tool_placement, expected in (
        (turned, turned.homogeneous),
        (matrix, matrix),
        ([0.1, 0, 0.2], moved),
    ):
        robot = load_urdf(urdf_file(*ONE_LINK), tool_placement=tool_placement)
        assert robot.tool_frame == robot.flange_frame == "tool"
        assert placement(robot, "tool").homogeneous == pytest.approx(expected)
    # A needle stands on the placement, and so does its weight.
    sideways = pin.SE3(pin.rpy.rpyToMatrix(0, np.pi / 2, 0), np.array([0, 0, 0.1]))
    tool = NeedleTool(sensor_height_m=0)
    robot = load_urdf(urdf_file(*ONE_LINK), tool_placement=sideways, payload=tool)

    assert (robot.tool_frame, robot.flange_frame) == ("needle_tip", "tool")
    assert "ft_sensor" not in robot.frame_names
    assert placement(robot, "needle_tip").translation == pytest.approx([0.153, 0, 0.1])

    first_moment = robot.model.inertias[1].mass * robot.model.inertias[1].lever

    assert first_moment[0] == pytest.approx(0.068 * tool.payload.com_m[2])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('value="1"', 'value="-1"', "mass is -1 kg"),
        ('ixy="0"', 'ixy="0.02"', "not positive definite"),
        ('izz="0.01"', 'izz="0.05"', "triangle inequality"),
    ],
)
def test_inertia_no_body_can_have_is_refused(urdf_file, old, new, message):
    path = urdf_file(link("a", ORIGIN, (MASS + INERTIA).replace(old, new)), ONE_LINK[1])

    with pytest.raises(InertiaError, match=f"link 'a': .*{message}"):
        load_urdf(path)

    robot = load_urdf(path, check_inertias=False)

    assert robot.nv == 1
    assert re.search(f"accepted that no rigid body has.*{message}", robot.warnings[0])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        *(
            ('value="1"', f'value="{text}"', f'<mass value="{text}"> is not one number')
            for text in ("1 ", "", "nan", "1e400", "0x10", "1,5", "１")
        ),
        ('ixx="0.01"', 'ixx="0,01"', '<inertia ixx="0,01"> is not one number'),
        *(
            (
                ORIGIN,
                f'<origin xyz="{text}"/>',
                f'<origin xyz="{text}"> is not 3 numbers',
            )
            for text in ("0, 0, 0.1", "0 0", "0 0 nan")
        ),
        (
            ORIGIN,
            '<origin rpy="0 0 pi/2"/>',
            '<origin rpy="0 0 pi/2"> is not 3 numbers',
        ),
        (MASS, "<mass/>", "needs <mass> with the number value"),
        (INERTIA, "<inertia/>", "needs <inertia> with the number ixx"),
    ],
)
def test_inertials_the_reader_would_drop_are_refused(urdf_file, old, new, message):
    """urdfdom gives such a link no inertia at all and goes on; only stderr knows."""
    path = urdf_file(
        link("a", (ORIGIN + MASS + INERTIA).replace(old, new)), ONE_LINK[1]
    )
    for check in (True, False):
        with pytest.raises(
            UrdfFileError, match=f"toy.urdf: link 'a': <inertial> .*{message}"
        ):
            load_urdf(path, check_inertias=check)


def test_numbers_are_parsed_as_the_reader_does(urdf_file, monkeypatch):
    for old, new in (
        ('value="1"', 'value=" 1"'),
        ('value="1"', 'value="+1.0E0"'),
        ('value="1"', 'value="1."'),
        (ORIGIN, '<origin xyz=" 0  0\t.1 " rpy="0 0 0"/>'),
        (ORIGIN, "<!-- a note --><origin xyz='0 0 1e-1'/><origin xyz='9 9 9'/>"),
    ):
        path = urdf_file(
            link("a", (ORIGIN + MASS + INERTIA).replace(old, new)), ONE_LINK[1]
        )
        inertia = load_urdf(path).model.inertias[1]
        assert inertia.mass == 1.0
        assert inertia.lever == pytest.approx([0, 0, 0.1])
    monkeypatch.setattr(description, "_NUMBER", re.compile(".*"))
    path = urdf_file(link("a", ORIGIN, '<mass value="1 "/>', INERTIA), ONE_LINK[1])

    with pytest.raises(
        UrdfFileError, match=r"file add up to 1 kg, .* loaded model to 0 kg"
    ):
        load_urdf(path)


def test_joints_that_move_no_inertia_are_refused(
    urdf_file,
):
    path = urdf_file(link("a"), joint("weld", "base", "a", kind="fixed"))

    with pytest.raises(UnsupportedJointError, match="no joint that moves"):
        load_urdf(path, tool_frame="a")

    point_mass = MASS + INERTIA.replace("0.01", "0")
    path = urdf_file(*ONE_LINK, link("b", point_mass), joint("idle", "a", "b"))

    with pytest.raises(InertiaError, match="move no inertia: idle"):
        load_urdf(path)

    # Rounding may leave a point mass a moment of -1e-20, which Pinocchio's constructor
    # refuses.
    body = Payload(
        mass_kg=0.3, com_m=np.full(3, 0.1), inertia_kg_m2=np.diag([0, -1e-20, 0])
    )
    robot = load_urdf(urdf_file(*ONE_LINK), payload=body)

    assert pin.computeTotalMass(robot.model) == pytest.approx(1.3)


def test_a_chain_too_long_is_refused(urdf_file, monkeypatch):
    def chain(count):
        names = ["base", *(f"l{k}" for k in range(1, count))]
        joints = [joint(f"j{k}", names[k - 1], names[k]) for k in range(1, count)]
        return urdf_file(*map(link, names[1:]), *joints)

    with pytest.raises(UrdfFileError, match="more than 499 joints"):
        load_urdf(chain(20_000))

    with pytest.raises(
        UnsupportedJointError, match=r"(?s)298 joints move.*keep_joints"
    ):
        load_urdf(chain(299))

    assert load_urdf(chain(299), keep_joints=["j7"], tool_frame="l298").nv == 1

    monkeypatch.setattr(xml_reader, "MAX_JOINTS", 2)

    assert load_urdf(chain(3)).nv == 2
    monkeypatch.setattr(xml_reader, "MAX_BYTES", 100_000)
    with pytest.raises(UrdfFileError, match=r"(?s)larger than any robot.*MAX_JOINTS"):
        load_urdf(urdf_file(*ONE_LINK, "<!--" + 200_000 * " " + "-->"))


def test_what_is_no_file_of_text_is_refused(tmp_path):
    binary = tmp_path / "binary.urdf"
    pipe = tmp_path / "pipe.urdf"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    os.mkfifo(pipe)
    for path in (tmp_path / "none.urdf", tmp_path, pipe, "a\0b.urdf"):
        with pytest.raises(UrdfFileError, match="no such file"):
            load_urdf(path)
    for path in (binary, 5000 * "x"):
        with pytest.raises(UrdfFileError, match="cannot be read as text"):
            load_urdf(path)


XACRO = "http://www.ros.org/wiki/xacro"
SHIFTED = joint("j", "base", "a", extra='<origin xyz="0, 0, 1"/>')
ENTITIES = "".join(f'<!ENTITY e{k + 1} "{10 * f"&e{k};"}">' for k in range(9))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed XML"),
        ("<robot name='toy'><link name='a'/>", "not well-formed XML"),
        ("<sdf/>", "root element is <sdf>"),
        (
            f'<robot name="x" xmlns:xacro="{XACRO}"><xacro:arm/></robot>',
            "is a xacro file",
        ),
        (
            f'<!DOCTYPE r [<!ENTITY e0 "ha">{ENTITIES}]><robot name="&e9;"/>',
            "well-formed XML",
        ),
        (
            "<robot name='toy'>" + 10_000 * "<a>" + 10_000 * "</a>" + "</robot>",
            "not a valid URDF",
        ),
        (
            f"<robot name='t'><link name='base'/>{link('a')}{SHIFTED}</robot>",
            "not a valid URDF",
        ),
    ],
)
def test_malformed_files_are_refused_with_the_reason(tmp_path, text, message):
    path = tmp_path / "bad.urdf"
    path.write_text(text)

    with pytest.raises(UrdfFileError, match=message):
        load_urdf(path)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"locked_joints": ["j9"]}, UnknownNameError, r"cannot lock 'j9'.*joints: j1"),
        ({"locked_joints": "j1"}, InputError, "expected a list of names"),
        ({"locked_joints": {"j1": np.nan}}, InputError, "position of 'j1' is nan"),
        (
            {"without": ["hand"]},
            UnknownNameError,
            "leave out 'hand'.*links: base, needle_tip",
        ),
        ({"without": ["base"]}, InputError, "'base', it is the root"),
        ({"without": "base"}, InputError, "expected a list of link names"),
        (
            {"tool_frame": "tool"},
            UnknownNameError,
            r"no frame 'tool'.*base, j1, needle_tip",
        ),
        ({"tool_placement": [1, 2]}, InputError, r"tool_placement has shape \(2,\)"),
        (
            {"tool_placement": 2 * np.eye(4)},
            InputError,
            "tool_placement is not a rigid motion",
        ),
        ({"gravity_m_s2": 9.81}, InputError, "gravity_m_s2"),
        ({"payload": 0.3}, InputError, "Payload, NeedleTool or None, got float"),
        (
            {"payload": NeedleTool()},
            UnknownNameError,
            "'needle_tip', but robot 'toy' has one",
        ),
    ],
)
def test_arguments_that_do_not_fit_are_refused(urdf_file, arguments, error, message):
    path = urdf_file(link("needle_tip"), joint("j1", "base", "needle_tip"))
    with pytest.raises(error, match=message):
        load_urdf(path, **arguments)
