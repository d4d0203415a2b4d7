"""The axial force sensor at the needle base: what it adds to the true force."""

from dataclasses import asdict, dataclass

import numpy as np
from scipy.signal import lfilter

from groundtruth.errors import Array, RunError, require_non_negative


def coloured(white: Array, period_s: float, correlation_s: float) -> Array:
    """Stationary noise of unit spread and that correlation time from white noise, row by row."""
    if correlation_s == 0.0:
        return white
    kept = np.exp(-period_s / correlation_s)
    entering = np.sqrt(1.0 - kept * kept) * white
    entering[0] = white[0]  # as if it had gone on for ever before
    return np.asarray(lfilter([1.0], [1.0, -kept], entering, axis=0))


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceNoise:
    """Noise, drift since the last zeroing, and steps of the reading; zero switches off."""

    white_std_N: float  # standard deviation of the noise of one sample
    drift_std_N_per_s: float  # standard deviation of the drift rate, drawn once per run
    step_N: float  # smallest step of the reading
    correlation_s: float = 0.0  # time constant of the noise if it is not white

    def __post_init__(self) -> None:
        """Raise `RunError` naming the value that is negative or not finite."""
        require_non_negative(RunError, **asdict(self))

    def reading_N(
        self, force_N: Array, t_s: Array, zeroed_s: float, rng: np.random.Generator
    ) -> Array:
        """The reading of a true force at some times, all of shape (n,); read-only.

        The sensor was last zeroed at `zeroed_s`: the drift passes through zero there.
        """
        white = rng.standard_normal(force_N.shape)
        period_s = float(np.median(np.diff(t_s))) if t_s.size > 1 else 1.0
        noise = self.white_std_N * coloured(white, period_s, self.correlation_s)
        drift = self.drift_std_N_per_s * rng.standard_normal() * (t_s - zeroed_s)
        reading = force_N + noise + drift
        if self.step_N > 0.0:
            reading = np.round(reading / self.step_N) * self.step_N
        reading.setflags(write=False)
        return reading


CLEAN = ForceNoise(white_std_N=0.0, drift_std_N_per_s=0.0, step_N=0.0)  # a perfect sensor

MINI45 = ForceNoise(white_std_N=0.01, drift_std_N_per_s=1.5e-4, step_N=1.0 / 256.0)
"""ATI Mini45 SI-145-5 along z, read at 1 kHz as a driver delivers it: averaged.

White: one raw sample at 2 kHz has 0.05 N, the mean over 0.1 s still 0.0155 N (coloured noise). The
paper found 0.01 N on this sensor (its σ₀), and the liver recordings have 0.007 N above 20 Hz.
Drift: warmed up, 0.055 N between minute 4 and minute 10 after switching on. Step: the converter's
1/16 N, averaged over 16 samples that the raw noise dithers.
"""
