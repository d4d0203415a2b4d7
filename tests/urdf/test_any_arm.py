"""URDFs as they are published: odd where it cannot matter, and what they lack."""

import re
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest

from tests.urdf.test_loading import ORIGIN, joint, link
from urdf import (
    InertiaError,
    InputError,
    NeedleTool,
    UnknownNameError,
    UnsupportedJointError,
    UrdfFileError,
    load_urdf,
)
from urdf.joint_choice import joints_towards, movable_joints

BASE = '<link name="base"/>'
GROUND = (BASE, link("a"), joint("j1", "base", "a"))
TWO = (*GROUND, link("b"), joint("j2", "a", "b"))


def body(name, mass="1", moments=(0.01, 0.01, 0.01)):
    ixx, iyy, izz = moments
    inertia = f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/>'
    return link(name, ORIGIN, f'<mass value="{mass}"/>', inertia)


@pytest.fixture
def arm(tmp_path):
    """Write an arm made of the given pieces, and return its path."""

    def write(*pieces, before="", name="arm"):
        path = tmp_path / f"{name}.urdf"
        text = "\n".join([f'{before}<robot name="{name}">', *pieces, "</robot>"])
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def torque_at(robot, q):
    return pin.computeGeneralizedGravity(
        robot.model, robot.create_data(), np.array(q, dtype=float)
    )


def test_a_continuous_joint_is_an_angle_without_limits(arm):
    pieces = (*GROUND, link("b"), joint("j2", "a", "b", kind="continuous"))
    without_limit = re.sub(r"<limit[^>]*>", "", pieces[-1])
    robot = load_urdf(arm(*pieces))

    assert (robot.nv, robot.model.nq) == (2, 2)
    assert robot.position_lower_rad[1] == -np.inf
    assert robot.position_upper_rad[1] == np.inf
    assert robot.effort_limit_Nm[1] == 5.0
    assert load_urdf(arm(*pieces[:-1], without_limit)).effort_limit_Nm[1] == 0.0
    bent = torque_at(robot, [0.3, 1.0])
    assert torque_at(robot, [0.3, 1.0 + 2.0 * np.pi]) == pytest.approx(bent)
    assert load_urdf(arm(*TWO)).joint_names == robot.joint_names
    assert torque_at(load_urdf(arm(*TWO)), [0.3, 1.0]) == pytest.approx(bent)


def test_a_welded_joint_stands_where_it_was_locked(arm):
    turned = '<origin xyz="0.1 0 0.2" rpy="0.3 0 0.5"/>'
    for kind in ("revolute", "continuous", "prismatic"):
        pieces = (*GROUND, link("b"), joint("j2", "a", "b", kind=kind, extra=turned))
        free = load_urdf(arm(*pieces))
        welded = load_urdf(arm(*pieces), locked_joints={"j2": 0.7})

        assert torque_at(welded, [0.4]) == pytest.approx(
            torque_at(free, [0.4, 0.7])[:1]
        )


def test_a_joint_and_a_link_may_share_a_name(arm):
    path = arm(
        *GROUND,
        link("hand"),
        joint("hand", "a", "hand", kind="fixed"),
        link("tip"),
        joint("tip_joint", "hand", "tip", kind="fixed"),
        link("finger"),
        joint("grip", "hand", "finger", kind="prismatic"),
    )
    robot = load_urdf(path, tool_frame="tip", locked_joints={"grip": 0.01})

    assert robot.joint_names == ("j1",)
    assert load_urdf(path, tool_frame="tip", keep_joints=["j1"]).nv == 1
    assert load_urdf(path, tool_frame="tip", locked_joints=["hand", "grip"]).nv == 1


@pytest.mark.parametrize(
    "extra",
    [
        '<dynamics friction="-1" damping="x"/>',
        "<safety_controller/>",
        '<calibration rising="nan"/>',
    ],
)
def test_what_is_not_used_stops_no_file(arm, extra):
    visual = '<visual><geometry><box size="a"/></geometry></visual></link>'
    shaped = link("a").replace("</link>", visual)
    path = arm(BASE, shaped, joint("j1", "base", "a", extra=extra))

    assert load_urdf(path).nv == 1


