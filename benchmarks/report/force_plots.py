"""Figures of the axial force of one run, after the published Figure 5.

And what saves all figures of a run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.insertion.methods import ForceReading, force_lag_s
from benchmarks.insertion.signals import ForceTruth
from benchmarks.jobs import Drawing, Fact, Job
from benchmarks.report.published_figures import FORCE_PANELS, PUBLISHED_RMSE_N
from benchmarks.report.tables import NOTHING
from foundation.arrays import Array
from needleforce.plots import Chart, Curve, LineStyle, Panel, palette, save_page_figure

Over = Literal["time", "depth"]
"""What is along the x axis."""


@dataclass(slots=True)
class RunFigures:
    """The figures of one run, saved in a folder.

    Attributes:
        job: The run.
        folder: Where they are saved.
        saved: What was saved, in order.
    """

    job: Job
    folder: Path
    saved: list[Drawing] = field(default_factory=list)

    def add(
        self,
        chart: Chart,
        kind: str,
        *,
        panel: tuple[str, str] = ("", ""),
        alt: str,
        caption: str,
        facts: tuple[Fact, ...] = (),
        is_alone: bool = False,
    ) -> None:
        """Draw a chart and save it.

        Its title says what is shown; this adds of which figure and run. `kind` is the
        ending of the file's name, `panel` the published figure and its letter, empty
        for none; a chart alone takes the whole width of the page. The rest is as in
        `Drawing`.

        Raises:
            FiguresError: It cannot be drawn or saved.
        """
        job = self.job
        figure, letter = panel
        title = f"{chart.title}\n{job.benchmark}, {job.where}"
        title = f"Figure {figure}{letter}: {title}" if figure else title.capitalize()
        number = f"figure-{figure}-" if figure else ""
        name = f"{number}{job.benchmark}-{job.plant}-{job.seed}-{kind}.svg"
        shown = save_page_figure(
            replace(chart, title=title),
            self.folder / name,
            alt=alt,
            caption=caption,
            is_alone=is_alone,
        )
        self.saved.append(
            Drawing(figure=figure, panel=letter, job=job, shown=shown, facts=facts)
        )


STYLES: dict[tuple[str, str], tuple[str, LineStyle]] = {
    ("ft", "ours"): ("F/T sensor", palette.OTHER_SENSOR),
    ("virtual", "ours"): ("virtual sensor, ours", palette.OURS),
    ("virtual", "published-one-setting"): (
        "virtual sensor, published",
        palette.PUBLISHED,
    ),
}
"""By source and method, in the order of drawing: dashed lines lie on continuous
ones."""


def force_chart(
    title: str, truth: ForceTruth, readings: Sequence[ForceReading], over: Over = "time"
) -> Chart:
    """Return force, and below it the error against the true force.

    Over time since the sensors were zeroed [s], or over depth since contact [mm].
    """
    margin_s = 2.0  # shown before contact and after withdrawal
    first = max(truth.start_s - margin_s, truth.zeroed_s)
    shown = (truth.t_s > first) & (truth.t_s <= truth.end_s + margin_s)
    place = truth.t_s - truth.zeroed_s if over == "time" else 1e3 * truth.depth_m
    x = place[shown]
    true = truth.axial_N[shown]
    forces = []
    errors = []
    for key, (name, style) in STYLES.items():
        for item in readings:
            if (item.source, item.method) != key:
                continue
            y = item.axial_N[shown]
            label = f"{name}, RMSE {rmse_N(item, truth, truth.axial_N):.3f} N"
            forces.append(Curve(style=style, x=x, y=y, label=label))
            std = item.std_N[shown] if style is palette.OURS else None
            errors.append(
                Curve(style=style, x=x, y=y - true, std=std, band_label="ours, ± 2 std")
            )
    forces.append(Curve(style=palette.TRUE_PART, x=x, y=true, label="true force"))
    limit = _error_limit(
        [curve for curve in errors if curve.style is not palette.OTHER_SENSOR]
    )
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME if over == "time" else palette.DEPTH,
        panels=(
            Panel(y_label=palette.FORCE, curves=tuple(forces), height=1.6),
            Panel(
                y_label=palette.FORCE_ERROR,
                curves=_thin(errors),
                limits=(-limit, limit),
            ),
        ),
        x_limits=(float(x.min()), float(x.max())),
        height_in=3.6,
    )


def _thin(errors: Sequence[Curve]) -> tuple[Curve, ...]:
    """Make lines thin: the quieter error lies on the noisier one."""
    ordered = sorted(errors, key=lambda curve: curve.style is not palette.OURS)
    dark = replace(palette.OTHER_DASHED, dash="-")
    styles = [
        dark if curve.style is palette.OTHER_SENSOR else curve.style
        for curve in ordered
    ]
    return tuple(
        replace(curve, style=replace(style, width_pt=0.7))
        for curve, style in zip(ordered, styles, strict=True)
    )


def _error_limit(errors: Sequence[Curve]) -> float:
    """Return half the height of the error panel; it holds 99 % of each error.

    But no wild curve may flatten the others: three times the smallest error at most.
    """
    sizes = [float(np.percentile(np.abs(curve.y), 99.0)) for curve in errors]
    limit = 1.2 * min(max(sizes), 3.0 * min(sizes)) if sizes else 0.0
    return limit or 1.0


def rmse_N(reading: ForceReading, truth: ForceTruth, target_N: Array) -> float:
    """Return the rms difference of a reading from the truth, or from another one.

    It counts over the judged part.
    """
    return float(np.sqrt(np.mean((reading.axial_N - target_N)[truth.judged] ** 2)))


def force_figures(
    job: Job, folder: Path, truth: ForceTruth, readings: Sequence[ForceReading]
) -> tuple[Drawing, ...]:
    """Draw force and error over time, and over depth where published so."""
    figures = RunFigures(job, folder)
    panels = FORCE_PANELS.get(job.benchmark, ())
    figures.add(
        force_chart("axial force over time", truth, readings),
        "force-time",
        panel=("5", panels[0]) if panels else ("", ""),
        alt="Axial force over time by every sensor, with the true force; below, the "
        "errors",
        caption="Axial force [N] over time [s]; below, its error against the true "
        "force [N], with the band of two standard deviations that our sensor states. "
        "Triangles mark where a curve leaves its panel. RMSE from first contact to "
        "the end of the withdrawal.",
        facts=_facts(job.benchmark, truth, readings) if panels else (),
        is_alone=not panels,
    )
    if panels:
        figures.add(
            force_chart("axial force over depth", truth, readings, "depth"),
            "force-depth",
            panel=("5", panels[1]),
            alt="Axial force over depth by every sensor, with the true force; below, "
            "the errors",
            caption="The same over depth [mm]. The upper branch is the insertion, the "
            "lower one the withdrawal, where friction holds the needle back.",
        )
    return tuple(figures.saved)


def _facts(
    scenario: str, truth: ForceTruth, readings: Sequence[ForceReading]
) -> tuple[Fact, ...]:
    """Return the numbers that stand below Figure 5."""
    by_key = {(item.source, item.method): item for item in readings}
    if len(by_key) < len(STYLES):
        return ()
    ft, ours, published = (by_key[key] for key in STYLES)
    judged = truth.judged
    time_s = truth.t_s[judged]
    true_N = truth.axial_N[judged]
    error_N = np.abs(ours.axial_N - truth.axial_N)[judged]
    within_pct = 100.0 * np.mean(error_N <= 2.0 * ours.std_N[judged])

    def delay_ms(reading: ForceReading) -> str:
        return f"{1e3 * force_lag_s(time_s, reading.axial_N[judged], true_N):.0f}"

    def against(reading: ForceReading, target_N: Array) -> str:
        return f"{rmse_N(reading, truth, target_N):.4f}"

    published_N = f"{PUBLISHED_RMSE_N[scenario]:g}"
    rows = (
        (
            "RMSE against the F/T sensor [N]",
            published_N,
            against(published, ft.axial_N),
            against(ours, ft.axial_N),
        ),
        (
            "RMSE against the true force [N]",
            NOTHING,
            against(published, truth.axial_N),
            against(ours, truth.axial_N),
        ),
        (
            "delay behind the true force [ms]",
            NOTHING,
            delay_ms(published),
            delay_ms(ours),
        ),
        (
            "true force within 2 stated standard deviations [%]",
            NOTHING,
            "none stated",
            f"{within_pct:.1f}",
        ),
    )
    heads = ("published", "published, here", "ours, here")
    return tuple(
        {"": f"`{scenario}`: {quantity}"} | dict(zip(heads, numbers, strict=True))
        for quantity, *numbers in rows
    )
