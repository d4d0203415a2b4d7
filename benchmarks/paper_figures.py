"""The paper's figures: which run gives the counterpart of each, and what there is to see."""

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
        see: Where to look in ours; what is found there, the numbers of the run say.
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
"""As the paper's text tells them, on the clock of its recordings."""
FRICTION_IN_PAPER = {
    "8": "481 online, 534 offline (Table I)",
    "9": "481 online, 534 offline (Table I)",
    "11": "481 online, 534 offline (Table I)",
}
RESIDUE_IN_PAPER = {
    "8": "almost zero (ML)",
    "9": "a rising curve is left",
    "11": "almost zero",
    "12": "close to zero",
    "13": "almost vanishes",
    "14": "feasible",
}

_ENHANCED = (
    "Up to the first rupture nothing is known and nothing is taken off. Continuous upright lines: "
    "a rupture is detected; dashed ones: friction is identified and taken off from there on, by "
    "ours at a first look and then for good; grey: the layer really gives way. From then on the "
    "enhanced force should follow the dotted truth: what the tip feels in the layer it is in."
)
PAPER_FIGURES = (
    PaperFigure(
        number="2",
        title="the two models, fitted offline",
        scenarios=("gel-70-constant", "stack-constant", "gel-70-sinusoidal", "stack-sinusoidal"),
        shows="Force measured, and reconstructed offline by the Kelvin-Voigt (KV) and the "
        "multi-layer (ML) model: one 70 % gel and a stack of three, at constant and sinusoidal "
        "speed. The paper's RMSE stand in its legends only; its text says that ML is better.",
        see="Look at how near either model stays to the reading as the needle goes deeper: KV "
        "has no friction that grows with depth. In the shaded part, which was not fitted, look at "
        "what each foretells of the withdrawal; neither knows friction at rest. The RMSE below "
        "are of these runs.",
    ),
    PaperFigure(
        number="3",
        title="the two models on the stack with the latex glove, fitted offline",
        scenarios=("stack-glove-constant",),
        shows="The same with a latex glove around the middle gel; ML again closer than KV.",
        see="The glove is stretched, a steep rise, and bursts: look at these corners, for which "
        "either model has straight lines only, and at the stretches between them.",
    ),
    PaperFigure(
        number="5",
        title="axial force from joint torques alone",
        scenarios=("gel-70-constant", "stack-glove-constant"),
        shows="Force of the F/T sensor, force estimated from the residual, and their difference, "
        "over time and over depth: RMSE 0.2444 N (one layer) and 0.285 N (stack with glove).",
        see="Look at how late each sensor follows where the force falls, and at whether the error "
        "of ours stays within the band that it states: the table has both as numbers. The paper's "
        "are of a real arm and real gels: to be laid beside ours, not to be equalled.",
    ),
    PaperFigure(
        number="8",
        title="friction compensated online, 70 % gel, constant speed, F/T sensor",
        scenarios=("gel-70-constant",),
        shows="Measured, predicted and compensated force with KV and ML; stiffness K, friction B "
        "and cumulative friction as they are identified. ML leaves almost nothing after the exit.",
        see=_ENHANCED,
    ),
    PaperFigure(
        number="9",
        title="friction compensated online, 70 % gel, sinusoidal speed, F/T sensor",
        scenarios=("gel-70-sinusoidal",),
        shows="The same with a sinusoidal speed (A = 7 cm, 0.016 Hz). After the exit a rising "
        "curve is left: friction is not proportional to speed.",
        see="Look at what is left after the exit: the published method takes friction as "
        "proportional to speed, ours also knows friction that does not depend on it. " + _ENHANCED,
    ),
    PaperFigure(
        number=FRICTION_FIGURE,
        title="friction of the three gels, offline and online",
        scenarios=GELS,
        shows="Friction of the 25, 50 and 70 % gel at constant and sinusoidal speed, identified "
        "offline (triangles) and online (stars). Online is below offline throughout.",
        see="Stars on the triangles of the same colour, and both on the short black lines of "
        "truth, are what is wanted.",
    ),
    PaperFigure(
        number=TABLE_ONE,
        title="cumulative friction of single gels",
        scenarios=GELS,
        shows="Mean and spread over the two speeds, offline and online.",
        see="The simulated gels were made so that their true friction at 2.3 mm/s is the paper's "
        "offline figure.",
    ),
    PaperFigure(
        number="11",
        title="friction compensated online, 70 % gel, constant speed, virtual sensor",
        scenarios=("gel-70-constant",),
        shows="Figure 8 again with the force estimated from joint torques in place of the F/T "
        "sensor's; the coefficients of Figure 8 in grey.",
        see=_ENHANCED,
    ),
    PaperFigure(
        number="12",
        title="friction compensated online, stack with glove, constant speed, virtual sensor",
        scenarios=("stack-glove-constant",),
        shows="Three layers, the middle one in a latex glove, 3 mm/s: three ruptures found.",
        see=_ENHANCED,
    ),
    PaperFigure(
        number="13",
        title="friction compensated online, bovine liver, constant speed, virtual sensor",
        scenarios=("liver-constant",),
        shows="Liver with its capsule, 2.3 mm/s: two ruptures found; the way to the first, on "
        "which the capsule is stretched, counts as a layer of its own.",
        see="Look at the stretch between the two ruptures: with the fictitious layer, what holds "
        "the needle before the capsule gives way may count as friction and be taken off there. "
        + _ENHANCED,
    ),
    PaperFigure(
        number="14",
        title="friction compensated online, abdominal phantom, virtual sensor",
        scenarios=("abdomen-sinusoidal",),
        shows="Fat, muscle and liver of a phantom, sinusoidal speed (A = 11.5 cm, 0.02 Hz; the "
        "caption says constant, the text and the curve say sinusoidal). The first transition is "
        "not detected.",
        see="The step from fat to muscle frees no force: the table counts how many of the true "
        "ruptures were detected. " + _ENHANCED,
    ),
)
"""In the order of the page."""
NEEDED = tuple(dict.fromkeys(name for item in PAPER_FIGURES for name in item.scenarios))
"""Every scenario that some figure needs."""
