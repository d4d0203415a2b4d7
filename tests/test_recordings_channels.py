"""Finding columns: names taken apart, patterns, usual names, units."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings import CHANNELS, ColumnError, MappingError, Table
from needleforce.recordings.channels import (
    detect_columns,
    find_columns,
    find_unit,
    parse_column_name,
    require_unit,
    split_unit,
)


def table_of(*names, **two_dimensional):
    columns = {name: np.full(3, float(i)) for i, name in enumerate(names)}
    return Table(columns={**columns, **two_dimensional})


def found(table, pattern):
    return [column.name for column in find_columns(table, pattern)]


def detected(table, channel):
    return [column.name for column in detect_columns(table, CHANNELS[channel])]


@pytest.mark.parametrize(
    ("written", "channel", "unit"),
    [
        ("mm/s", "speed", "mm/s"),
        ("mm_s", "speed", "mm/s"),
        ("mm_per_s", "speed", "mm/s"),
        ("µs", "time", "us"),
        ("μm", "depth", "um"),
        ("N·m", "tau", "Nm"),
        ("N.m", "tau", "Nm"),
        (" N ", "force", "N"),
        ("°", "q", "deg"),
        ("°/s", "dq", "deg/s"),
        ("n", "force", None),
        ("inch", "depth", None),
    ],
)
def test_units_are_known_in_their_usual_spellings(written, channel, unit):
    assert find_unit(written, CHANNELS[channel].units) == unit


def test_an_unknown_unit_is_refused_with_the_known_ones():
    with pytest.raises(MappingError, match="'inch' of depth is not known; use one of: m, cm, mm"):
        require_unit("inch", CHANNELS["depth"].units, "depth")


@pytest.mark.parametrize("channel", CHANNELS.values(), ids=lambda channel: channel.name)
def test_each_channel_is_si_first_and_named_after_it(channel):
    assert channel.units[channel.si_unit] == 1.0
    has_unit = channel.name not in ("force_status", "force_warnings")
    assert split_unit(channel.key, channel.units)[1] == (channel.si_unit if has_unit else None)


@pytest.mark.parametrize(
    ("name", "channel", "stem", "number", "unit"),
    [
        ("q", "q", "q", None, None),
        ("q1", "q", "q", 1, None),
        ("q_1", "q", "q", 1, None),
        ("q.1", "q", "q", 1, None),
        ("q[0]", "q", "q", 0, None),
        ("q7_deg", "q", "q", 7, "deg"),
        ("q_rad_7", "q", "q", 7, "rad"),
        ("q_rad[6]", "q", "q", 6, "rad"),
        ("dq_rad_s", "dq", "dq", None, "rad/s"),
        ("dq_rad_s", "q", "dq_rad_s", None, None),
        ("tau_J3", "tau", "tau_j", 3, None),
        ("/joint_states/position[2]", "q", "position", 2, None),
        ("Depth [mm]", "depth", "depth", None, "mm"),
        ("z (mm)", "depth", "z", None, "mm"),
        ("speed [mm/s]", "speed", "speed", None, "mm/s"),
        ("speed_mm_s", "speed", "speed", None, "mm/s"),
        ("depth_m_04", "depth", "depth", 4, "m"),
        ("f_z", "force", "f_z", None, None),
        ("t_ns", "time", "t", None, "ns"),
        ("time [beats]", "time", "time [beats]", None, None),
        ("42", "q", "42", None, None),
        ("q2024051512", "q", "q2024051512", None, None),
        (f"q{'9' * 5000}", "q", f"q{'9' * 5000}", None, None),
    ],
)
def test_a_name_is_taken_apart(name, channel, stem, number, unit):
    parts = parse_column_name(name, CHANNELS[channel].units)
    assert (parts.stem, parts.number, parts.unit) == (stem, number, unit)


@given(st.text(max_size=12), st.sampled_from(sorted(CHANNELS)))
def test_any_text_can_be_taken_apart(name, channel):
    parts = parse_column_name(name, CHANNELS[channel].units)
    assert parts.unit is None or parts.unit in CHANNELS[channel].units


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("a", ["a"]),
        ("q{1..3}", ["q1", "q2", "q3"]),
        ("q{3..1}", ["q3", "q2", "q1"]),
        ("k{08..10}", ["k08", "k09", "k10"]),
        ("q*", ["q1", "q2", "q3"]),
        ("/j*/effort", ["/j9/effort", "/j10/effort"]),
        ("q", ["q1", "q2", "q3"]),
        ("wrench[2]", ["wrench[2]"]),
        ("wrench[{0..1}]", ["wrench[0]", "wrench[1]"]),
        ("odd*name", ["odd*name"]),
    ],
)
def test_a_pattern_gives_columns_in_the_order_of_their_numbers(pattern, names):
    # Written in an order that is neither the file's nor the alphabet's.
    table = table_of(
        *("q3", "q1", "q2", "a", "k10", "k08", "k09", "/j10/effort", "/j9/effort", "odd*name"),
        wrench=np.arange(18.0).reshape(3, 6),
    )
    assert found(table, pattern) == names


def test_an_element_of_a_two_dimensional_column_counts_from_zero():
    wrench = np.arange(18.0).reshape(3, 6)
    (column,) = find_columns(table_of(wrench=wrench), "wrench[2]")
    np.testing.assert_array_equal(column.values, wrench[:, 2])


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("force", "no column 'force'. Did you mean 'Force'\\? Columns are: Force, q1"),
        ("q{1..3}", "no column 'q3'"),
        ("x_*", r"no column 'x_\*'. The \* stands for one number; all the rest"),
        ("z", r"no column 'z'. Did you mean 'z \[mm\]'\?"),
        ("q1:grad", "The unit 'grad' is none of this channel's; --help lists them"),
        ("/a:b", "no column '/a:b'. Columns are"),
        ("q1[0]", "no column"),
        ("none[0]", "no column"),
        ("wrench[6]", r"has the elements \[0\] to \[5\]"),
        ("p", "found the numbers 1 to 4, but not 2, 3"),
        ("p*", "found the numbers 1 to 4, but not 2, 3"),
        ("k", "fits both 'k1' and 'k_1'"),
        ("q{1..1000000000000}", "no column"),
        ("q{1..999999999}", "no column 'q3'"),
        ("h", "found the numbers 1 to 900000000, but not 2, 3, 4, 5, 6;"),
    ],
)
def test_a_pattern_that_fits_nothing_or_too_much_is_refused(pattern, message):
    names = ("Force", "q1", "q2", "p1", "p4", "k1", "k_1", "z [mm]", "h1", "h900000000")
    table = table_of(*names, wrench=np.zeros((3, 6)))
    with pytest.raises(ColumnError, match=message):
        find_columns(table, pattern)


@pytest.mark.parametrize("channel", CHANNELS.values(), ids=lambda channel: channel.name)
def test_every_usual_name_is_recognised_in_any_case_and_with_any_unit(channel):
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
        (["actual_q_0", "actual_q_1", "actual_qd_0", "actual_qd_1"], "dq", None),
        (["q", "q_d"], "q", ["q"]),
        (["force_N", "force_N_1"], "force", ["force_N"]),
        (["depth_m_04", "force_N_04"], "depth", ["depth_m_04"]),
        (["temperature", "phase"], "force", []),
    ],
)
def test_columns_are_found_by_their_usual_names(names, channel, columns):
    expected = ["actual_qd_0", "actual_qd_1"] if columns is None else columns
    assert detected(table_of(*names), channel) == expected


def test_a_two_dimensional_column_is_a_joint_channel_but_not_a_single_one():
    table = table_of(q=np.zeros((3, 7)), force=np.zeros((3, 6)), z=np.zeros((3, 1)))
    assert detected(table, "q") == ["q"]
    assert detected(table, "force") == []
    assert detected(table, "depth") == ["z"]


@pytest.mark.parametrize(
    ("names", "channel", "message"),
    [
        (["t", "timestamp"], "time", r"several columns would fit \(t, timestamp\).*--time"),
        (["depth_m_00", "depth_m_02"], "depth", "depth_m_00, depth_m_02"),
        (["q", "position"], "q", "several"),
        (["q1", "q2", "/other/q1", "/other/q2"], "q", "q#, /other/q#"),
        (["q1", "q2", "q4"], "q", "numbers 1 to 4, but not 3"),
    ],
)
def test_an_ambiguous_or_incomplete_choice_is_refused(names, channel, message):
    with pytest.raises(ColumnError, match=message):
        detect_columns(table_of(*names), CHANNELS[channel])
