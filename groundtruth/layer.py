"""One homogeneous layer of tissue, as a description without state."""

from dataclasses import dataclass

from groundtruth.checks import require_non_negative, require_positive
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
        stiffness_N_per_m: Slope of the elastic tip force at the start of the layer (K_i).
        stiffening: How much steeper the chord is at the end: 0.1 adds 10 %.
        cutting_N: Constant cutting force at the tip while it advances.
        release_m: Travel of the tip over which the tip force is released when it leaves the layer.
        friction: Friction of the layer on the shaft.
        membrane: What must be punctured to enter the layer, if anything.
    """

    name: str
    thickness_m: float
    stiffness_N_per_m: float
    stiffening: float = 0.0
    cutting_N: float = 0.0
    release_m: float
    friction: ShaftFriction
    membrane: Membrane | None = None

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            TissueError: A figure is not physical, or the layer is too thin for its membrane's
                indentation, its cutting onset and the releases at both its ends.
        """
        require_positive(TissueError, thickness_m=self.thickness_m, release_m=self.release_m)
        require_non_negative(
            TissueError,
            stiffness_N_per_m=self.stiffness_N_per_m,
            stiffening=self.stiffening,
            cutting_N=self.cutting_N,
        )
        taken = self.entry_m + CUTTING_ONSET_M + self.release_m
        if self.membrane is not None:
            taken += self.membrane.release_m
        if self.thickness_m <= taken:
            raise TissueError(
                f"layer {self.name!r} is {self.thickness_m} m thick, but indentation, cutting "
                f"onset and release take {taken:.4g} m: make it thicker"
            )

    @classmethod
    def ending_at(
        cls,
        exit_force_N: float,
        *,
        name: str,
        thickness_m: float,
        cutting_share: float,
        stiffening: float,
        release_m: float,
        friction: ShaftFriction,
        membrane: Membrane | None = None,
    ) -> "Layer":
        """The layer whose tip force at its far end is a given one.

        Args:
            exit_force_N: That force.
            cutting_share: Share of it, 0 to 1, that is cutting force; the rest is elastic.
            name: See the class, as for all that follow.
            thickness_m: See the class.
            stiffening: See the class.
            release_m: See the class.
            friction: See the class.
            membrane: See the class.

        Raises:
            TissueError: The share is outside 0 to 1, or a figure is not physical.
        """
        if not 0.0 <= cutting_share <= 1.0:
            raise TissueError(f"cutting_share is {cutting_share!r}; give a share from 0 to 1")
        cut_m = thickness_m - (0.0 if membrane is None else membrane.indentation_m)
        chord_m = cut_m * (1.0 + stiffening * cut_m / thickness_m)
        return cls(
            name=name,
            thickness_m=thickness_m,
            stiffness_N_per_m=(1.0 - cutting_share) * exit_force_N / chord_m,
            stiffening=stiffening,
            cutting_N=cutting_share * exit_force_N,
            release_m=release_m,
            friction=friction,
            membrane=membrane,
        )

    @property
    def entry_m(self) -> float:
        """Depth into the layer at which the tip begins to cut it: the membrane's indentation."""
        return 0.0 if self.membrane is None else self.membrane.indentation_m

    def tip_force_N(self, penetration_m: float) -> float:
        """Elastic and cutting force at the tip of an advancing needle.

        Args:
            penetration_m: Travel of the tip since it began to cut this layer.
        """
        if penetration_m <= 0.0:
            return 0.0
        elastic = self.stiffness_N_per_m * penetration_m
        elastic *= 1.0 + self.stiffening * penetration_m / self.thickness_m
        onset = min(penetration_m / CUTTING_ONSET_M, 1.0)
        return elastic + self.cutting_N * onset * (2.0 - onset)

    @property
    def exit_force_N(self) -> float:
        """Tip force at the far end of the layer, just before it gives way."""
        return self.tip_force_N(self.thickness_m - self.entry_m)

    @property
    def textbook_stiffness_N_per_m(self) -> float:
        """The K of equation (3) that ends the layer with the same tip force."""
        return self.exit_force_N / self.thickness_m
