"""npz and Parquet: what is written reads back, what cannot be read is reported."""

import io
import sys
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from needleforce.recordings import FileAccessError, FormatError, read_log, read_table, write_table
from needleforce.recordings.columnar import parquet_tables
from needleforce.recordings.output import open_table
from needleforce.recordings.table import Labels


@pytest.fixture
def npz_path(tmp_path):
    return tmp_path / "log.npz"


def test_arrays_become_columns_and_numbers_constants(npz_path):
    q_rad = np.arange(6.0).reshape(3, 2)
    np.savez(npz_path, t_s=np.arange(3), q_rad=q_rad, rate_Hz=100, contact=[True, False, True])
    table = read_table(npz_path)
    np.testing.assert_array_equal(table.columns["q_rad"], q_rad)
    np.testing.assert_array_equal(table.columns["contact"], [1.0, 0.0, 1.0])
    assert all(column.dtype == np.float64 for column in table.columns.values())
    assert dict(table.constants) == {"rate_Hz": 100.0}
    assert table.warnings == ()


def test_a_pickle_is_never_loaded(npz_path):
    class Trap:
        def __reduce__(self):
            return pytest.fail, ("the pickle was loaded",)

    np.savez(npz_path, t=np.arange(3.0), trap=np.array([Trap()], dtype=object))
    table = read_table(npz_path)
    assert list(table.columns) == ["t"]
    (warning,) = table.warnings
    assert warning.startswith("column 'trap' cannot be read (Object arrays cannot be loaded")


def test_what_is_no_column_of_numbers_is_left_out_and_reported(npz_path):
    np.savez(
        npz_path,
        t=np.arange(3.0),
        names=np.array(["a", "b"]),
        cube=np.zeros((2, 2, 2)),
        none=np.zeros(0),
        spectrum=np.zeros(3, dtype=complex),
    )
    table = read_table(npz_path)
    assert list(table.columns) == ["t"]
    assert [warning.split("'")[1] for warning in table.warnings] == [
        *("names", "cube", "none", "spectrum")
    ]


def test_a_damaged_array_is_left_out_and_reported(npz_path):
    np.savez(npz_path, t=np.zeros(1000), f=np.ones(1000))
    data = bytearray(npz_path.read_bytes())
    data[len(data) // 4] ^= 0xFF
    npz_path.write_bytes(data)
    table = read_table(npz_path)
    assert list(table.columns) == ["f"]
    assert "column 't' cannot be read (Bad CRC-32" in table.warnings[0]


def test_a_member_that_is_no_array_is_left_out_and_reported(npz_path):
    np.savez(npz_path, t=np.zeros(3))
    with zipfile.ZipFile(npz_path, "a") as archive:
        archive.writestr("readme.txt", "hello")
    table = read_table(npz_path)
    assert "column 'readme.txt' cannot be read" in table.warnings[0]


def array_bytes(**arrays):
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def single_array_bytes():
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    return stream.getvalue()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not an npz archive, or it is cut short"),
        (b"t,f\n0,1\n", "is not an npz archive"),
        (array_bytes(t=np.arange(1000.0))[:-50], "cut short"),
        (array_bytes(t=np.arange(1000.0))[:100], "cut short"),
        (single_array_bytes(), "is not an npz archive"),
        (array_bytes(), "holds no array of numbers"),
        (array_bytes(names=np.array(["a"])), "holds no array of numbers: column 'names' holds"),
        (array_bytes(rate_Hz=np.array(3.0)), "holds no array of numbers"),
    ],
)
def test_what_cannot_be_read_is_refused_with_file_and_reason(npz_path, content, message):
    npz_path.write_bytes(content)
    with pytest.raises(FormatError, match=message) as caught:
        read_table(npz_path)
    assert "log.npz" in str(caught.value)


def test_a_file_that_is_not_there_is_reported(npz_path):
    with pytest.raises(FileAccessError, match=r"cannot read .*No such file"):
        read_table(npz_path)


def test_no_cut_of_a_file_gives_anything_but_our_own_error(npz_path):
    whole = array_bytes(t=np.arange(20.0), f=np.arange(20.0))
    for size in range(0, len(whole), 7):
        npz_path.write_bytes(whole[:size])
        with pytest.raises(FormatError):
            read_table(npz_path)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.parquet"


@given(values=arrays(np.float64, st.tuples(st.integers(1, 30), st.integers(1, 3))))
def test_floats_read_back_bit_for_bit(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("parquet") / "log.parquet"
    write_table(path, {"t_s": np.arange(len(values)), "q_rad": values})
    table = read_table(path)
    for i, column in enumerate(values.T):
        np.testing.assert_array_equal(table.columns[f"q_rad_{i + 1}"], column)
    assert table.warnings == ()


def test_it_means_what_the_same_csv_means(path):
    columns = {"t_s": [0.0, 0.1, 0.2], "q_deg": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]}
    write_table(path, columns)
    write_table(path.with_suffix(".csv"), columns)
    one, other = read_log(path), read_log(path.with_suffix(".csv"))
    np.testing.assert_array_equal(one["q_rad"], other["q_rad"])
    assert one["q_rad"].shape == (3, 2)


