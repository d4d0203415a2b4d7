"""Force of the current layer as a linear model, fitted with priors and without negative values.

Equation (3) with friction beyond viscous: f = s C + v V + F_c g(x) + K x + s c dz + v b dz, with
s the presliding deflection (1 when sliding inwards), C and V the Coulomb and viscous friction of
the layers traversed, F_c the cutting force building up over g, and K, c, b of the current layer.
dz is the length of shaft in the layer, x the travel of the tip in it: less than dz by what a
membrane was pushed in before its puncture.
Lengths are in millimetres in here, so that all six unknowns are of similar size.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

MM = 1e3
COULOMB, VISCOUS, CUTTING, STIFFNESS, OWN_COULOMB, OWN_VISCOUS = range(6)
_SIZE = 6
_TINY = 1e-12
_RIDGE = 1e-10 * np.eye(_SIZE)


class NormalEquations(NamedTuple):
    """Weighted normal equations: all that is known about the six unknowns.

    Attributes:
        matrix: Sum of w phi phi', shape (6, 6).
        vector: Sum of w phi f, shape (6,).
    """

    matrix: NDArray[np.float64]
    vector: NDArray[np.float64]


class Spread(NamedTuple):
    """Variances a report needs at every sample, as plain floats.

    Attributes:
        coulomb: Of C [N^2].
        both: Covariance of C and V.
        viscous: Of V.
        stiffness: Of K.
        own_coulomb: Of c.
        own_both: Covariance of c and b.
        own_viscous: Of b.
    """

    coulomb: float
    both: float
    viscous: float
    stiffness: float
    own_coulomb: float
    own_both: float
    own_viscous: float


class LayerFit(NamedTuple):
    """Solution of the normal equations.

    Attributes:
        values: (C [N], V [N/(mm/s)], F_c [N], K [N/mm], c [N/mm], b [N/(mm mm/s)]), none negative.
        covariance: Of the unconstrained solution, shape (6, 6).
        spread: The variances of use at every sample.
    """

    values: tuple[float, ...]
    covariance: NDArray[np.float64]
    spread: Spread


def layer_fit(values: NDArray[np.float64], covariance: NDArray[np.float64]) -> LayerFit:
    """Pack a solution; plain floats keep the per-sample report fast."""
    rows = covariance.tolist()
    spread = Spread(
        rows[0][0], rows[0][1], rows[1][1], rows[3][3], rows[4][4], rows[4][5], rows[5][5]
    )
    return LayerFit(tuple(values.tolist()), covariance, spread)


def no_information() -> NormalEquations:
    """Nothing known."""
    return NormalEquations(np.zeros((_SIZE, _SIZE)), np.zeros(_SIZE))


def cutting_onset(layer_depth_m: float, onset_m: float) -> float:
    """Share of the cutting force reached at `layer_depth_m`: parabola to 1 at `onset_m`."""
    reach = min(max(layer_depth_m / onset_m, 0.0), 1.0)
    return reach * (2.0 - reach)


def model_row(
    layer_depth_m: float, tip_depth_m: float, speed_m_s: float, bristle: float, onset_m: float
) -> NDArray[np.float64]:
    """Regressor phi, shape (6,)."""
    depth, speed = MM * max(layer_depth_m, 0.0), MM * speed_m_s
    tip, onset = MM * max(tip_depth_m, 0.0), cutting_onset(tip_depth_m, onset_m)
    return np.array([bristle, speed, onset, tip, depth * bristle, depth * speed])


def add_row(
    information: NormalEquations, row: NDArray[np.float64], value: float, variance: float
) -> NormalEquations:
    """Add a measurement row @ x = value with the given variance."""
    weighted = row / max(variance, _TINY)
    return NormalEquations(
        information.matrix + weighted[:, None] * row, information.vector + weighted * value
    )


def solve_layer(information: NormalEquations) -> LayerFit:
    """Most likely non-negative values, and the covariance of the unconstrained ones."""
    matrix = information.matrix
    scale = 1.0 / np.sqrt(np.maximum(matrix.diagonal(), _TINY))
    both = scale[:, None] * scale
    scaled = matrix * both + _RIDGE
    factor = np.linalg.cholesky(scaled)
    target = np.linalg.solve(factor, information.vector * scale)
    values, _ = nnls(factor.T, target)
    inverse = np.linalg.inv(factor)
    return layer_fit(values * scale, (inverse.T @ inverse) * both)
