"""Finding columns, their units, and mappings in code, in TOML and in the short form."""

import tomllib

import numpy as np
import pytest

from needleforce.recordings import (
    CHANNELS,
    ColumnError,
    ColumnMapping,
    ColumnSpec,
    FileAccessError,
    MappingError,
    Table,
    load_mapping,
    read_log,
    write_table,
)
from needleforce.recordings.column_names import (
    detect_columns,
    find_columns,
    parse_column_name,
)
from needleforce.recordings.mapping import parse_column_spec
from needleforce.recordings.mapping_suggestion import suggest_mapping
from tests.needleforce.recordings.bag_samples import mapped

JOINTS = ("q", "dq", "tau")


def table_of(*names, **two_dimensional):
    columns = {name: np.full(3, float(i)) for i, name in enumerate(names)}
    return Table(columns={**columns, **two_dimensional})


def detected(table, channel):
    return detect_columns(table, CHANNELS[channel])


@pytest.mark.parametrize(
    ("written", "channel", "unit"),
    [
        ("mm/s", "speed", "mm/s"),
        ("mm_per_s", "speed", "mm/s"),
        ("µs", "time", "us"),
        ("N·m", "tau", "Nm"),
        ("°/s", "dq", "deg/s"),
        ("n", "force", None),
        ("inch", "depth", "inch"),
    ],
)
def test_units_are_known_in_their_usual_spellings(written, channel, unit):
    assert CHANNELS[channel].units.find(written) == unit


@pytest.mark.parametrize(
    ("name", "channel", "stem", "number", "unit"),
    [
        ("q", "q", "q", None, None),
        ("q1", "q", "q", 1, None),
        ("q[0]", "q", "q", 0, None),
        ("q7_deg", "q", "q", 7, "deg"),
        ("q_rad_7", "q", "q", 7, "rad"),
        ("dq_rad_s", "dq", "dq", None, "rad/s"),
        ("dq_rad_s", "q", "dq_rad_s", None, None),
        ("/joint_states/position[2]", "q", "position", 2, None),
        ("Depth [mm]", "depth", "depth", None, "mm"),
        ("speed_mm_s", "speed", "speed", None, "mm/s"),
        ("depth_m_04", "depth", "depth", 4, "m"),
        ("time [beats]", "time", "time_[beats]", None, None),
        ("q2024051512", "q", "q2024051512", None, None),
    ],
)
def test_a_name_is_taken_apart(name, channel, stem, number, unit):
    parts = parse_column_name(name, CHANNELS[channel].units)
    assert (parts.stem, parts.number, parts.unit) == (stem, number, unit)


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("a", ["a"]),
        ("q{1..3}", ["q1", "q2", "q3"]),
        ("k{08..10}", ["k08", "k09", "k10"]),
        ("q*", ["q1", "q2", "q3"]),
        ("/j*/effort", ["/j9/effort", "/j10/effort"]),
        ("q", ["q1", "q2", "q3"]),
        ("wrench[2]", ["wrench[2]"]),
        ("odd*name", ["odd*name"]),
    ],
)
def test_a_pattern_orders_columns_by_number(pattern, names):
    # Written in an order that is neither the file's nor the alphabet's.
    table = table_of(
        *(
            "q3",
            "q1",
            "q2",
            "a",
            "k10",
            "k08",
            "k09",
            "/j10/effort",
            "/j9/effort",
            "odd*name",
        ),
        wrench=np.arange(18.0).reshape(3, 6),
    )
    assert find_columns(table, pattern) == names


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("force", "no column 'force'. Did you mean 'Force'\\? Columns are: Force, q1"),
        ("q{1..3}", "no column 'q3'"),
        ("x_*", r"no column 'x_\*'. The \* stands for one number; all the rest"),
        ("z", r"no column 'z'. Did you mean 'z \[mm\]'\?"),
        ("q1:grad", "The unit 'grad' is none of this channel's"),
        ("q1[0]", "no column"),
        ("wrench[6]", r"has the elements \[0\] to \[5\]"),
        ("p", "found the numbers 1 to 4, but not 2, 3"),
        ("k", "fits both 'k1' and 'k_1'"),
        ("q{1..1000000000000}", "no column"),
    ],
)
def test_unfitting_or_ambiguous_patterns_are_refused(pattern, message):
    names = ("Force", "q1", "q2", "p1", "p4", "k1", "k_1", "z [mm]", "h1", "h900000000")
    table = table_of(*names, wrench=np.zeros((3, 6)))

    with pytest.raises(ColumnError, match=message):
        find_columns(table, pattern)


