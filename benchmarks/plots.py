"""After the paper's Figure 5: the estimated force against the true one, and the error."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.benchmark import RECORDING, Drawing, Fact, Job
from benchmarks.force_metrics import force_lag_s
from benchmarks.identification_metrics import Signals, enhanced_metrics
from benchmarks.methods import ForceReading, Identified, cumulative_friction_Ns_per_m, identify
from benchmarks.offline_fit import layer_spans, offline_fit, offline_metrics, quiet_speed_m_s
from benchmarks.paper_figures import (
    ENHANCED_FIGURES,
    FORCE_PANELS,
    FRICTION_IN_PAPER,
    OFFLINE_PANELS,
    RESIDUE_IN_PAPER,
    RUPTURES_IN_PAPER,
)
from benchmarks.signals import ForceTruth, InsertionTruth, NeedleSignal
from benchmarks.targets import GELS, PUBLISHED_RMSE_N
from identification import PUBLISHED, PUBLISHED_KV, OfflineIdentification, PublishedConfig
from identification.interaction_model import Model, regression_matrix
from needleforce.plots import Chart, Curve, Instants, LineStyle, Panel, Shading, palette, save_svg

Array = NDArray[np.float64]

OURS = ("virtual", "default")
STYLES: dict[tuple[str, str], tuple[str, LineStyle]] = {
    ("ft", "default"): ("F/T sensor", palette.OTHER_SENSOR),
    ("virtual", "published"): ("virtual, published", palette.PUBLISHED),
    OURS: ("virtual, ours", palette.OURS),
}
"""In the order of drawing, ours on top."""
MARGIN_s = 2.0
"""Shown before contact and after withdrawal."""
MOST_OF = 99.0
"""Per cent of each error curve that its panel must hold; single spikes may leave it."""
CALM_SHARE = 3.0
"""How many times as wide as the calmest virtual curve a panel may become for the others."""


def force_over_time(title: str, truth: ForceTruth, readings: Sequence[ForceReading]) -> Chart:
    """Force and error over the time since the sensors were zeroed."""
    return _chart(title, palette.INSERTION_TIME, truth.t_s - truth.zeroed_s, truth, readings)


def force_over_depth(title: str, truth: ForceTruth, readings: Sequence[ForceReading]) -> Chart:
    """Force and error over depth, on the way in and out."""
    return _chart(title, palette.DEPTH, 1e3 * truth.depth_m, truth, readings)


def rmse_N(reading: ForceReading, truth: ForceTruth, target_N: Array) -> float:
    """Difference of a reading from the true force, or another one, over the judged part."""
    return float(np.sqrt(np.mean((reading.axial_N - target_N)[truth.judged] ** 2)))


def _chart(
    title: str, x_label: str, place: Array, truth: ForceTruth, readings: Sequence[ForceReading]
) -> Chart:
    first = max(truth.start_s - MARGIN_s, truth.zeroed_s)
    shown = (truth.t_s > first) & (truth.t_s <= truth.end_s + MARGIN_s)
    x, true = place[shown], truth.axial_N[shown]
    ordered = sorted(readings, key=lambda item: list(STYLES).index((item.source, item.method)))
    forces, errors = [], []
    for item in ordered:
        name, style = STYLES[item.source, item.method]
        told, is_ours = item.axial_N[shown], (item.source, item.method) == OURS
        label = f"{name}, RMSE {rmse_N(item, truth, truth.axial_N):.3f} N"
        forces.append(Curve(style=style, x=x, y=told, label=label))
        errors.append(
            Curve(
                style=style,
                x=x,
                y=told - true,
                std=item.std_N[shown] if is_ours else None,
                band_label="ours, ± 2 std" if is_ours else None,
            )
        )
    forces.append(Curve(style=palette.TRUE, x=x, y=true, label="true force"))
    error_N = _error_limit(errors, [item.source for item in ordered])
    return Chart(
        title=title,
        x_label=x_label,
        panels=(
            Panel(
                y_label=palette.FORCE,
                curves=tuple(forces),
                limits=(float(true.min()) - error_N, float(true.max()) + error_N),
                height=1.6,
            ),
            Panel(y_label=palette.FORCE_ERROR, curves=tuple(errors), limits=(-error_N, error_N)),
        ),
        x_limits=(float(x.min()), float(x.max())),
        height_in=3.3,
    )


def _error_limit(errors: Sequence[Curve], sources: Sequence[str]) -> float:
    """Half the height of the error panel: no wild curve may flatten the others."""
    sizes = [
        float(np.percentile(np.abs(curve.y), MOST_OF))
        for curve, source in zip(errors, sources, strict=True)
        if source == "virtual"
    ]
    limit = 1.2 * min(max(sizes), CALM_SHARE * min(sizes)) if sizes else 0.0
    return limit or 1.0


# The clock of the charts: seconds since the needle set out, as in the paper.


MARGIN_s_insertion_axis = 1.0
"""Shown before contact and after the deepest point."""
_SEEN_BESIDE_A_LINE_PT = 3.0
"""A layer gives way within 0.1 s of a minute; lines that mark its detection lie on top."""


class InsertionAxis(NamedTuple):
    """Turns times of a run into places on the x axis.

    Attributes:
        truth: Of the run. The insertion begins where the tare stroke ends.
    """

    truth: InsertionTruth

    def place(self, t_s: Array) -> Array:
        """Seconds since the insertion began."""
        return t_s - self.truth.tare_end_s

    def at(self, t_s: float) -> float:
        """The same for one time."""
        return t_s - self.truth.tare_end_s

    @property
    def limits(self) -> tuple[float, float]:
        """From just before contact to just after the deepest point."""
        truth = self.truth
        return self.at(truth.contact_s - MARGIN_s_insertion_axis), self.at(
            truth.insertion_end_s + MARGIN_s_insertion_axis
        )

    def true_ruptures(self) -> Shading:
        """When layers really gave way: from the onset to the end of the release."""
        spans = tuple((self.at(item.onset_s), self.at(item.end_s)) for item in self.truth.ruptures)
        return Shading(
            label="a layer gives way (truth)",
            color=palette.TRUE_RUPTURE,
            spans=spans,
            least_pt=_SEEN_BESIDE_A_LINE_PT,
        )

    def events(self, item: Identified, who: str = "") -> list[Instants]:
        """Alarms and compensations of a method.

        Args:
            item: What the method made of the run.
            who: Added to the words of the legend.
        """
        times = self.truth.t_s[item.start :]
        compensated = tuple(
            self.at(float(times[k]))
            for k, estimate in enumerate(item.result.estimates)
            if estimate.identified_layer is not None
        )
        alarms = tuple(self.at(alarm.alarm_s) for alarm in item.alarms)
        return [
            Instants(label=f"rupture detected{who}", style=palette.RUPTURE, places=alarms),
            Instants(
                label=f"friction compensated{who}", style=palette.COMPENSATION, places=compensated
            ),
        ]


# After the upper halves of the paper's Figures 8, 9 and 11 to 14: forces without friction.


READINGS = {"ft": "F/T reading", "virtual": "virtual sensor's force"}


def enhanced_chart(
    title: str,
    truth: InsertionTruth,
    item: Identified,
    other: Identified | None = None,
    ft: ForceReading | None = None,
    has_speed: bool = False,
) -> Chart:
    """Reading, prediction and enhanced force of one method.

    Args:
        title: Above.
        truth: Of the run.
        item: The method's result; ruptures and compensations are its own.
        other: Of the same method with the Kelvin-Voigt model, for comparison.
        ft: The F/T reading, where the method was given another force.
        has_speed: Whether the profile of the speed is drawn, as in Figure 9.
    """
    axis = InsertionAxis(truth)
    top_N = float(truth.axial_N[truth.is_insertion].max())
    curves = _curves(axis, item, other, ft)
    if has_speed:
        share = truth.speed_m_s / float(np.max(truth.speed_m_s[truth.is_insertion]))
        profile = 0.5 * top_N * share
        x = axis.place(truth.t_s)
        curves.insert(0, Curve(style=palette.OTHER_DASHED, x=x, y=profile, label="speed, no scale"))
    limits = (-0.25 * top_N, 1.15 * top_N)
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=(Panel(y_label=palette.FORCE, curves=tuple(curves), limits=limits),),
        shadings=(axis.true_ruptures(),),
        instants=tuple(axis.events(item)),
        x_limits=axis.limits,
        height_in=2.7,
    )


def _curves(
    axis: InsertionAxis, item: Identified, other: Identified | None, ft: ForceReading | None
) -> list[Curve]:
    truth, is_ours = axis.truth, item.method == "default"
    x = axis.place(truth.t_s)
    own = x[item.start :]
    return [
        Curve(style=palette.READING, x=own, y=item.force_N, label=READINGS[item.source]),
        Curve(style=palette.PREDICTED, x=own, y=_predicted(item), label="predicted"),
        *_others(axis, other, ft),
        Curve(
            style=palette.OURS if is_ours else palette.PUBLISHED,
            x=own,
            y=item.enhanced_N,
            label="enhanced, ours" if is_ours else "enhanced, published",
        ),
        Curve(style=palette.TRUE_PART, x=x, y=truth.enhanced_N, label="enhanced, truth"),
    ]


def _others(
    axis: InsertionAxis, other: Identified | None, ft: ForceReading | None
) -> Sequence[Curve]:
    x, curves = axis.place(axis.truth.t_s), []
    if ft is not None:
        label = "F/T reading, to compare"
        curves.append(Curve(style=palette.OTHER_SENSOR, x=x, y=ft.axial_N, label=label))
    if other is not None:
        label = "enhanced, published, KV"
        curves.append(
            Curve(style=palette.PUBLISHED_KV, x=x[other.start :], y=other.enhanced_N, label=label)
        )
    return curves


def _predicted(item: Identified) -> np.ndarray:
    return np.array([estimate.predicted_force_N for estimate in item.result.estimates])


# True friction coefficients of a run, where truth has such a thing.


def true_friction(truth: InsertionTruth) -> dict[str, tuple[Array, Array]]:
    """Steps over time, by the name of the estimate they belong to.

    True friction is no coefficient (it also depends on speed in other ways): these are its values
    at each rupture, friction over speed, and that over the way since the rupture before. There is
    no one true stiffness, and none is given.
    """
    times: list[float] = []
    local: list[float] = []
    total: list[float] = []
    start_s, start_m, sum_before = truth.contact_s, 0.0, 0.0
    for rupture in truth.ruptures:
        speed = float(np.interp(rupture.onset_s, truth.t_s, truth.speed_m_s))
        product = rupture.layer_friction_N / speed
        thickness = rupture.onset_m - start_m
        times += [start_s, rupture.onset_s, rupture.onset_s]
        local += [product / thickness, product / thickness, np.nan]
        total += [sum_before, sum_before, np.nan]
        start_s, start_m, sum_before = rupture.onset_s, rupture.onset_m, sum_before + product
    times += [start_s, float(truth.insertion_end_s)]
    return {
        "friction_Ns_per_m2": (np.array(times[:-2]), np.array(local)),
        "cumulative_friction_Ns_per_m": (
            np.array(times),
            np.array([*total, sum_before, sum_before]),
        ),
    }


# After the lower halves of the paper's Figures 8, 9 and 11 to 14: what was identified online.


PANELS = (
    ("stiffness_N_per_m", palette.STIFFNESS),
    ("friction_Ns_per_m2", palette.FRICTION),
    ("cumulative_friction_Ns_per_m", palette.CUMULATIVE_FRICTION),
)


def parameter_chart(
    title: str,
    truth: InsertionTruth,
    ours: Identified,
    published: Identified,
    kelvin_voigt: Identified | None = None,
    on_ft: Identified | None = None,
) -> Chart:
    """Stiffness, friction per length and cumulative friction of every method.

    Args:
        title: Above.
        truth: Of the run.
        ours: With standard deviations; its ruptures and compensations are marked.
        published: With the multi-layer model.
        kelvin_voigt: Published, with the Kelvin-Voigt model. Its friction has another unit and is
            drawn only where the units agree.
        on_ft: Ours on the F/T reading, for comparison.
    """
    axis = InsertionAxis(truth)
    drawn: list[tuple[Identified, LineStyle, str]] = [
        (published, palette.PUBLISHED, "published"),
        (ours, palette.OURS, "ours"),
    ]
    if on_ft is not None:
        drawn.insert(0, (on_ft, palette.OTHER_DASHED, "ours on the F/T reading"))
    if kelvin_voigt is not None:
        drawn.insert(0, (kelvin_voigt, palette.PUBLISHED_KV, "published, Kelvin-Voigt"))
    true = true_friction(truth)
    panels = []
    for name, label in PANELS:
        curves = [
            _curve(axis, item, style, text, name)
            for item, style, text in drawn
            if item is not kelvin_voigt or name != "friction_Ns_per_m2"
        ]
        if name in true:
            t_s, values = true[name]
            curves.append(
                Curve(style=palette.TRUE_PART, x=axis.place(t_s), y=values, label="truth")
            )
        panels.append(Panel(y_label=label, curves=tuple(curves), limits=_limits(axis, curves)))
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=tuple(panels),
        shadings=(axis.true_ruptures(),),
        instants=tuple(axis.events(ours, ", ours")),
        x_limits=axis.limits,
        height_in=4.2,
    )


def _curve(axis: InsertionAxis, item: Identified, style: LineStyle, label: str, name: str) -> Curve:
    estimates = item.result.estimates
    stds = None
    if style is palette.OURS:
        spread = name.replace("_N_", "_std_N_").replace("_Ns_", "_std_Ns_")
        told = [getattr(estimate, spread) for estimate in estimates]
        stds = np.array([np.nan if std is None else std for std in told])
    return Curve(
        style=style,
        x=axis.place(axis.truth.t_s[item.start :]),
        y=np.array([getattr(estimate, name) for estimate in estimates]),
        label=label,
        std=stds,
        band_label=None if stds is None else "ours, ± 2 std",
    )


def _limits(axis: InsertionAxis, curves: Sequence[Curve]) -> tuple[float, float]:
    """Room for ours and the truth, and most of the others; transients may leave the panel."""
    sizes = [1e-9]
    for curve in curves:
        low, high = axis.limits
        inside = curve.y[(curve.x > low) & (curve.x < high) & np.isfinite(curve.y)]
        if curve.style is palette.TRUE_PART:
            sizes.append(1.4 * float(np.max(inside, initial=0.0)))
        elif len(inside):
            share, room = (90.0, 1.6) if curve.style is palette.OURS else (70.0, 1.2)
            sizes.append(room * float(np.percentile(inside, share)))
    return -0.2 * max(sizes), max(sizes)


# After the paper's Figures 2 and 3: the two models fitted offline, and what they leave.


AFTER_s = 1.0
NOT_FITTED = "#f0ead8"
MODELS: tuple[tuple[Model, str, LineStyle], ...] = (
    ("kv", "Kelvin-Voigt", palette.PUBLISHED_KV),
    ("ml", "multi-layer", palette.OURS),
)


def offline_chart(title: str, signal: NeedleSignal, truth: InsertionTruth) -> Chart:
    """Reading, both reconstructions, and their errors; in and out of the tissue.

    The parameters are those of the insertion; the withdrawal is foretold with them.
    """
    axis = InsertionAxis(truth)
    shown = truth.t_s >= truth.contact_s - AFTER_s
    x, reading = axis.place(truth.t_s[shown]), signal.force_N[shown]
    forces = [Curve(style=palette.READING, x=x, y=reading, label="F/T reading")]
    errors = []
    for model, name, style in MODELS:
        fit = offline_fit(signal, truth, model)
        predicted = _prediction(fit, signal, truth)[shown]
        label = f"{name}, RMSE {fit.rmse_N:.3f} N"
        forces.append(Curve(style=style, x=x, y=predicted, label=label))
        errors.append(Curve(style=style, x=x, y=reading - predicted))
    end = axis.at(truth.insertion_end_s)
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=(
            Panel(y_label=palette.FORCE, curves=tuple(forces), height=1.7),
            Panel(y_label=palette.FORCE_ERROR, curves=tuple(errors)),
        ),
        shadings=(
            axis.true_ruptures(),
            Shading(label="not fitted: foretold", color=NOT_FITTED, spans=((end, float(x[-1])),)),
        ),
        x_limits=(float(x[0]), float(x[-1])),
    )


def _prediction(fit: OfflineIdentification, signal: NeedleSignal, truth: InsertionTruth) -> Array:
    """The model's force over the whole run."""
    depth = signal.depth_m - np.interp(truth.contact_s, truth.t_s, signal.depth_m)
    spans, speed = layer_spans(truth), quiet_speed_m_s(signal)
    matrix = regression_matrix(truth.t_s, depth, speed, spans, fit.model)
    parameters = [(layer.stiffness_N_per_m, layer.friction) for layer in fit.layers]
    return matrix @ np.array(parameters).ravel()


