"""Which figures of the identification a run gives, and the numbers beside them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.insertion.methods import (
    ForceReading,
    Identified,
    cumulative_friction_Ns_per_m,
)
from benchmarks.insertion.metrics import IdentifiedRun
from benchmarks.insertion.signals import InsertionTruth
from benchmarks.jobs import Drawing, Fact, Job
from benchmarks.judging import GELS
from benchmarks.report.force_plots import RunFigures
from benchmarks.report.identification_plots import (
    SENSORS,
    enhanced_chart,
    offline_chart,
    parameter_chart,
    true_friction,
)
from benchmarks.report.published_figures import (
    ENHANCED_FIGURES,
    OFFLINE_PANELS,
    PublishedFigure,
)
from benchmarks.results import Figure
from identification import PublishedConfig

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
