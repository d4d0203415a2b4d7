"""Two-dimensional columns as numbered ones, for formats of flat tables."""

from collections.abc import Mapping

import numpy as np

from recordings.errors import LogError


def flat_columns(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return columns of one value a row; `q_rad` becomes `q_rad_1`, `q_rad_2`, ...

    `read_log` joins them again.

    Args:
        columns: name to values, shape (n,) or (n, k).

    Returns:
        Name to values, shape (n,), in the same order.

    Raises:
        LogError: a name would stand twice.
    """
    flat: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        if values.ndim == 1:
            parts = {name: values}
        else:
            parts = {f"{name}_{i + 1}": column for i, column in enumerate(values.T)}
        for part, column in parts.items():
            if part in flat:
                raise LogError(f"column name {part!r} would stand twice in the header")
            flat[part] = column
    return flat
