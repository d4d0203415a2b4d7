"""A membrane (liver capsule, latex glove) on top of a layer: a spring up to its puncture."""

from dataclasses import dataclass

from groundtruth.checks import require_positive, require_share
from groundtruth.errors import TissueError


@dataclass(frozen=True, slots=True, kw_only=True)
class Membrane:
    """A membrane the needle pushes in until it is punctured.

    Its force is `puncture_N ((1 - hardening) u + hardening u²)`, u = indentation / indentation_m:
    the second-order spring of Okamura, Simone, O'Leary 2004 for the capsule of bovine liver.

    Attributes:
        puncture_N: Force at which it gives way.
        indentation_m: How far it has then been pushed in.
        hardening: Share of the quadratic part, 0 (linear) to 1.
        release_m: Travel of the tip over which the force is released after the puncture.
    """

    puncture_N: float
    indentation_m: float
    hardening: float
    release_m: float

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            TissueError: A figure is zero, negative or not finite, or hardening is not a share.
        """
        require_positive(
            TissueError,
            puncture_N=self.puncture_N,
            indentation_m=self.indentation_m,
            release_m=self.release_m,
        )
        require_share(TissueError, hardening=self.hardening)

    def force_N(self, indentation_m: float) -> float:
        """Force of the intact membrane, zero when it is not touched.

        Args:
            indentation_m: How far the tip is beyond the membrane's place at rest.
        """
        if indentation_m <= 0.0:
            return 0.0
        u = indentation_m / self.indentation_m
        return self.puncture_N * u * (1.0 + self.hardening * (u - 1.0))
