"""The paper's figures: which run gives the counterpart of each, and what to compare."""

from dataclasses import dataclass

from benchmarks.targets import GELS

FRICTION_FIGURE, TABLE_ONE = "10", "I"


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperFigure:
    """One figure of the paper, or its table.

    Attributes:
        number: In the paper.
        title: What it is about.
        scenarios: Runs that give its counterpart.
        shows: What the paper shows.
        see: What to compare in ours; the results stand in the numbers of the run.
    """

    number: str
    title: str
    scenarios: tuple[str, ...]
    shows: str
    see: str

    @property
    def heading(self) -> str:
        """Above its section."""
        kind = "Table" if self.number == TABLE_ONE else "Figure"
        return f"{kind} {self.number}: {self.title}"

    @property
    def anchor(self) -> str:
        """Of its section within the page."""
        return f"table-{self.number}" if self.number == TABLE_ONE else f"figure-{self.number}"

    @property
    def command(self) -> str:
        """Draws all of it."""
        return f"python -m benchmarks run {' '.join(self.scenarios)} --report DIR"


OFFLINE_PANELS = {
    "gel-70-constant": ("2", "a"),
    "stack-constant": ("2", "b"),
    "gel-70-sinusoidal": ("2", "c"),
    "stack-sinusoidal": ("2", "d"),
    "stack-glove-constant": ("3", ""),
}
"""Figure and panel of the offline fit of a scenario."""
FORCE_PANELS = {"gel-70-constant": ("a", "c"), "stack-glove-constant": ("b", "d")}
"""Panels of Figure 5, over time and over depth."""
ENHANCED_FIGURES = {
    ("gel-70-constant", "ft"): "8",
    ("gel-70-sinusoidal", "ft"): "9",
    ("gel-70-constant", "virtual"): "11",
    ("stack-glove-constant", "virtual"): "12",
    ("liver-constant", "virtual"): "13",
    ("abdomen-sinusoidal", "virtual"): "14",
}
"""Figure of the friction compensation in a scenario, by the source of its force."""
RUPTURES_IN_PAPER = {
    "8": "1, at about 15 s",
    "9": "1, at about 20 s",
    "11": "1",
    "12": "3, at about 10.5, 16.5 and 20.5 s",
    "13": "2, at about 16.5 and 25.5 s",
    "14": "2 of 3, at about 27.5 and 35 s",
}
"""As in the paper's text, on the clock of its recordings."""
FRICTION_IN_PAPER = {
    "8": "481 online, 534 offline (Table I)",
    "9": "481 online, 534 offline (Table I)",
    "11": "481 online, 534 offline (Table I)",
}
REMAINING_IN_PAPER = {
    "8": "almost zero (ML)",
    "9": "a rising curve is left",
    "11": "almost zero",
    "12": "close to zero",
    "13": "almost vanishes",
    "14": "feasible",
}

