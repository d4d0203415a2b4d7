"""How well an average of runs is known: bootstrap over their seeds."""

from typing import Any

import numpy as np
import pandas as pd

MIN_SEEDS = 5
"""With fewer, too few different samples can be drawn from them: then single runs are
drawn."""
RESAMPLES = 2000
INTERVAL_SEED = 0
"""Every interval is drawn anew from the seed: it depends on nothing but its own
runs."""
BATCH = 10**6
"""Numbers drawn at a time."""


def interval(
    values: Any, seeds: Any, rng: np.random.Generator, *, is_mean: bool
) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean or the median of runs.

    Percentile bootstrap (Efron 1979). Seeds are drawn, each with all its runs: what a
    seed draws, they have in common.

    Args:
        values: One per run, finite, shape (n,).
        seeds: Of the same runs.
        rng: Draws the samples.
        is_mean: Whether it is that of the mean.
    """
    labels = np.asarray(seeds)
    if len(np.unique(labels)) < MIN_SEEDS:
        labels = np.arange(len(labels))
    units = pd.Series(values).groupby(labels)
    place = units.cumcount().to_numpy()
    runs = np.full((units.ngroups, place.max() + 1), np.nan)
    runs[units.ngroup(), place] = values
    # Seeds may have different numbers of runs: what is missing is nan.
    average = np.nanmean if is_mean else np.nanmedian

    rows = min(max(BATCH // runs.size, 1), RESAMPLES)
    averages = []
    while len(averages) < RESAMPLES:
        drawn = runs[rng.integers(len(runs), size=(rows, len(runs)))]
        averages.extend(average(drawn.reshape(rows, -1), axis=1))
    low, high = np.percentile(averages[:RESAMPLES], (2.5, 97.5))
    return float(low), float(high)