@pytest.mark.parametrize(
    ("before", "within"),
    [
        ("", '<gazebo><sensor:camera name="rgb" x:y="1"/></gazebo>'),
        ("\n\n<?xml version='1.0'?>", ""),
        ('<?xml version="1.0" encoding="gb2312"?><!-- a -- b --->', ""),
        ("\ufeff", "<gazebo>A & B \x01</gazebo>"),
        ("", '<gazebo><xacro:grey xmlns:z="z"/></gazebo>'),
    ],
)
def test_xml_that_the_usual_reader_takes_loads(arm, before, within):
    assert load_urdf(arm(*GROUND, within, before=before)).nv == 1


def test_a_comment_in_another_code_page_stops_no_file(arm):
    path = arm(*GROUND, "<!-- KIND -->")
    path.write_bytes(path.read_bytes().replace(b"KIND", "Länge".encode("cp1252")))

    assert load_urdf(path).nv == 1


def test_an_unexpanded_xacro_file_is_named(arm):
    path = arm(*GROUND, '<xacro:include filename="arm.xacro"/>')

    with pytest.raises(UrdfFileError, match="is a xacro file"):
        load_urdf(path)


def test_inertia_that_cannot_matter_is_not_looked_at(arm):
    odd = body("ground", moments=(0.01, 0.01, 0.5))
    path = arm(
        odd,
        link("mast", '<mass value="?"/>'),
        joint("mount", "ground", "mast", kind="fixed"),
        link("arm"),
        joint("j1", "mast", "arm"),
        body("flange", mass="0", moments=(0.1, 0.1, 0.1)),
        joint("flange_joint", "arm", "flange", kind="fixed"),
        link("loose", '<mass value="1 kg"/>'),
        joint("neck", "mast", "loose"),
    )
    robot = load_urdf(path, tool_frame="flange", keep_joints=["j1"])

    assert robot.warnings == ()
    assert robot.bare_model.inertias[1].mass == 1.0

    slider = joint("j1", "base", "a", kind="prismatic")
    path = arm(BASE, body("a", moments=(0.01, 0.01, 0.5)), slider)

    assert load_urdf(path).warnings == ()


def test_inertia_impossible_by_little_is_one_warning_with_its_effect(arm):
    rounded = body("b", moments=(-3.5e-8, 3.5e-8, 9e-8))
    broken = body("c", moments=(0.01, 0.01, 0.0206))
    path = arm(*GROUND, rounded, joint("j2", "a", "b"), broken, joint("j3", "b", "c"))
    robot = load_urdf(path, payload=NeedleTool(sensor_height_m=0))

    assert len(robot.warnings) == 1
    assert "the inertia of b, c, by up to 0.0006 kg m^2" in robot.warnings[0]
    assert "at rest" in robot.warnings[0]
    assert "0.006 N on a lever of 0.1 m" in robot.warnings[0]
    assert robot.with_payload(None).warnings == robot.warnings


def test_a_large_arm_may_have_a_small_body_that_cannot_be(arm):
    path = arm(
        BASE,
        body("upper", mass="20", moments=(0.5, 0.5, 0.1)),
        joint("j1", "base", "upper"),
        body("wrist", moments=(0.001, 0.002, 0.016)),
        joint("j2", "upper", "wrist", extra='<origin xyz="0 0 0.5"/>'),
    )

    assert "of wrist, by up to 0.013 kg m^2" in load_urdf(path).warnings[0]


def test_all_links_without_inertia_are_named_at_once_and_can_be_accepted(arm):
    path = arm(
        *GROUND,
        *(f'<link name="{name}"/>' for name in "bde"),
        link("c"),
        joint("j2", "a", "b"),
        joint("j3", "b", "c"),
        joint("j4", "c", "d"),
        joint("j5", "d", "e", kind="fixed"),
    )
    message = r"without inertia: b \(joint j2\), d \(joint j4\)(.|\n)*check_inertias"
    with pytest.raises(InertiaError, match=message):
        load_urdf(path)

    robot = load_urdf(path, check_inertias=False)

    assert robot.nv == 4
    assert "without inertia: b (joint j2), d (joint j4)" in robot.warnings[0]
    assert "weight" in robot.warnings[0]


