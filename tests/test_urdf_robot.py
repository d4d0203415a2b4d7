"""Robots from numbers and by hand: checked, nothing changes behind one's back, copies as asked."""

from dataclasses import FrozenInstanceError

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.recorded.panda import read_panda
from urdf import (
    InertiaError,
    InputError,
    NeedleTool,
    Payload,
    Robot,
    SerialJoint,
    UnknownNameError,
    build_serial_robot,
    load_lwr,
)

ROTOR = np.array([3.19, 3.05, 1.98, 2.05, 0.787, 0.391, 0.394])
POINT = np.array([1.0, 0, 0, 0.1, 0.02, 0, 0.02, 0, 0, 0.01])


def test_unknown_frame_lists_the_valid_ones(lwr):
    assert lwr.model.frames[lwr.tool_frame_id].name == lwr.tool_frame == "needle_tip"
    with pytest.raises(UnknownNameError, match=r"no frame 'tip' .*flange, ft_sensor, needle_tip"):
        lwr.frame_id("tip")
    for which in ("tool_frame", "flange_frame"):
        names = {"tool_frame": "flange", "flange_frame": "flange"} | {which: "nowhere"}
        with pytest.raises(UnknownNameError, match="'nowhere'"):
            Robot(bare_model=lwr.bare_model, **names)


def test_robot_is_frozen_its_arrays_read_only_and_its_model_a_copy(lwr):
    with pytest.raises(FrozenInstanceError):
        lwr.tool_frame = "flange"
    ranges = [f"position_{end}_rad" for end in ("lower", "upper")]
    for name in (*ranges, "velocity_limit_rad_s", "effort_limit_Nm", "gravity_m_s2"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(lwr, name)[0] = 1.0
    given = pin.Model(lwr.bare_model)
    robot = Robot(bare_model=given, tool_frame="flange", flange_frame="flange")
    given.inertias[7] = pin.Inertia.Zero()
    given.gravity = pin.Motion.Zero()
    assert robot.model.inertias[7].mass == pytest.approx(0.2806)
    assert robot.gravity_m_s2[2] == pytest.approx(-9.80665)
    first, second = lwr.create_data(), lwr.create_data()
    pin.crba(lwr.model, first, np.zeros(7))
    assert np.all(second.M == 0.0)


def test_with_payload_replaces_and_leaves_the_original_alone(lwr):
    heavy = Payload(mass_kg=2.0, com_m=np.zeros(3), inertia_kg_m2=0.01 * np.eye(3))
    before = pin.computeTotalMass(lwr.model)
    loaded = lwr.with_payload(heavy)
    assert pin.computeTotalMass(loaded.model) == pytest.approx(14.0503 + 2.0)
    assert pin.computeTotalMass(lwr.model) == before
    assert loaded.payload is heavy
    assert loaded.tool_frame == "needle_tip"
    bare = loaded.with_payload(None)
    assert bare.model.inertias[7].isApprox(load_lwr().model.inertias[7])
    with pytest.raises(InputError, match=r"NeedleTool .*\.payload"):
        lwr.with_payload(NeedleTool())


def test_armature_is_added_to_the_diagonal_of_the_mass_matrix_only(lwr):
    q = np.array([0.3, -0.4, 0.5, 1.2, -0.7, 0.9, 0.2])
    robots = (lwr, lwr.with_armature(ROTOR))
    matrices = [pin.crba(r.model, r.create_data(), q) for r in robots]
    assert matrices[1] - matrices[0] == pytest.approx(np.diag(ROTOR), abs=1e-12)
    gravity = [pin.computeGeneralizedGravity(r.model, r.create_data(), q) for r in robots]
    assert gravity[0] == pytest.approx(gravity[1])
    assert lwr.with_armature(ROTOR).with_payload(None).model.armature == pytest.approx(ROTOR)
    assert lwr.with_payload(None).with_armature(ROTOR).payload is None
    for rotor in ([1.0] * 6, [1.0] * 6 + [np.nan], [1.0] * 6 + [-1.0], "seven"):
        with pytest.raises(InputError, match="rotor_inertia_kg_m2"):
            lwr.with_armature(rotor)


# An arm from numbers: the same as from its URDF, and identified tables of real arms.


def a_joint(**change):
    good = {"name": "j1", "placement": np.eye(4), "axis": np.array([0, 1.0, 0]), "inertia": POINT}
    return SerialJoint(**(good | change))


def test_the_lwr_from_numbers_is_the_lwr_from_its_urdf(lwr):
    axes = [(0, 0, 1), (0, -1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 2)]
    heights = [0.110, 0.200, 0.200, 0.200, 0.200, 0.190, 0.078]
    bodies = [body.toDynamicParameters() for body in load_lwr().model.inertias[1:]]
    joints = [
        SerialJoint(
            name=f"j{i}",
            placement=pin.SE3(np.eye(3), np.array([0, 0, height])),
            axis=np.array(axis, dtype=float),
            inertia=inertia,
        )
        for i, (axis, height, inertia) in enumerate(zip(axes, heights, bodies, strict=True))
    ]
    built = build_serial_robot(joints, payload=NeedleTool())
    rng = np.random.default_rng(2)
    for _ in range(5):
        q, dq, ddq = rng.uniform(-1, 1, (3, 7))
        torque = [pin.rnea(r.model, r.create_data(), q, dq, ddq) for r in (built, lwr)]
        assert torque[0] == pytest.approx(torque[1], abs=1e-12)
    assert (built.tool_frame, built.flange_frame) == ("needle_tip", "tool")
    assert built.joint_names == tuple(f"j{i}" for i in range(7))


def test_tool_placement_and_rotor_inertia_enter_the_model():
    offset = np.eye(4)
    offset[:3, 3] = [0.1, 0.2, 0.3]
    robot = build_serial_robot([a_joint()], tool_placement=offset, rotor_inertia_kg_m2=[0.7])
    frame = robot.model.frames[robot.tool_frame_id]
    assert frame.placement.translation == pytest.approx([0.1, 0.2, 0.3])
    mass_matrix = pin.crba(robot.model, robot.create_data(), np.zeros(1))
    assert mass_matrix[0, 0] == pytest.approx(0.02 + 0.7)


def test_a_modified_dh_row_is_its_placement(recordings_dir):
    """The Panda's published table puts the flange where the arm's data sheet does."""
    robot = read_panda(recordings_dir).robot
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, np.zeros(7))
    height = 0.333 + 0.316 + 0.384 - 0.107
    assert data.oMf[robot.frame_id("tool")].translation == pytest.approx([0.088, 0, height])


