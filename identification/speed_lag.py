"""Learns how far the measured speed lags behind the depth, and takes the lag back.

A speed that went through a low-pass of time constant T obeys v = s + T ds/dt exactly, with s the
low-pass's output; so the depth less the integral of s is T s and a constant. Whenever the needle
changes its speed, T shows. A detector that does not know of the lag takes the friction lost while
the needle slows down for a rupture: force falls at once, the speed it is given later.
"""

from typing import NamedTuple

from identification.resampling import Block

_WINDOW_S = 0.1
_MEMORY = 0.998
"""Kept per window: a minute."""
_LEAST_WINDOWS = 5.0
_SIGNIFICANT = 4.0
_LEAST_S = 5e-3
_MOST_S = 0.25
"""A speed later than that is no speed of this needle."""


class Window(NamedTuple):
    """Means over a tenth of a second.

    Attributes:
        gap_m: Depth less the integral of the speed.
        speed_m_s: Speed.
    """

    gap_m: float
    speed_m_s: float


class Evidence(NamedTuple):
    """Sums over windows, from which the lag follows.

    Attributes:
        window: The newest window.
        cross: Sum of changes of gap times changes of speed.
        square: Sum of squared changes of speed.
        residual: Sum of squared changes of gap.
        windows: How many windows are in these sums.
    """

    window: Window | None = None
    cross: float = 0.0
    square: float = 0.0
    residual: float = 0.0
    windows: float = 0.0


NO_EVIDENCE = Evidence()


class SpeedLag(NamedTuple):
    """What is known of the lag.

    Attributes:
        lag_s: Time constant of the low-pass; 0 while none is significant.
        last: Newest block, lag and all; None at the start and after a gap.
        gap_m: Depth less the integral of the speed.
        gap_sum: Integral of the gap over the window being filled.
        speed_sum: Integral of the speed over it.
        time_s: Length of that window so far.
        evidence: Of the windows before.
    """

    lag_s: float = 0.0
    last: Block | None = None
    gap_m: float = 0.0
    gap_sum: float = 0.0
    speed_sum: float = 0.0
    time_s: float = 0.0
    evidence: Evidence = NO_EVIDENCE


def lag_step(state: SpeedLag, block: Block) -> tuple[SpeedLag, Block]:
    """Absorb one block and hand it back with the speed the needle had, not the one reported.

    Args:
        state: What is known.
        block: Newest block.
    """
    lag, last, gap, gap_sum, speed_sum, time, evidence = state
    if last is None:
        evidence = evidence._replace(window=None)
        return SpeedLag(lag, block, gap, evidence=evidence), block
    step, speed = block.dt_s, block.speed_m_s
    dt = 0.5 * (step + last.dt_s)
    gap += block.depth_m - last.depth_m - 0.5 * (speed + last.speed_m_s) * dt
    time += step
    gap_sum += gap * step
    speed_sum += speed * step
    if time >= _WINDOW_S:
        evidence = _add_window(evidence, Window(gap_sum / time, speed_sum / time))
        lag = _significant_lag(evidence)
        gap_sum = speed_sum = time = 0.0
    state = SpeedLag(lag, block, gap, gap_sum, speed_sum, time, evidence)
    if lag == 0.0:
        return state, block
    return state, block._replace(speed_m_s=speed + lag * (speed - last.speed_m_s) / dt)


def _add_window(known: Evidence, window: Window) -> Evidence:
    before = known.window
    if before is None:
        return known._replace(window=window)
    gap, speed = window.gap_m - before.gap_m, window.speed_m_s - before.speed_m_s
    return Evidence(
        window,
        _MEMORY * known.cross + gap * speed,
        _MEMORY * known.square + speed * speed,
        _MEMORY * known.residual + gap * gap,
        _MEMORY * known.windows + 1.0,
    )


def _significant_lag(known: Evidence) -> float:
    """Least-squares slope of gap over speed, if chance does not explain it."""
    if known.windows < _LEAST_WINDOWS or known.square <= 0.0:
        return 0.0
    lag = known.cross / known.square
    left = max(known.residual - lag * known.cross, 0.0) / (known.windows - 1.0)
    is_significant = lag > _LEAST_S and lag * lag * known.square > _SIGNIFICANT**2 * left
    return min(lag, _MOST_S) if is_significant else 0.0
