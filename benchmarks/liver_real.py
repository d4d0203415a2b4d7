"""``liver-real``: friction told during insertion against the force that pulls the needle out.

The needle is pulled out against friction alone, so the pull-out force at a depth is what the shaft
friction was there on the way in. Methods see the insertion only.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.benchmark import Findings
from benchmarks.identified import IDENTIFIERS
from benchmarks.job import Job, Progress
from benchmarks.liver import NUMBERS, LiverInsertion, read_liver
from benchmarks.measurement import Measurement
from benchmarks.pullout import in_and_out, mean_at_depth
from benchmarks.recordings_folder import recordings_folder
from benchmarks.row import Method
from identification import replay

Array = NDArray[np.float64]

DEPTHS_mm = (42, 78)
"""Half way and near the end: where friction is compared."""
GUESS_SHARE = 0.7
"""The rule of thumb: so much of the insertion force is friction."""


class _Told(NamedTuple):
    """What a method made of the insertions.

    Attributes:
        error_pct: Relative error of the friction, shape (insertions, depths).
        ruptures: Reported per insertion; nan for the guess.
    """

    error_pct: Array
    ruptures: float


def run_liver_real(job: Job, progress: Progress) -> Findings:
    """All insertions through both methods and the guess.

    Raises:
        DataError: The recording is missing or broken.
    """
    data = recordings_folder(job)
    errors: dict[Method, list[list[float]]] = {"guess": [], "paper": [], "default": []}
    counts: dict[Method, int] = dict.fromkeys(errors, 0)
    for index in range(len(NUMBERS)):
        progress(index / len(NUMBERS))
        insertion = read_liver(data, index, as_recorded=True)
        parts = in_and_out(insertion.depth_m)
        true = [-_at(insertion, parts.withdrawal, insertion.force_N, mm) for mm in DEPTHS_mm]
        guess = [
            GUESS_SHARE * _at(insertion, parts.insertion, insertion.force_N, mm) for mm in DEPTHS_mm
        ]
        errors["guess"].append(_errors_pct(guess, true))
        for method in IDENTIFIERS:
            friction, ruptures = _identify(insertion, parts.insertion, method)
            errors[method].append(_errors_pct(friction, true))
            counts[method] += ruptures
    told: dict[Method, _Told] = {
        method: _Told(
            np.array(found), counts[method] / len(NUMBERS) if method != "guess" else np.nan
        )
        for method, found in errors.items()
    }
    return Findings([item for method, found in told.items() for item in _measure(method, found)])


def _identify(insertion: LiverInsertion, inside: slice, method: Method) -> tuple[list[float], int]:
    """Shaft friction at each depth as told when the needle was there, and ruptures reported."""
    depth = insertion.depth_m[inside]
    result = replay(
        insertion.t_s[inside], depth, insertion.force_N[inside], config=IDENTIFIERS[method]
    )
    friction = np.array([estimate.shaft_friction_N for estimate in result.estimates])
    ruptures = sum(estimate.rupture is not None for estimate in result.estimates)
    return [mean_at_depth(depth, friction, 1e-3 * mm) for mm in DEPTHS_mm], ruptures


def _at(insertion: LiverInsertion, part: slice, values: Array, depth_mm: float) -> float:
    return mean_at_depth(insertion.depth_m[part], values[part], 1e-3 * depth_mm)


def _errors_pct(told: list[float], true: list[float]) -> list[float]:
    return [100.0 * abs(a - b) / b for a, b in zip(told, true, strict=True)]


def _measure(method: Method, told: _Told) -> Iterator[Measurement]:
    columns = {"": told.error_pct.ravel()}
    for mm, column in zip(DEPTHS_mm, told.error_pct.T, strict=True):
        columns[f"_{mm}mm"] = column
    for where, values in columns.items():
        for name, share in (("median", 50.0), ("p90", 90.0)):
            value = float(np.percentile(values, share))
            yield Measurement("ft", method, f"pullout_error{where}_{name}_pct", value)
    if not np.isnan(told.ruptures):
        yield Measurement("ft", method, "ruptures_per_insertion", told.ruptures)
