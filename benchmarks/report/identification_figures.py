"""Which figures of the identification a run gives, and the numbers beside them."""

import math
from collections.abc import Sequence
from pathlib import Path

from benchmarks.insertion.methods import (
    Identified,
    cumulative_friction_Ns_per_m,
)
from benchmarks.insertion.metrics import IdentifiedRun
from benchmarks.insertion.signals import InsertionTruth
from benchmarks.jobs import Drawing, Fact, Job
from benchmarks.report.force_plots import RunFigures
from benchmarks.report.identification_plots import (
    SENSORS,
    Compared,
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
from benchmarks.results import Measurement
from benchmarks.targets import GELS
from identification import PublishedConfig


class RunNumbers:
    """Numbers of a run by source, method and metric."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        self._values = {
            (item.source, item.method, item.metric): item.value for item in measurements
        }

    def of(self, item: Identified, metric: str) -> float:
        """Return a number of one method on one source; nan where there is none."""
        return self._values.get((item.source, item.method, metric), math.nan)


def draw_identification(
    job: Job,
    folder: Path,
    identified: IdentifiedRun,
    measurements: Sequence[Measurement],
    kelvin_voigt: Identified | None = None,
) -> tuple[Drawing, ...]:
    """Draw every figure of the identification in a run.

    Args:
        job: The run.
        folder: Where the figures are saved.
        identified: What every method made of each source.
        measurements: The numbers of the run.
        kelvin_voigt: The published method with its simpler model on the F/T sensor's
            force, for scenarios of which that is published.
    """
    figures = RunFigures(job, folder)
    numbers = RunNumbers(measurements)
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
        compared = Compared(
            ours=by_method["ours"],
            tuned=by_method["published-as-authors-ran"],
            published=by_method["published-one-setting"],
            kelvin_voigt=kelvin_voigt if figure and is_ft else None,
            ft=None if is_ft else identified.ft,
            on_ft=None if is_ft else on_ft,
        )
        add_enhanced(figures, figure, identified.truth, compared, numbers)
        if figure:
            add_parameters(figures, figure.number, identified.truth, compared)
    return tuple(figures.saved)


def add_offline(
    figures: RunFigures, on_ft: Identified, truth: InsertionTruth, numbers: RunNumbers
) -> None:
    """Draw both models on the F/T sensor's force, where that is published."""
    scenario = figures.job.benchmark
    if scenario not in OFFLINE_PANELS:
        return
    panel = OFFLINE_PANELS[scenario]
    here = tuple(
        (f"{model}, here", f"{numbers.of(on_ft, metric):.3f}")
        for model, metric in (
            ("Kelvin-Voigt", "offline_rmse_kv_N"),
            ("multi-layer", "offline_rmse_ml_N"),
        )
    )
    quantity = f"`{scenario}`: RMSE of the insertion [N]"
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
        facts=(Fact(what=quantity, published="ML below KV", here=here),),
        is_alone=not panel[1],
    )


def add_enhanced(
    figures: RunFigures,
    figure: PublishedFigure | None,
    truth: InsertionTruth,
    compared: Compared,
    numbers: RunNumbers,
) -> None:
    """Draw the forces by each method."""
    source = compared.ours.source
    tuned = compared.tuned
    ft = compared.ft
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
        enhanced_chart(
            title, truth, tuned, compared.kelvin_voigt, ft, has_speed=has_speed
        ),
        f"{source}-published",
        panel=(number, "a" if number else ""),
        alt=f"{alt}published method",
        caption="Axial forces [N] over time [s]. The published method with the "
        f"settings of its authors: commanded speed, σ₁ = {tuned.config.sigma1_N:g} "
        f"N.{none}",
    )
    title = f"friction compensation by our method, {sensor}"
    figures.add(
        enhanced_chart(title, truth, compared.ours, None, ft, has_speed=has_speed),
        f"{source}-ours",
        panel=(number, "b" if number else ""),
        alt=f"{alt}our method",
        caption="The same by our method: measured speed, one setting for every "
        "recording.",
        facts=enhanced_facts(figure, truth, compared, numbers) if figure else (),
    )


def add_parameters(
    figures: RunFigures, number: str, truth: InsertionTruth, compared: Compared
) -> None:
    """Draw stiffness, friction and cumulative friction as they are identified."""
    source = compared.ours.source
    figures.add(
        parameter_chart(f"identified parameters, {SENSORS[source]}", truth, compared),
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
    compared: Compared,
    numbers: RunNumbers,
) -> tuple[Fact, ...]:
    """Return the numbers that stand below a published figure."""
    heads = (
        "published, tuned, here",
        "published, one setting, here",
        "ours, one setting, here",
    )
    items = (compared.tuned, compared.published, compared.ours)
    _, steps = true_friction(truth)["cumulative_friction_Ns_per_m"]
    ruptures = [describe_ruptures(item, truth) for item in items]
    sums = [f"{cumulative_friction_Ns_per_m(item.alarms):.0f}" for item in items]
    remaining = [f"{numbers.of(item, 'remaining_force_pct'):.1f}" for item in items]
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
        Fact(
            what=quantity,
            published=published,
            here=tuple(zip(heads, texts, strict=True)),
        )
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
