"""Writing: what is written reads back, and a failed write leaves no trace."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from needleforce.recordings import (
    FileAccessError,
    Log,
    LogError,
    check_writable,
    read_log,
    read_table,
    write_log,
    write_table,
)
from needleforce.recordings.output import open_table

SUFFIXES = ("csv", "csv.gz", "npz")
T_S = np.arange(3) / 1000.0


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_log_reads_back_bit_for_bit(tmp_path, suffix):
    rng = np.random.default_rng(2)
    q_rad, tau_Nm = rng.normal(size=(3, 12)), 1e6 * rng.normal(size=(3, 12))
    tau_Nm[1, 3] = np.nan
    channels = {"q_rad": q_rad, "tau_Nm": tau_Nm, "force_N": rng.normal(size=3)}
    log = Log(t_s=T_S, channels=channels)
    path = tmp_path / f"log.{suffix}"
    write_log(path, log)
    again = read_log(path)
    np.testing.assert_array_equal(again.t_s, log.t_s)
    assert set(again.channels) == set(channels)
    for name, values in channels.items():
        np.testing.assert_array_equal(again[name], values)
    assert again.warnings == log.warnings


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50)
@given(hnp.arrays(np.float64, st.tuples(st.integers(1, 5), st.just(2))))
def test_any_float_reads_back(tmp_path, values):
    columns = {"x": values[:, 0], "y": values[:, 1]}
    for suffix in SUFFIXES:
        write_table(tmp_path / f"t.{suffix}", columns)
        again = read_table(tmp_path / f"t.{suffix}").columns
        np.testing.assert_array_equal(again["x"], columns["x"])
        np.testing.assert_array_equal(again["y"], columns["y"])


def test_csv_numbers_two_dimensional_columns_and_quotes_names(tmp_path):
    path = tmp_path / "t.csv"
    write_table(path, {"n": [1, 2], "on": [True, False], "w, z": np.array([[0.1, 0.2], [1, 2]])})
    assert path.read_text() == 'n,on,"w, z_1","w, z_2"\n1,1,0.1,0.2\n2,0,1.0,2.0\n'
    assert list(read_table(path).columns) == ["n", "on", "w, z_1", "w, z_2"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_same_columns_give_the_same_bytes(tmp_path, suffix):
    paths = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for path in paths:
        write_table(path, {"t_s": T_S, "file": T_S})
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({}, "no columns"),
        ({"": T_S}, "is empty"),
        ({"#t": T_S}, "starts with '#'"),
        ({"t": T_S, "f": T_S[:2]}, r"'f' has shape \(2,\).*expected numbers of shape \(3,\)"),
        ({"t": 1.0}, "shape"),
        ({"t": np.zeros((2, 2, 2))}, "shape"),
        ({"t": ["a", "b"]}, "type <U1"),
        ({"t": [[1.0], [1.0, 2.0]]}, "'t' is not an array of numbers"),
        ({"q": np.zeros((3, 2)), "q_1": T_S}, "'q_1' would stand twice"),
    ],
)
def test_what_is_no_table_is_refused_and_the_old_file_kept(tmp_path, columns, message):
    path = tmp_path / "t.csv"
    write_table(path, {"old": [1.0]})
    with pytest.raises(LogError, match=message):
        write_table(path, columns)
    assert path.read_text() == "old\n1.0\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["t.csv"]


def test_a_write_that_fails_half_way_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "t.csv"
    write_table(path, {"old": [1.0]})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(FileAccessError, match=r"cannot write .*No space left"):
        write_table(path, {"new": [2.0]})
    assert path.read_text() == "old\n1.0\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["t.csv"]


def test_unknown_suffix_and_missing_folder_are_reported(tmp_path):
    with pytest.raises(FileAccessError, match=r"known are: \.csv, \.csv\.gz, \.npz"):
        write_table(tmp_path / "t.xlsx", {"t": T_S})
    with pytest.raises(FileAccessError, match=r"cannot write .*No such file"):
        write_table(tmp_path / "none" / "t.csv", {"t": T_S})


@pytest.mark.parametrize(
    ("name", "message"), [("t.xlsx", "known are"), ("none/t.csv", "no folder")]
)
def test_what_cannot_be_written_is_known_before_the_work(tmp_path, name, message):
    with pytest.raises(FileAccessError, match=message):
        check_writable(tmp_path / name)
    check_writable(tmp_path / "t.csv.gz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_rows_appended_are_rows_written_at_once(tmp_path, suffix):
    rng = np.random.default_rng(5)
    columns = {"t_s": np.arange(50.0), "q_rad": rng.normal(size=(50, 7)), "status": np.arange(50)}
    write_table(tmp_path / f"once.{suffix}", columns)
    path = tmp_path / f"pieces.{suffix}"
    with open_table(path) as table:
        for start in range(0, 50, 7):
            table.append({name: values[start : start + 7] for name, values in columns.items()})
    assert path.read_bytes() == (tmp_path / f"once.{suffix}").read_bytes()
    if suffix == "npz":
        assert np.load(path)["status"].dtype == columns["status"].dtype


@pytest.mark.parametrize("suffix", ["csv", "csv.gz"])
def test_a_live_table_shows_its_rows_and_keeps_them(tmp_path, suffix):
    path = tmp_path / f"t.{suffix}"
    write_table(path, {"old": [1.0]})
    with suppress(ZeroDivisionError), open_table(path, is_live=True) as table:
        assert list(read_table(path).columns) == ["old"]
        table.append({"t": T_S})
        assert len(read_table(path).columns["t"]) == 3
        table.append({"t": T_S})
        raise ZeroDivisionError
    assert len(read_table(path).columns["t"]) == 6
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_what_cannot_grow_is_written_in_the_end_and_not_after_a_failure(tmp_path):
    path = tmp_path / "t.npz"
    with open_table(path, is_live=True) as table:
        table.append({"t": T_S})
        assert not path.exists()
    assert len(read_table(path).columns["t"]) == 3
    with suppress(ZeroDivisionError), open_table(path) as table:
        table.append({"t": [1.0]})
        raise ZeroDivisionError
    assert len(read_table(path).columns["t"]) == 3


def test_a_table_without_rows_touches_nothing(tmp_path):
    with open_table(tmp_path / "t.csv", is_live=True):
        pass
    with open_table(tmp_path / "t.npz"):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "later", [{"t": T_S}, {"t": T_S, "x": T_S}, {"f": T_S, "t": T_S}, {"t": T_S, "f": [1, 2, 3]}]
)
def test_rows_with_other_columns_are_refused(tmp_path, later):
    with open_table(tmp_path / "t.csv") as table:
        table.append({"t": T_S, "f": T_S})
        with pytest.raises(LogError, match="do not fit those before"):
            table.append(later)
    assert len(read_table(tmp_path / "t.csv").columns["t"]) == 3


def test_the_log_that_is_being_read_is_no_place_to_write(tmp_path):
    path = tmp_path / "log.csv"
    write_table(path, {"t": T_S})
    (tmp_path / "link.csv").symlink_to(path)
    check_writable(tmp_path / "other.csv", source=path)
    check_writable("-", source=path)
    with pytest.raises(FileAccessError, match="it is the log itself"):
        check_writable(tmp_path / "link.csv", source=path)
