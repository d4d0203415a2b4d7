"""Re-run of RLS with covariance resetting over a whole layer (Section III-B), window by window.

A window maps the estimate linearly, theta_k = A_k theta_{k-1} + c_k. Between two resets RLS with
lambda = 1 is a regularised least squares, theta = (Psi_0^-1 + S)^-1 (Psi_0^-1 theta_prev + b) with
S = sum phi phi' and b = sum phi f: a re-run over the layer needs S and b of each window, not its
samples.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.jit import Matrix, compiled


class WindowSums(NamedTuple):
    """Sums over the samples between two covariance resets.

    Attributes:
        kk: Sum of phi_K^2.
        kb: Sum of phi_K phi_B.
        bb: Sum of phi_B^2.
        kf: Sum of phi_K f.
        bf: Sum of phi_B f.
        kv: Sum of phi_K v.
        bv: Sum of phi_B v; with `kv` it allows a later change of the cumulative friction.
    """

    kk: float = 0.0
    kb: float = 0.0
    bb: float = 0.0
    kf: float = 0.0
    bf: float = 0.0
    kv: float = 0.0
    bv: float = 0.0


def less_viscous_force(sums: WindowSums, damping_Ns_per_m: float) -> WindowSums:
    """Sums as if `damping_Ns_per_m * v` had been subtracted from every force sample."""
    return sums._replace(
        kf=sums.kf - damping_Ns_per_m * sums.kv, bf=sums.bf - damping_Ns_per_m * sums.bv
    )


def window_step(
    theta: tuple[float, float], sums: WindowSums, variances: tuple[float, float]
) -> tuple[float, float]:
    """Estimate after one window that began with covariance diag(variances) at `theta`.

    Written as theta + Psi_0 (I + S Psi_0)^-1 (b - S theta): no inverse of Psi_0 or S is needed,
    so collinear columns and zero variances are harmless.
    """
    k, b = theta
    p, q = variances
    rk = sums.kf - sums.kk * k - sums.kb * b
    rb = sums.bf - sums.kb * k - sums.bb * b
    m11, m12 = 1.0 + sums.kk * p, sums.kb * q
    m21, m22 = sums.kb * p, 1.0 + sums.bb * q
    excitation = max(sums.kk * sums.bb - sums.kb * sums.kb, 0.0)
    determinant = 1.0 + sums.kk * p + sums.bb * q + p * q * excitation
    return (
        k + p * (m22 * rk - m12 * rb) / determinant,
        b + q * (m11 * rb - m21 * rk) / determinant,
    )


_CHUNK = 16
_KF, _BF, _KV, _BV = (WindowSums._fields.index(name) for name in ("kf", "bf", "kv", "bv"))


class WindowHistory(NamedTuple):
    """Windows in order of time; immutable, and appending copies only what is recent.

    Attributes:
        chunks: Older windows, one row each: the fields of `WindowSums`; shape (m, 7).
        recent: The newest ones.
    """

    chunks: tuple[NDArray[np.float64], ...] = ()
    recent: tuple[WindowSums, ...] = ()


def append_window(history: WindowHistory, sums: WindowSums, most: int) -> WindowHistory:
    """Add a closed window; beyond ``most`` neighbours are added up, see `add_neighbours`."""
    recent = (*history.recent, sums)
    if len(recent) < _CHUNK:
        return WindowHistory(history.chunks, recent)
    chunks = (*history.chunks, _frozen(np.array(recent)))
    if sum(map(len, chunks)) > most:
        chunks = (_frozen(add_neighbours(np.concatenate(chunks))),)
    return WindowHistory(chunks)


def window_rows(history: WindowHistory) -> NDArray[np.float64]:
    """All windows, one row each, shape (m, 7); not to be written to."""
    if len(history.chunks) == 1 and not history.recent:
        return history.chunks[0]
    parts = [*history.chunks, np.array(history.recent).reshape(-1, len(WindowSums._fields))]
    return np.concatenate(parts)


def joined(history: WindowHistory) -> WindowHistory:
    """The same windows in one piece, field by field: what a later re-run need not do."""
    rows = np.asfortranarray(window_rows(history))
    return WindowHistory((_frozen(rows),) if len(rows) else ())


def add_neighbours(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Halve the number of windows by adding neighbours: bounds memory in an endless layer.

    The re-run then resets half as often over that stretch; an odd last window stays alone.
    """
    even = len(rows) // 2 * 2
    return np.concatenate((rows[0:even:2] + rows[1:even:2], rows[even:]))


def less_viscous_rows(history: WindowHistory, damping_Ns_per_m: float) -> WindowHistory:
    """Windows as if ``damping_Ns_per_m * v`` had been subtracted from every force sample."""
    rows = np.array(window_rows(history), order="F")
    rows[:, _KF] -= damping_Ns_per_m * rows[:, _KV]
    rows[:, _BF] -= damping_Ns_per_m * rows[:, _BV]
    return WindowHistory((_frozen(rows),) if len(rows) else ())


def _frozen(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    rows.setflags(write=False)
    return rows


Pair = tuple[float, float]


def rerun_history(history: WindowHistory, variances: Pair, theta: Pair = (0.0, 0.0)) -> Pair:
    """Estimate at the end of a layer.

    Args:
        history: Windows of the layer.
        variances: Diagonal of the (re-weighted) Psi_0, restored at each window's start.
        theta: Estimate at the start of the layer.

    Returns:
        (K, B), the same as the sample-by-sample re-run up to rounding.
    """
    return follow_windows(np.ascontiguousarray(window_rows(history).T), variances, theta)


@compiled
def follow_windows(columns: Matrix, variances: Pair, theta: Pair) -> Pair:
    """The estimate after all windows, one after the other: `window_step` written as A and c.

    Args:
        columns: The fields of `WindowSums`, shape (7, m).
        variances: See `rerun_history`.
        theta: Estimate before them.
    """
    k, b = theta
    p, q = variances
    for i in range(columns.shape[1]):
        kk, kb, bb, kf, bf = (
            columns[0, i],
            columns[1, i],
            columns[2, i],
            columns[3, i],
            columns[4, i],
        )
        pb, qb = p * kb, q * kb
        first, second = 1.0 + q * bb, 1.0 + p * kk
        excitation = max(kk * bb - kb * kb, 0.0)
        scale = 1.0 / (second + q * bb + (p * q) * excitation)
        own_k, own_b = p * (first * kf - qb * bf) * scale, q * (second * bf - pb * kf) * scale
        k, b = (
            own_k + first * scale * k - pb * scale * b,
            own_b - qb * scale * k + second * scale * b,
        )
    return float(k), float(b)
