"""``python -m benchmarks bound``."""

import argparse

import numpy as np
from rich.table import Table

from benchmarks.benchmark import Job, Progress
from benchmarks.bounds import CUTTING, BoundCase, ForceNoiseSeries, bound_cases, reading_error_N
from benchmarks.commands.progress_bar import progress_bar
from benchmarks.force_metrics import force_lag_s
from benchmarks.signals import truth_of_run
from benchmarks.simulated import arm_signals, simulated_case
from benchmarks.tables import new_console
from groundtruth import scenario
from groundtruth.force_noise import MINI45

RUN = Job(benchmark="stack-constant", plant="clean", seed=0)
"""The insertion from which the noise of the virtual force is taken."""
WORDS = {
    "release_m": ("release", 1e3, "mm"),
    "speed_m_s": ("speed", 1e3, "mm/s"),
    "thickness_m": ("thickness", 1e3, "mm"),
    CUTTING: ("cutting up to", 1e2, "%"),
}
WHITE_SAMPLES = 20_000
CAPTION = (
    "Release 0.3 mm, 3 mm/s, 25 mm, about 12 % of the tip force cutting, unless changed. Friction: "
    "standard deviation 3 mm after the rupture. Delay: mean, with one false alarm an hour."
)


def execute(_arguments: argparse.Namespace) -> int:
    """Compute and print."""
    with progress_bar(1) as tell:
        noises = [_ft_noise(), *_virtual_noise(lambda share: tell(0, share))]
    new_console().print(case_table(list(bound_cases(noises)), noises))
    return 0


def case_table(cases: list[BoundCase], noises: list[ForceNoiseSeries]) -> Table:
    """One line per stack, a pair of columns per noise."""
    table = Table(title="Bounds for the lower of two equal gels", caption=CAPTION)
    table.add_column("changed", no_wrap=True)
    for noise in noises:
        size = f"{1e3 * float(np.std(noise.error_N)):.0f} mN"
        table.add_column(f"{noise.name}\n{size}\nfriction, %", justify="right")
        table.add_column("\n\ndelay, ms", justify="right")
    rows: dict[str, list[str]] = {}
    for case in cases:
        word, scale, unit = WORDS[case.changed]
        cells = rows.setdefault(f"{word} {scale * case.value:g} {unit}".strip(), [])
        cells += [f"{case.friction_pct:.2f}", f"{case.delay_ms:.1f}"]
    for head, cells in rows.items():
        table.add_row(head, *cells)
    return table


def _ft_noise() -> ForceNoiseSeries:
    rng = np.random.default_rng(0)
    error = MINI45.white_std_N * rng.standard_normal(WHITE_SAMPLES)
    return ForceNoiseSeries("F/T, white", error, is_white=True, lag_s=0.0)


def _virtual_noise(tell: Progress) -> list[ForceNoiseSeries]:
    """White as a comparison, and as it is."""
    case = simulated_case(RUN, scenario(RUN.benchmark), tell)
    truth = truth_of_run(case.run)
    (signal,) = (
        item["default"] for item in arm_signals(case) if item["default"].source == "virtual"
    )
    lag_s = max(force_lag_s(truth.t_s, signal.force_N, truth.axial_N), 0.0)
    error = reading_error_N(signal, truth, lag_s)
    return [
        ForceNoiseSeries("virtual, were it white", error, is_white=True, lag_s=lag_s),
        ForceNoiseSeries("virtual, as it is", error, is_white=False, lag_s=lag_s),
    ]
