"""Any URDF: what loads, and what cannot work is refused."""

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
    joints_towards,
    load_urdf,
    movable_joints,
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


def body(name, mass="1", moments=(0.01, 0.01, 0.01)):
    ixx, iyy, izz = moments
    inertia = f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/>'
    return link(name, ORIGIN, f'<mass value="{mass}"/>', inertia)


@pytest.fixture
def arm(tmp_path):
    """Write an arm made of the given pieces, `base` first, and return its path."""

    def write(*pieces, base='<link name="base"/>'):
        path = tmp_path / "arm.urdf"
        path.write_text("\n".join(['<robot name="toy">', base, *pieces, "</robot>"]))
        return path

    return write


ONE = (link("a"), joint("j1", "base", "a"))
TWO = (*ONE, link("b"), joint("j2", "a", "b"))
HAND = (
    *TWO,
    link("hand"),
    joint("palm", "b", "hand", kind="fixed"),
    link("f1"),
    joint("finger", "hand", "f1"),
    link("f2"),
    joint(
        "other_finger",
        "hand",
        "f2",
        extra='<mimic joint="finger" multiplier="-2" offset="0.1"/>',
    ),
    link("wheel"),
    joint("wheel_joint", "base", "wheel", kind="continuous"),
    link("ball"),
    joint("ball_joint", "base", "ball", kind="floating"),
)


def torque_at(robot, q):
    return pin.computeGeneralizedGravity(
        robot.model, robot.create_data(), np.array(q, dtype=float)
    )


# What loads.


def test_the_last_link_is_the_tool_frame_and_what_is_not_used_is_not_read(arm):
    mesh = '<visual><geometry><mesh filename="nowhere.stl"/></geometry></visual>'
    odd = '<dynamics friction="-1" damping="x"/><calibration rising="nan"/>'
    shaped = link("a").replace("</link>", f"{mesh}</link>")
    path = arm(shaped, joint("j1", "base", "a", extra=odd), *TWO[2:], f"<x>{mesh}</x>")
    robot = load_urdf(path)

    assert (robot.joint_names, robot.tool_frame, robot.flange_frame) == (
        *(("j1", "j2"), "b", "b"),
    )
    assert robot.warnings == ()


TOY = b'<robot name="toy">'


@pytest.mark.parametrize(
    ("start", "name"),
    [
        (TOY + b'<gazebo><sensor:camera name="rgb" x:y="1"/></gazebo>', "toy"),
        (b'<?xml version="1.0" encoding="gb2312"?><!-- a -->\n' + TOY, "toy"),
        (
            b"\xef\xbb\xbf\n" + TOY + b'<gazebo><xacro:grey xmlns:z="z"/></gazebo>',
            "toy",
        ),
        (TOY + "<!-- Länge -->".encode("cp1252"), "toy"),
        (b"<robot>", "arm"),  # called as its file
    ],
)
def test_xml_that_the_usual_reader_takes_loads(arm, start, name):
    path = arm(*ONE)
    path.write_bytes(path.read_bytes().replace(TOY, start))
    robot = load_urdf(path)

    assert (robot.nv, robot.model.name) == (1, name)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('type="revolute"', 'type="continuous"', (-np.inf, np.inf, 5.0, 2.0)),
        ('lower="-1" upper="1"', 'lower="0" upper="0"', (-np.inf, np.inf, 5.0, 2.0)),
        ('lower="-1" upper="1"', 'lower="1" upper="-1"', (-np.inf, np.inf, 5.0, 2.0)),
        ('lower="-1" upper="1"', "", (-np.inf, np.inf, 5.0, 2.0)),
        ("<limit[^>]*>", "", (-np.inf, np.inf, 0.0, 0.0)),
        ('effort="5"', 'effort="-5"', (-1.0, 1.0, 0.0, 2.0)),
        ('effort="5"', "", (-1.0, 1.0, 0.0, 2.0)),
        ('velocity="2"', 'velocity="0"', (-1.0, 1.0, 5.0, 0.0)),
    ],
)
def test_limits_that_are_none_are_not_known(arm, old, new, expected):
    robot = load_urdf(arm(link("a"), re.sub(old, new, ONE[1])))
    limits = np.concatenate(
        [
            *(robot.position_lower_rad, robot.position_upper_rad),
            *(robot.effort_limit_Nm, robot.velocity_limit_rad_s),
        ]
    )

    # A continuous joint is an angle.
    assert (*limits, robot.model.nq) == (*expected, 1)
    assert torque_at(robot, [0.5]) == pytest.approx(
        torque_at(load_urdf(arm(*ONE)), [0.5])
    )


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
def test_a_welded_joint_stands_where_it_was_locked(arm, kind):
    turned = '<origin xyz="0.1 0 0.2" rpy="0.3 0 0.5"/>'
    path = arm(*ONE, link("b"), joint("j2", "a", "b", kind=kind, extra=turned))
    free = load_urdf(path)
    welded = load_urdf(path, locked_joints={"j2": 0.7})

    assert torque_at(welded, [0.4]) == pytest.approx(torque_at(free, [0.4, 0.7])[:1])


