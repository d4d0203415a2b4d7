"""Figures of the identification in one run, and the numbers beside them.

After the published Figures 2, 3, 8, 9 and 11 to 14. The clock starts where the tare
stroke ends and the needle sets out, as in the publication.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.insertion.methods import (
    ForceReading,
    Identified,
    cumulative_friction_Ns_per_m,
)
from benchmarks.insertion.metrics import IdentifiedRun
from benchmarks.insertion.offline import layer_spans, offline_fit, quiet_speed_m_s
from benchmarks.insertion.signals import InsertionTruth, NeedleSignal
from benchmarks.jobs import Drawing, Fact, Job
from benchmarks.judging import GELS
from benchmarks.report.force_plots import RunFigures
from benchmarks.report.published_figures import (
    ENHANCED_FIGURES,
    OFFLINE_PANELS,
    PublishedFigure,
)
from benchmarks.results import Figure
from foundation.arrays import Array
from identification import PublishedConfig
from identification.config import Model
from identification.published.offline import regression_matrix
from needleforce.plots import Chart, Curve, Instants, LineStyle, Panel, Shading, palette

Numbers = Mapping[tuple[str, str, str], float]
"""Of a run, by source, method and metric."""


def draw_identification(
    job: Job,
    folder: Path,
    identified: IdentifiedRun,
    numbers_measured: Sequence[Figure],
    kelvin_voigt: Identified | None = None,
) -> tuple[Drawing, ...]:
    """Draw every figure of the identification in a run.

    Args:
        job: The run.
        folder: Where the figures are saved.
        identified: What every method made of each source.
        numbers_measured: The numbers of the run.
        kelvin_voigt: The published method with its simpler model on the F/T sensor's
            force, for scenarios of which that is published.
    """
    figures = RunFigures(job, folder)
    numbers = {
        (item.source, item.method, item.metric): float(item.value)
        for item in numbers_measured
    }
    on_ft = {item.method: item for item in identified.sources[0]}["ours"]
    add_offline(figures, on_ft, identified.truth, numbers)
    # Without a published counterpart: the whole chain; of gels, for Table I, the F/T
    # sensor.
    is_ft_usual = job.benchmark in GELS or len(identified.sources) == 1
    usual = "ft" if is_ft_usual else "virtual"
    for items in identified.sources:
        source = items[0].source
        figure = ENHANCED_FIGURES.get((job.benchmark, source))
        if figure is None and source != usual:
            continue
        by_method = {item.method: item for item in items}
        is_ft = source == "ft"
        beside = kelvin_voigt if figure and is_ft else None
        ft = None if is_ft else identified.ft
        truth = identified.truth
        add_enhanced(figures, figure, truth, by_method, beside, ft, numbers)
        if figure:
            others = (None if is_ft else on_ft, beside)
            add_parameters(figures, figure.number, truth, by_method, others)
    return tuple(figures.saved)


def add_offline(
    figures: RunFigures, on_ft: Identified, truth: InsertionTruth, numbers: Numbers
) -> None:
    """Draw both models on the F/T sensor's force, where that is published."""
    scenario = figures.job.benchmark
    if scenario not in OFFLINE_PANELS:
        return
    panel = OFFLINE_PANELS[scenario]
    fact = {
        "": f"`{scenario}`: RMSE of the insertion [N]",
        "published": "ML below KV",
        "Kelvin-Voigt, here": f"{numbers['ft', 'ours', 'offline_rmse_kv_N']:.3f}",
        "multi-layer, here": f"{numbers['ft', 'ours', 'offline_rmse_ml_N']:.3f}",
    }
    figures.add(
        offline_chart("both models, fitted offline", on_ft.signal, truth),
        "offline",
        panel=panel,
        alt="Force of the F/T sensor, and as reconstructed by the Kelvin-Voigt and "
        "the multi-layer model; below, the errors",
        caption="Axial force of the F/T sensor [N] over time [s], and the two models "
        "fitted to the insertion with true layers and ruptures given; below, measured "
        "minus modelled force. Triangles mark where a curve leaves its panel. RMSE "
        "from first contact to the deepest point.",
        facts=(fact,),
        is_alone=not panel[1],
    )


