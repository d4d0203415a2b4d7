"""Where the charts of one run are drawn."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.drawing import Drawing, Fact
from benchmarks.job import RECORDING, Job
from figures import Chart, save_svg


@dataclass(slots=True)
class Sketchbook:
    """Saves charts of one run and keeps what was drawn.

    Attributes:
        job: Whose charts they are.
        folder: Where they go.
        drawings: In the order in which they were drawn.
    """

    job: Job
    folder: Path
    drawings: list[Drawing] = field(default_factory=list)

    def title(self, figure: str, panel: str, text: str) -> str:
        """One line above a chart: which figure, what, and from where."""
        number = f"{figure}{panel}  " if figure else ""
        job = self.job
        which = "recording" if job.plant == RECORDING else f"{job.plant}, seed"
        return f"{number}{text}\n{job.benchmark}, {which} {job.seed}"

    def add(
        self,
        chart: Chart,
        kind: str,
        *,
        figure: str = "",
        panel: str = "",
        alt: str,
        caption: str,
        facts: tuple[Fact, ...] = (),
        tuned_friction_Ns_per_m: float = math.nan,
    ) -> None:
        """Draw a chart.

        Args:
            chart: What to draw.
            kind: Ending of the file's name.
            figure: Of the paper to which it is the counterpart.
            panel: Letter of the panel.
            alt: What it shows.
            caption: What to look at.
            facts: Numbers to stand below.
            tuned_friction_Ns_per_m: See `Drawing`.

        Raises:
            figures.FiguresError: It cannot be drawn or saved.
        """
        job = self.job
        number = f"figure-{figure}-" if figure else ""
        name = f"{number}{job.benchmark}-{job.plant}-{job.seed}-{kind}"
        self.drawings.append(
            Drawing(
                figure=figure,
                panel=panel,
                scenario=job.benchmark,
                plant=job.plant,
                seed=job.seed,
                path=save_svg(chart, self.folder / name),
                alt=alt,
                caption=caption,
                facts=facts,
                tuned_friction_Ns_per_m=tuned_friction_Ns_per_m,
            )
        )
