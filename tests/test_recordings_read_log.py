"""From a file to a log: channels, units, time, warnings; and real recordings."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from bag_samples import mapped
from hypothesis import given
from hypothesis import strategies as st

from needleforce.recordings import (
    ColumnError,
    ColumnMapping,
    ColumnSpec,
    FileAccessError,
    LogError,
    MappingError,
    Table,
    read_log,
    write_table,
)
from needleforce.recordings.channels import CHANNELS
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.log import LogStream
from needleforce.recordings.mapping import ChannelRequest
from needleforce.recordings.open_recording import log_of as log_of_table
from needleforce.recordings.open_recording import stream_tables

BESIDE = Path(__file__).parents[2] / "shared" / "data"
DATA = Path(os.environ.get("NEEDLEFORCE_DATA", BESIDE))


def real(name):
    path = DATA / name
    if not path.exists():
        pytest.skip(f"the real recording {name} is not here")
    return path


def log_of(mapping=None, required=(), optional=(), constants=None, **columns):
    table = Table(columns=columns, constants=constants or {})
    request = ChannelRequest(
        mapping=mapping or ColumnMapping(), required=tuple(required), optional=tuple(optional)
    )
    return log_of_table(table, request)


T = np.arange(3.0) / 100
ONES = np.ones(3)


def test_a_csv_with_usual_names_needs_no_mapping(tmp_path):
    path = tmp_path / "LOG.CSV"
    path.write_text("time [ms],q1_deg,q2_deg,effort_1,effort_2\n0,180,0,1,2\n1,90,0,3,4\n")
    log = read_log(path, required=("q", "tau"), optional=("dq",))
    np.testing.assert_allclose(log.t_s, [0.0, 0.001])
    np.testing.assert_allclose(log["q_rad"], [[np.pi, 0.0], [np.pi / 2, 0.0]])
    np.testing.assert_array_equal(log["tau_Nm"], [[1.0, 2.0], [3.0, 4.0]])
    assert list(log.channels) == ["q_rad", "tau_Nm"]
    assert log.warnings == ()


def test_an_unknown_suffix_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(FileAccessError, match=r"no known suffix; known are: \.csv, "):
        read_log(tmp_path / "log.xlsx")


@given(
    st.sampled_from([(name, unit) for name, channel in CHANNELS.items() for unit in channel.units]),
    st.floats(-4.0, 4.0).filter(lambda scale: abs(scale) > 0.01),
)
def test_units_and_scales_multiply(chosen, scale):
    name, unit = chosen
    channel = CHANNELS[name]
    raw = np.array([1.0, 2.0, 4.0])
    expected = raw * channel.units[unit] * scale
    if name == "time":
        scale, expected = abs(scale), np.abs(expected)
    mapping = mapped(**{name: ColumnSpec(columns="x", unit=unit, scale=scale)})
    if name == "time":
        values = log_of(mapping, ("force",), x=raw, force_N=ONES).t_s
    else:
        log = log_of(mapping, (name,), x=raw, t_s=T)
        values = log[channel.key].reshape(-1)
        assert log[channel.key].ndim == (2 if channel.per_joint else 1)
    np.testing.assert_allclose(values, expected)


CURRENT, WRENCH = np.arange(6.0).reshape(3, 2), np.arange(18.0).reshape(3, 6)


@pytest.mark.parametrize(
    ("spec", "columns", "key", "expected"),
    [
        (None, {"depth_m": 5.0 * ONES}, "depth_m", 5.0 * ONES),
        # A stated unit wins over the one in the name; each column has its own, and its own scale.
        (ColumnSpec(columns="depth_m", unit="mm"), {"depth_m": ONES}, "depth_m", ONES / 1000),
        (
            ColumnSpec(columns=("a_deg", "b_rad"), scale=(1.0, -2.0)),
            {"a_deg": 180.0 * ONES, "b_rad": ONES},
            "q_rad",
            np.array([[np.pi, -2.0]] * 3),
        ),
        (ColumnSpec(columns="i", scale=(1.0, 2.0)), {"i": CURRENT}, "tau_Nm", CURRENT * [1, 2]),
        (ColumnSpec(columns="w[2]", scale=-1.0), {"w": WRENCH}, "force_N", -WRENCH[:, 2]),
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


def test_without_a_request_every_recognised_channel_is_taken():
    log = log_of(t=T, force_N=ONES, depth_m=ONES, colour=ONES)
    assert set(log.channels) == {"force_N", "depth_m"}


def test_a_missing_channel_is_reported_with_usual_names_and_columns():
    with pytest.raises(ColumnError) as caught:
        log_of(None, ("q", "tau"), t=T, q=ONES, moment=ONES)
    message = str(caught.value)
    assert "no column found for tau (measured joint torques)" in message
    assert "tau, tau_j, effort, torque" in message
    assert "Columns are: t, q, moment" in message


@pytest.mark.parametrize(
    ("mapping", "required", "error", "message"),
    [
        (None, ("torque",), MappingError, "unknown channel 'torque'"),
        (None, ("time",), MappingError, "unknown channel 'time'"),
        (mapped(force="pull"), (), ColumnError, "no column 'pull'"),
        (mapped(force="pair"), (), ColumnError, "force is one column, but pair gives 2"),
        (mapped(q=("a", "short")), (), LogError, "q: the columns a, short differ in length"),
        (mapped(depth="short"), (), LogError, "in rows: t_s 3, depth_m 2"),
        (mapped(q="pair", tau="a"), (), LogError, "number of joints: q_rad 2, tau_Nm 1"),
        (mapped(depth="empty"), ("depth",), LogError, "depth_m has no finite value"),
        (
            mapped(q=ColumnSpec(columns="pair", scale=(1.0, 2.0, 3.0))),
            (),
            MappingError,
            "q: 3 scale factors for 2 columns; give one or 2",
        ),
    ],
)
def test_what_forms_no_log_is_refused(mapping, required, error, message):
    columns = {"a": ONES, "short": ONES[:2], "pair": np.ones((3, 2)), "empty": ONES * np.nan}
    with pytest.raises(error, match=message):
        log_of(mapping, required, t=T, **columns)


def test_a_table_without_any_channel_is_refused():
    with pytest.raises(ColumnError, match=r"no channel was recognised. Columns are: t, colour"):
        log_of(t=T, colour=ONES)


def test_a_left_out_column_is_explained_when_it_is_asked_for(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,pull\n0,high\n1,low\n")
    with pytest.raises(ColumnError, match=r"no column 'pull' .column 'pull' holds text"):
        read_log(path, mapped(force="pull"))


def test_all_that_is_missing_is_reported_at_once():
    table = Table(columns={"t": [0.0, 1.0], "a": [1.0, 2.0]})
    message = r"no column found for q \(joint.* Nor for tau \(measured joint torques\). Columns are"
    with pytest.raises(ColumnError, match=message):
        log_of_table(table, ChannelRequest(required=("q", "tau"), optional=("dq",)))


def test_what_was_left_out_is_reported_when_nothing_fits(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("time,tau,z\n2024-05-01T12:00:00,oops,1\n2024-05-01T12:00:01,oops,2\n")
    for required in ("depth", "tau"):
        with pytest.raises(
            ColumnError, match=r"'time' holds text .*'2024-05-01T12:00:00'"
        ) as caught:
            read_log(log, required=[required])
        assert "'tau' holds text (line 2, 'oops') and was left out)" in str(caught.value)
        with pytest.raises(ColumnError) as streamed:
            list(LogStream(stream_tables(log, FollowOptions()), required=[required]))
        assert str(streamed.value) == str(caught.value)


def test_an_optional_channel_without_values_is_left_out_and_reported():
    log = log_of(None, ("q",), ("dq",), t=T, q=ONES, dq=ONES * np.nan)
    assert list(log.channels) == ["q_rad"]
    assert log.warnings == ("dq: its columns hold no finite value and were left out",)


def test_rows_without_a_time_stamp_are_left_out_and_reported():
    log = log_of(t=np.array([0.0, np.nan, 0.02]), f=np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(log["force_N"], [1.0, 3.0])
    assert log.warnings == ("time: rows without a stamp, left out: 1 (first: row 2)",)


def test_time_comes_from_the_mappings_rate_before_all_else():
    log = log_of(mapped(rate_hz=200.0), constants={"sample_rate_Hz": 1.0}, t=T, f=ONES)
    np.testing.assert_allclose(log.t_s, [0.0, 0.005, 0.01])
    assert log.warnings == ()


def test_time_comes_from_the_files_own_rate_if_nothing_else_is_there():
    log = log_of(constants={"gain": 3.0, "sample_rate_Hz": 1000.0}, f=ONES)
    np.testing.assert_allclose(log.t_s, [0.0, 0.001, 0.002])
    assert log.warnings == ("no time column: time from sample_rate_Hz = 1000",)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_no_time_and_no_rate_is_refused(rate):
    with pytest.raises(ColumnError, match="no time column found; say which one with --time"):
        log_of(constants={"sample_rate_Hz": rate}, f=ONES)


def test_values_that_are_hardly_si_get_a_hint_if_no_unit_was_stated():
    names = {"t": np.arange(3.0), "q": 90.0 * ONES, "depth": 85.0 * ONES, "v": 3.0 * ONES}
    hints = log_of(**names).warnings
    assert [hint.split(":")[0] for hint in hints] == ["time", "q", "depth", "speed"]
    assert (
        "depth: it reaches 85 in SI; if the file is in mm, say unit = 'mm', or --depth COLUMN:mm"
        in hints
    )
    stated = {"t_s": np.arange(3.0), "q_rad": 90.0 * ONES, "depth_m": 85.0 * ONES, "v_m_s": ONES}
    assert log_of(**stated).warnings == ()
    assert log_of(t=T, q=3.0 * ONES, depth=0.1 * ONES, v=0.1 * ONES).warnings == ()


def test_a_minute_of_a_robot_at_1_khz_reads_in_about_a_second(tmp_path):
    rng, rows = np.random.default_rng(1), 60_000
    channels = {name: rng.normal(size=(rows, 7)) for name in ("q_rad", "dq_rad_s", "tau_Nm")}
    path = tmp_path / "minute.csv"
    write_table(path, {"t_s": np.arange(rows) / 1000, **channels})
    start_s = time.perf_counter()
    log = read_log(path, required=("q", "tau"), optional=("dq",))
    # Three times the goal: the test machine may be busy, a fall-back to Python cells takes longer.
    assert time.perf_counter() - start_s < 3.0
    for name, values in channels.items():
        np.testing.assert_array_equal(log[name], values)


def test_a_real_panda_log_is_read_whole_and_without_a_warning():
    log = read_log(real("panda_gaz2019/free_motion.npz"), required=("q", "dq", "tau"))
    assert log["tau_Nm"].shape == (20544, 7)
    assert log.t_s[-1] - log.t_s[0] == pytest.approx(21.0, abs=1.0)
    assert log.warnings == ()


def test_real_ur10e_log_has_currents_that_need_their_constants():
    path = real("ur10e_mamedov2020/unloaded.npz")
    with pytest.raises(ColumnError, match=r"no column found for tau.*current_A \(6 columns\)"):
        read_log(path, required=("q", "tau"))
    spec = ColumnSpec(columns="current_A", scale=(11.0, 11.0, 9.0, 9.0, 9.0, 9.0))
    log = read_log(path, mapped(tau=spec), required=("q", "tau"))
    assert log["tau_Nm"].shape == log["q_rad"].shape == (4771, 6)


def test_real_bovine_log_has_no_time():
    path = real("bovine_liver_okamura2004/depth_force.csv")
    with pytest.raises(ColumnError, match=r"--rate.*Columns are: depth_m, force_N"):
        read_log(path, required=("depth", "force"))
    log = read_log(path, mapped(rate_hz=100.0), required=("depth", "force"))
    assert len(log) == 371
    assert log["force_N"].max() == pytest.approx(2.32, abs=0.1)


def test_real_liver_log_holds_many_insertions_and_its_own_rate():
    path = real("liver_dejong2017/insertions.npz")
    with pytest.raises(ColumnError, match=r"depth: several columns would fit .depth_m_00, depth_m"):
        read_log(path, required=("depth", "force"))
    mapping = mapped(depth="depth_m_04", force="force_N_04")
    log = read_log(path, mapping, required=("depth", "force"))
    assert log["depth_m"].max() == pytest.approx(0.085, abs=1e-3)
    assert log.t_s[1] == pytest.approx(0.001)
    assert log.warnings == ("no time column: time from sample_rate_Hz = 1000",)
