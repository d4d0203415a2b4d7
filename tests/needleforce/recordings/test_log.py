"""From a file to a log: tables, channels, units, time, warnings; and real
recordings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings import (
    ChannelRequest,
    ColumnError,
    ColumnSpec,
    Log,
    LogError,
    MappingError,
    Table,
    UnitError,
    read_log,
    read_table,
    write_log,
    write_table,
)
from needleforce.recordings.channels import CHANNELS
from needleforce.recordings.log import log_of_table
from needleforce.recordings.time_stamps import (
    start_of_clock,
    to_nanoseconds,
    to_seconds,
)
from tests.needleforce.recordings.bag_samples import START_NS, mapped

T_S = np.arange(4) / 1000.0


def test_log_stores_read_only_copies():
    t_s = T_S.copy()
    force_N = np.ones(4)
    log = Log(t_s=t_s, channels={"force_N": force_N})
    t_s[0] = force_N[0] = 99.0

    assert (log.t_s[0], log["force_N"][0]) == (0.0, 1.0)
    assert [v.flags.writeable for v in (log.t_s, log["force_N"])] == [False, False]


@pytest.mark.parametrize(
    ("t_s", "channels", "message"),
    [
        (T_S, {}, "at least one channel"),
        (
            [0.0, np.nan, 1.0],
            {"force_N": [0.0, 0.0, 0.0]},
            "not finite: 1 .first: row 2",
        ),
        (T_S, {"force_N": T_S[:-1]}, r"force_N has shape \(3,\).*4 stamps"),
        (T_S, {"force_N": ["a", "b", "c", "d"]}, "force_N is not an array of numbers"),
    ],
)
def test_invalid_logs_are_refused_with_the_reason(t_s, channels, message):
    with pytest.raises(LogError, match=message):
        Log(t_s=t_s, channels=channels)


def test_missing_values_are_counted_by_row_not_refused():
    q_rad = np.zeros((4, 7))
    q_rad[2, 3] = np.nan
    q_rad[2, 4] = np.inf
    log = log_of(t_s=T_S, q_rad=q_rad)

    assert log.warnings == ("q_rad: rows with NaN or infinity: 1 (first: row 3)",)
    np.testing.assert_array_equal(log["q_rad"], q_rad)


@given(
    first_ns=st.one_of(st.integers(0, 1 << 40), st.integers(1 << 60, (1 << 62) - 1)),
    since_ns=st.lists(st.integers(0, 86_400 * 10**9), min_size=1, max_size=20),
)
def test_stamps_come_back_from_seconds(first_ns, since_ns):
    stamps_ns = np.array([first_ns, *(first_ns + step for step in since_ns)])
    start_ns = start_of_clock(first_ns)

    assert (
        to_nanoseconds(to_seconds(stamps_ns, start_ns), start_ns).tolist()
        == stamps_ns.tolist()
    )
    assert start_ns in (0, first_ns)


@pytest.mark.parametrize("suffix", ["csv", "ragged.csv", "npz", "parquet"])
def test_whole_nanoseconds_since_the_epoch_lose_no_digit(tmp_path, suffix):
    stamps_ns = START_NS + np.cumsum(np.arange(5000)) % 7 + 1_000_003 * np.arange(5000)
    path = tmp_path / f"log.{suffix}"
    write_table(path, {"time [ns]": stamps_ns, "force_N": np.ones(5000)})
    if suffix == "ragged.csv":
        lines = path.read_text().splitlines()
        lines[3000:3000] = ["1,2,3", f"{START_NS}"]
        path.write_text("\n".join(lines) + "\n")
    else:
        assert read_table(path).columns["time [ns]"].tolist() == stamps_ns.tolist()

    log = read_log(path)

    assert to_nanoseconds(log.t_s, log.start_ns).tolist() == stamps_ns.tolist()

    write_log(tmp_path / "log.mcap", log)
    again = read_log(tmp_path / "log.mcap")

    assert to_nanoseconds(again.t_s, again.start_ns).tolist() == stamps_ns.tolist()


def log_of(mapping=None, required=(), optional=(), sorted_within_s=1.0, **columns):
    table = Table(columns=columns)
    request = ChannelRequest(mapping or mapped(), required, optional)
    return log_of_table(table, request)


T = np.arange(3.0) / 100
ONES = np.ones(3)


def test_a_csv_with_usual_names_needs_no_mapping(tmp_path):
    path = tmp_path / "LOG.CSV"
    path.write_text(
        "time [ms],q1_deg,q2_deg,effort_1,effort_2\n0,180,0,1,2\n1,90,0,3,4\n"
    )
    log = read_log(path, required=("q", "tau"), optional=("dq",))

    np.testing.assert_allclose(log.t_s, [0.0, 0.001])
    np.testing.assert_allclose(log["q_rad"], [[np.pi, 0.0], [np.pi / 2, 0.0]])
    np.testing.assert_array_equal(log["tau_Nm"], [[1.0, 2.0], [3.0, 4.0]])
    assert list(log.channels) == ["q_rad", "tau_Nm"]
    assert log.warnings == ()


@given(
    st.sampled_from(
        [(name, unit) for name, channel in CHANNELS.items() for unit in channel.units]
    ),
    st.floats(-4.0, 4.0).filter(lambda scale: abs(scale) > 0.01),
)
def test_units_and_scales_multiply(chosen, scale):
    name, unit = chosen
    channel = CHANNELS[name]
    raw = np.array([1.0, 2.0, 4.0])
    expected = raw * channel.units[unit] * scale
    if name == "time":
        scale = abs(scale)
        expected = np.abs(expected)

    mapping = mapped(**{name: ColumnSpec(columns="x", unit=unit, scale=scale)})
    if name == "time":
        values = log_of(mapping, ("force",), x=raw, force_N=ONES).t_s
    else:
        log = log_of(mapping, (name,), x=raw, t_s=T)
        values = log[channel.key].reshape(-1)
        assert log[channel.key].ndim == (2 if channel.per_joint else 1)

    np.testing.assert_allclose(values, expected)


CURRENT = np.arange(6.0).reshape(3, 2)
WRENCH = np.arange(18.0).reshape(3, 6)


@pytest.mark.parametrize(
    ("spec", "columns", "key", "expected"),
    [
        (None, {"depth_m": 5.0 * ONES}, "depth_m", 5.0 * ONES),
        # Each column has its own unit, and its own scale.
        (
            ColumnSpec(columns=("a_deg", "b_rad"), scale=(1.0, -2.0)),
            {"a_deg": 180.0 * ONES, "b_rad": ONES},
            "q_rad",
            np.array([[np.pi, -2.0]] * 3),
        ),
        (
            ColumnSpec(columns="i", scale=(1.0, 2.0)),
            {"i": CURRENT},
            "tau_Nm",
            CURRENT * [1, 2],
        ),
        (
            ColumnSpec(columns="w[2]", scale=-1.0),
            {"w": WRENCH},
            "force_N",
            -WRENCH[:, 2],
        ),
    ],
)
def test_columns_become_si(spec, columns, key, expected):
    name = next(name for name, channel in CHANNELS.items() if channel.key == key)
    log = log_of(mapped(**({name: spec} if spec else {})), t=T, **columns)

    np.testing.assert_allclose(log[key], expected)


def test_only_the_channels_asked_for_are_looked_at():
    log = log_of(None, ("force",), t=T, force_N=ONES, depth_m=ONES, z=ONES)

    assert list(log.channels) == ["force_N"]
    with pytest.raises(ColumnError, match="several"):
        log_of(None, ("force",), ("depth",), t=T, force_N=ONES, depth_m=ONES, z=ONES)


def test_a_missing_channel_error_lists_names_and_columns():
    message = (
        "no column found for tau .* tau, tau_j, effort, torque.*"
        "Columns are: t, q, moment"
    )
    with pytest.raises(ColumnError, match=message):
        log_of(None, ("q", "tau"), t=T, q=ONES, moment=ONES)


@pytest.mark.parametrize(
    ("mapping", "required", "error", "message"),
    [
        (None, ("torque",), MappingError, "unknown channel 'torque'"),
        (mapped(force="pull"), (), ColumnError, "no column 'pull'"),
        (
            mapped(force="pair"),
            (),
            ColumnError,
            "force is one column, but pair gives 2",
        ),
        (
            mapped(q=("a", "short")),
            (),
            LogError,
            "q: the columns a, short differ in length",
        ),
        (mapped(depth="short"), (), LogError, "in rows: t_s 3, depth_m 2"),
        (
            mapped(q="pair", tau="a"),
            (),
            LogError,
            "number of joints: q has 2 .*tau has 1",
        ),
        (mapped(depth="empty"), ("depth",), LogError, "depth_m has no finite value"),
    ],
)
def test_what_forms_no_log_is_refused(mapping, required, error, message):
    columns = {
        "a": ONES,
        "short": ONES[:2],
        "pair": np.ones((3, 2)),
        "empty": ONES * np.nan,
    }
    with pytest.raises(error, match=message):
        log_of(mapping, required, t=T, **columns)


@pytest.mark.parametrize(
    ("mapping", "columns", "t_s", "warning"),
    [
        (
            None,
            {"t": [0.0, np.nan, 0.02]},
            [0.0, 0.02],
            "time: rows without a stamp, left out: 1 (first: row 2)",
        ),
        (mapped(rate_hz=200.0), {"t": T}, [0.0, 0.005, 0.01], ""),
    ],
    ids=["column", "rate of the mapping"],
)
def test_time_comes_from_rate_or_column(mapping, columns, t_s, warning):
    log = log_of(mapping, **columns, f=np.arange(3.0))

    np.testing.assert_allclose(log.t_s, t_s)
    assert log["force_N"].tolist() == ([0.0, 2.0] if len(t_s) == 2 else [0.0, 1.0, 2.0])
    assert log.warnings == ((warning,) if warning else ())


def test_an_empty_optional_channel_is_omitted_and_reported():
    log = log_of(None, ("q",), ("dq",), t=T, q=ONES, dq=ONES * np.nan)

    assert list(log.channels) == ["q_rad"]
    assert "dq: its columns hold no finite value in the first rows" in log.warnings[0]


def test_channels_left_out_are_not_read_and_needed_ones_stay():
    columns = {"t": T, "q": ONES, "dq": ONES}

    assert list(log_of(mapped(dq="none"), ("q",), ("dq",), **columns).channels) == [
        "q_rad"
    ]
    assert list(log_of(mapped(dq="none"), **columns).channels) == ["q_rad"]
    with pytest.raises(MappingError, match="q = 'none' leaves out a channel"):
        log_of(mapped(q="none"), ("q",), **columns)


@pytest.mark.parametrize(("travel", "is_reported"), [(0.5, True), (0.0, False)])
def test_velocities_of_zero_are_reported_if_the_arm_moved(travel, is_reported):
    q = np.linspace(0.0, travel, 300)
    log = log_of(None, ("q",), ("dq",), t=0.01 * np.arange(300), q=q, dq=0.0 * q)

    assert any("dq is zero in all rows" in text for text in log.warnings) == is_reported


def test_no_time_and_no_rate_is_refused():
    with pytest.raises(
        ColumnError, match=r"(?s)no time column found.*Name it under `time`"
    ):
        log_of(f=ONES)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"t": np.arange(3.0), "f": ONES}, "time: the median step of t, taken as in s"),
        ({"q": 90.0 * ONES}, "q: the size of q, taken as in rad, is 90 rad"),
        ({"dq": 90.0 * ONES}, "dq: the size of dq, taken as in rad/s, is 90 rad/s"),
        ({"tau": 9000.0 * ONES}, "tau: the size of tau, taken as in Nm, is 9000 Nm"),
        (
            {"depth": [0.0, 40.0, 85.0]},
            "depth: the size of depth, taken as in m, is 85 m, expected at most 1 .no "
            "needle",
        ),
        ({"v": 3.0 * ONES}, "speed: the size of v, taken as in m/s"),
        ({"f": 900.0 * ONES}, "force: the size of f, taken as in N, is 900 N"),
    ],
)
def test_an_assumed_unit_that_the_values_contradict_is_refused(columns, message):
    with pytest.raises(UnitError, match=message):
        log_of(**{"t": T, **columns})


def test_a_stated_unit_is_not_doubted():
    stated = {
        "t_s": np.arange(3.0),
        "q_rad": 90.0 * ONES,
        "depth_m": 85.0 * ONES,
        "v_m_s": ONES,
    }

    assert log_of(**stated).warnings == ()
    assert log_of(t=T, q=3.0 * ONES, depth=0.1 * ONES, v=0.1 * ONES).warnings == ()


def test_a_spike_beyond_what_is_plausible_is_reported_not_refused():
    force_N = np.ones(100)
    force_N[50] = 5000.0
    log = log_of(t=np.arange(100) / 100, f=force_N)

    assert log.warnings == (
        "force: the size of f, taken as in N, is 5000 N, expected at most 200 (such a "
        "force buckles any needle); rows beyond it: 1",
    )


def test_the_real_liver_log_lacks_time(recordings_dir):
    path = recordings_dir / "liver_dejong2017/insertions.npz"

    with pytest.raises(
        ColumnError, match=r"depth: several columns would fit .depth_m_00, depth_m"
    ):
        read_log(path, required=("depth", "force"))

    mapping = mapped(depth="depth_m_04", force="force_N_04", rate_hz=1000.0)
    log = read_log(path, mapping, required=("depth", "force"))

    assert log["depth_m"].max() == pytest.approx(0.085, abs=1e-3)
    assert log.t_s[1] == pytest.approx(0.001)
    assert log.warnings == ()
