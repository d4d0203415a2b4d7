"""Which columns are which channels and in which unit: names, mappings, layouts."""

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings import (
    CHANNELS,
    ChannelRequest,
    ColumnError,
    ColumnMapping,
    ColumnSpec,
    FileAccessError,
    Log,
    LogError,
    MappingError,
    Table,
    UnitError,
    load_layouts,
    load_mapping,
    parse_column_spec,
    read_log,
    suggest_mapping,
)
from needleforce.recordings.log import log_of_table
from tests.needleforce.recordings.bag_samples import mapped, number, write_bag

T_S = np.arange(3.0) / 100
ONES = np.ones(3)


def log_of(mapping=None, required=(), optional=(), joints=(), units=None, **columns):
    table = Table(columns={"t_s": T_S, **columns}, units=units or {})
    request = ChannelRequest(mapping or mapped(), required, optional, joints)
    return log_of_table(table, request)


@pytest.mark.parametrize(
    ("t_s", "channels"),
    [
        (T_S, {}),
        ([0.0, np.nan, 1.0], {"force_N": ONES}),
        (T_S, {"force_N": T_S[:-1]}),
        (T_S, {"force_N": ["a", "b", "c"]}),
        (np.empty(0), {"force_N": np.empty(0)}),
    ],
)
def test_what_forms_no_log_is_refused(t_s, channels):
    with pytest.raises(LogError):
        Log(t_s=t_s, channels=channels)


def test_a_log_holds_copies_that_nobody_changes():
    t_s = T_S.copy()
    log = Log(t_s=t_s, channels={"force_N": t_s})
    t_s[0] = 99.0

    assert (log.t_s[0], log["force_N"][0]) == (0.0, 0.0)
    assert not log.t_s.flags.writeable
    assert not log["force_N"].flags.writeable
    assert "force_N" in log
    with pytest.raises(ColumnError, match="depth_m"):
        log["depth_m"]


@pytest.mark.parametrize(
    ("text", "channel", "factor"),
    [
        *(("kN", "force", 1e3), ("KN", "force", 1e3), ("cN", "force", 1e-2)),
        *(("g", "force", 9.80665e-3), ("kgF", "force", 9.80665)),
        *(("lbs", "force", 4.4482216152605), ("ozF", "force", 0.27801385095)),
        *(("Newton", "force", 1.0), ("in", "depth", 0.0254), ("grads", "depth", None)),
        *(("μm", "depth", 1e-6), ("degrees", "q", np.pi / 180), ("N*m", "tau", 1.0)),
        *(("°/s", "dq", np.pi / 180), ("rev/min", "dq", 2 * np.pi / 60)),
        *(("deg/sec", "dq", np.pi / 180), ("N-mm", "tau", 1e-3), ("N·m", "tau", 1.0)),
        *(("in-lbf", "tau", 0.1129848290), ("lbf·in", "tau", 0.1129848290)),
        *(
            ("cN·m", "tau", 1e-2),
            ("kgf·cm", "tau", 0.0980665),
            ("kgf*m", "tau", 9.80665),
        ),
        *(("sec", "time", 1.0), ("min", "time", 60.0), ("mm/min", "speed", 1e-3 / 60)),
        *(("mm_per_s", "speed", 1e-3), ("inch/min", "speed", 0.0254 / 60)),
        *(("%", "force", None), ("MN", "force", None), ("n", "force", None)),
        *(("M", "depth", None), ("grad", "q", None)),
    ],
)
def test_units_of_laboratories_have_their_factor(text, channel, factor):
    if factor is None:
        with pytest.raises(MappingError, match="unit"):
            mapped(**{channel: ColumnSpec(columns="x", unit=text)})
        return

    unit = CHANNELS[channel].units.find(text)
    assert CHANNELS[channel].units[unit] == pytest.approx(factor)


@given(
    st.sampled_from([(n, u) for n, c in CHANNELS.items() for u in c.units]),
    st.floats(-4.0, 4.0).filter(lambda scale: abs(scale) > 0.01),
)
def test_units_and_scales_multiply(chosen, scale):
    name, unit = chosen
    scale = abs(scale) if name == "time" else scale
    channel = CHANNELS[name]
    raw = np.array([1.0, 2.0, 4.0])
    mapping = mapped(**{name: ColumnSpec(columns="x", unit=unit, scale=scale)})
    log = log_of(mapping, x=raw, force_N=ONES)
    values = log.t_s if name == "time" else log[channel.key]

    np.testing.assert_allclose(values.ravel(), raw * channel.units[unit] * scale)
    assert values.ndim == 1 + channel.per_joint


