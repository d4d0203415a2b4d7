"""Binary files: npz and Parquet, damage, limits, and files that are not read."""

import gzip
import io
import sys
import tracemalloc

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from needleforce.recordings import (
    ColumnError,
    FileAccessError,
    FormatError,
    load_mapping,
    read_log,
    read_table,
    write_table,
)
from needleforce.recordings.writers import standard_types
from tests.needleforce.recordings.bag_samples import mapped


def array_bytes(**arrays):
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def test_arrays_become_columns(tmp_path):
    path = tmp_path / "log.npz"
    q_rad = np.arange(6.0).reshape(3, 2)
    contact = [True, False, True]
    text = np.array(["a", "b", "c"])
    content = {"q_rad": q_rad, "rate_Hz": 100, "contact": contact, "text": text}
    path.write_bytes(array_bytes(**content, image=np.zeros((3, 2, 2)), empty=[]))
    table = read_table(path)

    assert list(table.columns) == ["q_rad", "contact"]
    np.testing.assert_array_equal(table.columns["q_rad"], q_rad)
    np.testing.assert_array_equal(table.columns["contact"], [1.0, 0.0, 1.0])
    assert len(table.warnings) == 3


class Trap:
    """An object that makes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_objects_are_never_loaded(tmp_path):
    path = tmp_path / "log.npz"
    trap = np.array([Trap(tmp_path / "sprung")], dtype=object)
    np.savez(path, f=np.ones(3), t=trap)

    assert list(read_table(path).columns) == ["f"]
    assert not (tmp_path / "sprung").exists()


def test_types_of_other_writers_become_numbers(tmp_path):
    path = tmp_path / "log.parquet"
    lists = pa.array([[1, 2], None, [5, 6], [7, 8]], pa.list_(pa.int32()))
    ragged = pa.array([[1], [1, 2], [5, 6], [7, 8]])
    cells = {"t": [0.0, 1.0, 2.0, 3.0], "flag": [True, None, False, True], "q": lists}
    names = ["a", "b", "1", None]
    pq.write_table(pa.table({**cells, "name": names, "ragged": ragged}), path)
    table = read_table(path)

    assert list(table.columns) == ["t", "flag", "q"]
    np.testing.assert_array_equal(table.columns["flag"], [1.0, np.nan, 0.0, 1.0])
    nan = np.nan
    np.testing.assert_array_equal(
        table.columns["q"], [[1, 2], [nan, nan], [5, 6], [7, 8]]
    )
    assert ["ragged" in note for note in table.warnings] == [False, True]


def write_hdf5(path, arrays):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[f"run/{name}"] = values


def write_matlab_7_3(path, arrays):
    # MATLAB writes columns as rows, and vectors as matrices.
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[f"run/{name}"] = np.atleast_2d(values.T)


def write_matlab_7_3_rows(path, arrays):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[f"run/{name}"] = values.T if values.ndim == 2 else values[:, None]


def write_matlab(path, arrays):
    columns = {n: v[:, None] if v.ndim == 1 else v for n, v in arrays.items()}
    savemat(path, {"run": columns})


@pytest.mark.parametrize(
    ("suffix", "write"),
    [
        ("h5", write_hdf5),
        ("mat", write_matlab_7_3),
        ("mat", write_matlab_7_3_rows),
        ("mat", write_matlab),
    ],
)
def test_arrays_in_groups_are_columns(tmp_path, suffix, write):
    path = tmp_path / f"log.{suffix}"
    q_rad = np.arange(12.0).reshape(6, 2) / 10
    arrays = {"t_s": np.arange(6.0) / 10, "q": q_rad, "tau": 2.0 * q_rad}
    write(path, arrays)
    log = read_log(path, required=["q", "tau"])

    np.testing.assert_array_equal(log.t_s, arrays["t_s"])
    np.testing.assert_array_equal(log["q_rad"], q_rad)
    np.testing.assert_array_equal(log["tau_Nm"], 2.0 * q_rad)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(FormatError, match=path.name):
        read_log(path)


@pytest.mark.parametrize(("first_ms", "later_ms"), [(0, 0), (1_700_000_000_000, 100)])
def test_channels_of_tdms_have_their_units_and_clocks(tmp_path, first_ms, later_ms):
    nptdms = pytest.importorskip("nptdms")
    clock = {"wf_start_time": np.datetime64(first_ms, "ms"), "wf_increment": 0.02}
    late = {**clock, "wf_start_time": np.datetime64(first_ms + later_ms, "ms")}
    channels = [
        nptdms.ChannelObject("Stage", "Position", np.arange(30.0), clock),
        nptdms.ChannelObject("Cell", "Force", np.arange(20.0), late),
    ]
    for channel, unit in zip(channels, ("mm", "kN"), strict=True):
        channel.properties["unit_string"] = unit
    path = tmp_path / "log.tdms"
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)
    log = read_log(path, required=["depth", "force"])

    np.testing.assert_allclose(log.t_s, 0.02 * np.arange(20), atol=1e-9)
    shift = later_ms / 20.0
    np.testing.assert_allclose(log["depth_m"], 1e-3 * (np.arange(20) + shift))
    np.testing.assert_allclose(log["force_N"], 1e3 * np.arange(20))


def test_of_several_demonstrations_one_has_to_be_named(tmp_path):
    path = tmp_path / "demo.hdf5"
    q_rad = np.arange(12.0).reshape(6, 2) / 10
    with h5py.File(path, "w") as file:
        for demo in ("data/demo_0", "data/demo_1"):
            file[f"{demo}/timestamps"] = np.arange(6.0) / 10
            file[f"{demo}/obs/robot0_joint_pos"] = q_rad
    with pytest.raises(ColumnError, match="demo_1"):
        read_log(path, required=["q"])

    one = mapped(time="data/demo_0/timestamps", q="data/demo_0/obs/robot0_joint_pos")
    np.testing.assert_array_equal(read_log(path, one, required=["q"])["q_rad"], q_rad)


@pytest.mark.parametrize(
    ("values", "known"),
    [
        ([1.0, -999.0, 3.0, -999.0], [True, False, True, False]),
        ([-9999.0, 2.0, 2.0, 2.0], [False, True, True, True]),
        ([1.0, -999.0, -9999.0, -99.9], [True, False, False, True]),
        ([120.0, -999.0, -640.0, -80.0], [True] * 4),  # as in mN
        ([-998.0, -999.0, -1000.0, -998.5], [True] * 4),
        ([*range(30), -999.0, 5000.0], [True] * 30 + [False, True]),
        ([*range(0, 80_000, 4000), -999.0], [True] * 21),
    ],
)
def test_a_number_far_from_all_else_stands_for_no_value(tmp_path, values, known):
    path = tmp_path / "log.csv"
    write_table(path, {"t_s": np.arange(len(values)) / 10, "force_mN": values})
    log = read_log(path, required=["force"])

    expected = np.where(known, np.array(values) / 1e3, np.nan)
    np.testing.assert_allclose(log["force_N"], expected)
    (kept,) = {"kept" in text for text in log.warnings if "-999" in text}
    assert kept is all(known)


@pytest.mark.parametrize(("unit", "name"), [("ns", "time"), ("ms", "time_ms")])
def test_stamps_of_parquet_become_exact_seconds(tmp_path, unit, name):
    path = tmp_path / "log.parquet"
    stamps = np.array([1_700_000_000_123, 1_700_000_000_124, "NaT"], dtype="M8[ms]")
    column = pa.array(stamps.astype(f"M8[{unit}]"))
    pq.write_table(pa.table({name: column, "f": [1.0, 2.0, 3.0]}), path)
    log = read_log(path)

    assert log.t_s.tolist() == [0.0, 0.001]
    assert log.start_ns == 1_700_000_000_123_000_000
    assert log.left_out == 1


@given(
    first_ns=st.one_of(st.integers(0, 1 << 40), st.integers(1 << 60, (1 << 62) - 1)),
    since_ns=st.lists(st.integers(1, 10**9), min_size=1, max_size=20),
)
@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
def test_whole_nanoseconds_lose_no_digit(tmp_path_factory, suffix, first_ns, since_ns):
    stamps_ns = first_ns + np.unique([0, *since_ns])
    path = tmp_path_factory.mktemp("log") / f"log.{suffix}"
    write_table(path, {"time [ns]": stamps_ns, "force_N": np.ones(len(stamps_ns))})
    log = read_log(path)
    again_ns = log.start_ns + np.rint(1e9 * log.t_s).astype(np.int64)

    assert again_ns.tolist() == stamps_ns.tolist()


@given(where=st.floats(0.0, 1.0, exclude_max=True), byte=st.integers(0, 255))
@pytest.mark.parametrize("suffix", ["parquet", "npz"])
def test_damaged_bytes_are_read_or_refused(tmp_path_factory, suffix, where, byte):
    path = tmp_path_factory.mktemp("damaged") / f"log.{suffix}"
    write_table(path, {"t_s": np.arange(50.0), "force_N": np.ones(50)})
    data = bytearray(path.read_bytes())
    data[int(where * len(data))] ^= byte
    path.write_bytes(data)
    try:
        assert read_table(path).columns
    except (FormatError, FileAccessError):
        return


@pytest.mark.parametrize("suffix", ["parquet", "npz", "h5", "csv.gz"])
def test_what_unpacks_beyond_the_limit_is_refused_within_it(
    tmp_path, monkeypatch, suffix
):
    writers = {
        "parquet": lambda x: pq.write_table(pa.table({"t": x}), path),
        "npz": lambda x: np.savez_compressed(path, t=x),
        "h5": lambda x: h5py.File(path, "w").create_dataset(
            "t", data=x, compression="gzip"
        ),
        "csv.gz": lambda x: path.write_bytes(gzip.compress(b"0,1\n" * x.size)),
    }
    path = tmp_path / f"x.{suffix}"
    writers[suffix](np.zeros(9))
    read_table(path)  # imports take memory, too
    writers[suffix](np.zeros(1 << 21))
    limit = 1 << 20
    assert path.stat().st_size < limit
    monkeypatch.setattr("needleforce.recordings.errors.MAX_BYTES", limit)

    tracemalloc.start()
    with pytest.raises(FormatError, match="limit"):
        read_table(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 * limit


@pytest.mark.parametrize("suffix", ["parquet", "npz", "csv.gz", "mcap.zstd"])
def test_the_limit_is_that_of_all_files_of_a_recording(tmp_path, monkeypatch, suffix):
    columns = {"t_s": np.arange(9.0), "force_N": np.arange(9.0)}
    for name in ("one", "two"):
        path = tmp_path / f"{name}.{suffix}"
        plain = path.with_suffix("") if suffix in ("csv.gz", "mcap.zstd") else path
        write_table(plain, columns)
        data = plain.read_bytes()
        if plain != path:
            pack = gzip.compress if suffix == "csv.gz" else zstandard.compress
            path.write_bytes(pack(data))
            plain.unlink()
    # An archive or a Parquet file states what it holds, beside its headers.
    size = 400 if suffix in ("parquet", "npz") else len(data)
    monkeypatch.setattr("needleforce.recordings.errors.MAX_BYTES", size)

    read_table(path)
    with pytest.raises(FormatError, match="limit"):
        read_table(tmp_path)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_lists_that_are_no_signals_are_left_out(tmp_path, suffix):
    lists = [[0.0] * 10_000, [0.0] * 10_000, [1.0]]
    path = tmp_path / f"x.{suffix}"
    if suffix == "csv":
        rows = [f'{k},1,"{cell}"' for k, cell in enumerate(lists)]
        path.write_text("\n".join(["t,f,image", *rows, ""]))
    else:
        columns = {"t": [0.0, 1.0, 2.0], "f": [1.0, 1.0, 1.0], "image": lists}
        pq.write_table(pa.table(columns), path)

    table = read_table(path)
    assert list(table.columns) == ["t", "f"]
    assert "image" in table.warnings[0]


@pytest.mark.parametrize(
    "name", ["x.npz", "x.mcap", "x.db3", "x.csv", "x.parquet", "x.toml"]
)
def test_a_device_is_no_file(tmp_path, name):
    (tmp_path / name).symlink_to("/dev/zero")
    read = load_mapping if name == "x.toml" else read_table
    with pytest.raises(FileAccessError, match=name):
        read(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("x.xlsx", "CSV"),
        ("x.csv.zst", "zstd"),
        ("x", ".parquet"),
    ],
)
def test_what_is_not_read_is_refused_with_what_makes_it_readable(
    tmp_path, name, advice
):
    path = tmp_path / name
    path.write_bytes(b"PK")
    with pytest.raises(FileAccessError) as refused:
        read_table(path)
    assert advice in refused.value.advice


@pytest.mark.parametrize(
    ("suffix", "library"), [("parquet", "pyarrow"), ("mcap", "rosbags")]
)
def test_a_missing_library_is_named(tmp_path, monkeypatch, suffix, library):
    path = tmp_path / f"log.{suffix}"
    write_table(path, {"t_s": [0.0], "f": [1.0]})
    standard_types.cache_clear()
    for module in ("pyarrow", "pyarrow.parquet", "rosbags.typesys"):
        monkeypatch.setitem(sys.modules, module, None)

    for use in (read_table, lambda path: write_table(path, {"t_s": [0.0], "f": [1.0]})):
        with pytest.raises(FileAccessError, match=library):
            use(path)


def test_the_real_liver_log_needs_a_mapping_and_a_rate(recordings_dir):
    path = recordings_dir / "liver_dejong2017/insertions.npz"
    mapping = mapped(depth="depth_m_04", force="force_N_04", rate_hz=1000.0)
    log = read_log(path, mapping, required=("depth", "force"))

    assert log["depth_m"].max() == pytest.approx(0.085, abs=1e-3)
    assert log.t_s[1] == pytest.approx(0.001)
