"""What a tissue law answers at each step, and what every law offers."""

from typing import NamedTuple, Protocol

from groundtruth.interface import Interface
from groundtruth.layer import Layer


class TissueForce(NamedTuple):
    """Force of the tissue on the needle, along its axis.

    A named tuple, not a dataclass: it is made at every physics step.

    Attributes:
        axial_N: Tip force and shaft friction together, positive when tissue pushes back.
        tip_N: Elastic, membrane and cutting force at the tip; never negative.
        friction_N: Friction along the whole shaft; it opposes motion, negative on the way out.
        layer: 0 above the surface (or before its membrane is punctured), i with the tip in layer
            i, number of layers + 1 beyond the last.
        layer_friction_N: The share of each layer in `friction_N`.
    """

    axial_N: float
    tip_N: float
    friction_N: float
    layer: int
    layer_friction_N: tuple[float, ...]


class TissueLaw(Protocol):
    """A law of tissue: depth and speed of the tip in, force out."""

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers, first the one the needle meets first."""
        ...

    @property
    def interfaces(self) -> tuple[Interface, ...]:
        """The boundaries, from the surface to the exit, as this law has them give way."""
        ...

    def step(self, depth_m: float, speed_m_s: float, dt_s: float) -> TissueForce:
        """Advance by one step and return the force at its end."""
        ...

    def reset(self) -> None:
        """Forget everything: a fresh, uncut tissue."""
        ...


def no_force(layer_count: int) -> TissueForce:
    """The force on a needle in free air."""
    return TissueForce(0.0, 0.0, 0.0, 0, (0.0,) * layer_count)