def test_an_arm_without_any_inertia_is_named_with_the_checks_off(arm):
    path = arm(BASE, '<link name="a"/>', joint("j1", "base", "a"))
    for check in (True, False):
        with pytest.raises(InertiaError, match=r"without inertia: a \(joint j1\)"):
            load_urdf(path, check_inertias=check)

    # What hangs on the flange is inertia of the last joint.
    assert load_urdf(path, payload=NeedleTool(sensor_height_m=0)).nv == 1


def test_several_faults_are_one_message(arm):
    path = arm(
        *GROUND,
        body("b", mass="-1"),
        joint("j2", "a", "b"),
        body("c", moments=(0.01, 0.01, 0.5)),
        joint("j3", "b", "c"),
        '<link name="d"/>',
        joint("j4", "c", "d"),
    )
    message = "'b': mass is -1.*'c': principal.*without inertia: d"
    with pytest.raises(InertiaError, match=message):
        load_urdf(path)


MIMIC = '<mimic joint="finger" multiplier="-2" offset="0.1"/>'
ROBOT = (
    *TWO,
    link("hand"),
    joint("palm", "b", "hand", kind="fixed"),
    link("f1"),
    joint("finger", "hand", "f1"),
    link("f2"),
    joint("other_finger", "hand", "f2", extra=MIMIC),
    link("wheel"),
    joint("wheel_joint", "base", "wheel", kind="continuous"),
    link("ball"),
    joint("ball_joint", "base", "ball", kind="floating"),
)


def test_all_joints_that_cannot_move_are_named_at_once(arm):
    message = "'other_finger' mimics 'finger'; joint 'ball_joint' is of type 'floating'"
    with pytest.raises(UnsupportedJointError, match=rf"{message}(.|\n)*keep_joints"):
        load_urdf(arm(*ROBOT), tool_frame="hand")


def test_joints_that_are_not_kept_are_locked(arm):
    path = arm(*ROBOT)
    robot = load_urdf(path, tool_frame="hand", keep_joints=["j2", "j1"])

    assert robot.joint_names == ("j1", "j2")

    posture = {"finger": 0.3, "wheel_joint": 1.0, "ball_joint": 0.0}
    closed = load_urdf(path, tool_frame="hand", locked_joints=posture)
    both = posture | {"other_finger": -0.5}

    assert closed.joint_names == ("j1", "j2")
    assert torque_at(closed, [0.2, 0.3]) == pytest.approx(
        torque_at(load_urdf(path, tool_frame="hand", locked_joints=both), [0.2, 0.3])
    )
    kept = load_urdf(
        path, tool_frame="hand", keep_joints=["j1", "j2"], locked_joints=both
    )
    assert torque_at(kept, [0.2, 0.3]) == pytest.approx(torque_at(closed, [0.2, 0.3]))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"keep_joints": ["j9"]}, UnknownNameError, "cannot keep 'j9'.*joints: j1, j2"),
        ({"keep_joints": ["palm"]}, UnknownNameError, "cannot keep 'palm'"),
        ({"locked_joints": {"palm": 1}}, UnknownNameError, "cannot lock 'palm'"),
        ({"keep_joints": "j1"}, InputError, "expected a list of names"),
        (
            {"keep_joints": ["j1"], "locked_joints": ["j1"]},
            InputError,
            "in locked_joints and in keep_joints",
        ),
        ({"keep_joints": ["other_finger"]}, UnsupportedJointError, "mimics"),
        ({"keep_joints": []}, UnsupportedJointError, "no joint that moves"),
    ],
)
def test_joints_to_keep_that_do_not_fit_are_refused(arm, arguments, error, message):
    with pytest.raises(error, match=message):
        load_urdf(arm(*ROBOT), **{"tool_frame": "hand"} | arguments)