@pytest.mark.parametrize("channel", [c for c in CHANNELS.values() if c.name != "time"])
def test_usual_names_match_any_case_path_and_unit(channel):
    for spelling in channel.spellings:
        for unit in ("", *channel.units):
            suffix = f"_{unit.replace('/', '_')}" if unit else ""
            for name in (f"{spelling}{suffix}", f"/topic/{spelling.upper()}{suffix}"):
                log = log_of(
                    None, (channel.name,), **{name: 1e-9 * ONES, "other": ONES}
                )
                factor = channel.units[unit] if unit else 1.0
                np.testing.assert_allclose(
                    log[channel.key].ravel(), 1e-9 * factor * ONES
                )


@pytest.mark.parametrize(
    ("channel", "names"),
    [
        ("q", ["q3", "q2", "q1"]),
        ("q", [f"q_{i}" for i in range(11, 0, -1)]),
        ("q", ["position[1]", "position[0]"]),
        ("q", ["q_deg_2", "q_deg_1"]),
        ("q", ["q2_deg", "q1_deg"]),
        ("q", ["J2 Position (deg)", "J1 Position (deg)"]),
        ("q", ["joint_2_position", "joint_1_position"]),
        ("q", ["A2 pos [rad]", "A1 pos [rad]"]),
        ("q", ["state.q[1]", "state.q[0]"]),
        ("q", ["MeasuredJointPosition2", "MeasuredJointPosition1"]),
        ("q", ["position.a2", "position.a1"]),
        (
            "q",
            [
                "/iiwa/state/JointPosition/position/a2",
                "/iiwa/state/JointPosition/position/a1",
            ],
        ),
        ("tau", ["field.torque.a2", "field.torque.a1"]),
        ("tau", ["effort_J2", "effort_J1"]),
        ("tau", ["torque joint 2", "torque joint 1"]),
        ("tau", ["/dsr01/raw_joint_torque.1", "/dsr01/raw_joint_torque.0"]),
        ("dq", ["actual_qd_0"]),
        ("depth", ["depth_m_04"]),
        ("depth", ["Crosshead"]),
        ("depth", ["Position (mm)"]),
        ("force", ["Kraft in kN"]),
        ("force", ["Load/kN"]),
    ],
)
def test_columns_are_found_by_their_names_in_the_order_of_joints(channel, names):
    values = {name: 0.001 * (len(names) - k) * ONES for k, name in enumerate(names)}
    log = log_of(None, (channel,), **values, q_d=ONES, effort_x=ONES)
    (unit,) = [unit for unit in log.units if unit.channel == channel]

    assert list(unit.columns) == sorted(names, key=lambda name: values[name][0])
    assert ("deg" in names[0]) == ("deg" in unit.units)


@pytest.mark.parametrize(
    ("channel", "names", "word"),
    [
        ("force", ["force", "fz"], "fz"),
        ("tau_ext", ["tau_ext", "external_torque"], "external_torque"),
        ("q", ["q", "position"], "position"),
        ("q", ["q1", "q2", "/other/q1", "/other/q2"], "/other/q#"),
        ("q", ["q1", "q2", "q4"], "not 3"),
        ("tau", ["moment"], "moment"),
        ("tau", ["actual_joint_torque_0", "actual_joint_torque_1"], "actual_joint"),
        ("force", ["Position (mm)"], "Position"),
    ],
)
def test_ambiguous_incomplete_or_missing_columns_are_refused(channel, names, word):
    with pytest.raises(ColumnError, match=word) as refused:
        log_of(None, (channel,), **dict.fromkeys(names, ONES))
    assert channel in str(refused.value) + refused.value.advice


def test_what_force_writes_unsmoothed_is_preferred():
    log = log_of(None, ("force",), axial_N=ONES, axial_unsmoothed_N=2.0 * ONES)

    assert log["force_N"].tolist() == [2.0] * 3


