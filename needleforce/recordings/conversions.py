"""Files that are not read, and the command that makes a file of them that is."""

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


def conversion_of(name: str) -> str:
    """Return what makes a readable file of one by its name; empty if nothing is known.

    Args:
        name: Of the file, without its folder.
    """
    stem, dot, suffix = name.rpartition(".")
    line = CONVERSIONS.get(f"{dot}{suffix}".lower(), "")
    return line.format(name=name, stem=stem)