def add_enhanced(
    figures: RunFigures,
    figure: PublishedFigure | None,
    truth: InsertionTruth,
    by_method: Mapping[str, Identified],
    kelvin_voigt: Identified | None,
    ft: ForceReading | None,
    numbers: Numbers,
) -> None:
    """Draw the forces by each method."""
    ours = by_method["ours"]
    source = ours.source
    tuned = by_method["published-as-authors-ran"]
    assert isinstance(tuned.config, PublishedConfig)
    number = figure.number if figure else ""
    sensor = SENSORS[source]
    has_speed = number == "9"
    alt = (
        f"Axial force of the {sensor}, predicted force and enhanced force, "
        "with the true one, "
    )
    none = "" if tuned.alarms else " No rupture was detected, so nothing is subtracted."
    title = f"friction compensation by the published method, {sensor}"
    figures.add(
        enhanced_chart(title, truth, tuned, kelvin_voigt, ft, has_speed=has_speed),
        f"{source}-published",
        panel=(number, "a" if number else ""),
        alt=f"{alt}published method",
        caption="Axial forces [N] over time [s]. The published method with the "
        f"settings of its authors: commanded speed, σ₁ = {tuned.config.sigma1_N:g} "
        f"N.{none}",
    )
    title = f"friction compensation by our method, {sensor}"
    figures.add(
        enhanced_chart(title, truth, ours, None, ft, has_speed=has_speed),
        f"{source}-ours",
        panel=(number, "b" if number else ""),
        alt=f"{alt}our method",
        caption="The same by our method: measured speed, one setting for every "
        "recording.",
        facts=enhanced_facts(figure, truth, by_method, numbers) if figure else (),
    )


def add_parameters(
    figures: RunFigures,
    number: str,
    truth: InsertionTruth,
    by_method: Mapping[str, Identified],
    others: tuple[Identified | None, Identified | None],
) -> None:
    """Draw stiffness, friction and cumulative friction as they are identified.

    `others` are ours on the F/T sensor's force, and the Kelvin-Voigt model, if shown.
    """
    ours = by_method["ours"]
    source = ours.source
    title = f"identified parameters, {SENSORS[source]}"
    tuned = by_method["published-as-authors-ran"]
    figures.add(
        parameter_chart(title, truth, ours, *others, tuned),
        f"{source}-parameters",
        panel=(number, "c"),
        alt="Stiffness, friction per length and cumulative friction over time, both "
        "methods",
        caption="From above: stiffness K and friction B of the layer the tip is in, "
        "and cumulative friction of the layers traversed, over time [s]. At constant "
        "speed K and B cannot be separated before the rupture, hence the broad band "
        "of two standard deviations. Triangles mark where a curve leaves its panel, "
        "with its farthest value.",
        is_alone=True,
    )


def enhanced_facts(
    figure: PublishedFigure,
    truth: InsertionTruth,
    by_method: Mapping[str, Identified],
    numbers: Numbers,
) -> tuple[Fact, ...]:
    """Return the numbers that stand below a published figure."""
    methods = {
        "published-as-authors-ran": "published, tuned, here",
        "published-one-setting": "published, one setting, here",
        "ours": "ours, one setting, here",
    }
    items = [by_method[method] for method in methods]
    _, steps = true_friction(truth)["cumulative_friction_Ns_per_m"]
    ruptures = [describe_ruptures(item, truth) for item in items]
    sums = [f"{cumulative_friction_Ns_per_m(item.alarms):.0f}" for item in items]
    keys = ((item.source, item.method, "remaining_force_pct") for item in items)
    remaining = [f"{numbers.get(key, math.nan):.1f}" for key in keys]
    lines = (
        (f"ruptures detected (true: {len(truth.ruptures)})", figure.ruptures, ruptures),
        (
            f"cumulative friction in the end (true: {steps[-1]:.0f}) [Ns/m]",
            figure.friction,
            sums,
        ),
        (
            "remaining force after the last rupture [% of the axial force]",
            figure.remaining,
            remaining,
        ),
    )
    return tuple(
        {"": quantity, "published": published}
        | dict(zip(methods.values(), texts, strict=True))
        for quantity, published, texts in lines
    )


