"""What a user adds to the known words, units and layouts, and the layouts we know."""

import numpy as np
import pytest

from needleforce.recordings import (
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