def test_joints_that_are_not_kept_are_locked_and_followers_follow(arm):
    path = arm(*HAND)
    robot = load_urdf(path, tool_frame="hand", keep_joints=iter(["j2", "j1"]))
    locked = {"finger": 0.3, "wheel_joint": 1.0, "ball_joint": 0.0}
    both = locked | {"other_finger": -0.5}
    arms = [
        load_urdf(path, tool_frame="hand", locked_joints=locked),
        load_urdf(path, tool_frame="hand", locked_joints=both),
        load_urdf(
            path, tool_frame="hand", keep_joints=["j1", "j2"], locked_joints=both
        ),
    ]

    assert robot.joint_names == arms[0].joint_names == ("j1", "j2")
    assert len({tuple(torque_at(one, [0.2, 0.3]).round(9)) for one in arms}) == 1


def test_a_joint_and_a_link_may_share_a_name(arm):
    path = arm(
        *(*ONE, *map(link, ("hand", "tip", "f"))),
        joint("hand", "a", "hand", kind="fixed"),
        joint("tip_joint", "hand", "tip", kind="fixed"),
        joint("grip", "hand", "f", kind="prismatic"),
    )
    for kinds in (
        {"locked_joints": {"grip": 0.01}},
        {"keep_joints": ["j1"]},
        {"locked_joints": ["grip"], "keep_joints": ["j1"]},
    ):
        assert load_urdf(path, tool_frame="tip", **kinds).joint_names == ("j1",)


def test_links_left_out_go_with_their_children(arm):
    path = arm(
        joint("finger_joint", "hand", "finger", kind="continuous"),
        *(link(name) for name in ("finger", "hand", "a")),
        joint("hand_joint", "a", "hand", kind="fixed"),
        joint("j1", "base", "a"),
    )
    robot = load_urdf(path, without=["hand"])

    assert (robot.frame_names, pin.computeTotalMass(robot.model)) == (
        ("universe", "base", "j1", "a"),
        pytest.approx(1.0),
    )
    assert load_urdf(path, without=("finger", "hand")).tool_frame == "a"


def test_the_joints_on_the_way_to_the_tool_are_known(arm):
    assert joints_towards(arm(*TWO), None) == ("j1", "j2")

    path = arm(*HAND)
    towards = [joints_towards(path, frame) for frame in ("hand", "palm", "f2")]

    assert movable_joints(path) == ("j1", "j2", "finger", "wheel_joint")
    assert towards == [("j1", "j2")] * 3
    for frame in ("nowhere", None):
        with pytest.raises(UnknownNameError):
            joints_towards(path, frame)


TURNED = pin.SE3(pin.rpy.rpyToMatrix(0, np.pi / 2, 0), np.array([0, 0, 0.1]))


