"""The noise of a force reading as a stationary process, measured where nothing ruptures."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.signals.needle_signal import NeedleSignal

Array = NDArray[np.float64]

AROUND_s = 0.15
"""Left out from the onset of a release to so long after its end: there a lag looks like noise."""
_FLOOR = 1e-6


def reading_error_N(signal: NeedleSignal, truth: InsertionTruth, lag_s: float = 0.0) -> Array:
    """Reading less true force over the insertion, straight lines across the releases.

    Args:
        signal: The reading.
        truth: Of the run.
        lag_s: Time constant of the sensor: the truth goes through it before it is taken off.

    Returns:
        Error at the samples of `truth.is_insertion`, shape (m,).
    """
    inside = truth.is_insertion
    error = (signal.force_N - lagging(truth.axial_N, truth.t_s, lag_s))[inside]
    t_s = truth.t_s[inside]
    quiet = np.ones(len(t_s), dtype=bool)
    for rupture in truth.ruptures:
        quiet &= (t_s < rupture.onset_s) | (t_s > rupture.end_s + AROUND_s)
    return np.interp(t_s, t_s[quiet], error[quiet])


def lagging(values: Array, t_s: Array, lag_s: float) -> Array:
    """Values behind a first-order lag, sampled evenly, shape (n,)."""
    if lag_s <= 0.0:
        return values

    keep = float(np.exp(-np.median(np.diff(t_s)) / lag_s))
    found, _ = lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])
    return np.asarray(found, dtype=np.float64)


def autocovariance(error_N: Array, length: int) -> Array:
    """Autocovariance about zero at lags 0 to length - 1 [N^2].

    The biased estimate: it is positive definite, and about zero because a force is judged against
    its free-air zero, so that a constant error is an error.

    Args:
        error_N: Shape (m,).
        length: Number of lags; those the data do not reach are 0.
    """
    count = len(error_N)
    spectrum = np.abs(np.fft.rfft(error_N, 2 * count)) ** 2
    lags = np.fft.irfft(spectrum)[: min(length, count)] / count
    return np.concatenate((lags, np.zeros(length - len(lags))))


def whitener(covariance: Array) -> Array:
    """Lower factor L of L L' = C for the Toeplitz matrix C of an autocovariance, shape (n, n)."""
    matrix = toeplitz(covariance) + _FLOOR * covariance[0] * np.eye(len(covariance))
    return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