_ENHANCED = (
    "Nothing is subtracted before the first rupture. Ticks on the lower edge mark detected "
    "ruptures, dots where friction was identified and from where on it is subtracted (ours "
    "gives a provisional, then a final estimate); grey bands are the true ruptures. After a "
    "rupture the enhanced force should follow the dotted true one: the force without the friction "
    "of the layers already traversed."
)
PAPER_FIGURES = (
    PaperFigure(
        number="2",
        title="the two models, fitted offline",
        scenarios=("gel-70-constant", "stack-constant", "gel-70-sinusoidal", "stack-sinusoidal"),
        shows="measured force, and its reconstruction offline by the Kelvin-Voigt (KV) and the "
        "multi-layer (ML) model: one 70 % gel and a stack of three, at constant and sinusoidal "
        "speed. The RMSE stand in the legends only; the text says that ML is better.",
        see="the distance of either model from the measured force as the needle goes deeper: KV "
        "has no friction that grows with depth. The shaded withdrawal was not fitted but predicted "
        "with the parameters of the insertion; neither model has static friction.",
    ),
    PaperFigure(
        number="3",
        title="the two models on the stack with the latex glove, fitted offline",
        scenarios=("stack-glove-constant",),
        shows="the same with a latex glove around the middle gel; ML again closer than KV.",
        see="the stretched glove gives a steep rise and a sudden drop, which neither model can "
        "follow: both are linear in depth within a layer.",
    ),
    PaperFigure(
        number="5",
        title="axial force from joint torques alone",
        scenarios=("gel-70-constant", "stack-glove-constant"),
        shows="force of the F/T sensor, force estimated from the residual, and their difference, "
        "over time and over depth: RMSE 0.2444 N (one layer) and 0.285 N (stack with glove).",
        see="the delay of each sensor where the force drops, and whether the error of ours stays "
        "within its stated band; the table gives both. The paper's numbers come from a real arm "
        "and real gels, ours from a simulation, so they cannot be compared directly.",
    ),
    PaperFigure(
        number="8",
        title="friction compensated online, 70 % gel, constant speed, F/T sensor",
        scenarios=("gel-70-constant",),
        shows="measured, predicted and compensated force with KV and ML; stiffness K, friction B "
        "and cumulative friction as identified. With ML almost no force remains after the exit.",
        see="the enhanced force after each rupture. " + _ENHANCED,
    ),
    PaperFigure(
        number="9",
        title="friction compensated online, 70 % gel, sinusoidal speed, F/T sensor",
        scenarios=("gel-70-sinusoidal",),
        shows="the same with a sinusoidal speed (A = 7 cm, 0.016 Hz). After the exit a rising "
        "force remains: friction is not proportional to speed.",
        see="the force that remains after the exit: the published method takes friction as "
        "proportional to speed, ours adds friction that does not depend on it. " + _ENHANCED,
    ),
    PaperFigure(
        number=FRICTION_FIGURE,
        title="friction of the three gels, offline and online",
        scenarios=GELS,
        shows="friction of the 25, 50 and 70 % gel at constant and sinusoidal speed, identified "
        "offline (triangles) and online (stars). Online is below offline throughout.",
        see="stars should lie on the triangles of the same colour, and both on the short black "
        "lines of the ground truth.",
    ),
    PaperFigure(
        number=TABLE_ONE,
        title="cumulative friction of single gels",
        scenarios=GELS,
        shows="mean and spread over the two speeds, offline and online.",
        see="the simulated gels are set so that their true friction at 2.3 mm/s is the paper's "
        "offline value.",
    ),
    PaperFigure(
        number="11",
        title="friction compensated online, 70 % gel, constant speed, virtual sensor",
        scenarios=("gel-70-constant",),
        shows="Figure 8 again with the force estimated from joint torques in place of the F/T "
        "sensor's; the coefficients of Figure 8 in grey.",
        see="the enhanced force after each rupture. " + _ENHANCED,
    ),
    PaperFigure(
        number="12",
        title="friction compensated online, stack with glove, constant speed, virtual sensor",
        scenarios=("stack-glove-constant",),
        shows="three layers, the middle one in a latex glove, 3 mm/s: three ruptures detected.",
        see="the enhanced force after each rupture. " + _ENHANCED,
    ),
    PaperFigure(
        number="13",
        title="friction compensated online, bovine liver, constant speed, virtual sensor",
        scenarios=("liver-constant",),
        shows="liver with its capsule, 2.3 mm/s: two ruptures detected; the travel up to the "
        "first, on which the capsule is stretched, counts as a layer of its own.",
        see="the force between the two ruptures: the fictitious layer may take the resistance of "
        "the stretched capsule for friction, which is then subtracted there. " + _ENHANCED,
    ),
    PaperFigure(
        number="14",
        title="friction compensated online, abdominal phantom, virtual sensor",
        scenarios=("abdomen-sinusoidal",),
        shows="fat, muscle and liver of a phantom, sinusoidal speed (A = 11.5 cm, 0.02 Hz; the "
        "caption says constant, the text and the curve say sinusoidal). The first transition is "
        "not detected.",
        see="the step from fat to muscle releases no force: the table counts how many of the true "
        "ruptures were detected. " + _ENHANCED,
    ),
)
"""In the order of the page."""
NEEDED = tuple(dict.fromkeys(name for item in PAPER_FIGURES for name in item.scenarios))
"""Every scenario that some figure needs."""
