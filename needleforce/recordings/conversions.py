"""Files that are not read, and the command that makes a file of them that is."""

from pathlib import Path

HDF5 = (
    "python -c \"import h5py, numpy; f = h5py.File('{name}'); "
    "numpy.savez('{stem}.npz', "
    "**{{name: f[name][()] for name in f if hasattr(f[name], 'shape')}})\""
)
"""Datasets at the top of an HDF5 file become columns; needs h5py."""

MATLAB = (
    "python -c \"import numpy, scipy.io; m = scipy.io.loadmat('{name}', "
    "squeeze_me=True); numpy.savez('{stem}.npz', **{{name: m[name] for name in m if "
    "name[0] != '_'}})\""
)
"""Variables of a MATLAB file, up to version 7, become columns."""

MATLAB_HDF5 = HDF5.replace("f[name][()]", "f[name][()].T.squeeze()")
"""A MATLAB file of version 7.3 is HDF5, with rows and columns exchanged."""

MATLAB_HDF5_HEAD = b"MATLAB 7.3"
"""How such a file begins."""

SPREADSHEET = "save the sheet as CSV (in Excel: CSV UTF-8)"
"""What a user of a spreadsheet does."""

CONVERSIONS = {
    ".h5": HDF5,
    ".hdf5": HDF5,
    ".mat": MATLAB,
    ".xlsx": SPREADSHEET,
    ".xls": SPREADSHEET,
    ".ods": SPREADSHEET,
}
"""What to do with a file, by its suffix."""


def conversion_of(path: Path) -> str:
    """Return what makes a readable file of another; empty if nothing is known.

    Args:
        path: Of the file, which is opened only if its suffix is that of MATLAB.
    """
    line = CONVERSIONS.get(path.suffix.lower(), "")
    if line == MATLAB and path.is_file():
        with path.open("rb") as file:
            if file.read(len(MATLAB_HDF5_HEAD)) == MATLAB_HDF5_HEAD:
                line = MATLAB_HDF5

    command = line.format(name=path.name, stem=path.stem)
    is_program = command.startswith("python ")
    return f"run in its folder: {command}" if is_program else command
