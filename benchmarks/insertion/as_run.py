"""The published method as its authors ran it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.insertion.matching import match
from benchmarks.insertion.methods import Identified, identify
from benchmarks.insertion.signals import InsertionTruth, NeedleSignal
from benchmarks.results import Method
from identification import PUBLISHED, PublishedConfig

SIGMA1_N = (0.03, 0.05, 0.08, 0.15)
"""Its authors set σ₁ for each recording: 0.08 N in the text, 0.03 to 0.15 N in their
settings."""


def identify_as_run(
    signal: NeedleSignal,
    truth: InsertionTruth,
    commanded_m_s: NDArray[np.float64],
    method: Method = "published-as-authors-ran",
    config: PublishedConfig = PUBLISHED,
) -> Identified:
    """Run the published method as its authors did: commanded speed and the best σ₁.

    The commanded speed has shape (n,). Best is the one with most ruptures found less
    false alarms, which they saw in the force.
    """
    quiet = replace(signal, speed_m_s=commanded_m_s)
    tried = [
        identify(quiet, truth, method, replace(config, sigma1_N=sigma1_N))
        for sigma1_N in SIGMA1_N
    ]

    def merit(item: Identified) -> int:
        matching = match(truth.ruptures, item.alarms)
        return len(matching.found) - len(matching.false)

    return max(tried, key=merit)