# Where the charts of one run are drawn.


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


# Draws the forces of one run: Figure 5, and the same for every other run.


ALT = "Axial force of the F/T sensor, the published and our virtual sensor beside the true force"


def draw_forces(book: Sketchbook, truth: ForceTruth, readings: Sequence[ForceReading]) -> None:
    """Force and error over time, and over depth where the paper shows it so."""
    panels = FORCE_PANELS.get(book.job.benchmark)
    figure, (over_time, over_depth) = ("5", panels) if panels else ("", ("", ""))
    title = book.title(figure, over_time, "axial force over time")
    book.add(
        force_over_time(title, truth, readings),
        "force-time",
        figure=figure,
        panel=over_time,
        alt=f"{ALT}, over time; below, the errors",
        caption="Above the axial force, below its error against the true force; peaks where a "
        "layer gives way may leave the lower panel. RMSE from first contact to the end of the "
        "withdrawal.",
        facts=_facts(book.job.benchmark, truth, readings) if figure else (),
    )
    if panels:
        title = book.title(figure, over_depth, "axial force over depth")
        book.add(
            force_over_depth(title, truth, readings),
            "force-depth",
            figure=figure,
            panel=over_depth,
            alt=f"{ALT}, over depth; below, the errors",
            caption="The same over depth: the upper branch on the way in, the lower on the way "
            "out, where friction holds the needle back.",
        )


