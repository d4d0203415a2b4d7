"""Which figures of the identification a run gives, and the numbers beside them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.benchmark import Drawing, Fact, Job
from benchmarks.force_plots import RunFigures
from benchmarks.identification_metrics import Signals, enhanced_metrics, offline_metrics
from benchmarks.identification_plots import (
    SENSORS,
    Compared,
    enhanced_chart,
    offline_chart,
    parameter_chart,
    true_friction,
)
from benchmarks.methods import ForceReading, Identified, cumulative_friction_Ns_per_m, identify
from benchmarks.published_figures import ENHANCED_FIGURES, OFFLINE_PANELS, PublishedFigure
from benchmarks.signals import InsertionTruth, NeedleSignal
from benchmarks.targets import GELS
from identification import PUBLISHED, PUBLISHED_KV, PublishedConfig

Array = NDArray[np.float64]

# The published method as its authors ran it, for the counterparts of their figures.
#
# In the tables it runs as ours does: one setting for every recording, and the speed that the arm
# measures. Its authors changed σ₁ between recordings (0.03 to 0.15 N), and its figures show a speed
# without noise; with 0.12 mm/s of noise on 2.3 mm/s it takes noise for excitation, and on a force
# that lags by 0.2 s its CUSUM never alarms at the 0.08 N of the text.
SIGMA1_N = {"ft": 0.06, "virtual": 0.05}
"""By source: detects the small force drop of the 25 % gel, and the smeared ones of the residual."""
SIGMA1_OF_FIGURE_N = {"13": 0.04}
"""Where another is needed to find the ruptures that the published figure shows."""


def sigma1_N(figure: str, source: str) -> float:
    """The setting of a published figure."""
    return SIGMA1_OF_FIGURE_N.get(figure, SIGMA1_N[source])


def tuned_published(
    signal: NeedleSignal,
    truth: InsertionTruth,
    commanded_m_s: Array,
    figure: str = "",
    config: PublishedConfig = PUBLISHED,
) -> Identified:
    """Run the published method with the commanded speed, shape (n,), and the figure's own σ₁."""
    quiet = replace(signal, speed_m_s=commanded_m_s)
    tuned = replace(config, sigma1_N=sigma1_N(figure, signal.source))
    return identify(quiet, truth, "published", tuned)


def draw_identification(
    job: Job,
    folder: Path,
    truth: InsertionTruth,
    commanded_m_s: Array,
    found: Sequence[tuple[Signals, Sequence[Identified]]],
    ft: ForceReading | None = None,
) -> tuple[Drawing, ...]:
    """Every figure of the identification in a run.

    `found` holds of every source what the methods were given and what they made of it, the F/T
    sensor's first; `ft` is that sensor's force, if another source is among them.
    """
    figures = RunFigures(job, folder)
    _add_offline(figures, found[0][0]["default"], truth)
    on_ft = {item.method: item for item in found[0][1]}["default"]
    # Without a published counterpart: the whole chain; of gels, for Table I, the F/T sensor.
    usual = "ft" if job.benchmark in GELS or len(found) == 1 else "virtual"
    for signals, identified in found:
        by_method = {item.method: item for item in identified}
        source, given = by_method["default"].source, signals["published"]
        figure = ENHANCED_FIGURES.get((job.benchmark, source))
        if figure is None and source != usual:
            continue
        is_ft, number = source == "ft", figure.number if figure else ""
        kelvin_voigt = None
        if figure and is_ft:
            kelvin_voigt = tuned_published(given, truth, commanded_m_s, number, PUBLISHED_KV)
        compared = Compared(
            ours=by_method["default"],
            tuned=tuned_published(given, truth, commanded_m_s, number),
            published=by_method["published"],
            kelvin_voigt=kelvin_voigt,
            ft=None if is_ft else ft,
            on_ft=None if is_ft else on_ft,
        )
        _add_enhanced(figures, figure, truth, compared)
        if figure:
            _add_parameters(figures, number, truth, compared)
    return tuple(figures.saved)


def _add_offline(figures: RunFigures, signal: NeedleSignal, truth: InsertionTruth) -> None:
    """Both models on the F/T sensor's force, where that scenario is published so."""
    scenario = figures.job.benchmark
    if scenario not in OFFLINE_PANELS:
        return
    found, panel = offline_metrics(signal, truth), OFFLINE_PANELS[scenario]
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
    figures: RunFigures, figure: PublishedFigure | None, truth: InsertionTruth, compared: Compared
) -> None:
    """The forces by each method."""
    source, tuned, ft = compared.ours.source, compared.tuned, compared.ft
    number = figure.number if figure else ""
    sensor, has_speed = SENSORS[source], number == "9"
    alt = f"Axial force of the {sensor}, predicted force and enhanced force, with the true one, "
    none = "" if tuned.alarms else " No rupture was detected, so nothing is subtracted."
    friction = cumulative_friction_Ns_per_m(tuned.alarms) if source == "ft" else math.nan
    title = f"friction compensation by the published method, {sensor}"
    figures.add(
        enhanced_chart(title, truth, tuned, compared.kelvin_voigt, ft, has_speed=has_speed),
        f"{source}-published",
        panel=(number, "a" if number else ""),
        alt=f"{alt}published method",
        caption="Axial forces [N] over time [s]. The published method with the settings of its "
        f"authors: commanded speed, σ₁ = {sigma1_N(number, source):g} N.{none}",
        tuned_friction_Ns_per_m=friction,
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


def _facts(figure: PublishedFigure, truth: InsertionTruth, compared: Compared) -> tuple[Fact, ...]:
    heads = ("published, tuned, here", "published, one setting, here", "ours, one setting, here")
    items = (compared.tuned, compared.published, compared.ours)
    _, steps = true_friction(truth)["cumulative_friction_Ns_per_m"]
    friction = [f"{cumulative_friction_Ns_per_m(item.alarms):.0f}" for item in items]
    forces = [enhanced_metrics(item, truth) for item in items]
    remaining = [f"{each.get('remaining_force_pct', math.nan):.1f}" for each in forces]
    lines = (
        (
            f"ruptures detected (true: {len(truth.ruptures)})",
            figure.ruptures,
            [_ruptures(item, truth) for item in items],
        ),
        (
            f"cumulative friction in the end (true: {steps[-1]:.0f}) [Ns/m]",
            figure.friction,
            friction,
        ),
        (
            "remaining force after the last rupture [% of the axial force]",
            figure.remaining,
            remaining,
        ),
    )
    return tuple(
        Fact(what=what, published=published, here=tuple(zip(heads, texts, strict=True)))
        for what, published, texts in lines
    )


def _ruptures(item: Identified, truth: InsertionTruth) -> str:
    """Those of the insertion; in the withdrawal there are none to find."""
    inside = [alarm.alarm_s for alarm in item.alarms if alarm.alarm_s <= truth.insertion_end_s]
    times = ", ".join(f"{alarm_s - truth.tare_end_s:.1f}" for alarm_s in inside)
    return f"{len(inside)}, at {times} s" if inside else "none"
