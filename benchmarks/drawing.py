"""A chart of a run, drawn, and the words that go with it."""

import math
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Fact:
    """One number of a figure, the paper's beside those of our runs.

    Attributes:
        what: With the unit.
        paper: As printed in the paper, or said in its text.
        here: From our runs, by the head of its column.
    """

    what: str
    paper: str
    here: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """A chart of a run, drawn.

    Attributes:
        figure: Of the paper to which it is the counterpart, such as ``8``; empty for none.
        panel: Letter of the panel; empty for none.
        scenario: What was simulated.
        plant: On which arm.
        seed: Of everything drawn.
        path: The file.
        alt: What it shows, for those who cannot see it.
        caption: What to look at.
        facts: Numbers to stand below.
        tuned_friction_Ns_per_m: Cumulative friction in the end, by the published method as its
            authors ran it; nan where the drawing shows something else.
    """

    figure: str
    panel: str = ""
    scenario: str
    plant: str
    seed: int
    path: Path
    alt: str
    caption: str
    facts: tuple[Fact, ...] = ()
    tuned_friction_Ns_per_m: float = math.nan

    @property
    def provenance(self) -> str:
        """Where it comes from, in words."""
        if self.plant == "needle":
            return f"`{self.scenario}`, needle without an arm, seed {self.seed}"
        if self.plant == "recording":
            return f"`{self.scenario}`, recording {self.seed}"
        return f"`{self.scenario}`, {self.plant} arm, seed {self.seed}"