def _facts(scenario: str, truth: ForceTruth, readings: Sequence[ForceReading]) -> tuple[Fact, ...]:
    by_key = {(item.source, item.method): item for item in readings}
    ft, paper, ours = (
        by_key.get(key)
        for key in (("ft", "default"), ("virtual", "published"), ("virtual", "default"))
    )
    if ft is None or paper is None or ours is None:
        return ()
    name = f"`{scenario}`: RMSE against"
    printed = f"{PUBLISHED_RMSE_N[scenario]:g}"
    return (
        _fact(f"{name} the F/T sensor [N]", printed, truth, (paper, ours), ft.axial_N),
        _fact(f"{name} the true force [N]", "–", truth, (paper, ours), truth.axial_N),
        _of_both(
            f"`{scenario}`: delay behind the true force [ms]",
            "–",
            [f"{1e3 * _delay_s(item, truth):.0f}" for item in (paper, ours)],
        ),
        _of_both(
            f"`{scenario}`: true force within 2 stated standard deviations [%]",
            "–",
            ["none stated", f"{100.0 * _share_within(ours, truth):.1f}"],
        ),
    )


def _fact(
    what: str,
    printed: str,
    truth: ForceTruth,
    both: tuple[ForceReading, ForceReading],
    target_N: Array,
) -> Fact:
    return _of_both(what, printed, [f"{rmse_N(item, truth, target_N):.4f}" for item in both])


