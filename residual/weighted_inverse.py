"""Equation (13), weighted: a wrench from joint torques, with its covariance (pure functions)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.wrench_estimate import MOST_CONDITIONING, UNSEEN_STD


class WeightedSolution(NamedTuple):
    """Solution of ``torque = map' x`` for x.

    Attributes:
        value: x, shape (k,).
        covariance: Of x, shape (k, k); `UNSEEN_STD` squared on the diagonal where x cannot be seen.
        conditioning: Ratio of the largest to the smallest standard deviation over directions.
        damping_share: Share of each true component that damping removes, shape (k,).
    """

    value: NDArray[np.float64]
    covariance: NDArray[np.float64]
    conditioning: float
    damping_share: NDArray[np.float64]


def weighted_inverse(
    jacobian: NDArray[np.float64],
    torque: NDArray[np.float64],
    error_covariance: NDArray[np.float64],
    *,
    precision: NDArray[np.float64] | None = None,
    damping: NDArray[np.float64] | None = None,
) -> WeightedSolution:
    """Solve ``torque = J' x + error`` by weighted least squares; the paper's (13) generalised.

    ``x = (J W J' + D)^-1 J W torque``. With W the inverse covariance of the error this is the best
    linear estimate; W = 1 and D = 0 give the pseudo-inverse (J')# of equation (13). D is the
    inverse variance of what x is expected to be: it matters only where the joints cannot see x,
    there it draws the answer to zero, and the share that it removes is reported.

    Args:
        jacobian: J, shape (k, n), rows are directions of x.
        torque: External joint torque [Nm], shape (n,).
        error_covariance: Of the error of that torque [Nm^2], shape (n, n).
        precision: W, shape (n, n); None for 1.
        damping: Diagonal of D, shape (k,); None for none.

    Returns:
        The solution with its covariance, conditioning and damping share.
    """
    weighted = jacobian if precision is None else jacobian.dot(precision)
    information = weighted.dot(jacobian.T)
    prior = np.zeros(len(information)) if damping is None else damping
    eigenvalues, vectors = np.linalg.eigh(information + np.diag(prior))
    # Directions below rounding of the largest are unseen: the pseudo-inverse leaves them at zero.
    seen = eigenvalues > eigenvalues[-1] * 1e-12
    inverse = (vectors[:, seen] / eigenvalues[seen]) @ vectors[:, seen].T
    gain = inverse.dot(weighted)
    covariance = gain.dot(error_covariance).dot(gain.T) + inverse * prior @ inverse
    if not seen.all():
        blind = (np.abs(vectors[:, ~seen]) > 1e-9).any(axis=1)
        covariance[blind, blind] = UNSEEN_STD**2
    own = np.linalg.eigvalsh(information)
    sightless = own[0] <= own[-1] / MOST_CONDITIONING**2
    return WeightedSolution(
        value=gain.dot(torque),
        covariance=covariance,
        conditioning=MOST_CONDITIONING if sightless else float(np.sqrt(own[-1] / own[0])),
        damping_share=np.diag(inverse) * prior,
    )
