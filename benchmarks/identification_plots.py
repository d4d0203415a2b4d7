"""Charts of the identification in one run, after the paper's Figures 2, 3, 8, 9 and 11 to 14."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.force_plots import Over
from benchmarks.methods import ForceReading, Identified
from benchmarks.offline_fit import layer_spans, offline_fit, quiet_speed_m_s
from benchmarks.signals import InsertionTruth, NeedleSignal
from identification.interaction_model import Model, regression_matrix
from needleforce.plots import Chart, Curve, Instants, LineStyle, Panel, Shading, palette

Array = NDArray[np.float64]

MARGIN_s = 1.0
"""Shown before contact and after the deepest point."""
LEAST_RUPTURE_PT = 4.0
"""A layer ruptures within 0.1 s of a minute; so wide its shade is seen."""


class InsertionAxis(NamedTuple):
    """Turns times of a run into places on the x axis.

    Attributes:
        truth: Of the run. The clock of the figures starts where the tare stroke ends and the needle
            sets out, as in the paper.
        over: What is on the axis. Over depth, only the insertion is shown.
    """

    truth: InsertionTruth
    over: Over = "time"

    def place(self, t_s: Array) -> Array:
        """Seconds since the insertion began, or depth [mm]; nan after the insertion."""
        if self.over == "time":
            return t_s - self.truth.tare_end_s
        depth_mm = 1e3 * np.interp(t_s, self.truth.t_s, self.truth.depth_m)
        return np.where(t_s <= self.truth.insertion_end_s, depth_mm, np.nan)

    def at(self, *t_s: float) -> tuple[float, ...]:
        """The same for single times."""
        return tuple(self.place(np.array(t_s)).tolist())

    @property
    def label(self) -> str:
        """Words of the axis."""
        return palette.INSERTION_TIME if self.over == "time" else palette.DEPTH

    @property
    def limits(self) -> tuple[float, float]:
        """From just before contact to the deepest point, over time to just after it."""
        end_s = self.truth.insertion_end_s
        first, last, after = self.at(self.truth.contact_s - MARGIN_s, end_s, end_s + MARGIN_s)
        return first, after if self.over == "time" else last

    def true_ruptures(self) -> Shading:
        """When layers ruptured: from the onset to the end of the release."""
        spans = [self.at(item.onset_s, item.end_s) for item in self.truth.ruptures]
        return Shading(
            label="true rupture",
            color=palette.TRUE_RUPTURE,
            spans=tuple((first, last) for first, last in spans),
            least_pt=LEAST_RUPTURE_PT,
        )

    def events(self, item: Identified) -> tuple[Instants, Instants]:
        """Alarms, and where friction was identified, by a method."""
        t_s = self.truth.t_s[item.start :]
        is_identified = np.array(
            [one.identified_layer is not None for one in item.result.estimates]
        )
        return (
            Instants(
                label="rupture detected",
                style=palette.RUPTURE,
                places=self.at(*(alarm.alarm_s for alarm in item.alarms)),
            ),
            Instants(
                label="friction identified",
                style=palette.COMPENSATION,
                places=self.at(*t_s[is_identified].tolist()),
            ),
        )


SENSORS = {"ft": "F/T sensor", "virtual": "virtual sensor"}


def enhanced_chart(
    title: str,
    truth: InsertionTruth,
    item: Identified,
    kelvin_voigt: Identified | None = None,
    ft: ForceReading | None = None,
    *,
    over: Over = "time",
    window: tuple[float, float] | None = None,
    has_speed: bool = False,
) -> Chart:
    """Measured, predicted and enhanced force of one method.

    Args:
        title: What is shown.
        truth: Of the run.
        item: The method's result; the events are its own.
        kelvin_voigt: Of the same method with the Kelvin-Voigt model, for comparison.
        ft: The F/T sensor's force, where the method was given another.
        over: Time since the insertion began [s], or depth since contact [mm].
        window: First and last place on that axis; None for the whole insertion.
        has_speed: Whether the profile of the speed is drawn, as in Figure 9.
    """
    axis, own = InsertionAxis(truth, over), truth.t_s[item.start :]
    x, is_ours = axis.place(own), item.method == "default"
    top_N = float(truth.axial_N[truth.is_insertion].max())
    predicted_N = np.array([estimate.predicted_force_N for estimate in item.result.estimates])
    enhanced, who = (palette.OURS, "ours") if is_ours else (palette.PUBLISHED, "published")
    drawn = [
        (palette.READING, x, item.force_N, f"force of the {SENSORS[item.source]}"),
        (palette.PREDICTED, x, predicted_N, "predicted force"),
        (enhanced, x, item.enhanced_N, f"enhanced force, {who}"),
        (palette.TRUE_PART, axis.place(truth.t_s), truth.enhanced_N, "true enhanced force"),
    ]
    if ft is not None:
        everywhere = axis.place(truth.t_s)
        drawn.insert(0, (palette.OTHER_SENSOR, everywhere, ft.axial_N, "force of the F/T sensor"))
    if kelvin_voigt is not None:
        there, label = axis.place(truth.t_s[kelvin_voigt.start :]), "enhanced force, Kelvin-Voigt"
        drawn.insert(-2, (palette.PUBLISHED_KV, there, kelvin_voigt.enhanced_N, label))
    if has_speed:
        profile = truth.speed_m_s / float(np.max(truth.speed_m_s[truth.is_insertion]))
        scaled = 0.5 * top_N * profile
        drawn.insert(
            0, (palette.OTHER_DASHED, axis.place(truth.t_s), scaled, "speed, not to scale")
        )
    curves = tuple(Curve(style=style, x=x, y=y, label=label) for style, x, y, label in drawn)
    chart = Chart(
        title=title,
        x_label=axis.label,
        panels=(Panel(y_label=palette.FORCE, curves=curves, limits=(-0.25 * top_N, 1.15 * top_N)),),
        shadings=(axis.true_ruptures(),),
        instants=axis.events(item),
        x_limits=axis.limits,
        height_in=2.9,
    )
    return chart if window is None else chart.within(*window)


def true_friction(truth: InsertionTruth) -> dict[str, tuple[Array, Array]]:
    """Steps over time, by the name of the estimate they belong to.

    True friction is no coefficient (it also depends on speed in other ways): these are its values
    at each rupture, friction over speed, and that over the travel since the rupture before. There
    is no one true stiffness, and none is given.
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
    ends = [start_s, float(truth.insertion_end_s)]
    return {
        "friction_Ns_per_m2": (np.array(times), np.array(local)),
        "cumulative_friction_Ns_per_m": (
            np.array(times + ends),
            np.array([*total, sum_before, sum_before]),
        ),
    }


