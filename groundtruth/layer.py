"""One homogeneous layer of tissue, as a description without state."""

from dataclasses import dataclass

from groundtruth.checks import require_non_negative, require_positive, require_share
from groundtruth.errors import TissueError
from groundtruth.friction import ShaftFriction
from groundtruth.membrane import Membrane

CUTTING_ONSET_M = 1e-3
"""Penetration over which the cutting force builds up: about one needle diameter (18G 1.27 mm)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """What a needle meets between two ruptures.

    Attributes:
        name: For tables and legends.
        thickness_m: d_i of the paper.
        exit_force_N: Tip force at the far end of the layer, at which it gives way there.
        cutting_share: Share of it that is a constant cutting force; the rest is elastic and grows
            with the penetration.
        stiffening: How much steeper the chord of the elastic part is at the end than the slope at
            the start: 0.1 means 10 %.
        release_m: Travel of the tip over which the tip force is released when it leaves the layer.
        relaxed_share: Share of the tip force and of the Coulomb friction lost after a long rest.
        friction: Friction of the layer on the shaft.
        membrane: What must be punctured to enter the layer, if anything.
    """

    name: str
    thickness_m: float
    exit_force_N: float
    cutting_share: float
    stiffening: float
    release_m: float
    relaxed_share: float
    friction: ShaftFriction
    membrane: Membrane | None = None

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            TissueError: A figure is not physical, or the layer is too thin for its membrane's
                indentation, its cutting onset and the releases at both its ends.
        """
        require_positive(
            TissueError,
            thickness_m=self.thickness_m,
            exit_force_N=self.exit_force_N,
            release_m=self.release_m,
        )
        require_non_negative(TissueError, stiffening=self.stiffening)
        require_share(
            TissueError, cutting_share=self.cutting_share, relaxed_share=self.relaxed_share
        )
        taken = self.entry_m + CUTTING_ONSET_M + self.release_m
        if self.membrane is not None:
            taken += self.membrane.release_m
        if self.thickness_m <= taken:
            raise TissueError(
                f"layer {self.name!r} is {self.thickness_m} m thick, but indentation, cutting "
                f"onset and release take {taken:.4g} m: make it thicker"
            )

    @property
    def entry_m(self) -> float:
        """Depth into the layer at which the tip begins to cut it: the membrane's indentation."""
        return 0.0 if self.membrane is None else self.membrane.indentation_m

    def tip_force_N(self, penetration_m: float) -> float:
        """Elastic and cutting force at the tip of an advancing needle, tissue not relaxed.

        Args:
            penetration_m: Travel of the tip since it began to cut this layer.
        """
        if penetration_m <= 0.0:
            return 0.0
        p = penetration_m / (self.thickness_m - self.entry_m)
        elastic = p * (1.0 + self.stiffening * p) / (1.0 + self.stiffening)
        onset = min(penetration_m / CUTTING_ONSET_M, 1.0)
        cutting = onset * (2.0 - onset)
        c = self.cutting_share
        return self.exit_force_N * ((1.0 - c) * elastic + c * cutting)

    @property
    def stiffness_N_per_m(self) -> float:
        """The K of equation (3) that ends the layer with the same tip force."""
        return self.exit_force_N / self.thickness_m
