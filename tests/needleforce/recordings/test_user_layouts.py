"""What a user adds to the known words, units and layouts, and the layouts we know."""

import numpy as np
import pytest

from needleforce.recordings import (
    CHANNELS,
    ColumnError,
    MappingError,
    UnitError,
    load_layouts,
    load_mapping,
    read_log,
)

RIG = "axis1;axis2;i1;i2\n90;0;2.0;4.0\n90;45;2.0;4.0\n"
OURS = """
[units.force]
daN = [10]
[units.time]
s = [1.0, "sn"]
[channels.depth]
words = ["Droga"]
[[layouts]]
name = "our rig"
columns = ["axis1", "i*"]
rate_hz = 500
joints = []
channels = { q = "axis*:deg", tau = "i*:Nm:2.5", dq = "none" }
"""


@pytest.fixture
def ours(tmp_path):
    path = tmp_path / "ours.toml"
    path.write_text(OURS, encoding="utf-8")
    return path


def written(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_users_words_and_units_are_known(tmp_path, ours):
    path = written(tmp_path, "zaman [sn],droga [mm],load [daN]\n0,1,2\n1,2,3\n")
    with pytest.raises(UnitError, match="'daN', which is no known unit of force"):
        read_log(path, required=("force",))

    log = read_log(path, required=("depth", "force"), layouts=[ours])

    assert log["force_N"].tolist() == [20.0, 30.0]
    assert log["depth_m"].tolist() == [0.001, 0.002]
    assert log.t_s.tolist() == [0.0, 1.0]


def test_a_users_layout_says_columns_units_factors_and_rate(tmp_path, ours):
    path = written(tmp_path, RIG)
    log = read_log(path, required=("q", "tau"), layouts=[ours])

    np.testing.assert_allclose(log["q_rad"], [[np.pi / 2, 0.0], [np.pi / 2, np.pi / 4]])
    assert log["tau_Nm"].tolist() == [[5.0, 10.0], [5.0, 10.0]]
    assert log.t_s.tolist() == [0.0, 0.002]
    assert "dq_rad_s" not in log


def test_a_mapping_comes_before_a_layout(tmp_path, ours):
    path = written(tmp_path, RIG)
    knowledge = load_layouts(ours)
    mapping = load_mapping(
        written(tmp_path, 'rate_hz = 100\ntau = "i*:Nm:-1"', "m.toml"), knowledge
    )
    log = read_log(path, mapping, required=("q", "tau"))

    assert log["tau_Nm"].tolist() == [[-2.0, -4.0], [-2.0, -4.0]]
    assert log.t_s.tolist() == [0.0, 0.01]
    np.testing.assert_allclose(log["q_rad"][1], [np.pi / 2, np.pi / 4])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("units = ", "not valid TOML"),
        ("[units.force]\ndaN = ['x']", "daN = .* expected the factor to SI"),
        ("[units.force]\ndaN = [0]", "daN = .* expected the factor to SI"),
        ("[channels.depth]\nword = ['a']", "unknown field `word`"),
        ("[channels.x]\nkey = 'x'", "missing required field"),
        (
            "[channels.x]\nkey = 'x'\nquantity = 'mass'\nmeaning = ''\nnames = []",
            "quantity 'mass' is none of time, angle",
        ),
        ("[[layouts]]\nname = 'a'", "layout 'a' needs columns or a first_line"),
        ("[[layouts]]\nname = 'a'\nfirst_line = '('", "'.' is no pattern"),
        (
            "[[layouts]]\nname = 'a'\ncolumns = ['a']\nchannels = { x = 'a' }",
            "layout 'a': unknown channel 'x'",
        ),
    ],
)
def test_a_wrong_layout_is_refused_with_its_place(tmp_path, text, message):
    path = written(tmp_path, text, "wrong.toml")
    with pytest.raises(MappingError, match=message):
        load_layouts(path)


