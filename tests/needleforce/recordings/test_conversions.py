"""Files that are not read: the command in the error makes one that is."""

import shlex
import subprocess
import sys

import h5py
import numpy as np
import pytest
import scipy.io

from needleforce.recordings import FileAccessError, read_log, read_table

COLUMNS = {
    "t_s": np.arange(50) / 100.0,
    "q_rad": np.linspace(0.0, 1.0, 150).reshape(50, 3),
    "force_N": np.arange(50.0),
}


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        for name, values in COLUMNS.items():
            file[name] = values

        file.create_group("settings")


def write_matlab_hdf5(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in COLUMNS.items():
            file[name] = np.atleast_2d(values) if values.ndim == 1 else values.T

    data = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + data[512:])


def write_matlab(path):
    scipy.io.savemat(path, COLUMNS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("log.h5", write_hdf5),
        ("my log.mat", write_matlab),
        ("log.mat", write_matlab_hdf5),
    ],
)
def test_the_command_in_the_error_converts_the_file(tmp_path, name, write):
    write(tmp_path / name)

    with pytest.raises(FileAccessError) as caught:
        read_table(tmp_path / name)

    advice, _, command = caught.value.advice.removeprefix("To convert it, ").partition(
        ": "
    )
    program, *arguments = shlex.split(command)

    assert (advice, program) == ("run in its folder", "python")

    subprocess.run([sys.executable, *arguments], cwd=tmp_path, check=True)
    log = read_log((tmp_path / name).with_suffix(".npz"))

    np.testing.assert_array_equal(log.t_s, COLUMNS["t_s"])
    np.testing.assert_array_equal(log["q_rad"], COLUMNS["q_rad"])
    np.testing.assert_array_equal(log["force_N"], COLUMNS["force_N"])


def test_a_spreadsheet_is_refused_with_what_to_do(tmp_path):
    path = tmp_path / "log.xlsx"
    path.write_bytes(b"PK")

    with pytest.raises(FileAccessError) as caught:
        read_table(path)

    assert caught.value.advice.startswith("To convert it, save the sheet as CSV")
