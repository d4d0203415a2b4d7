"""What is wrong with a log's time stamps, in words."""

import numpy as np

from recordings.errors import LogError
from recordings.table import FloatArray


def check_time_stamps(t_s: FloatArray) -> tuple[str, ...]:
    """Report stamps that do not advance; refuse a log in which none does.

    A stamp advances if it is later than every stamp before it. The others stay in the log: an
    online step skips them.

    Args:
        t_s: finite time stamps in s, shape (n,).

    Returns:
        One warning for backward stamps and one for repeated ones, each with how many and where
        the first stands (rows count from 1).

    Raises:
        LogError: fewer than two stamps advance, so that no time step can be formed.
    """
    latest_before_s = np.maximum.accumulate(t_s)[:-1]
    late = t_s[1:]
    if not np.any(late > latest_before_s):
        raise LogError(
            f"no usable time: of {t_s.size} samples none is later than the first; "
            "at least two time stamps must advance"
        )
    backward = np.flatnonzero(late < latest_before_s)
    repeated = np.flatnonzero(late == latest_before_s)
    warnings = []
    if backward.size:
        warnings.append(f"time: stamps running backward: {_where(t_s, backward)}")
    if repeated.size:
        warnings.append(f"time: stamps repeated: {_where(t_s, repeated)}")
    return tuple(warnings)


def _where(t_s: FloatArray, rows: np.ndarray) -> str:
    row = int(rows[0]) + 1
    latest_s = t_s[:row].max()
    return f"{rows.size} (first: row {row + 1}, {t_s[row]:.9g} s after {latest_s:.9g} s)"
