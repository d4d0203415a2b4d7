"""npz files, whole and broken."""

import io
import zipfile

import numpy as np
import pytest

from needleforce.recordings import FileAccessError, FormatError, read_table


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.npz"


def test_arrays_become_columns_and_numbers_constants(path):
    q_rad = np.arange(6.0).reshape(3, 2)
    np.savez(path, t_s=np.arange(3), q_rad=q_rad, rate_Hz=100, contact=[True, False, True])
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["q_rad"], q_rad)
    np.testing.assert_array_equal(table.columns["contact"], [1.0, 0.0, 1.0])
    assert all(column.dtype == np.float64 for column in table.columns.values())
    assert dict(table.constants) == {"rate_Hz": 100.0}
    assert table.warnings == ()


def test_a_pickle_is_never_loaded(path):
    class Trap:
        def __reduce__(self):
            return pytest.fail, ("the pickle was loaded",)

    np.savez(path, t=np.arange(3.0), trap=np.array([Trap()], dtype=object))
    table = read_table(path)
    assert list(table.columns) == ["t"]
    (warning,) = table.warnings
    assert warning.startswith("column 'trap' cannot be read (Object arrays cannot be loaded")


def test_what_is_no_column_of_numbers_is_left_out_and_told(path):
    np.savez(
        path,
        t=np.arange(3.0),
        names=np.array(["a", "b"]),
        cube=np.zeros((2, 2, 2)),
        none=np.zeros(0),
        spectrum=np.zeros(3, dtype=complex),
    )
    table = read_table(path)
    assert list(table.columns) == ["t"]
    assert [warning.split("'")[1] for warning in table.warnings] == [
        *("names", "cube", "none", "spectrum")
    ]


def test_a_damaged_array_is_left_out_and_told(path):
    np.savez(path, t=np.zeros(1000), f=np.ones(1000))
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 0xFF
    path.write_bytes(data)
    table = read_table(path)
    assert list(table.columns) == ["f"]
    assert "column 't' cannot be read (Bad CRC-32" in table.warnings[0]


def test_a_member_that_is_no_array_is_left_out_and_told(path):
    np.savez(path, t=np.zeros(3))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("readme.txt", "hello")
    table = read_table(path)
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
def test_what_cannot_be_read_is_refused_with_file_and_reason(path, content, message):
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message) as caught:
        read_table(path)
    assert "log.npz" in str(caught.value)


def test_a_file_that_is_not_there_is_told(path):
    with pytest.raises(FileAccessError, match=r"cannot read .*No such file"):
        read_table(path)


def test_no_cut_of_a_file_gives_anything_but_our_own_error(path):
    whole = array_bytes(t=np.arange(20.0), f=np.arange(20.0))
    for size in range(0, len(whole), 7):
        path.write_bytes(whole[:size])
        with pytest.raises(FormatError):
            read_table(path)