PARAMETERS = {
    "stiffness_N_per_m": palette.STIFFNESS,
    "friction_Ns_per_m2": palette.FRICTION,
    "cumulative_friction_Ns_per_m": palette.CUMULATIVE_FRICTION,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """What several methods made of one force.

    Attributes:
        ours: One setting for everything.
        tuned: The published method with the settings of its authors.
        published: The published method with one setting and the measured speed.
        kelvin_voigt: `tuned` with the Kelvin-Voigt model, if it is to be shown.
        ft: The F/T sensor's force, where the force was another.
        on_ft: Ours on the F/T sensor's force, likewise.
    """

    ours: Identified
    tuned: Identified
    published: Identified
    kelvin_voigt: Identified | None = None
    ft: ForceReading | None = None
    on_ft: Identified | None = None


def parameter_chart(title: str, truth: InsertionTruth, compared: Compared) -> Chart:
    """Stiffness, friction per length and cumulative friction of every method.

    The Kelvin-Voigt model's friction has another unit and is drawn only where the units agree.
    """
    axis, true = InsertionAxis(truth), true_friction(truth)
    drawn = (
        (compared.ours, palette.OURS, "ours"),
        (compared.on_ft, palette.OTHER_DASHED, "ours on the F/T sensor's force"),
        (compared.kelvin_voigt, palette.PUBLISHED_KV, "published, Kelvin-Voigt"),
        (compared.tuned, palette.PUBLISHED, "published"),
    )
    panels = []
    for name, label in PARAMETERS.items():
        curves = [
            _parameter(axis, item, style, text, name)
            for item, style, text in drawn
            if item is not None
            and (item is not compared.kelvin_voigt or name != "friction_Ns_per_m2")
        ]
        if name in true:
            t_s, values = true[name]
            x = axis.place(t_s)
            curves.append(Curve(style=palette.TRUE_PART, x=x, y=values, label="ground truth"))
        layers = [alarm.layer for alarm in compared.ours.alarms if alarm.layer is not None]
        found = [getattr(layer, name) for layer in layers if hasattr(layer, name)]
        panels.append(
            Panel(y_label=label, curves=tuple(curves), limits=_limits(axis, curves, found))
        )
    return Chart(
        title=title,
        x_label=axis.label,
        panels=tuple(panels),
        shadings=(axis.true_ruptures(),),
        instants=axis.events(compared.ours),
        x_limits=axis.limits,
        height_in=4.6,
    )


def _parameter(
    axis: InsertionAxis, item: Identified, style: LineStyle, label: str, name: str
) -> Curve:
    estimates, std = item.result.estimates, None
    if style is palette.OURS:
        spread = name.replace("_N_", "_std_N_").replace("_Ns_", "_std_Ns_")
        stated = [getattr(estimate, spread) for estimate in estimates]
        std = np.array([np.nan if one is None else one for one in stated])
    return Curve(
        style=style,
        x=axis.place(axis.truth.t_s[item.start :]),
        y=np.array([getattr(estimate, name) for estimate in estimates]),
        label=label,
        std=std,
        band_label=None if std is None else "ours, ± 2 std",
    )


def _limits(
    axis: InsertionAxis, curves: Sequence[Curve], found: Sequence[float]
) -> tuple[float, float]:
    """Room for the identified layers, the truth, and most of every curve, without transients."""
    sizes, (low, high) = [1e-9, *(1.1 * value for value in found)], axis.limits
    for curve in curves:
        inside = curve.y[(curve.x > low) & (curve.x < high) & np.isfinite(curve.y)]
        if curve.style is palette.TRUE_PART:
            sizes.append(1.4 * float(np.max(inside, initial=0.0)))
        elif len(inside):
            percent, room = (90.0, 1.6) if curve.style is palette.OURS else (70.0, 1.2)
            sizes.append(room * float(np.percentile(inside, percent)))
    return -0.2 * max(sizes), max(sizes)


AFTER_s = 1.0
NOT_FITTED = "#f0ead8"
MODELS: tuple[tuple[Model, str, LineStyle], ...] = (
    ("ml", "multi-layer", palette.OURS),
    ("kv", "Kelvin-Voigt", palette.PUBLISHED_KV),
)


def offline_chart(title: str, signal: NeedleSignal, truth: InsertionTruth) -> Chart:
    """F/T sensor's force, both models fitted to the insertion, and their errors.

    The withdrawal is predicted with the parameters of the insertion.
    """
    axis = InsertionAxis(truth)
    shown = truth.t_s >= truth.contact_s - AFTER_s
    x, reading = axis.place(truth.t_s[shown]), signal.force_N[shown]
    depth_m = signal.depth_m - np.interp(truth.contact_s, truth.t_s, signal.depth_m)
    spans, speed_m_s = layer_spans(truth), quiet_speed_m_s(signal)
    forces = [Curve(style=palette.READING, x=x, y=reading, label="force of the F/T sensor")]
    errors = []
    for model, name, style in MODELS:
        fit = offline_fit(signal, truth, model)
        matrix = regression_matrix(truth.t_s, depth_m, speed_m_s, spans, fit.model)
        parameters = [(layer.stiffness_N_per_m, layer.friction) for layer in fit.layers]
        predicted = (matrix @ np.array(parameters).ravel())[shown]
        label = f"{name} model, RMSE {fit.rmse_N:.3f} N"
        forces.append(Curve(style=style, x=x, y=predicted, label=label))
        errors.append(Curve(style=style, x=x, y=reading - predicted))
    (end,) = axis.at(truth.insertion_end_s)
    predicted_span = Shading("predicted, not fitted", NOT_FITTED, ((end, float(x[-1])),))
    return Chart(
        title=title,
        x_label=axis.label,
        panels=(
            Panel(y_label=palette.FORCE, curves=tuple(forces), height=1.7),
            Panel(y_label=palette.FORCE_ERROR, curves=tuple(errors)),
        ),
        shadings=(predicted_span, axis.true_ruptures()),
        x_limits=(float(x[0]), float(x[-1])),
        height_in=3.3,
    )