@pytest.mark.parametrize(
    ("placement", "expected"),
    [
        (TURNED, TURNED.homogeneous),
        (np.diag([-1.0, -1, 1, 1]), np.diag([-1.0, -1, 1, 1])),
        ([0.1, 0, 0.2], pin.SE3(np.eye(3), np.array([0.1, 0, 0.2])).homogeneous),
    ],
)
def test_a_tool_is_placed_anywhere_on_a_link_and_carries_the_needle(
    arm, placement, expected
):
    tool = NeedleTool(sensor_height_m=0)
    robot = load_urdf(arm(*ONE), tool_placement=placement, payload=tool)
    place, tip = (
        robot.model.frames[robot.frame_id(name)].placement
        for name in ("tool", "needle_tip")
    )
    weight = pin.SE3(expected).act(tool.payload.com_m) * 0.068
    body = robot.model.inertias[1]
    found = place.homogeneous, place.actInv(tip).translation, body.mass * body.lever

    assert (robot.tool_frame, robot.flange_frame, *found) == (
        *("needle_tip", "tool", pytest.approx(expected)),
        *(pytest.approx([0, 0, 0.153]), pytest.approx(weight + np.array([0, 0, 0.1]))),
    )


# Inertia.


@pytest.mark.parametrize(
    ("old", "new"),
    [
        *(
            ('value="1"', f'value="{text}"')
            for text in ("1 ", "", "nan", "1e400", "0x10", "1,5", "１", "1_0", "?")
        ),
        ('ixx="0.01"', 'ixx="0,01"'),
        *(
            (ORIGIN, f'<origin xyz="{text}"/>')
            for text in ("0, 0, 1", "0 0", "0 0 nan")
        ),
        (ORIGIN, '<origin rpy="0 0 pi/2"/>'),
        (MASS, "<mass/>"),
        (MASS, ""),
        (INERTIA, "<inertia/>"),
    ],
)
@pytest.mark.parametrize("check", [True, False])
def test_inertials_the_reader_would_drop_are_refused(arm, old, new, check):
    """urdfdom gives such a link no inertia at all and goes on; only stderr knows."""
    path = arm(link("a", (ORIGIN + MASS + INERTIA).replace(old, new)), ONE[1])
    with pytest.raises(UrdfFileError, match="reader"):
        load_urdf(path, check_inertias=check)


@pytest.mark.parametrize("text", [" 1", "+1.0E0", "1."])
def test_numbers_are_parsed_as_the_reader_does(arm, text):
    origins = "<origin xyz=' 0  0 \t1e-1'/><origin xyz='9 9 9'/>"
    moments = INERTIA.replace("0.01", "1.0e-002")
    path = arm(link("a", origins, f'<mass value="{text}"/>', moments), ONE[1])
    inertia = load_urdf(path).model.inertias[1]

    assert (inertia.mass, inertia.lever) == (1.0, pytest.approx([0, 0, 0.1]))


@pytest.mark.parametrize(
    ("mass", "moments"),
    [
        ("-1", (0.01, 0.01, 0.01)),
        ("1", (0.01, 0.01, -0.002)),
        ("1", (0.01, 0.01, 0.03)),
    ],
)
def test_inertia_no_body_can_have_is_refused_and_may_be_accepted(arm, mass, moments):
    path = arm(body("a", mass, moments), ONE[1])
    with pytest.raises(InertiaError, match="j1"):
        load_urdf(path)

    assert "j1" in load_urdf(path, check_inertias=False).warnings[0]


@pytest.mark.parametrize(
    ("moments", "is_refused"),
    [((0.002, 0.002, 0.0284), False), ((0.002, 0.002, 0.0304), True)],
)
def test_a_large_arm_may_have_a_small_body_that_cannot_be(arm, moments, is_refused):
    """5 % of what the first joint turns: 0.5 kg m^2 are tolerated by 0.025."""
    links = body("a", moments=(0.5, 0.5, 0.01)), body("b", "1e-6", moments)
    path = arm(*(each.replace(ORIGIN, "") for each in links), *TWO[1::2])
    accepted = load_urdf(path, check_inertias=False).warnings

    assert ["j2" in warning for warning in accepted] == [True] * is_refused


