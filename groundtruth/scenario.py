"""A scenario: what is pierced, how the needle moves, and by which law the tissue answers."""

from dataclasses import dataclass, replace
from typing import Literal

from groundtruth.errors import ScenarioError
from groundtruth.layer import Layer
from groundtruth.motion import Motion
from groundtruth.textbook_tissue import TextbookTissue
from groundtruth.tissue import Tissue
from groundtruth.tissue_force import TissueLaw

LawName = Literal["tissue", "textbook"]
LAWS = {"tissue": Tissue, "textbook": TextbookTissue}


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """One insertion, ready to be simulated.

    Attributes:
        id: Permanent name.
        title: One line for people.
        layers: First the one the needle meets first; none for free motion.
        motion: Motion of the needle tip relative to the undeformed surface.
        law: `tissue` (realistic) or `textbook` (exactly equation 3).
    """

    id: str
    title: str
    layers: tuple[Layer, ...]
    motion: Motion
    law: LawName = "tissue"

    def __post_init__(self) -> None:
        """Check the law.

        Raises:
            ScenarioError: The law is unknown.
        """
        if self.law not in LAWS:
            raise ScenarioError(f"unknown tissue law {self.law!r}; known: {', '.join(LAWS)}")

    def with_law(self, law: LawName) -> "Scenario":
        """The same scenario under another tissue law.

        Raises:
            ScenarioError: The law is unknown.
        """
        return replace(self, law=law)

    def new_tissue(self) -> TissueLaw:
        """Fresh, uncut tissue under the scenario's law."""
        return LAWS[self.law](self.layers)

    @property
    def thickness_m(self) -> float:
        """All layers together."""
        return sum(layer.thickness_m for layer in self.layers)