def _of_both(what: str, printed: str, values: Sequence[str]) -> Fact:
    heads = ("published, here", "ours, here")
    return Fact(what=what, paper=printed, here=tuple(zip(heads, values, strict=True)))


def _delay_s(item: ForceReading, truth: ForceTruth) -> float:
    part = truth.judged
    return force_lag_s(truth.t_s[part], item.axial_N[part], truth.axial_N[part])


def _share_within(item: ForceReading, truth: ForceTruth) -> float:
    part = truth.judged
    error = np.abs(item.axial_N - truth.axial_N)[part]
    return float(np.mean(error <= 2.0 * item.std_N[part]))


# The published method as its authors ran it, for the counterparts of their figures.
#
# In the tables it runs as ours does: one setting for every recording, and the speed that the arm
# measures. Its authors changed σ₁ between recordings (0.03 to 0.15 N), and its figures show a speed
# without noise; with 0.12 mm/s of noise on 2.3 mm/s it takes noise for excitation, and on a force
# that lags by 0.2 s its CUSUM never alarms at the 0.08 N of the text.


SIGMA1_N = {"ft": 0.06, "virtual": 0.05}
"""By source: what finds the small fall of the 25 % gel, and the smeared ones of the residual."""
SIGMA1_OF_FIGURE_N = {"13": 0.04}
"""Where another is needed to find the ruptures that the paper's figure shows."""