STAMP_NS = 1_700_000_000_123_456_789
KNOWN = {
    "libfranka": (
        "time,success_rate,state.q[0],state.q[1],state.tau_J[0],state.tau_J[1]\n"
        + "".join(f"{k},1.0,0,1,2,3\n" for k in range(3)),
        [0.0, 0.001, 0.002],
    ),
    "rostopic": (
        "%time,field.position0,field.position1,field.effort0,field.effort1\n"
        + "".join(f"{STAMP_NS + k * 1_000_000},0,1,2,3\n" for k in range(3)),
        [0.0, 0.001, 0.002],
    ),
    "pyfri": (
        "record_time_nsec,mp1,mp2,mt1,mt2,et1,et2\n"
        + "".join(f"{k * 1_000_000},0,1,2,3,9,9\n" for k in range(3)),
        [0.0, 0.001, 0.002],
    ),
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_layouts_need_no_mapping(tmp_path, name):
    text, t_s = KNOWN[name]
    log = read_log(written(tmp_path, text), required=("q", "tau"))

    assert log.t_s.tolist() == t_s
    assert log["q_rad"].tolist() == [[0.0, 1.0]] * 3
    assert log["tau_Nm"].tolist() == [[2.0, 3.0]] * 3


def test_a_recorder_of_universal_robots_has_no_torque_but_says_so(tmp_path):
    text = "timestamp,actual_q_0,actual_q_1,actual_current_0,actual_current_1\n"
    path = written(tmp_path, text + "0,1,2,3,4\n1,1,2,3,4\n")
    log = read_log(path, required=("q",))

    assert log["q_rad"].tolist() == [[1.0, 2.0]] * 2
    assert any("actual_current is a current" in text for text in log.warnings)
    with pytest.raises(ColumnError, match="no column found for tau"):
        read_log(path, required=("q", "tau"))


def joints(*names, count=2, first=1):
    """A header's columns of joints, name by name."""
    numbers = range(first, first + count)
    return ",".join(name.replace("#", str(k)) for name in names for k in numbers)


KINOVA = joints("cmd_j#", "cmdvel_j#", "meas_j#", "measraw_j#", "vel_j#", "torque_j#")
KUKA = [
    f"{name}_A{k}"
    for k in (1, 2)
    for name in ("Position_Command", "Position", "Torque", "Current", "Temperature")
]
YASKAWA = joints("j#_pos", "j#_vel", "j#_eff")
OMX = joints("joint#_pos", "joint#_vel", "joint#_eff")
TRIFINGER = joints(
    "observation_position_#",
    "observation_velocity_#",
    "observation_torque_#",
    "applied_action_torque_#",
    first=0,
).replace(",", " ")
UR5E = joints("q#", "qd#", "actualI#", "outputI#", "tau#")
MECADEMIC = joints("TargetJointPos_#", "JointPos_#", "JointVel_#", first=0)
PUBLIC = {
    "Kinova Gen3": (
        f"time_s,dt_s,{KINOVA},arm_state\n"
        "0.000,0.001,1,1,1,1,90,180,90,180,30,-30,5.5,-1.25,0\n"
        "0.001,0.001,1,1,1,1,90,180,90,180,30,-30,6.5,-1.25,0\n",
        0.001,
        {
            "q_rad": [1.5707963, 3.1415927],
            "dq_rad_s": [0.5235988, -0.5235988],
            "tau_Nm": [6.5, -1.25],
        },
    ),
    "KUKA KR": (
        f"Sample_time,{','.join(KUKA)},A1,A2,Speed\n"
        "12,1,90,10.5,2,40,1,-45,-3.25,2,40,1,0,20%\n"
        "24,1,90,11.5,2,40,1,-45,-3.25,2,40,1,0,20%\n",
        0.012,
        {"q_rad": [1.5707963, -0.7853982], "tau_Nm": [11.5, -3.25]},
    ),
    "Yaskawa HC10DTP": (
        f"ros_timestamp_ns,wall_time,trajectory_mode,meas_x,{YASKAWA},adapt_w\n"
        "1700000000123456789,2024-05-01T10:00:00.1,hand,0.5,1,2,0.1,0.2,7,-8,0\n"
        "1700000000133456789,2024-05-01T10:00:00.2,hand,0.5,1,2,0.1,0.2,9,-8,0\n",
        0.01,
        {"q_rad": [1.0, 2.0], "dq_rad_s": [0.1, 0.2], "tau_Nm": [9.0, -8.0]},
    ),
    "OpenMANIPULATOR-X": (
        f"t,{OMX}\n0.00,1,2,0.1,0.2,0.7,-0.8\n0.01,1,2,0.1,0.2,0.9,-0.8\n",
        0.01,
        {"q_rad": [1.0, 2.0], "dq_rad_s": [0.1, 0.2], "tau_Nm": [0.9, -0.8]},
    ),
    "TriFinger": (
        f"#time_index timestamp status_action_repetitions {TRIFINGER}\n"
        "0 1586435000.001 0 1 2 0.1 0.2 0.25 -0.35 9 9\n"
        "1 1586435000.002 0 1 2 0.1 0.2 0.27 -0.35 9 9\n",
        0.001,
        {"q_rad": [1.0, 2.0], "dq_rad_s": [0.1, 0.2], "tau_Nm": [0.27, -0.35]},
    ),
    "UR5e": (
        f"time,{UR5E},F_z\n"
        "0.000,1,2,0.1,0.2,700,800,710,810,9,9,3.5\n"
        "0.002,1,2,0.1,0.2,700,800,710,810,9,9,4.5\n",
        0.002,
        {"q_rad": [1.0, 2.0], "dq_rad_s": [0.1, 0.2], "force_N": 4.5},
    ),
    "Mecademic": (
        f"timestamp,{MECADEMIC}\n"
        "     1200512000,      0,      0,     90,    -45,     30,    -30\n"
        "     1200522000,      0,      0,    180,    -45,     30,    -30\n",
        0.01,
        {"q_rad": [3.1415927, -0.7853982], "dq_rad_s": [0.5235988, -0.5235988]},
    ),
    "needle rig": (
        "time,fx,fy,fz,tx,ty,tz,px,py,pz\n"
        "0,-0.007,0.007,0.5,0.03,0.07,0.01,9.9,0.0,-0.5\n"
        "10255,-0.010,0.007,1.25,0.01,0.09,-0.02,9.9,0.0,12.5\n",
        0.010255,
        {"depth_m": 0.0125, "force_N": 1.25},
    ),
    # priyanshum17/pressure, README.md: its names say all.
    "Vernier force plate": (
        "Time(s),Force(N),DeltaF(N),FSR1,FSR2,FSR3\n"
        "7.19,16.611,-1.011,1023,1023,1023\n7.30,17.622,1.011,1023,1023,1023\n",
        0.11,
        {"force_N": 17.622},
    ),
}


@pytest.mark.parametrize("name", PUBLIC)
def test_public_layouts_are_read_in_si_units(tmp_path, name):
    text, step_s, latest = PUBLIC[name]
    channels = [name for name, channel in CHANNELS.items() if channel.key in latest]
    log = read_log(written(tmp_path, text), optional=channels)

    assert log.t_s[1] - log.t_s[0] == pytest.approx(step_s, abs=1e-6)
    for key, values in latest.items():
        assert log[key][1] == pytest.approx(values, abs=1e-6)


def test_measurements_of_flobaroid_are_read(tmp_path):
    path = tmp_path / "measurements.npz"
    np.savez(
        path,
        times=[0.0, 0.005],
        positions=[[1.0, 2.0]] * 2,
        positions_raw=[[8.0, 8.0]] * 2,
        velocities=[[0.1, 0.2]] * 2,
        torques=[[5.0, -6.0], [5.5, -6.0]],
        torques_raw=[[9.0, 9.0]] * 2,
        frequency=200.0,
    )
    log = read_log(path, required=("q", "dq", "tau"))

    assert log.t_s.tolist() == [0.0, 0.005]
    assert log["q_rad"][1].tolist() == [1.0, 2.0]
    assert log["dq_rad_s"][1].tolist() == [0.1, 0.2]
    assert log["tau_Nm"][1].tolist() == [5.5, -6.0]


@pytest.mark.parametrize("name", ["UR5e", "Mecademic"])
def test_what_is_no_measured_torque_is_said(tmp_path, name):
    path = written(tmp_path, PUBLIC[name][0])

    assert any("FACTOR" in note for note in read_log(path).warnings)
    with pytest.raises((ColumnError, MappingError), match=r"(?s)tau.*FACTOR"):
        read_log(path, required=("q", "tau"))
