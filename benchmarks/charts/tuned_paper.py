"""The published method as its authors ran it, for the counterparts of their figures.

In the tables it runs as ours does: one setting for every recording, and the speed that the arm
measures. Its authors changed σ₁ between recordings (0.03 to 0.15 N), and its figures show a speed
without noise; with 0.12 mm/s of noise on 2.3 mm/s it takes noise for excitation, and on a force
that lags by 0.2 s its CUSUM never alarms at the 0.08 N of the text.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.identified import Identified, identify
from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.signals.needle_signal import NeedleSignal
from identification import PAPER, PaperConfig

SIGMA1_N = {"ft": 0.06, "virtual": 0.05}
"""By source: what finds the small fall of the 25 % gel, and the smeared ones of the residual."""
SIGMA1_OF_FIGURE_N = {"13": 0.04}
"""Where another is needed to find the ruptures that the paper's figure shows."""


def sigma1_N(figure: str, source: str) -> float:
    """The setting of a figure."""
    return SIGMA1_OF_FIGURE_N.get(figure, SIGMA1_N[source])


def tuned_paper(
    signal: NeedleSignal,
    truth: InsertionTruth,
    commanded_m_s: NDArray[np.float64],
    figure: str = "",
    config: PaperConfig = PAPER,
) -> Identified:
    """Run it with the commanded speed and the figure's own σ₁.

    Args:
        signal: What the benchmark gives the published method.
        truth: Of the run.
        commanded_m_s: Speed as the robot was told, shape (n,).
        figure: Of the paper; empty for none.
        config: `PAPER` or `PAPER_KV`.
    """
    quiet = replace(signal, speed_m_s=commanded_m_s)
    tuned = replace(config, sigma1_N=sigma1_N(figure, signal.source))
    return identify(quiet, truth, "paper", tuned)