NAMES = ["q3", "q1", "q2", "a", "k10", "k08", "k09", "odd*name", "/j10/e", "/j9/e"]


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("a", ["a"]),
        ("q{1..3}", ["q1", "q2", "q3"]),
        ("k{08..10}", ["k08", "k09", "k10"]),
        ("q*", ["q1", "q2", "q3"]),
        ("/j*/e", ["/j9/e", "/j10/e"]),
        ("q", ["q1", "q2", "q3"]),
        ("wrench[2]", ["wrench[2]"]),
        ("odd*name", ["odd*name"]),
        (("a", "k08"), ["a", "k08"]),
    ],
)
def test_a_pattern_orders_columns_by_number(pattern, names):
    wrench = np.arange(18.0).reshape(3, 6)
    columns = {name: k * ONES for k, name in enumerate(NAMES)}
    log = log_of(mapped(tau=pattern), ("tau",), **columns, wrench=wrench)
    expected = [wrench[:, 2] if "[" in n else columns[n] for n in names]

    assert list(log.units[1].columns) == names
    np.testing.assert_array_equal(log["tau_Nm"], np.stack(expected, axis=1))


@pytest.mark.parametrize(
    "pattern",
    ["Q1", "q{1..4}", "x_*", "q1[0]", "wrench[6]", "p", "h", "q{1..1000000000000}"],
)
def test_patterns_that_fit_nothing_or_not_only_one_are_refused(pattern):
    names = ("q1", "q2", "p1", "p4", "h1", "h_1")
    columns = dict.fromkeys(names, ONES)
    with pytest.raises(ColumnError):
        log_of(mapped(tau=pattern), ("tau",), **columns, wrench=np.zeros((3, 6)))


@pytest.mark.parametrize(
    ("mapping", "required", "error", "word"),
    [
        (None, ("torque",), MappingError, "torque"),
        (mapped(force="pair"), (), ColumnError, "pair"),
        (mapped(q=("a", "short")), (), LogError, "short"),
        (mapped(depth="short"), (), LogError, "short"),
        (mapped(q="pair", tau="a"), (), LogError, "tau"),
        (mapped(depth="empty"), ("depth",), LogError, "depth_m"),
        (
            mapped(q=ColumnSpec(columns="pair", scale=(1.0, 2.0, 3.0))),
            (),
            MappingError,
            "q",
        ),
        (mapped(q="none"), ("q",), MappingError, "none"),
        (mapped(force="a", dq="half"), (), LogError, "joint 2"),
        (ColumnMapping(joints="left_*"), (), ColumnError, "left_"),
    ],
)
def test_channels_that_do_not_fit_each_other_are_refused(
    mapping, required, error, word
):
    pair = np.ones((3, 2))
    columns = {"a": ONES, "short": ONES[:2], "pair": pair, "empty": ONES * np.nan}
    half = pair * [1.0, np.nan]
    with pytest.raises(error, match=word):
        log_of(mapping, required, **columns, half=half, force=ONES)


def test_only_the_channels_asked_for_are_read():
    columns = {
        "force_N": ONES,
        "depth_m": ONES,
        "z": ONES,
        "q": ONES,
        "dq": ONES * np.nan,
    }

    assert list(log_of(None, ("force",), **columns).channels) == ["force_N"]
    with pytest.raises(ColumnError, match="z"):
        log_of(None, ("force",), ("depth",), **columns)

    log = log_of(None, ("q",), ("dq",), **columns)
    assert list(log.channels) == ["q_rad"]
    assert "dq" in log.warnings[0]
    log = log_of(mapped(q="none"), (), ("q", "force"), **columns)
    assert list(log.channels) == ["force_N"]


@pytest.mark.parametrize("name", ["dq", "force"])
def test_rows_with_missing_values_are_counted_and_kept(name):
    values = np.array([1.0, np.nan, np.inf])
    log = log_of(None, **{name: values})

    assert "2 (first: row 2)" in log.warnings[0]
    np.testing.assert_array_equal(log[CHANNELS[name].key].ravel(), values)