@pytest.mark.parametrize("channel", CHANNELS.values(), ids=lambda channel: channel.name)
def test_usual_names_match_any_case_and_unit(channel):
    for spelling in channel.spellings:
        for unit in ("", *(f"_{unit.replace('/', '_')}" for unit in channel.units)):
            for name in (f"{spelling}{unit}", f"/topic/{spelling.upper()}{unit}"):
                assert detected(table_of("other", name), channel.name) == [name]


@pytest.mark.parametrize(
    ("names", "channel", "columns"),
    [
        (["q2", "q1", "q3", "t"], "q", ["q1", "q2", "q3"]),
        ([f"q_{i}" for i in range(1, 12)], "q", [f"q_{i}" for i in range(1, 12)]),
        (["position[1]", "position[0]"], "q", ["position[0]", "position[1]"]),
        (["actual_q_0", "actual_qd_0"], "dq", ["actual_qd_0"]),
        (["q", "q_d"], "q", ["q"]),
        (["depth_m_04", "force_N_04"], "depth", ["depth_m_04"]),
    ],
)
def test_columns_are_found_by_their_usual_names(names, channel, columns):
    assert detected(table_of(*names), channel) == columns


@pytest.mark.parametrize(
    ("names", "channel", "message"),
    [
        (
            ["axial_std_N", "force_std_N"],
            "force_std",
            r"(?s)\(axial_std_N, force_std_N\).*under `force_std` in the `mapping`",
        ),
        (
            ["tau_ext", "external_torque"],
            "tau_ext",
            "(?s)several.*Name it under `tau_ext` in the `mapping`",
        ),
        (
            ["t", "timestamp"],
            "time",
            r"(?s)several columns would fit \(t, timestamp\).*under `time`",
        ),
        (["q", "position"], "q", "several"),
        (["q1", "q2", "/other/q1", "/other/q2"], "q", "q#, /other/q#"),
        (["q1", "q2", "q4"], "q", "numbers 1 to 4, but not 3"),
    ],
)
def test_an_ambiguous_or_incomplete_choice_is_refused(names, channel, message):
    with pytest.raises(ColumnError, match=message):
        detect_columns(table_of(*names), CHANNELS[channel])


def from_toml(tmp_path, text):
    path = tmp_path / "mapping.toml"
    path.write_text(text, encoding="utf-8")
    return load_mapping(path)


@pytest.mark.parametrize(
    "scale", [0.0, float("nan"), float("inf"), (1.0, 0.0), (), 10**400]
)
def test_a_scale_is_finite_and_not_zero(scale):
    with pytest.raises(MappingError, match="finite and not zero"):
        ColumnSpec(columns="z", scale=scale)


def test_a_mapping_copies_and_normalises_units():
    source = {"speed": ColumnSpec(columns="v", unit="mm_s")}
    mapping = ColumnMapping(channels=source)
    source.clear()

    assert mapping.channels["speed"].unit == "mm/s"


@pytest.mark.parametrize(
    ("channels", "rate_hz", "message"),
    [
        (
            {"torque": "tau"},
            None,
            "unknown channel 'torque'; channels are: time, q, dq, tau",
        ),
        ({}, 0.0, "positive"),
        ({"time": "t"}, 100.0, "expected one of them"),
    ],
)
def test_a_mapping_that_contradicts_itself_is_refused(channels, rate_hz, message):
    with pytest.raises(MappingError, match=message):
        mapped(rate_hz, **channels)


