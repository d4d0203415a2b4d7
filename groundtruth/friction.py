"""Shaft friction per unit of embedded length: Coulomb + viscous, with presliding."""

import math
from dataclasses import dataclass

from groundtruth.checks import require_non_negative, require_positive, require_share
from groundtruth.errors import TissueError


@dataclass(frozen=True, slots=True, kw_only=True)
class ShaftFriction:
    """Friction of one tissue on a needle shaft, per unit of embedded length.

    In steady sliding the force per length is `coulomb sign(v) + viscous v`. Around a reversal the
    tissue first moves along with the shaft: the Coulomb part builds up over `presliding_m`
    (Dahl's model, see `bristle_step`).

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
        require_share(TissueError, coulomb_share=coulomb_share)
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