@pytest.mark.parametrize(
    ("columns", "channel"),
    [
        ({"t_s": None, "t": np.arange(3.0), "f": ONES}, "time"),
        ({"q": 90.0 * ONES}, "q"),
        ({"dq": 90.0 * ONES}, "dq"),
        ({"tau": 9000.0 * ONES}, "tau"),
        ({"depth": 40.0 * T_S / T_S[1]}, "depth"),
        ({"v": 3.0 * ONES}, "speed"),
        ({"f": 900.0 * ONES}, "force"),
    ],
)
def test_an_assumed_unit_that_the_values_contradict_is_refused(columns, channel):
    table = {"t_s": T_S, **columns}
    table = Table(columns={name: v for name, v in table.items() if v is not None})
    with pytest.raises(UnitError, match=channel) as refused:
        log_of_table(table, ChannelRequest())
    assert ":UNIT" in refused.value.advice


def test_stated_units_are_not_doubted_and_spikes_are_reported():
    stated = {"q_rad": 90.0 * ONES, "depth_m": 85.0 * ONES, "v_m_s": ONES}
    assert log_of(**stated).warnings == ()
    assert log_of(q=3.0 * ONES, depth=0.1 * ONES, v=0.1 * ONES).warnings == ()

    force_N = np.ones(100)
    force_N[50] = 5000.0
    table = Table(columns={"t": np.arange(100) / 100, "f": force_N})
    assert "5000" in log_of_table(table, ChannelRequest()).warnings[0]
    assert "kN" in log_of(f=0.01 * ONES).warnings[0]


def test_the_origin_of_every_unit_is_reported():
    mapping = mapped(force=ColumnSpec(columns="x", unit="mN", scale=-1.0))
    columns = {"x": ONES, "Weg": ONES, "q": np.ones((3, 2))}
    log = log_of(mapping, units={"Weg": "mm"}, **columns)

    assert {unit.channel: str(unit) for unit in log.units} == {
        "time": "t_s in s (header)",
        "q": "q in rad (assumed)",
        "depth": "Weg in mm (row of units)",
        "force": "x in mN (mapping); times -1",
    }


@pytest.mark.parametrize(
    ("asked", "row", "column"),
    [
        ("m", "mm", "z"),
        ("N", None, "Force (kN)"),
        (None, "N", "Force (kN)"),
        (None, "%", "Load"),
        (None, "daN", "Load"),
        ("N", "%", "Load"),
    ],
)
def test_units_that_contradict_each_other_are_refused(asked, row, column):
    channel = "depth" if column == "z" else "force"
    spec = ColumnSpec(columns=column, unit=asked)
    mapping = mapped(**({channel: spec} if asked else {}))
    units = {column: row} if row else {}
    with pytest.raises(UnitError, match=channel):
        log_of(mapping, (channel,), units=units, **{column: ONES})

    # A factor stands for a unit that is not known, the mapping decides between two.
    if row in ("%", "daN"):
        scaled = mapped(force=ColumnSpec(columns=column, scale=10.0))
        log = log_of(scaled, units=units, **{column: ONES})
        assert log["force_N"].tolist() == [10.0] * 3
    if (asked, row) == (None, "N"):
        decided = mapped(force=ColumnSpec(columns=column, unit="kN"))
        log = log_of(decided, units=units, **{column: ONES})
        assert log["force_N"].tolist() == [1000.0] * 3