def test_only_what_links_have_together_matters(arm):
    path = arm(
        *(*ONE, body("flange", mass="0.1", moments=(1e-4, 1e-4, 1e-3))),
        joint("flange_joint", "a", "flange", kind="fixed"),
        base=body("base", moments=(0.01, 0.01, 0.5)),
    )

    assert load_urdf(path).warnings == ()


def test_all_joints_that_move_no_mass_are_named_at_once_and_can_be_accepted(arm):
    path = arm(
        *ONE,
        *(f'<link name="{name}"/>' for name in "bde"),
        link("c"),
        joint("j2", "a", "b"),
        joint("j3", "b", "c"),
        joint("j4", "c", "d"),
        joint("j5", "d", "e", kind="fixed"),
    )
    with pytest.raises(InertiaError, match=r"j2.*j4"):
        load_urdf(path)
    robot = load_urdf(path, check_inertias=False)

    assert (robot.nv, len(robot.warnings)) == (4, 2)


def test_an_arm_without_any_inertia_is_refused_with_the_checks_off(arm):
    path = arm('<link name="a"/>', ONE[1])
    with pytest.raises(InertiaError, match="joint j1"):
        load_urdf(path, check_inertias=False)

    # What hangs on the flange is inertia of the last joint.
    assert load_urdf(path, payload=NeedleTool(sensor_height_m=0)).nv == 1


def test_a_payload_may_be_a_point(arm):
    # Rounding may leave a point mass a moment that Pinocchio's constructor refuses.
    moments = np.diag([0, -1e-20, 0])
    hung = Payload(mass_kg=0.3, com_m=np.full(3, 0.1), inertia_kg_m2=moments)
    hanging = load_urdf(arm(*ONE), payload=hung).model

    assert pin.computeTotalMass(hanging) == pytest.approx(1.3)


# What is refused.


def chain(count):
    """Links l1 to l(count - 1), one after the other on the base."""
    joints = [joint(f"j{k}", f"l{k - 1}", f"l{k}") for k in range(2, count)]
    links = [link(f"l{k}") for k in range(1, count)]
    return *links, joint("j1", "base", "l1"), *joints


def test_a_long_chain_loads_with_few_joints(arm):
    assert load_urdf(arm(*chain(299)), keep_joints=["j7"], tool_frame="l298").nv == 1


NO_TREES = [
    link("a"),
    ONE[1],
    joint("j2", "a", "c"),
    joint("j2", "x", "a"),
    link("b"),
    joint("j2", "a", "base"),
    joint("j2", "base", "a"),
]
POINT = link("b", MASS, re.sub(r"0\.01", "0", INERTIA))
NEEDLE_THERE = link("needle_tip"), joint("j1", "base", "needle_tip")


@pytest.mark.parametrize(
    ("pieces", "arguments", "error", "word"),
    [
        *(
            ((*ONE, one), {"tool_frame": "a"}, UrdfFileError, "valid")
            for one in NO_TREES
        ),
        (chain(501), {}, UrdfFileError, "499"),
        (chain(299), {}, UnsupportedJointError, "298"),
        ((*ONE, f"<!--{9_000_000 * ' '}-->"), {}, UrdfFileError, "larger"),
        (
            HAND,
            {"tool_frame": "hand"},
            UnsupportedJointError,
            "ball_joint.*other_finger",
        ),
        ((*ONE, POINT, joint("idle", "a", "b")), {}, InertiaError, "idle"),
        (NEEDLE_THERE, {"payload": NeedleTool()}, UnknownNameError, "needle_tip"),
    ],
    ids=range(13),
)
def test_what_makes_no_arm_is_refused(arm, pieces, arguments, error, word):
    with pytest.raises(error, match=word):
        load_urdf(arm(*pieces), **arguments)