def describe_ruptures(item: Identified, truth: InsertionTruth) -> str:
    """Describe the ruptures of the insertion.

    In the withdrawal there are none to find.
    """
    inside = [
        alarm.alarm_s for alarm in item.alarms if alarm.alarm_s <= truth.insertion_end_s
    ]
    times = ", ".join(f"{alarm_s - truth.tare_end_s:.1f}" for alarm_s in inside)
    return f"{len(inside)}, at {times} s" if inside else "none"


MARGIN_s = 1.0
"""Shown before contact and after the deepest point."""
SENSORS = {"ft": "F/T sensor", "virtual": "virtual sensor"}
WHOSE = {
    "ours": (palette.OURS, "ours"),
    "published-one-setting": (palette.PUBLISHED, "published, one setting"),
    "published-as-authors-ran": (palette.PUBLISHED, "published, as its authors ran it"),
}


def _limits_s(truth: InsertionTruth) -> tuple[float, float]:
    """Return the limits from just before contact to just after the deepest point."""
    zero = truth.tare_end_s
    return truth.contact_s - MARGIN_s - zero, truth.insertion_end_s + MARGIN_s - zero


def _true_ruptures(truth: InsertionTruth) -> Shading:
    """Return when layers ruptured: from the onset to the end of the release."""
    zero = truth.tare_end_s
    spans = tuple((item.onset_s - zero, item.end_s - zero) for item in truth.ruptures)
    # A layer ruptures within 0.1 s of a minute; 4 points wide its shade is seen.
    return Shading("true rupture", palette.TRUE_RUPTURE, spans, 4.0)


def _times_s(item: Identified, truth: InsertionTruth) -> Array:
    """Time of every estimate of a method."""
    return truth.t_s[item.start :] - truth.tare_end_s


def _events(item: Identified, truth: InsertionTruth) -> tuple[Instants, Instants]:
    """Return alarms, and where friction was identified, by a method."""
    alarms = tuple(alarm.alarm_s - truth.tare_end_s for alarm in item.alarms)
    is_identified = [
        estimate.identified_layer is not None for estimate in item.result.estimates
    ]
    identified = tuple(_times_s(item, truth)[is_identified].tolist())
    return (
        Instants("rupture detected", palette.RUPTURE, alarms),
        Instants("friction identified", palette.COMPENSATION, identified),
    )


def enhanced_chart(
    title: str,
    truth: InsertionTruth,
    item: Identified,
    kelvin_voigt: Identified | None = None,
    ft: ForceReading | None = None,
    *,
    has_speed: bool = False,
) -> Chart:
    """Return measured, predicted and enhanced force of one method with its events.

    Beside it the same with the Kelvin-Voigt model, the F/T sensor's force where the
    method was given another, and the profile of the speed, as in Figure 9.
    """
    x = _times_s(item, truth)
    whole = truth.t_s - truth.tare_end_s
    top_N = float(truth.axial_N[truth.is_insertion].max())
    drawn: list[tuple[LineStyle, Array, Array, str]] = []
    if has_speed:
        profile = truth.speed_m_s / float(np.max(truth.speed_m_s[truth.is_insertion]))
        drawn.append(
            (palette.OTHER_DASHED, whole, 0.5 * top_N * profile, "speed, not to scale")
        )
    if ft is not None:
        drawn.append(
            (palette.OTHER_SENSOR, whole, ft.axial_N, "force of the F/T sensor")
        )
    drawn += [
        (palette.READING, x, item.force_N, f"force of the {SENSORS[item.source]}"),
        (palette.PREDICTED, x, item.series("predicted_force_N"), "predicted force"),
    ]
    if kelvin_voigt is not None:
        there = _times_s(kelvin_voigt, truth)
        label = "enhanced force, Kelvin-Voigt"
        drawn.append(
            (
                palette.PUBLISHED_KV,
                there,
                kelvin_voigt.series("enhanced_force_N"),
                label,
            )
        )
    enhanced, who = WHOSE[item.method]
    drawn += [
        (enhanced, x, item.series("enhanced_force_N"), f"enhanced force, {who}"),
        (palette.TRUE_PART, whole, truth.enhanced_N, "true enhanced force"),
    ]
    curves = tuple(
        Curve(style=style, x=x, y=y, label=label) for style, x, y, label in drawn
    )
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=(
            Panel(
                y_label=palette.FORCE,
                curves=curves,
                limits=(-0.25 * top_N, 1.15 * top_N),
            ),
        ),
        shadings=(_true_ruptures(truth),),
        instants=_events(item, truth),
        x_limits=_limits_s(truth),
        height_in=2.9,
    )