def from_toml(tmp_path, text, name="mapping.toml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_toml_gives_columns_units_scales_and_rate(tmp_path):
    text = """
        rate_hz = 500
        depth = "z:mm:-1"
        q = ["a", "b"]
        [tau]
        columns = "i{1..2}"
        unit = "mNm"
        scale = [10.5, -9]
        """
    mapping = load_mapping(from_toml(tmp_path, text))

    assert mapping.rate_hz == 500
    assert mapping.channels["depth"] == ColumnSpec(columns="z", unit="mm", scale=-1.0)
    assert mapping.channels["q"] == ColumnSpec(columns=("a", "b"))
    tau = ColumnSpec(columns="i{1..2}", unit="mNm", scale=(10.5, -9.0))
    assert mapping.channels["tau"] == tau


@pytest.mark.parametrize(
    "text",
    [
        *("depth = ", "depht = 'z'", "rate_hz = 'fast'", "rate_hz = -1", ""),
        *(f"a = {'[' * 5000}", "[depth]\ncolumn = 'z'", "[depth]\nunit = 'mm'"),
        *("[depth]\ncolumns = 'z'\nunit = 'kN'", "depth = ''", "depth = 3"),
        *("[depth]\ncolumns = 'z'\nscale = 0", "joints = ['a', 'a']", "depth = 'z:0'"),
        *("rate_hz = 10\ntime = 't'", "x" * (5 << 20)),
    ],
)
def test_a_wrong_mapping_is_refused(tmp_path, text):
    path = from_toml(tmp_path, text)
    with pytest.raises(MappingError, match="mapping"):
        load_mapping(path)

    with pytest.raises(FileAccessError):
        load_mapping(tmp_path / "missing.toml")


@pytest.mark.parametrize("scale", [0.0, np.nan, np.inf, (1.0, 0.0), (), 10**400])
def test_a_scale_is_finite_and_not_zero(scale):
    with pytest.raises(MappingError, match="scale"):
        ColumnSpec(columns="z", scale=scale)


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("fz", ColumnSpec(columns="fz")),
        ("fz:N:-1", ColumnSpec(columns="fz", unit="N", scale=-1.0)),
        ("fz:-2", ColumnSpec(columns="fz", scale=-2.0)),
        ("a, b:kN:1,2", ColumnSpec(columns=("a", "b"), unit="kN", scale=(1.0, 2.0))),
        ("ns:fz", ColumnSpec(columns="ns:fz")),
    ],
)
def test_the_short_form_has_names_unit_and_scale(text, spec):
    assert parse_column_spec(text, CHANNELS["force"]) == spec


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
note = "currents"
channels = { q = "axis*:deg", tau = "i*:Nm:2.5", dq = "none" }
"""


def test_a_users_words_units_and_layouts_are_known(tmp_path):
    ours = from_toml(tmp_path, OURS, "ours.toml")
    words = from_toml(
        tmp_path, "zaman [sn],droga [mm],load [daN]\n0,1,2\n1,2,3\n", "w.csv"
    )
    log = read_log(words, required=("depth", "force"), layouts=[ours])
    assert log["force_N"].tolist() == [20.0, 30.0]
    assert log["depth_m"].tolist() == [0.001, 0.002]
    assert log.t_s.tolist() == [0.0, 1.0]

    rig = from_toml(
        tmp_path, "axis1;axis2;i1;i2\n90;0;2.0;4.0\n90;45;2.0;4.0\n", "r.csv"
    )
    log = read_log(rig, required=("q", "tau"), layouts=[ours])
    np.testing.assert_allclose(log["q_rad"], [[np.pi / 2, 0], [np.pi / 2, np.pi / 4]])
    assert log["tau_Nm"].tolist() == [[5.0, 10.0], [5.0, 10.0]]
    assert log.t_s.tolist() == [0.0, 0.002]
    assert "currents" in log.warnings[0]

    text = 'rate_hz = 100\ntau = "i*:Nm:-1"'
    mapping = load_mapping(from_toml(tmp_path, text), load_layouts(ours))
    log = read_log(rig, mapping, required=("q", "tau"))
    assert log["tau_Nm"].tolist() == [[-2.0, -4.0], [-2.0, -4.0]]
    assert log.t_s.tolist() == [0.0, 0.01]
    with pytest.raises(ColumnError, match="currents"):
        read_log(rig, required=("force",), layouts=[ours])


def test_a_layout_may_order_the_joints_and_a_mapping_wins(tmp_path):
    text = '[[layouts]]\nname = "rig"\ncolumns = ["a_q"]\njoints = ["b", "a"]'
    ours = from_toml(tmp_path, text, "ours.toml")
    rig = from_toml(tmp_path, "t,a_q,b_q\n0,1,2\n0.1,1,2\n", "rig.csv")
    log = read_log(rig, required=("q",), joints=("a", "b"), layouts=[ours])
    assert log["q_rad"][0].tolist() == [2.0, 1.0]

    mapping = ColumnMapping(joints=("a", "b"))
    log = read_log(rig, mapping, required=("q",), layouts=[ours])
    assert log["q_rad"][0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    "text",
    [
        *("units = ", "[units.force]\ndaN = ['x']", "[units.force]\ndaN = [0]"),
        *("[channels.depth]\nword = ['a']", "[channels.x]\nkey = 'x'"),
        "[channels.x]\nkey = 'x'\nquantity = 'mass'\nmeaning = ''\nnames = []",
        *("[[layouts]]\nname = 'a'", "[[layouts]]\nname = 'a'\ncolumns = []"),
        "[[layouts]]\nname = 'a'\ncolumns = ['a']\nchannels = { x = 'a' }",
    ],
)
def test_a_wrong_layout_is_refused(tmp_path, text):
    with pytest.raises(MappingError):
        load_layouts(from_toml(tmp_path, text, "wrong.toml"))


@pytest.mark.parametrize(
    ("names", "step"),
    [
        ("time,success_rate,state.q[0],state.q[1],state.tau_J[0],state.tau_J[1]", 1),
        ("%time,spare,position0,position1,effort0,effort1", 1_000_000),
        ("record_time_nsec,spare,mp1,mp2,mt1,mt2", 1_000_000),
    ],
)
def test_known_layouts_need_no_mapping(tmp_path, names, step):
    rows = "".join(f"{k * step},1.0,0,1,2,3\n" for k in range(3))
    log = read_log(
        from_toml(tmp_path, f"{names}\n{rows}", "x.csv"), required=("q", "tau")
    )

    np.testing.assert_allclose(log.t_s, [0.0, 0.001, 0.002])
    assert log["q_rad"].tolist() == [[0.0, 1.0]] * 3
    assert log["tau_Nm"].tolist() == [[2.0, 3.0]] * 3


PANDA = [f"panda_joint{i}" for i in range(1, 4)]


@pytest.mark.parametrize(
    "form", ["panda_{}_{}", "/joints/panda_{}/{}", "left_{1}_{0}", "{}.{}"]
)
def test_columns_named_after_joints_are_found(form):
    q_rad = 0.1 * np.arange(9.0).reshape(3, 3)
    columns = {
        form.format(f"joint{k + 1}", quantity): factor * q_rad[:, k]
        for k in (2, 0, 1)
        for quantity, factor in (("position", 1), ("effort", 2), ("desired_effort", 3))
    }
    log = log_of(None, ("q", "tau"), joints=PANDA, **columns)

    np.testing.assert_allclose(log["q_rad"], q_rad)
    np.testing.assert_allclose(log["tau_Nm"], 2.0 * q_rad)


def test_the_joints_that_are_wanted_are_named_where_columns_have_others():
    columns = {f"/js/{j}/{q}": ONES for j in "ab" for q in ("position", "effort")}
    with pytest.raises(ColumnError, match="panda_joint1, panda_joint2"):
        log_of(None, ("q", "tau"), joints=PANDA[:2], **columns)
    mapping = ColumnMapping(joints=("b", "a"))
    log = log_of(mapping, ("q", "tau"), joints=PANDA[:2], **columns)

    assert log.units[1].columns == ("/js/b/position", "/js/a/position")


def test_a_suggested_mapping_reads_the_log_and_names_stay_comments(tmp_path):
    evil = 'x\nrate_hz = 5\n[force]\ncolumns = "t"'
    path = tmp_path / "evil\nrate_hz = 6\n.npz"
    columns = {
        "t": np.arange(3.0) / 100,
        "load_kN": ONES,
        "q1_deg": ONES,
        "q2_deg": ONES,
    }
    np.savez(path, **columns, wrench=np.ones((3, 6)), **{evil: ONES})
    known = mapped(dq="none", tau=ColumnSpec(columns="wrench", scale=2.0))
    text = suggest_mapping(path, ["force", "q", "dq", "tau", "depth"], mapping=known)
    content = tomllib.loads(text)

    assert set(content) == {"time", "force", "q", "dq", "tau"}
    assert content["force"] == {"columns": "load_kN", "unit": "kN", "scale": 1.0}
    assert content["q"]["columns"] == ["q1_deg", "q2_deg"]
    assert "wrench" not in text.partition("not used")[2]
    log = read_log(path, load_mapping(from_toml(tmp_path, text)), required=["force"])
    assert log["force_N"].tolist() == [1000.0] * 3

    folder = write_bag(tmp_path / "bag", [(f"/{evil}", k, number(k)) for k in range(9)])
    assert tomllib.loads(suggest_mapping(folder, ["depth"])) == {}