@pytest.mark.parametrize(
    "name", ["none.urdf", "", "pipe.urdf", "a\0b.urdf", "binary.urdf", 5000 * "x"]
)
def test_what_is_no_file_of_text_is_refused(tmp_path, name):
    (tmp_path / "binary.urdf").write_bytes(b"\xff\xfe\x00\x80")
    os.mkfifo(tmp_path / "pipe.urdf")
    with pytest.raises(UrdfFileError):
        load_urdf(tmp_path / name)


XACRO = "http://www.ros.org/wiki/xacro"
SHIFTED = joint("j", "base", "a", extra='<origin xyz="0, 0, 1"/>')
ENTITIES = "".join(f'<!ENTITY e{k + 1} "{10 * f"&e{k};"}">' for k in range(9))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "XML"),
        ("<robot name='toy'><link name='a'/>", "XML"),
        ("<?xml\nversion='1.0'?>\n<!-- -\n-->\n<robot>\n</bot>", "line 6"),
        ("<sdf/>", "sdf"),
        (f'<robot name="x" xmlns:xacro="{XACRO}"><xacro:arm/></robot>', "xacro"),
        ('<robot><link name="a"/><xacro:include filename="b"/></robot>', "xacro"),
        (f'<!DOCTYPE r [<!ENTITY e0 "ha">{ENTITIES}]><robot name="&e9;"/>', "DOCTYPE"),
        ("<robot name='toy'>" + 10_000 * "<a>" + 10_000 * "</a>" + "</robot>", "valid"),
        (f"<robot><link name='base'/>{link('a')}{SHIFTED}</robot>", "valid"),
        *(
            ("<robot name='a'>" + unit * (200_000 // len(unit)), "XML")
            for unit in ("<!--", "<?xml ", "<?xml", "&", "&a", "<!-- & -->&")
        ),
    ],
)
def test_malformed_files_are_refused(tmp_path, text, word):
    path = tmp_path / "bad.urdf"
    path.write_text(text)

    with pytest.raises(UrdfFileError, match=word):
        load_urdf(path)


@pytest.mark.parametrize(
    ("arguments", "error", "word"),
    [
        ({"locked_joints": ["j9"]}, UnknownNameError, "j9"),
        ({"locked_joints": {"palm": 1}}, UnknownNameError, "palm"),
        ({"keep_joints": ["j9"]}, UnknownNameError, "j9"),
        ({"keep_joints": ["palm"]}, UnknownNameError, "palm"),
        ({"locked_joints": "j1"}, UnknownNameError, "'j'"),
        ({"keep_joints": "j1"}, UnknownNameError, "'j'"),
        ({"locked_joints": {"j1": np.nan}}, InputError, "j1"),
        ({"keep_joints": ["j1"], "locked_joints": ["j1"]}, InputError, "j1"),
        ({"keep_joints": ["other_finger"]}, UnsupportedJointError, "other_finger"),
        ({"keep_joints": []}, UnsupportedJointError, "no joint"),
        ({"without": ["foot"]}, UnknownNameError, "foot"),
        ({"without": ["base"]}, InputError, "base"),
        ({"without": "base"}, UnknownNameError, "'s'"),
        ({"tool_frame": "tool"}, UnknownNameError, "base, "),
        ({"tool_placement": [1, 2]}, InputError, "tool_placement"),
        ({"tool_placement": 2 * np.eye(4)}, InputError, "tool_placement"),
        ({"gravity_m_s2": 9.81}, InputError, "gravity_m_s2"),
        ({"payload": 0.3}, InputError, "float"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arm, arguments, error, word):
    kept = {} if "locked_joints" in arguments else {"keep_joints": ["j1", "j2"]}
    with pytest.raises(error, match=word):
        load_urdf(arm(*HAND), **{"tool_frame": "hand"} | kept | arguments)