def true_friction(truth: InsertionTruth) -> dict[str, tuple[Array, Array]]:
    """Return steps over time, by the name of the estimate they belong to.

    True friction is no coefficient (it also depends on speed in other ways): these are
    its values at each rupture, friction over speed, and that over the travel since the
    rupture before. There is no one true stiffness, and none is given.
    """
    times: list[float] = []
    local: list[float] = []
    total: list[float] = []
    start_s = truth.contact_s
    start_m = 0.0
    sum_before = 0.0
    for rupture in truth.ruptures:
        speed = float(np.interp(rupture.onset_s, truth.t_s, truth.speed_m_s))
        product = rupture.layer_friction_N / speed
        thickness = rupture.onset_m - start_m
        times += [start_s, rupture.onset_s, rupture.onset_s]
        local += [product / thickness, product / thickness, np.nan]
        total += [sum_before, sum_before, np.nan]
        start_s = rupture.onset_s
        start_m = rupture.onset_m
        sum_before = sum_before + product
    ends = [start_s, float(truth.insertion_end_s)]
    sums = np.array([*total, sum_before, sum_before])
    return {
        "friction_Ns_per_m2": (np.array(times), np.array(local)),
        "cumulative_friction_Ns_per_m": (np.array(times + ends), sums),
    }


def parameter_chart(
    title: str,
    truth: InsertionTruth,
    ours: Identified,
    on_ft: Identified | None,
    kelvin_voigt: Identified | None,
    tuned: Identified,
) -> Chart:
    """Return stiffness, friction and cumulative friction of every method.

    The Kelvin-Voigt model's friction has another unit and is drawn only where the units
    agree.

    Args:
        title: Of the chart.
        truth: The insertion with its ground truth.
        ours: One setting for everything.
        on_ft: Ours on the F/T sensor's force, where the force was another.
        kelvin_voigt: `tuned` with the Kelvin-Voigt model, if shown.
        tuned: The published method with the settings of its authors.
    """
    true = true_friction(truth)
    drawn = (
        (ours, palette.OURS, "ours"),
        (on_ft, palette.OTHER_DASHED, "ours on the F/T sensor's force"),
        (kelvin_voigt, palette.PUBLISHED_KV, "published, Kelvin-Voigt"),
        (tuned, palette.PUBLISHED, "published"),
    )
    panels = []
    parameters = {
        "stiffness_N_per_m": palette.STIFFNESS,
        "friction_Ns_per_m2": palette.FRICTION,
        "cumulative_friction_Ns_per_m": palette.CUMULATIVE_FRICTION,
    }
    for name, label in parameters.items():
        curves = [
            _parameter(item, truth, style, text, name)
            for item, style, text in drawn
            if item is not None
            and (item is not kelvin_voigt or name != "friction_Ns_per_m2")
        ]
        if name in true:
            t_s, values = true[name]
            x = t_s - truth.tare_end_s
            curves.append(
                Curve(style=palette.TRUE_PART, x=x, y=values, label="ground truth")
            )
        layers = [alarm.layer for alarm in ours.alarms if alarm.layer is not None]
        identified_values = [
            getattr(layer, name) for layer in layers if hasattr(layer, name)
        ]
        limits = _parameter_limits(_limits_s(truth), curves, identified_values)
        panels.append(Panel(y_label=label, curves=tuple(curves), limits=limits))
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=tuple(panels),
        shadings=(_true_ruptures(truth),),
        instants=_events(ours, truth),
        x_limits=_limits_s(truth),
        height_in=4.6,
    )