def test_the_joints_on_the_way_to_the_tool_are_known(arm):
    assert joints_towards(arm(*TWO), None) == ("j1", "j2")

    path = arm(*ROBOT)

    assert movable_joints(path) == ("j1", "j2", "finger", "wheel_joint")
    for frame in ("hand", "palm", "f2"):
        assert joints_towards(path, frame) == ("j1", "j2")
    for frame in ("nowhere", None):
        with pytest.raises(UnknownNameError):
            joints_towards(path, frame)


def test_five_hundred_joints_are_refused_before_there_is_a_model(arm, monkeypatch):
    def build(*_):
        raise AssertionError("a model was built")

    monkeypatch.setattr("urdf.loading.build_model", build)
    names = [f"l{k}" for k in range(501)]
    joints = [joint(f"j{k}", names[k], names[k + 1]) for k in range(500)]
    for pieces in ([*joints, *map(link, names)], [*map(link, names), *joints]):
        with pytest.raises(UrdfFileError, match="more than 499 joints"):
            load_urdf(arm(*pieces))


def test_a_robot_without_a_name_is_called_as_its_file(arm):
    path = arm(*GROUND, name="toy")
    path.write_text(path.read_text().replace(' name="toy"', ""))

    assert load_urdf(path).model.name == "toy"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r'effort="5"', 'effort="-5"'),
        (r'effort="5"', ""),
        (r'effort="5" velocity="2"', 'effort="0" velocity="0"'),
    ],
)
def test_a_torque_limit_that_cannot_be_is_not_known(arm, old, new):
    limited = joint("j1", "base", "a").replace(old, new)
    robot = load_urdf(arm(BASE, link("a"), limited))

    assert robot.effort_limit_Nm[0] == 0.0
    assert robot.position_upper_rad[0] == 1.0


@pytest.mark.parametrize("limits", ["", 'lower="0" upper="0"', 'lower="1" upper="-1"'])
def test_positions_without_room_are_not_limited(arm, limits):
    limited = joint("j1", "base", "a").replace('lower="-1" upper="1"', limits)
    robot = load_urdf(arm(BASE, link("a"), limited))

    assert robot.position_lower_rad[0] == -np.inf
    assert robot.position_upper_rad[0] == np.inf
    assert robot.effort_limit_Nm[0] == 5.0


@pytest.mark.parametrize(
    ("piece", "message"),
    [
        (link("a"), "link 'a' stands twice"),
        (GROUND[2], "joint 'j1' stands twice; link 'a' hangs on two joints"),
        (
            joint("j2", "a", "c"),
            "joint 'j2' has the child link 'c', which is not there",
        ),
        (link("b"), "2 links hang on nothing, expected one: base, b"),
    ],
)
def test_what_is_no_tree_of_links_is_named(arm, piece, message):
    with pytest.raises(UrdfFileError, match=f"not a valid URDF: {message}"):
        load_urdf(arm(*GROUND, piece))


@pytest.mark.parametrize("unit", ["<!--", "<?xml ", "<?xml", "&", "&a", "<!-- & -->&"])
def test_a_file_of_marks_alone_is_refused_at_once(tmp_path, unit):
    """200 kB of `<!--` once took minutes; the limit only tells those apart."""
    path = tmp_path / "marks.urdf"
    path.write_text("<robot name='a'>" + unit * (200_000 // len(unit)))
    program = (
        "from pathlib import Path\n"
        "from urdf.errors import UrdfFileError\n"
        "from urdf.xml_reader import read_links_and_joints\n"
        "try:\n"
        f"    read_links_and_joints(Path({str(path)!r}))\n"
        "except UrdfFileError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=60.0,
        check=True,
    )

    assert "is not well-formed XML" in done.stdout


def test_an_error_names_the_line_of_the_file(tmp_path):
    path = tmp_path / "bad.urdf"
    path.write_text("<?xml\nversion='1.0'?>\n<!-- --\n-->\n<robot>\n</bot>")

    with pytest.raises(UrdfFileError, match="line 6"):
        load_urdf(path)