def test_unphysical_and_massless_links_are_refused_unless_asked_for():
    bad = POINT.copy()
    bad[9] = 0.9
    idle = [a_joint(), a_joint(name="j2", inertia=np.zeros(10))]
    for joints, message in (
        ([a_joint(inertia=bad)], r"link behind joint 'j1'.*triangle"),
        (idle, "move no inertia: j2"),
    ):
        with pytest.raises(InertiaError, match=message):
            build_serial_robot(joints)
        assert build_serial_robot(joints, check_inertias=False).nv == len(joints)


def test_joint_arrays_are_read_only_copies():
    axis = np.array([0, 0, 3.0])
    joint = a_joint(axis=axis)
    axis[0] = 1.0
    assert joint.axis == pytest.approx([0, 0, 1])
    with pytest.raises(ValueError, match="read-only"):
        joint.inertia[0] = 2.0


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"axis": np.zeros(3)}, InputError, "axis is zero"),
        ({"axis": np.zeros(2)}, InputError, "axis has shape"),
        ({"inertia": np.zeros(6)}, InputError, "inertia has shape"),
        ({"inertia": np.full(10, np.nan)}, InputError, "inertia has NaN"),
        ({"inertia": np.eye(10)[1]}, InertiaError, "mass is 0 kg but"),
        ({"placement": np.eye(3)}, InputError, "placement has shape"),
        ({"placement": np.diag([1.0, 1, -1, 1])}, InputError, "not a rigid motion"),
        ({"placement": np.diag([1.0, 1, 1, 2])}, InputError, "not a rigid motion"),
    ],
)
def test_malformed_joints_are_refused(change, error, message):
    with pytest.raises(error, match=message):
        a_joint(**change)


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        ([], {}, "names"),
        (["a", "a"], {}, "names"),
        (["tool"], {}, "names"),
        (["a"], {"tool_placement": np.eye(3)}, "tool_placement"),
        (["a"], {"rotor_inertia_kg_m2": [1.0, 1.0]}, "rotor_inertia_kg_m2"),
        (["a"], {"gravity_m_s2": [1.0, 1.0]}, "gravity_m_s2"),
    ],
)
def test_malformed_chains_and_options_are_refused(names, options, message):
    with pytest.raises(InputError, match=message):
        build_serial_robot([a_joint(name=name) for name in names], **options)