def _parameter(
    item: Identified, truth: InsertionTruth, style: LineStyle, label: str, name: str
) -> Curve:
    """Return the curve of a parameter, ours with its stated deviation."""
    spread = name.replace("_N_", "_std_N_").replace("_Ns_", "_std_Ns_")
    std = item.series(spread) if style is palette.OURS else None
    x = _times_s(item, truth)
    y = item.series(name)
    band = "ours, ± 2 std"
    return Curve(style=style, x=x, y=y, label=label, std=std, band_label=band)


def _parameter_limits(
    shown_s: tuple[float, float],
    curves: Sequence[Curve],
    identified_values: Sequence[float],
) -> tuple[float, float]:
    """Return limits that hold the identified layers, the truth and most curves.

    Transients are left out.
    """
    sizes = [1e-9, *(1.1 * value for value in identified_values)]
    low, high = shown_s
    for curve in curves:
        inside = curve.y[(curve.x > low) & (curve.x < high) & np.isfinite(curve.y)]
        if curve.style is palette.TRUE_PART:
            sizes.append(1.4 * float(np.max(inside, initial=0.0)))
        elif len(inside):
            percent, room = (90.0, 1.6) if curve.style is palette.OURS else (70.0, 1.2)
            sizes.append(room * float(np.percentile(inside, percent)))
    return -0.2 * max(sizes), max(sizes)


def offline_chart(title: str, signal: NeedleSignal, truth: InsertionTruth) -> Chart:
    """Return the F/T force, both models fitted to it, and their errors.

    The withdrawal is predicted with the parameters of the insertion.
    """
    shown = truth.t_s >= truth.contact_s - MARGIN_s
    x = truth.t_s[shown] - truth.tare_end_s
    reading = signal.force_N[shown]
    depth_m = signal.depth_m - np.interp(truth.contact_s, truth.t_s, signal.depth_m)
    spans = layer_spans(truth)
    speed_m_s = quiet_speed_m_s(signal)
    forces = [
        Curve(style=palette.READING, x=x, y=reading, label="force of the F/T sensor")
    ]
    errors = []
    models: tuple[tuple[Model, str, LineStyle], ...] = (
        ("ml", "multi-layer", palette.OURS),
        ("kv", "Kelvin-Voigt", palette.PUBLISHED_KV),
    )
    for model, name, style in models:
        fit = offline_fit(signal, truth, model)
        matrix = regression_matrix(truth.t_s, depth_m, speed_m_s, spans, fit.model)
        parameters = [(layer.stiffness_N_per_m, layer.friction) for layer in fit.layers]
        predicted = (matrix @ np.array(parameters).ravel())[shown]
        label = f"{name} model, RMSE {fit.rmse_N:.3f} N"
        forces.append(Curve(style=style, x=x, y=predicted, label=label))
        errors.append(Curve(style=style, x=x, y=reading - predicted))
    end_s = truth.insertion_end_s - truth.tare_end_s
    span = ((end_s, float(x[-1])),)
    predicted_span = Shading("predicted, not fitted", "#f0ead8", span)
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=(
            Panel(y_label=palette.FORCE, curves=tuple(forces), height=1.7),
            Panel(y_label=palette.FORCE_ERROR, curves=tuple(errors)),
        ),
        shadings=(predicted_span, _true_ruptures(truth)),
        x_limits=(float(x[0]), float(x[-1])),
        height_in=3.3,
    )
