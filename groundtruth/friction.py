"""Shaft friction per unit of embedded length: Coulomb + viscous, with presliding."""

import math
from dataclasses import dataclass

from groundtruth.checks import require_non_negative, require_positive
from groundtruth.errors import TissueError


@dataclass(frozen=True, slots=True, kw_only=True)
class ShaftFriction:
    """Friction of one tissue on a needle shaft, per unit of embedded length.

    In steady sliding the force per length is `coulomb sign(v) + viscous v`. Around a reversal the
    tissue first moves along with the shaft: the Coulomb part builds up over `presliding_m`
    (Dahl's model).

    Attributes:
        coulomb_N_per_m: Part that does not depend on speed.
        viscous_Ns_per_m2: Part proportional to speed.
        presliding_m: Travel over which the Coulomb part closes 63 % of the way to its new value.
        reference_speed_m_s: Speed at which the friction was measured or calibrated.
    """

    coulomb_N_per_m: float
    viscous_Ns_per_m2: float
    presliding_m: float
    reference_speed_m_s: float

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            TissueError: A figure is negative, zero where it may not be, or not finite.
        """
        require_non_negative(
            TissueError,
            coulomb_N_per_m=self.coulomb_N_per_m,
            viscous_Ns_per_m2=self.viscous_Ns_per_m2,
        )
        require_positive(
            TissueError,
            presliding_m=self.presliding_m,
            reference_speed_m_s=self.reference_speed_m_s,
        )

    @classmethod
    def calibrated(
        cls,
        *,
        force_N_per_m: float,
        reference_speed_m_s: float,
        coulomb_share: float,
        presliding_m: float,
    ) -> "ShaftFriction":
        """Split a friction measured at one speed into its Coulomb and its viscous part.

        Args:
            force_N_per_m: Friction per length in steady sliding at the reference speed.
            reference_speed_m_s: That speed.
            coulomb_share: Share of it, 0 to 1, that does not depend on speed.
            presliding_m: See the class.

        Raises:
            TissueError: The share is outside 0 to 1, or a figure is not physical.
        """
        if not 0.0 <= coulomb_share <= 1.0:
            raise TissueError(f"coulomb_share is {coulomb_share!r}; give a share from 0 to 1")
        require_positive(TissueError, reference_speed_m_s=reference_speed_m_s)
        return cls(
            coulomb_N_per_m=coulomb_share * force_N_per_m,
            viscous_Ns_per_m2=(1.0 - coulomb_share) * force_N_per_m / reference_speed_m_s,
            presliding_m=presliding_m,
            reference_speed_m_s=reference_speed_m_s,
        )

    def sliding_N_per_m(self, speed_m_s: float) -> float:
        """Friction per length in steady sliding; it has the sign of the speed, zero at rest."""
        if speed_m_s == 0.0:
            return 0.0
        coulomb = math.copysign(self.coulomb_N_per_m, speed_m_s)
        return coulomb + self.viscous_Ns_per_m2 * speed_m_s

    @property
    def textbook_Ns_per_m2(self) -> float:
        """The B of equation (3) that gives the same friction at the reference speed."""
        return self.sliding_N_per_m(self.reference_speed_m_s) / self.reference_speed_m_s


def presliding_step(bristle: float, travel_m: float, presliding_m: float) -> float:
    """Advance the deflection of the shaft's bristles by one step of travel.

    Exact solution of Dahl's dw/dx = (sign(dx) - w) / presliding over the step: it cannot leave
    [-1, 1] and two half steps equal one, whatever the step (Dahl 1968, shape exponent 1).

    Args:
        bristle: Deflection before, -1 to 1; the Coulomb force is `coulomb * bristle`.
        travel_m: Signed travel of the shaft during the step; zero leaves the bristle as it is.
        presliding_m: Travel constant of the tissue.

    Returns:
        The deflection after the step.
    """
    if travel_m == 0.0:
        return bristle
    target = 1.0 if travel_m > 0.0 else -1.0
    return target + (bristle - target) * math.exp(-abs(travel_m) / presliding_m)
