"""Whitens one joint's residuals, whose noise is correlated along its position.

Noise of two blocks at positions q and q' has the covariance

    w [same block] + v exp(-((q - q') / l)^2 / 2)

with white noise w and a sensor's waviness v of the correlation length l. Its Cholesky
root is computed panel by panel, and used so: each panel is a short step.
"""

import numpy as np
from scipy.linalg import solve_triangular

from foundation.arrays import Array
from foundation.steps import Steps

PANEL = 32
"""Columns of a root that are computed in one step: 0.2 ms at 400 blocks."""

PANELS_PER_STEP = 3
"""Panels of a root that are solved with in one step."""


class NoiseRoot:
    """Cholesky root of the covariance of one joint's noise over m blocks.

    Args:
        white_Nm2: Variance of the white noise.
        wave_Nm2: Variance of the waviness; 0 for none.
        q_rad: Position of the joint at every block, shape (m,).
        wave_rad: Correlation length.
    """

    def __init__(
        self, white_Nm2: float, wave_Nm2: float, q_rad: Array, wave_rad: float
    ) -> None:
        self._white_Nm2 = white_Nm2
        self._wave_Nm2 = wave_Nm2
        self._position = q_rad / wave_rad
        self._panels = [
            slice(start, min(start + PANEL, len(q_rad)))
            for start in range(0, len(q_rad), PANEL)
        ]
        self._root = np.zeros((0, 0))

    def compute(self) -> Steps[None]:
        """Compute the root; before that only white noise is whitened."""
        if self._wave_Nm2 == 0.0:
            return
        position = self._position
        root = np.zeros((len(position), len(position)))
        for panel in self._panels:
            width = panel.stop - panel.start
            distance = position[panel.start :, None] - position[panel]
            covariance = self._wave_Nm2 * np.exp(-0.5 * distance**2)
            covariance[np.arange(width), np.arange(width)] += self._white_Nm2
            done = root[panel.start :, : panel.start]
            covariance -= done @ done[:width].T
            corner = np.linalg.cholesky(covariance[:width]).astype(float)
            root[panel, panel] = corner
            root[panel.stop :, panel] = _solve(corner, covariance[width:].T).T
            yield
        self._root = root

    def whiten(self, values: Array) -> Steps[Array]:
        """Return values with noise of unit covariance, shape (m, k) as they are."""
        if not len(self._root):
            return values / np.sqrt(self._white_Nm2)
        white = np.empty_like(values)
        for number, panel in enumerate(self._panels, 1):
            known = self._root[panel, : panel.start] @ white[: panel.start]
            white[panel] = _solve(self._root[panel, panel], values[panel] - known)
            if number % PANELS_PER_STEP == 0:
                yield
        return white


def invert_covariance(matrix: Array) -> Steps[Array]:
    """Return the inverse of a symmetric positive definite matrix, shape (m, m)."""
    size = len(matrix)
    root = np.linalg.cholesky(matrix).astype(float)
    yield
    inverse_root = np.zeros((size, size))
    parts = np.array_split(np.arange(size), max(1, -(-size // (2 * PANEL))))
    for part in parts:
        # The inverse of a lower triangle is one.
        first = part[0]
        units = np.eye(size - first, len(part))
        inverse_root[first:, part] = _solve(root[first:, first:], units)
        yield
    inverse = np.empty((size, size))
    for part in parts:
        first = part[0]
        inverse[part] = inverse_root[first:, part].T @ inverse_root[first:]
        yield
    return inverse


def _solve(root: Array, values: Array) -> Array:
    """Return the solution of a lower-triangular system."""
    return solve_triangular(root, values, lower=True, check_finite=False)
