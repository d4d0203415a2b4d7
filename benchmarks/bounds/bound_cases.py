"""Bounds of a stack of two gels, as release, speed, thickness and cutting change."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.bounds.delay_bound import delay_bounds_s
from benchmarks.bounds.friction_bound import CUTTING_SHARE, friction_bounds
from benchmarks.signals.insertion_truth import InsertionTruth, truth_of_needle
from groundtruth import SCENARIOS, Scenario, insert_needle
from groundtruth.motion import constant_motion

Array = NDArray[np.float64]

GEL = SCENARIOS["gel-50-constant"].layers[0]
"""The paper's middle gel: 0.75 N at the tip, 17 N/m of friction at 2.3 mm/s."""
MIDDLE = {"release_m": 0.3e-3, "speed_m_s": 3e-3, "thickness_m": 25e-3}
CHANGES = {
    "release_m": (0.1e-3, 0.3e-3, 0.5e-3, 2e-3),
    "speed_m_s": (2e-3, 3e-3, 6e-3),
    "thickness_m": (10e-3, 25e-3, 40e-3),
}
"""One at a time; 2 mm is the longest release of real liver."""
CUTTING = "cutting_share"
CUTTING_SHARES = (0.0, CUTTING_SHARE, 1.0)
"""Root mean square share of cutting in the tip force that the estimator is told."""
BEYOND_m = 11e-3
STANDOFF_m = 5e-3


class ForceNoiseSeries(NamedTuple):
    """Noise of one source.

    Attributes:
        name: For people.
        error_N: A stretch of it, a millisecond per sample, shape (m,).
        is_white: Whether it is to be taken as white.
        lag_s: Time constant of the source.
    """

    name: str
    error_N: Array
    is_white: bool
    lag_s: float


class BoundCase(NamedTuple):
    """Bounds of one stack with one noise.

    Attributes:
        changed: What is not as in `MIDDLE`, or is looked at.
        value: Its value.
        noise: Name of the noise.
        friction_pct: Least standard deviation of the friction of the second layer.
        delay_ms: Least mean delay of its rupture.
    """

    changed: str
    value: float
    noise: str
    friction_pct: float
    delay_ms: float


def bound_cases(noises: list[ForceNoiseSeries]) -> Iterator[BoundCase]:
    """Every change with every noise, in order."""
    for changed, values in CHANGES.items():
        for value in values:
            truth = _truth(**(MIDDLE | {changed: value}))
            for noise in noises:
                yield BoundCase(changed, value, noise.name, *_bounds(truth, noise))
    truth = _truth(**MIDDLE)
    for share in CUTTING_SHARES:
        for noise in noises:
            yield BoundCase(CUTTING, share, noise.name, *_bounds(truth, noise, share))


def _bounds(
    truth: InsertionTruth, noise: ForceNoiseSeries, cutting_share: float = CUTTING_SHARE
) -> tuple[float, float]:
    friction = friction_bounds(
        truth, noise.error_N, is_white=noise.is_white, cutting_share=cutting_share
    )
    error = _whitened(noise.error_N) if noise.is_white else noise.error_N
    delay = delay_bounds_s(truth, truth.ruptures[-1:], error, noise.lag_s)
    return 100.0 * friction[-1], 1e3 * delay[0]


def _truth(*, release_m: float, speed_m_s: float, thickness_m: float) -> InsertionTruth:
    layer = replace(GEL, release_m=release_m, thickness_m=thickness_m)
    depth = 2.0 * thickness_m + BEYOND_m
    motion = constant_motion(speed_m_s=speed_m_s, depth_m=depth, standoff_m=STANDOFF_m)
    stack = Scenario(id="bound", title="two equal gels", layers=(layer, layer), motion=motion)
    return truth_of_needle(insert_needle(stack, noise="clean"))


def _whitened(error_N: Array) -> Array:
    """White noise of the same size."""
    rng = np.random.default_rng(0)
    return float(np.std(error_N)) * rng.standard_normal(len(error_N))