def test_types_of_other_writers_become_numbers(path):
    lists = pa.array([[1, 2], None, [5, 6], [7]], pa.list_(pa.int32()))
    cells = {"t": [0.0, 1.0, 2.0, 3.0], "flag": [True, None, False, True], "q": lists}
    pq.write_table(pa.table({**cells, "name": ["a", "b", "c", "d"]}), path)
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["flag"], [1.0, np.nan, 0.0, 1.0])
    nan = np.nan
    np.testing.assert_array_equal(table.columns["q"], [[1, 2], [nan, nan], [5, 6], [nan, nan]])
    assert table.warnings == ("column 'name' holds string, no numbers, and was left out",)


@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
def test_time_stamps_become_seconds_without_loss(path, unit):
    stamps = np.array([1_700_000_000_123, 1_700_000_000_124], dtype="M8[ms]").astype(f"M8[{unit}]")
    pq.write_table(pa.table({"time": pa.array(stamps), "f": [1.0, 2.0]}), path)
    log = read_log(path)
    assert log.t_s.tolist() == [0.0, 0.001]
    assert log.start_ns == 1_700_000_000_123_000_000


def test_a_missing_stamp_is_nan_and_the_row_is_reported(path):
    stamps = pa.array([None, 10, 20, 30], pa.timestamp("ms"))
    pq.write_table(pa.table({"time": stamps, "f": [1.0, 2.0, 3.0, 4.0]}), path)
    log = read_log(path)
    assert log.t_s.tolist() == [0.01, 0.02, 0.03]
    assert "rows without a stamp" in log.warnings[0]


def test_the_start_of_the_clock_is_kept(path):
    write_table(path, {"t_s": [0.0, 1.0], "f": [1.0, 2.0]}, labels=Labels(start_ns=17))
    assert read_log(path).start_ns == 17


def test_chunks_are_the_file_in_pieces(path):
    q = np.arange(20.0).reshape(10, 2)
    with open_table(path) as table:
        for rows in (slice(0, 4), slice(4, 10)):
            table.append({"t_s": np.arange(10.0)[rows], "q": q[rows]})
    chunks = list(parquet_tables(path, 3))
    assert all(chunk.columns.keys() == chunks[0].columns.keys() for chunk in chunks)
    joined = np.concatenate([chunk.columns["q_2"] for chunk in chunks])
    np.testing.assert_array_equal(joined, read_table(path).columns["q_2"])
    assert max(chunk.columns["t_s"].size for chunk in chunks) == 3


def test_all_row_groups_are_read(path):
    pq.write_table(pa.table({"t": np.arange(100.0)}), path, row_group_size=7)
    assert read_table(path).columns["t"].size == 100


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_a_file_cut_short_is_refused_with_the_reason(path, share):
    write_table(path, {"t_s": np.arange(1000.0), "f": np.ones(1000)})
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(FormatError, match="ends with its table of contents"):
        read_table(path)


@pytest.mark.parametrize("cells", [{"a": pa.array([], pa.float64())}, {"a": ["x"]}])
def test_a_file_without_numbers_is_refused(path, cells):
    pq.write_table(pa.table(cells), path)
    with pytest.raises(FormatError, match="columns of numbers"):
        read_table(path)


def test_a_missing_file_is_reported(path):
    with pytest.raises(FileAccessError, match="cannot read"):
        read_table(path)


def test_without_pyarrow_the_error_says_what_to_install(path, monkeypatch):
    write_table(path, {"t_s": [0.0]})
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(FileAccessError, match=r"pip install 'needleforce\[recordings\]'"):
        read_table(path)
    with pytest.raises(FileAccessError, match=r"pip install 'needleforce\[recordings\]'"):
        write_table(path, {"t_s": [0.0]})


@given(where=st.floats(0.0, 1.0, exclude_max=True), byte=st.integers(0, 255))
def test_damaged_bytes_end_in_a_table_or_in_one_of_our_errors(tmp_path_factory, where, byte):
    path = tmp_path_factory.mktemp("damaged") / "log.parquet"
    write_table(path, {"t_s": np.arange(50.0), "force_N": np.ones(50)})
    data = bytearray(path.read_bytes())
    data[int(where * len(data))] ^= byte
    path.write_bytes(data)
    try:
        table = read_table(path)
    except (FormatError, FileAccessError):
        return
    assert table.columns


def test_a_damaged_name_is_reported(path):
    write_table(path, {"t_s": [0.0, 1.0]})
    path.write_bytes(path.read_bytes().replace(b"t_s", b"t\xffs"))
    with pytest.raises(FormatError, match="damaged"):
        read_table(path)
