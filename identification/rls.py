"""State of the recursive least squares in two unknowns; `paper_tick.rls_step` advances it."""

from typing import NamedTuple


class RlsState(NamedTuple):
    """Estimate and covariance of a two-parameter recursive least squares.

    Attributes:
        stiffness: First parameter, K.
        friction: Second parameter, B.
        var_stiffness: Psi[0, 0].
        covariance: Psi[0, 1] = Psi[1, 0].
        var_friction: Psi[1, 1].
    """

    stiffness: float
    friction: float
    var_stiffness: float
    covariance: float
    var_friction: float


def reset_covariance(state: RlsState, var_stiffness: float, var_friction: float) -> RlsState:
    """Covariance resetting (Section III-A): Psi back to Psi_0, theta kept."""
    stiffness, friction = state.stiffness, state.friction
    return RlsState(stiffness, friction, float(var_stiffness), 0.0, float(var_friction))
