"""Whether a state has the form of a sensor's: arrays of the shapes that such a sensor keeps."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from residual.errors import SnapshotError

GROWING = ("probe.rows", "recorder.means", "recorder.time_s", "recorder.scatter")
"""Ends of the places of arrays whose first dimension counts what was gathered so far."""
LIKE = {"guard.noise": "guard.last", "guard.rejected": "guard.last"}
"""Arrays that a new sensor has not got yet, and others of the same shape."""


def check_form(state: object, model: object) -> None:
    """Compare the shapes of all arrays of a state with those of another of the same kind.

    Args:
        state: What is to be restored.
        model: State of a sensor of the same robot and settings that has seen samples.

    Raises:
        SnapshotError: With the array that differs.
    """
    expected = {place: array.shape for place, array in _arrays(model)}
    for place, array in _arrays(state):
        first = 1 if place.endswith(GROWING) else 0
        known = place
        for new, old in LIKE.items():
            known = known.replace(new, old)
        wanted = expected.get(known, array.shape)
        if array.ndim != len(wanted) or array.shape[first:] != wanted[first:]:
            raise SnapshotError(f"{place} has shape {array.shape}, expected {wanted}")


def _arrays(value: Any, place: str = "") -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Every array of a state, and where it stands: names of fields with dots between."""
    if isinstance(value, np.ndarray):
        yield place, value
    for name in getattr(type(value), "_fields", ()):
        yield from _arrays(getattr(value, name), f"{place}.{name}" if place else name)
