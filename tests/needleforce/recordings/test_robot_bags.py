"""Bags as drivers of robots record them, of ROS 1 and ROS 2, need no mapping."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from needleforce.cli.logs.tool_mass import model_tool_mass_kg, tool_mass_warnings
from needleforce.recordings import ColumnError, read_log
from needleforce.recordings.table import ToolMass, choose_tool_mass
from tests.needleforce.recordings.bag_samples import (
    START_NS,
    STEP_NS,
    joint_state,
    write_bag,
)
from urdf import Payload

ROWS = 60
JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
Q_RAD = np.arange(ROWS)[:, None] * 0.01 + np.arange(7)
FRANKA_STATE = """std_msgs/Header header
float64[7] q
float64[7] q_d
float64[7] dq
float64[7] tau_J
float64[7] tau_J_d
float64[6] O_F_ext_hat_K
float64[7] tau_ext_hat_filtered
float64 m_ee
float64 m_load
float64 m_total
uint8 ROBOT_MODE_OTHER=0
uint8 robot_mode
"""
ROBOT_STATE = """std_msgs/Header header
sensor_msgs/JointState measured_joint_state
sensor_msgs/JointState desired_joint_state
float64[7] dtau_j
sensor_msgs/JointState tau_ext_hat_filtered
geometry_msgs/InertiaStamped inertia_total
"""
UR_JOINTS = ["elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint"] + [
    f"wrist_{i}_joint" for i in (1, 2, 3)
]


@pytest.fixture(scope="module")
def ros1():
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(get_types_from_msg(FRANKA_STATE, "franka_msgs/msg/FrankaState"))
    return types


def make(types, kind, *values):
    return types.types[kind](*values)


def ros1_header(types, k):
    stamp = divmod(START_NS + k * STEP_NS, 1_000_000_000)
    time = make(types, "builtin_interfaces/msg/Time", *stamp)
    return make(types, "std_msgs/msg/Header", k, time, "base")


def write_ros1(path, types, rows, compression=None):
    """Write rows of topic, number and message."""
    bag = Writer(path)
    if compression is not None:
        bag.set_compression(compression)

    connections = {}
    with bag:
        for topic, k, content in rows:
            kind = content.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=types)

            log_ns = START_NS + k * STEP_NS + 500
            data = types.serialize_ros1(content, kind)
            bag.write(connections[topic], log_ns, data)

    return path


def franka_rows(types):
    zeros = np.zeros(7)
    for k in range(ROWS):
        header = ros1_header(types, k)
        q = Q_RAD[k]
        state = (q, zeros, 2.0 * q, 3.0 * q, zeros, np.zeros(6), 4.0 * q, 0.7, 0.1, 0.8)
        kind = "franka_msgs/msg/FrankaState"
        yield "/arm/franka_states", k, make(types, kind, header, *state, 0)
        signals = (JOINTS, 9.0 * q, zeros, zeros)
        kind = "sensor_msgs/msg/JointState"
        yield "/joint_states", k, make(types, kind, header, *signals)


def assert_franka(log, count=ROWS):
    for name, factor in (("q_rad", 1), ("dq_rad_s", 2), ("tau_Nm", 3)):
        np.testing.assert_allclose(log[name], factor * Q_RAD[:count])


@pytest.mark.parametrize("compression", [None, "LZ4", "BZ2"])
def test_franka_states_of_ros1_are_found_beside_joint_states(
    tmp_path, ros1, compression
):
    packing = compression and Writer.CompressionFormat[compression]
    path = write_ros1(tmp_path / "arm.bag", ros1, franka_rows(ros1), packing)
    log = read_log(path, required=["q", "tau"], optional=["dq"], joints=JOINTS)

    assert_franka(log)
    assert log.start_ns == START_NS
    assert log.warnings == ()


def test_joint_states_and_wrench_of_ros1_are_columns(tmp_path, ros1):
    def rows():
        for k in range(ROWS):
            header = ros1_header(ros1, k)
            zeros = np.zeros(7)
            signals = (JOINTS[::-1], Q_RAD[k], zeros, 2.0 * Q_RAD[k])
            kind = "sensor_msgs/msg/JointState"
            yield "/joint_states", k, make(ros1, kind, header, *signals)
            kind = "geometry_msgs/msg/Vector3"
            vectors = [make(ros1, kind, 0.0, 0.0, float(k)) for _ in range(2)]
            wrench = make(ros1, "geometry_msgs/msg/Wrench", *vectors)
            kind = "geometry_msgs/msg/WrenchStamped"
            yield "/ft", k, make(ros1, kind, header, wrench)

    path = write_ros1(tmp_path / "arm.bag", ros1, rows())
    log = read_log(path, required=["q", "tau"], joints=JOINTS)

    np.testing.assert_allclose(log["q_rad"], Q_RAD[:, ::-1])
    with pytest.raises(ColumnError, match=r"/ft/force_xyz \(3 columns\)"):
        read_log(path, required=["force"])


@pytest.mark.parametrize(("stated_kg", "is_named"), [(0.32, False), (0.8, True)])
def test_another_tool_mass_is_one_warning_with_both(lwr, stated_kg, is_named):
    payload = Payload(
        mass_kg=0.3, com_m=(0.0, 0.0, 0.1), inertia_kg_m2=np.zeros((3, 3))
    )
    robot = lwr.with_payload(payload)
    warnings = tool_mass_warnings(ToolMass(stated_kg, "m_total"), robot)

    assert model_tool_mass_kg(robot) == pytest.approx(0.3)
    assert [("0.8 kg" in text, "0.3 kg" in text) for text in warnings] == (
        [(True, True)] if is_named else []
    )


def test_efforts_of_a_ur_driver_are_called_currents(tmp_path):
    names = [f"left_{name}" for name in UR_JOINTS]
    rows = [
        (
            "/joint_states",
            START_NS + k * STEP_NS,
            joint_state(START_NS + k * STEP_NS, names, range(6), range(6), range(6)),
        )
        for k in range(ROWS)
    ]
    log = read_log(write_bag(tmp_path / "ur", rows), required=["q", "tau"])

    assert any("motor currents in A" in text for text in log.warnings)


def test_a_bad_stamp_in_a_bag_costs_its_message(tmp_path):
    rows = []
    for k in range(ROWS):
        log_ns = START_NS + k * STEP_NS
        stamp_ns = log_ns + (400_000_000_000 if k == 30 else 0)
        rows.append(("/joint_states", log_ns, joint_state(stamp_ns, JOINTS, Q_RAD[k])))

    log = read_log(write_bag(tmp_path / "bag", rows), required=["q"])

    np.testing.assert_allclose(log["q_rad"], np.delete(Q_RAD, 30, axis=0))


@pytest.mark.parametrize(
    ("total_kg", "parts_kg", "expected_kg"),
    [(0.8, (0.7, 0.2), 0.8), (0.0, (0.7, 0.2), 0.9), (None, (0.7, 0.2), 0.9)],
)
def test_the_whole_tool_mass_counts_or_else_that_of_its_parts(
    total_kg, parts_kg, expected_kg
):
    total = None if total_kg is None else ToolMass(total_kg, "m_total")
    chosen = choose_tool_mass(total, [ToolMass(kg, "part") for kg in parts_kg])

    assert chosen.mass_kg == pytest.approx(expected_kg)