def test_toml_gives_columns_units_scales_and_rate(tmp_path):
    mapping = from_toml(
        tmp_path,
        """
        rate_hz = 500
        depth = "z"
        [q]
        columns = "q{1..7}"
        unit = "deg"
        [tau]
        columns = ["i1", "i2"]
        scale = [10.5, -9]
        [force]
        columns = "fz"
        scale = -1
        """,
    )

    assert mapping.rate_hz == 500
    assert mapping.channels["depth"] == ColumnSpec(columns="z")
    assert mapping.channels["q"] == ColumnSpec(columns="q{1..7}", unit="deg")
    assert mapping.channels["tau"] == ColumnSpec(
        columns=("i1", "i2"), scale=(10.5, -9.0)
    )
    assert mapping.channels["force"] == ColumnSpec(columns="fz", scale=-1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depth = ", "not valid TOML"),
        ("depht = 'z'", "unknown channel 'depht'"),
        ("rate_hz = 'fast'", r"Expected `float | null`, got `str` - at `\$.rate_hz`"),
        (f"a = {'[' * 5000}", "not valid TOML"),
        (
            "[depth]\ncolumn = 'z'",
            r"\[depth\] has 'column', expected only columns, unit",
        ),
        ("[depth]\n", "missing required field `columns` - at `\\$.depth`"),
        ("joints = ['a', 'a']", "names a joint twice"),
        ("[depth]\ncolumns = 'z'\nunit = 'N'", "unit 'N' of channel 'depth'"),
        ("[depth]\ncolumns = ['z', 3]", "got `int` - at `\\$.depth.columns"),
        ("[depth]\ncolumns = 'z'\nscale = 0", "not zero"),
    ],
)
def test_a_wrong_toml_error_names_the_file(tmp_path, text, message):
    with pytest.raises(MappingError, match=message) as caught:
        from_toml(tmp_path, text)

    assert "mapping.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("z", ColumnSpec(columns="z")),
        ("z:mm", ColumnSpec(columns="z", unit="mm")),
        ("z:mm:-1", ColumnSpec(columns="z", unit="mm", scale=-1.0)),
        ("z:2.5", ColumnSpec(columns="z", scale=2.5)),
        ("a, b", ColumnSpec(columns=("a", "b"))),
        ("ns::z:um", ColumnSpec(columns="ns::z", unit="um")),
        ("z:furlong", ColumnSpec(columns="z:furlong")),
    ],
)
def test_the_short_form_means_the_same_specification(text, spec):
    assert parse_column_spec(text, CHANNELS["depth"]) == spec


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".mcap"])
def test_a_suggested_mapping_reads_the_same_log(tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    rng = np.random.default_rng(0)
    columns = {
        name: rng.normal(size=(50, 3)) for name in ("q_rad", "dq_rad_s", "tau_Nm")
    }
    write_table(path, {"t_s": np.arange(50) / 1000, **columns})
    mapping = from_toml(tmp_path, suggest_mapping(path, JOINTS))

    assert set(mapping.channels) >= set(JOINTS)

    plain, same = (
        read_log(path, known_mapping, required=JOINTS)
        for known_mapping in (None, mapping)
    )

    np.testing.assert_array_equal(plain.t_s, same.t_s)

    for name in plain.channels:
        np.testing.assert_array_equal(plain[name], same[name])


def test_a_suggested_mapping_keeps_units_and_known_columns(tmp_path):
    path = tmp_path / "log.csv"
    names = "time_ms,depth_mm,force,Kraft,a_deg,b_rad"
    path.write_text(f"{names}\n0,1,2,3,4,5\n1,2,3,4,5,6\n", encoding="utf-8")
    known = mapped(force=ColumnSpec(columns="Kraft", scale=-1.0), q=("a_deg", "b_rad"))
    text = suggest_mapping(path, ("depth", "force", "q"), mapping=known)
    content = tomllib.loads(text)

    assert content["depth"]["unit"] == "mm"
    assert content["time"]["unit"] == "ms"
    assert content["q"] == {"columns": ["a_deg", "b_rad"], "scale": 1.0}
    assert content["force"] == {"columns": "Kraft", "unit": "N", "scale": -1.0}
    assert 'unit = "N"  # assumed; of N, mN, cN, kN' in text
    with pytest.raises(FileAccessError, match="cannot read the mapping"):
        load_mapping(tmp_path / "none.toml")

    for name in ("no.mcap", "no.csv"):
        with pytest.raises(FileAccessError, match="cannot read"):
            suggest_mapping(tmp_path / name, JOINTS)
