"""Which figures of the identification a run gives, and the numbers beside them."""

import math
from collections.abc import Sequence
from pathlib import Path

from benchmarks.insertion.methods import (
    ForceReading,
    Identified,
    cumulative_friction_Ns_per_m,
)
from benchmarks.insertion.metrics import (
    enhanced_metrics,
    identify_as_run,
    offline_metrics,
)
from benchmarks.insertion.signals import Array, InsertionTruth, NeedleSignal
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
from benchmarks.targets import GELS
from identification import PUBLISHED_KV, PublishedConfig


def draw_identification(
    job: Job,
    folder: Path,
    truth: InsertionTruth,
    commanded_m_s: Array,
    found: Sequence[Sequence[Identified]],
    ft: ForceReading | None = None,
) -> tuple[Drawing, ...]:
    """Every figure of the identification in a run.

    `found` holds what every method made of each source, the F/T sensor's first; `ft` is
    that sensor's force, if another source is among them.
    """
    figures = RunFigures(job, folder)
    on_ft = {item.method: item for item in found[0]}["ours"]
    _add_offline(figures, on_ft.signal, truth)
    # Without a published counterpart: the whole chain; of gels, for Table I, the F/T
    # sensor.
    usual = "ft" if job.benchmark in GELS or len(found) == 1 else "virtual"
    for identified in found:
        by_method = {item.method: item for item in identified}
        tuned = by_method["published-as-run"]
        source = identified[0].source
        figure = ENHANCED_FIGURES.get((job.benchmark, source))
        if figure is None and source != usual:
            continue
        is_ft = source == "ft"
        number = figure.number if figure else ""
        kelvin_voigt = None
        if figure and is_ft:
            kelvin_voigt = identify_as_run(
                tuned.signal, truth, commanded_m_s, config=PUBLISHED_KV
            )
        compared = Compared(
            ours=by_method["ours"],
            tuned=tuned,
            published=by_method["published"],
            kelvin_voigt=kelvin_voigt,
            ft=None if is_ft else ft,
            on_ft=None if is_ft else on_ft,
        )
        _add_enhanced(figures, figure, truth, compared)
        if figure:
            _add_parameters(figures, number, truth, compared)
    return tuple(figures.saved)


def _add_offline(
    figures: RunFigures, signal: NeedleSignal, truth: InsertionTruth
) -> None:
    """Both models on the F/T sensor's force, where that scenario is published so."""
    scenario = figures.job.benchmark
    if scenario not in OFFLINE_PANELS:
        return
    found = offline_metrics(signal, truth)
    panel = OFFLINE_PANELS[scenario]
    kv, ml = (f"{found[f'offline_rmse_{model}_N']:.3f}" for model in ("kv", "ml"))
    here = (("Kelvin-Voigt, here", kv), ("multi-layer, here", ml))
    what = f"`{scenario}`: RMSE of the insertion [N]"
    figures.add(
        offline_chart("both models, fitted offline", signal, truth),
        "offline",
        panel=panel,
        alt="Force of the F/T sensor, and as reconstructed by the Kelvin-Voigt and the multi-layer "
        "model; below, the errors",
        caption="Axial force of the F/T sensor [N] over time [s], and the two models fitted to the "
        "insertion with true layers and ruptures given; below, measured minus modelled force. "
        "Triangles mark where a curve leaves its panel. RMSE from first contact to the deepest "
        "point.",
        facts=(Fact(what=what, published="ML below KV", here=here),),
        is_alone=not panel[1],
    )


def _add_enhanced(
    figures: RunFigures,
    figure: PublishedFigure | None,
    truth: InsertionTruth,
    compared: Compared,
) -> None:
    """The forces by each method."""
    source = compared.ours.source
    tuned = compared.tuned
    ft = compared.ft
    assert isinstance(tuned.config, PublishedConfig)
    number = figure.number if figure else ""
    sensor = SENSORS[source]
    has_speed = number == "9"
    alt = f"Axial force of the {sensor}, predicted force and enhanced force, with the true one, "
    none = "" if tuned.alarms else " No rupture was detected, so nothing is subtracted."
    title = f"friction compensation by the published method, {sensor}"
    figures.add(
        enhanced_chart(
            title, truth, tuned, compared.kelvin_voigt, ft, has_speed=has_speed
        ),
        f"{source}-published",
        panel=(number, "a" if number else ""),
        alt=f"{alt}published method",
        caption="Axial forces [N] over time [s]. The published method with the settings of its "
        f"authors: commanded speed, σ₁ = {tuned.config.sigma1_N:g} N.{none}",
    )
    title = f"friction compensation by our method, {sensor}"
    figures.add(
        enhanced_chart(title, truth, compared.ours, None, ft, has_speed=has_speed),
        f"{source}-ours",
        panel=(number, "b" if number else ""),
        alt=f"{alt}our method",
        caption="The same by our method: measured speed, one setting for every recording.",
        facts=_facts(figure, truth, compared) if figure else (),
    )


def _add_parameters(
    figures: RunFigures, number: str, truth: InsertionTruth, compared: Compared
) -> None:
    source = compared.ours.source
    figures.add(
        parameter_chart(f"identified parameters, {SENSORS[source]}", truth, compared),
        f"{source}-parameters",
        panel=(number, "c"),
        alt="Stiffness, friction per length and cumulative friction over time, both methods",
        caption="From above: stiffness K and friction B of the layer the tip is in, and cumulative "
        "friction of the layers traversed, over time [s]. At constant speed K and B cannot be "
        "separated before the rupture, hence the broad band of two standard deviations. Triangles "
        "mark where a curve leaves its panel, with its farthest value.",
        is_alone=True,
    )


def _facts(
    figure: PublishedFigure, truth: InsertionTruth, compared: Compared
) -> tuple[Fact, ...]:
    heads = (
        "published, tuned, here",
        "published, one setting, here",
        "ours, one setting, here",
    )
    items = (compared.tuned, compared.published, compared.ours)
    _, steps = true_friction(truth)["cumulative_friction_Ns_per_m"]
    ruptures = [_ruptures(item, truth) for item in items]
    sums = [f"{cumulative_friction_Ns_per_m(item.alarms):.0f}" for item in items]
    forces = [enhanced_metrics(item, truth) for item in items]
    left = [f"{each.get('remaining_force_pct', math.nan):.1f}" for each in forces]
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
            left,
        ),
    )
    return tuple(
        Fact(what=what, published=published, here=tuple(zip(heads, texts, strict=True)))
        for what, published, texts in lines
    )


def _ruptures(item: Identified, truth: InsertionTruth) -> str:
    """Those of the insertion; in the withdrawal there are none to find."""
    inside = [
        alarm.alarm_s for alarm in item.alarms if alarm.alarm_s <= truth.insertion_end_s
    ]
    times = ", ".join(f"{alarm_s - truth.tare_end_s:.1f}" for alarm_s in inside)
    return f"{len(inside)}, at {times} s" if inside else "none"