def sigma1_N(figure: str, source: str) -> float:
    """The setting of a figure."""
    return SIGMA1_OF_FIGURE_N.get(figure, SIGMA1_N[source])


def tuned_published(
    signal: NeedleSignal,
    truth: InsertionTruth,
    commanded_m_s: NDArray[np.float64],
    figure: str = "",
    config: PublishedConfig = PUBLISHED,
) -> Identified:
    """Run it with the commanded speed and the figure's own σ₁.

    Args:
        signal: What the benchmark gives the published method.
        truth: Of the run.
        commanded_m_s: Speed as the robot was told, shape (n,).
        figure: Of the paper; empty for none.
        config: `PUBLISHED` or `PUBLISHED_KV`.
    """
    quiet = replace(signal, speed_m_s=commanded_m_s)
    tuned = replace(config, sigma1_N=sigma1_N(figure, signal.source))
    return identify(quiet, truth, "published", tuned)


# Draws the friction compensation in one run: Figures 8, 9, 11 to 14, and other runs.


OURS_enhanced_drawings, AS_PUBLISHED = "ours", "as published"
ALT_enhanced_drawings = "Axial force given, predicted and without friction, beside the truth, "
PARAMETERS = (
    "What was identified, from above: stiffness and friction of the layer the tip is in, and the "
    "friction of all layers left. At constant speed the first two are one number until a rupture "
    "tells them apart, hence the broad band. Transients may leave the panel."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """What several methods made of one force.

    Attributes:
        ours: One setting for everything.
        tuned: The published method as its authors ran it.
        published: The published method with one setting and the measured speed.
        kelvin_voigt: `tuned` with the Kelvin-Voigt model, if it is to be shown.
        ft: The F/T reading, where the force was another.
        on_ft: Ours on the F/T reading, likewise.
    """

    ours: Identified
    tuned: Identified
    published: Identified
    kelvin_voigt: Identified | None = None
    ft: ForceReading | None = None
    on_ft: Identified | None = None


def draw_enhanced(book: Sketchbook, figure: str, truth: InsertionTruth, told: Compared) -> None:
    """The forces by each method; for a figure of the paper the parameters as well.

    Args:
        book: Where to draw.
        figure: Of the paper; empty for none.
        truth: Of the run.
        told: By the methods.
    """
    _draw_published(book, figure, truth, told)
    _draw_ours(book, figure, truth, told)
    if figure:
        _draw_parameters(book, figure, truth, told)


def _draw_published(book: Sketchbook, figure: str, truth: InsertionTruth, told: Compared) -> None:
    source, item = told.ours.source, told.tuned
    panel = "a" if figure else ""
    title = book.title(figure, panel, f"{READINGS[source]}, {AS_PUBLISHED}")
    none = "" if item.alarms else " No rupture was detected, so nothing is taken off."
    friction = cumulative_friction_Ns_per_m(item.alarms)
    book.add(
        enhanced_chart(title, truth, item, told.kelvin_voigt, told.ft, has_speed=figure == "9"),
        f"{source}-paper",
        figure=figure,
        panel=panel,
        alt=ALT_enhanced_drawings + AS_PUBLISHED,
        caption="The published method as its authors ran it: commanded speed, "
        f"σ₁ = {sigma1_N(figure, source):g} N.{none}",
        tuned_friction_Ns_per_m=friction if source == "ft" else math.nan,
    )


def _draw_ours(book: Sketchbook, figure: str, truth: InsertionTruth, told: Compared) -> None:
    source = told.ours.source
    panel = "a" if figure else ""
    title = book.title(figure, panel, f"{READINGS[source]}, {OURS_enhanced_drawings}")
    book.add(
        enhanced_chart(title, truth, told.ours, None, told.ft, has_speed=figure == "9"),
        f"{source}-default",
        figure=figure,
        panel=panel,
        alt=ALT_enhanced_drawings + OURS_enhanced_drawings,
        caption="Ours: measured speed, one setting for every recording.",
        facts=_facts_enhanced_drawings(figure, truth, told) if figure else (),
    )


def _draw_parameters(book: Sketchbook, figure: str, truth: InsertionTruth, told: Compared) -> None:
    source = told.ours.source
    title = book.title(figure, "b", f"parameters from the {READINGS[source]}")
    book.add(
        parameter_chart(title, truth, told.ours, told.tuned, told.kelvin_voigt, told.on_ft),
        f"{source}-parameters",
        figure=figure,
        panel="b",
        alt="Stiffness, friction per length and cumulative friction over time, both methods",
        caption=PARAMETERS,
    )


def _facts_enhanced_drawings(
    figure: str, truth: InsertionTruth, told: Compared
) -> tuple[Fact, ...]:
    methods = {
        "published, tuned, here": told.tuned,
        "published, one setting, here": told.published,
        "ours, one setting, here": told.ours,
    }
    _, steps = true_friction(truth)["cumulative_friction_Ns_per_m"]
    return (
        Fact(
            what=f"ruptures detected (true: {len(truth.ruptures)})",
            paper=RUPTURES_IN_PAPER[figure],
            here=tuple((head, _ruptures(item, truth)) for head, item in methods.items()),
        ),
        Fact(
            what=f"cumulative friction in the end (true: {steps[-1]:.0f}) [Ns/m]",
            paper=FRICTION_IN_PAPER.get(figure, "not stated"),
            here=tuple(
                (head, f"{cumulative_friction_Ns_per_m(item.alarms):.0f}")
                for head, item in methods.items()
            ),
        ),
        Fact(
            what="|enhanced force| after the last exit, of the force there [%]",
            paper=RESIDUE_IN_PAPER[figure],
            here=tuple((head, _residue(item, truth)) for head, item in methods.items()),
        ),
    )


def _ruptures(item: Identified, truth: InsertionTruth) -> str:
    """Those of the insertion; on the way out there are none to find."""
    inside = [alarm.alarm_s for alarm in item.alarms if alarm.alarm_s <= truth.insertion_end_s]
    times = ", ".join(f"{alarm_s - truth.tare_end_s:.1f}" for alarm_s in inside)
    return f"{len(inside)}, at {times} s" if inside else "none"


def _residue(item: Identified, truth: InsertionTruth) -> str:
    return f"{enhanced_metrics(item, truth).get('exit_residue_pct', math.nan):.1f}"


# Draws the offline fit of one run: Figures 2 and 3.


def draw_offline(book: Sketchbook, signal: NeedleSignal, truth: InsertionTruth) -> None:
    """Both models on the F/T reading, where the paper shows that scenario so."""
    if book.job.benchmark not in OFFLINE_PANELS:
        return
    figure, panel = OFFLINE_PANELS[book.job.benchmark]
    found = offline_metrics(signal, truth)
    name = f"`{book.job.benchmark}`: RMSE of the insertion [N]"
    said = "ML below KV"
    book.add(
        offline_chart(book.title(figure, panel, "models fitted offline"), signal, truth),
        "offline",
        figure=figure,
        panel=panel,
        alt="F/T reading with the reconstructions of the Kelvin-Voigt and the multi-layer model; "
        "below, what each leaves",
        caption="Broad and pale the reading, thin the two models with layers and ruptures given; "
        "below what each leaves, of which peaks where a layer gives way may leave the panel. "
        "RMSE from first contact to the deepest point.",
        facts=(
            Fact(
                what=name,
                paper=said,
                here=(
                    ("Kelvin-Voigt, here", f"{found['offline_rmse_kv_N']:.3f}"),
                    ("multi-layer, here", f"{found['offline_rmse_ml_N']:.3f}"),
                ),
            ),
        ),
    )


# Every chart of one run, drawn in the process that ran it.


Found = Sequence[tuple[Signals, Sequence[Identified]]]
"""Of every source: what the methods were given, and what they made of it."""


def force_drawings(
    job: Job, folder: Path, truth: ForceTruth, readings: Sequence[ForceReading]
) -> tuple[Drawing, ...]:
    """The forces of a run."""
    book = Sketchbook(job, folder)
    draw_forces(book, truth, readings)
    return tuple(book.drawings)


def identification_drawings(
    job: Job,
    folder: Path,
    truth: InsertionTruth,
    commanded_m_s: Array,
    found: Found,
    ft: ForceReading | None = None,
) -> tuple[Drawing, ...]:
    """The identification in a run.

    Args:
        job: The run.
        folder: Where the drawings go.
        truth: Of the run.
        commanded_m_s: Speed as the robot was told, shape (n,).
        found: By source, the F/T sensor's first.
        ft: The F/T reading, if another source is among them.
    """
    book = Sketchbook(job, folder)
    draw_offline(book, found[0][0]["default"], truth)
    on_ft = {item.method: item for item in found[0][1]}["default"]
    for signals, identified in found:
        by_method = {item.method: item for item in identified}
        source = by_method["default"].source
        figure = ENHANCED_FIGURES.get((job.benchmark, source), "")
        if not figure and source != _usual_source(job, found):
            continue
        is_ft = source == "ft"
        given, has_kv = signals["published"], bool(figure) and is_ft
        told = Compared(
            ours=by_method["default"],
            tuned=tuned_published(given, truth, commanded_m_s, figure),
            published=by_method["published"],
            kelvin_voigt=tuned_published(given, truth, commanded_m_s, figure, PUBLISHED_KV)
            if has_kv
            else None,
            ft=None if is_ft else ft,
            on_ft=None if is_ft else on_ft,
        )
        draw_enhanced(book, figure, truth, told)
    return tuple(book.drawings)


def _usual_source(job: Job, found: Found) -> str:
    """What is shown without a figure: the whole chain; of gels, for Table I, the F/T sensor."""
    return "ft" if job.benchmark in GELS or len(found) == 1 else "virtual"
