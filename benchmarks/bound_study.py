"""Bounds of a stack of two gels, as release, speed, thickness, cutting and noise change."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.benchmark import Job, Progress
from benchmarks.bounds import CUTTING_FRACTION, delay_bounds_s, friction_bounds, reading_error_N
from benchmarks.methods import force_lag_s
from benchmarks.signals import InsertionTruth, insertion_truth
from benchmarks.simulated import read_sensors, session_signal
from benchmarks.tables import ResultTable
from groundtruth import SCENARIOS, Scenario, insert_needle, simulate
from groundtruth.force_noise import MINI45
from groundtruth.motion import constant_motion

Array = NDArray[np.float64]

GEL = SCENARIOS["gel-50-constant"].layers[0]
"""The published middle gel: 0.75 N at the tip, 17 N/m of friction at 2.3 mm/s."""
MIDDLE = {"release_m": 0.3e-3, "speed_m_s": 3e-3, "thickness_m": 25e-3}
CUTTING = "cutting_fraction"
CHANGES: dict[str, tuple[str, float, str, tuple[float, ...]]] = {
    "release_m": ("release", 1e3, "mm", (0.1e-3, 0.3e-3, 0.5e-3, 2e-3)),
    "speed_m_s": ("speed", 1e3, "mm/s", (2e-3, 3e-3, 6e-3)),
    "thickness_m": ("thickness", 1e3, "mm", (10e-3, 25e-3, 40e-3)),
    CUTTING: ("cutting up to", 1e2, "%", (0.0, CUTTING_FRACTION, 1.0)),
}
"""One at a time, with words, scale and unit; 2 mm is the longest release of real liver. Cutting is
the root mean square fraction of the tip force that the estimator knows of."""
BEYOND_m, STANDOFF_m = 11e-3, 5e-3
RUN = Job(benchmark="stack-constant", plant="clean", seed=0)
"""The insertion from which the noise of the virtual force is taken."""
WHITE_SAMPLES = 20_000
CAPTION = (
    "Release 0.3 mm, 3 mm/s, 25 mm, about 12 % of the tip force cutting, unless changed. Friction: "
    "standard deviation 3 mm after the rupture. Delay: mean, with one false alarm an hour."
)


class ForceNoiseSeries(NamedTuple):
    """Noise of one source."""

    name: str  # for people
    error_N: Array  # a stretch of it, a millisecond per sample, shape (m,)
    is_white: bool  # whether it is to be taken as white
    lag_s: float  # time constant of the source


def bound_noises(progress: Progress) -> list[ForceNoiseSeries]:
    """Noise of the F/T sensor, and of the virtual force with its own and with a white spectrum."""
    rng = np.random.default_rng(0)
    ft = MINI45.white_std_N * rng.standard_normal(WHITE_SAMPLES)
    case = read_sensors(simulate(RUN.benchmark, RUN.plant, RUN.seed), progress)
    truth = insertion_truth(case.run)
    signal = session_signal(case, "default", case.sessions["default"].reading)
    lag_s = max(force_lag_s(truth.t_s, signal.force_N, truth.axial_N), 0.0)
    error = reading_error_N(signal, truth, lag_s)
    return [
        ForceNoiseSeries("F/T, white", ft, is_white=True, lag_s=0.0),
        ForceNoiseSeries("virtual, for white noise", error, is_white=True, lag_s=lag_s),
        ForceNoiseSeries("virtual, own spectrum", error, is_white=False, lag_s=lag_s),
    ]


Bounds = tuple[float, float]
"""Least deviation of the friction of the second layer [%], least delay of its rupture [ms]."""


def bound_cases(noises: Sequence[ForceNoiseSeries]) -> dict[str, list[Bounds]]:
    """Bounds for every noise, by what is not as in `MIDDLE`, in words."""
    found: dict[str, list[Bounds]] = {}
    for changed, (word, scale, unit, values) in CHANGES.items():
        for value in values:
            is_cutting = changed == CUTTING
            truth = _truth(**(MIDDLE if is_cutting else MIDDLE | {changed: value}))
            cutting = value if is_cutting else CUTTING_FRACTION
            line = f"{word} {scale * value:g} {unit}"
            found[line] = [_bounds(truth, noise, cutting) for noise in noises]
    return found


def _bounds(truth: InsertionTruth, noise: ForceNoiseSeries, cutting_fraction: float) -> Bounds:
    friction = friction_bounds(
        truth, noise.error_N, is_white=noise.is_white, cutting_fraction=cutting_fraction
    )
    error = noise.error_N
    if noise.is_white:
        rng = np.random.default_rng(0)
        error = float(np.std(error)) * rng.standard_normal(len(error))
    delay = delay_bounds_s(truth, truth.ruptures[-1:], error, noise.lag_s)
    return 100.0 * friction[-1], 1e3 * delay[0]


def _truth(*, release_m: float, speed_m_s: float, thickness_m: float) -> InsertionTruth:
    layer = replace(GEL, release_m=release_m, thickness_m=thickness_m)
    depth = 2.0 * thickness_m + BEYOND_m
    motion = constant_motion(speed_m_s=speed_m_s, depth_m=depth, standoff_m=STANDOFF_m)
    stack = Scenario(id="bound", title="two equal gels", layers=(layer, layer), motion=motion)
    return insertion_truth(insert_needle(stack, noise="clean"))


def case_table(cases: dict[str, list[Bounds]], noises: Sequence[ForceNoiseSeries]) -> ResultTable:
    """One line per stack, a pair of columns per noise."""
    heads = ["changed"]
    for noise in noises:
        size = f"{1e3 * float(np.std(noise.error_N)):.0f} mN"
        heads += [f"{noise.name}\n{size}\nfriction, %", "\n\ndelay, ms"]
    return ResultTable(
        title="Bounds for the lower of two equal gels",
        heads=tuple(heads),
        align="L" + (len(heads) - 1) * "r",
        lines=tuple(
            (line, *(cell for one in found for cell in (f"{one[0]:.2f}", f"{one[1]:.1f}")))
            for line, found in cases.items()
        ),
        caption=CAPTION,
    )
