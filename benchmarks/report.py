"""Our counterparts of the figures of Ferro et al. that single runs draw.

Each run draws into the folder of its job; `write_report` makes a page of the drawings.
The clock of the drawings starts where the tare ends and the needle sets out, as in the
publication. `published_figures.toml` says what is published, and what to compare. What
they state of all gels together (Figure 10, Table I) is in docs/reference/results.md.
"""

import tomllib
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from benchmarks.insertion.methods import ForceReading, Identified, identify_as_run
from benchmarks.insertion.offline import layer_spans, offline_fit, quiet_speed_m_s
from benchmarks.insertion.signals import ForceTruth, InsertionTruth, NeedleSignal
from benchmarks.jobs import Job
from foundation.arrays import Array
from identification import PUBLISHED_KV
from identification.config import Model
from identification.published.offline import regression_matrix

_FILE = tomllib.loads(
    Path(__file__).with_name("published_figures.toml").read_text(encoding="utf-8")
)
PUBLISHED = tuple(_FILE["figures"])
"""Figures in the order of the page."""
OURS = "tab:blue"
THEIRS = "tab:orange"
SENSORS = {"ft": "F/T sensor", "virtual": "virtual sensor"}


def published_number(kind: str, scenario: str) -> str:
    """Return the number of a published figure; empty where there is none.

    Args:
        kind: Of drawing: ``force``, ``offline``, or the source whose friction is
            compensated online.
        scenario: That is drawn.
    """
    numbers = [
        item["number"]
        for item in PUBLISHED
        if item["kind"] == kind and scenario in item["scenarios"]
    ]
    return numbers[0] if numbers else ""


def open_drawing(rows: int, columns: int = 1) -> tuple[Drawing, Array]:
    """Return a drawing and its axes, shape (rows, columns), times or depths shared."""
    drawing = Drawing(figsize=(11.0, 2.4 * rows + 0.8), layout="constrained")
    axes = drawing.subplots(rows, columns, sharex="col", squeeze=False)
    for item in axes.flat:
        item.grid(alpha=0.3)
    return drawing, axes


def save_drawing(drawing: Drawing, job: Job, kind: str) -> None:
    """Write a drawing into the folder of a job."""
    assert job.report is not None, "only a job with a folder draws"
    number = published_number(kind, job.benchmark)
    title = f"{job.benchmark}, {job.plant}, seed {job.seed}: {kind}"
    drawing.suptitle(f"Figure {number}: {title}" if number else title)
    for axes in drawing.axes:
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="small")
    name = f"figure-{number}-{job.benchmark}-{job.plant}-{job.seed}-{kind}.svg"
    drawing.savefig(job.report / name)


def draw_force(job: Job, truth: ForceTruth, readings: Sequence[ForceReading]) -> None:
    """Draw axial force and its error, over time and over depth, as in Figure 5."""
    drawing, axes = open_drawing(2, 2)
    styles = {
        ("ft", "ours"): ("F/T sensor", "0.6"),
        ("virtual", "ours"): ("virtual sensor, ours", OURS),
        ("virtual", "published-one-setting"): ("virtual sensor, published", THEIRS),
    }
    shown = (truth.t_s > max(truth.start_s - 2.0, truth.zeroed_s)) & (
        truth.t_s <= truth.end_s + 2.0
    )
    places = ((truth.t_s - truth.zeroed_s)[shown], 1e3 * truth.depth_m[shown])
    for column, (place, label) in enumerate(
        zip(places, ("time [s]", "depth [mm]"), strict=True)
    ):
        force_axes, error_axes = axes[:, column]
        for reading in readings:
            if (reading.source, reading.method) not in styles:
                continue
            name, color = styles[reading.source, reading.method]
            error_N = reading.axial_N - truth.axial_N
            rmse_N = np.sqrt(np.mean(error_N[truth.judged] ** 2))
            legend = f"{name}, RMSE {rmse_N:.3f} N"
            force_axes.plot(place, reading.axial_N[shown], color=color, label=legend)
            error_axes.plot(place, error_N[shown], color=color, linewidth=0.7)
        force_axes.plot(place, truth.axial_N[shown], "k:", label="true force")
        error_axes.set_xlabel(label)
    axes[0, 0].set_ylabel("axial force [N]")
    axes[1, 0].set_ylabel("error [N]")
    save_drawing(drawing, job, "force")


def draw_offline(job: Job, signal: NeedleSignal, truth: InsertionTruth) -> None:
    """Draw the F/T force, both models fitted to it, and their errors, as in Figure 2.

    The withdrawal is predicted with the parameters of the insertion.
    """
    drawing, axes = open_drawing(2)
    force_axes, error_axes = axes[:, 0]
    shown = truth.t_s >= truth.contact_s - 1.0
    time_s = truth.t_s[shown] - truth.tare_end_s
    force_N = signal.force_N[shown]
    depth_m = signal.depth_m - np.interp(truth.contact_s, truth.t_s, signal.depth_m)
    speed_m_s = quiet_speed_m_s(signal)
    force_axes.plot(time_s, force_N, color="0.6", label="force of the F/T sensor")
    models: Mapping[Model, tuple[str, str]] = {
        "ml": ("multi-layer", OURS),
        "kv": ("Kelvin-Voigt", THEIRS),
    }
    for model, (name, color) in models.items():
        fit = offline_fit(signal, truth, model)
        matrix = regression_matrix(
            truth.t_s, depth_m, speed_m_s, layer_spans(truth), fit.model
        )
        parameters = [(layer.stiffness_N_per_m, layer.friction) for layer in fit.layers]
        predicted_N = (matrix @ np.array(parameters).ravel())[shown]
        legend = f"{name} model, RMSE {fit.rmse_N:.3f} N"
        force_axes.plot(time_s, predicted_N, color=color, label=legend)
        error_axes.plot(time_s, force_N - predicted_N, color=color)
    insertion_end_s = truth.insertion_end_s - truth.tare_end_s
    for item in (force_axes, error_axes):
        item.axvspan(insertion_end_s, time_s[-1], color="0.95")  # predicted, not fitted
    force_axes.set_ylabel("axial force [N]")
    error_axes.set_ylabel("error [N]")
    error_axes.set_xlabel("time [s]")
    save_drawing(drawing, job, "offline")


def draw_identification(
    job: Job,
    source: str,
    items: Sequence[Identified],
    truth: InsertionTruth,
    commanded_m_s: Array,
) -> None:
    """Draw the enhanced force and the parameters by both methods, as in Figures 8, 9.

    And in 11 to 14. Of Figures 8 and 9 the Kelvin-Voigt model is drawn, too.

    Args:
        job: The run.
        source: Of the force.
        items: What every method made of it.
        truth: The insertion with its ground truth.
        commanded_m_s: Commanded speed, shape (n,).
    """
    drawing, axes = open_drawing(5)
    by_method = {item.method: item for item in items}
    ours = by_method["ours"]
    drawn = {
        "published": (by_method["published-as-authors-ran"], THEIRS),
        "ours": (ours, OURS),
    }
    if source == "ft" and published_number(source, job.benchmark):
        kelvin_voigt = identify_as_run(
            ours.signal, truth, commanded_m_s, config=PUBLISHED_KV
        )
        drawn["published, Kelvin-Voigt"] = (kelvin_voigt, "tab:red")
    time_s = truth.t_s - truth.tare_end_s
    for panel, name in ((0, "published"), (1, "ours")):
        item, color = drawn[name]
        since_s = time_s[item.start :]
        panel_axes = axes[panel, 0]
        panel_axes.plot(since_s, item.force_N, color="0.6", label=SENSORS[source])
        for quantity, style in (("predicted", "--"), ("enhanced", "-")):
            force_N = item.series(f"{quantity}_force_N")
            panel_axes.plot(
                since_s, force_N, style, color=color, label=f"{quantity}, {name}"
            )
        panel_axes.plot(time_s, truth.enhanced_N, "k:", label="true enhanced force")
        mark_events(panel_axes, item, truth)
        top_N = float(truth.axial_N[truth.is_insertion].max())
        panel_axes.set_ylim(-0.25 * top_N, 1.15 * top_N)
        panel_axes.set_ylabel("force [N]")
    parameters = {
        "stiffness_N_per_m": "stiffness [N/m]",
        "friction_Ns_per_m2": "friction [Ns/m²]",
        "cumulative_friction_Ns_per_m": "cumulative friction [Ns/m]",
    }
    for panel_axes, (parameter, label) in zip(
        axes[2:, 0], parameters.items(), strict=True
    ):
        for name, (item, color) in drawn.items():
            values = item.series(parameter)
            panel_axes.plot(time_s[item.start :], values, color=color, label=name)
        shown = ours.series(parameter)[truth.is_insertion[ours.start :]]
        top = float(np.nanpercentile(shown, 90.0)) if np.isfinite(shown).any() else 1.0
        panel_axes.set_ylim(-0.2 * top, 2.0 * top + 1e-9)
        panel_axes.set_ylabel(label)
    draw_true_friction(axes[3, 0], axes[4, 0], truth)
    axes[4, 0].set_xlabel("time [s]")
    axes[4, 0].set_xlim(
        truth.contact_s - truth.tare_end_s - 1.0,
        truth.insertion_end_s - truth.tare_end_s + 1.0,
    )
    save_drawing(drawing, job, source)


def mark_events(axes: Axes, item: Identified, truth: InsertionTruth) -> None:
    """Mark alarms, identified friction and true ruptures."""
    for rupture in truth.ruptures:
        axes.axvline(rupture.onset_s - truth.tare_end_s, color="0.8", linewidth=4.0)
    alarms_s = [alarm.alarm_s - truth.tare_end_s for alarm in item.alarms]
    axes.plot(alarms_s, np.zeros(len(alarms_s)), "r|", label="rupture detected")
    is_identified = [
        estimate.identified_layer is not None for estimate in item.result.estimates
    ]
    times_s = (truth.t_s[item.start :] - truth.tare_end_s)[is_identified]
    axes.plot(times_s, np.zeros(len(times_s)), "g.", label="friction identified")


def draw_true_friction(local: Axes, total: Axes, truth: InsertionTruth) -> None:
    """Draw true friction of the layers, and of all traversed, as steps over time.

    True friction is no coefficient (it also depends on speed in other ways): these are
    its values at each rupture, friction over speed, and that over the travel since the
    rupture before.
    """
    onsets_s = np.array([rupture.onset_s for rupture in truth.ruptures])
    depths_m = [rupture.onset_m for rupture in truth.ruptures]
    frictions_N = np.array([rupture.layer_friction_N for rupture in truth.ruptures])
    if not len(onsets_s):
        return
    products = frictions_N / np.interp(onsets_s, truth.t_s, truth.speed_m_s)
    starts_s = np.array([truth.contact_s, *onsets_s]) - truth.tare_end_s
    densities = products / np.diff([0.0, *depths_m])
    local.step(starts_s, [*densities, np.nan], "k:", where="post", label="truth")
    sums = np.cumsum([0.0, *products])
    times_s = [*starts_s, truth.insertion_end_s - truth.tare_end_s]
    total.step(times_s, [*sums, sums[-1]], "k:", where="post", label="truth")


def write_report(folder: Path, results: pd.DataFrame) -> None:
    """Write ``index.html``: every figure that the runs have drawn."""
    parts = [
        "<!DOCTYPE html><meta charset=utf-8><title>Figures of the paper</title>",
        "<style>body{max-width:70em;margin:auto}img{width:100%}</style>",
    ]
    for item in PUBLISHED:
        drawings = sorted(folder.glob(f"figure-{item['number']}-*.svg"))
        if not drawings:
            continue
        parts.append(f"<h2>Figure {item['number']}: {escape(item['title'])}</h2>")
        parts += describe_published(item)
        parts += [f"<img src='{escape(path.name)}'>" for path in drawings]
    parts.append("<h2>Further runs</h2>")
    parts += [f"<img src='{escape(path.name)}'>" for path in folder.glob("figure--*")]
    numbers = results.groupby(["scenario", "plant", "source", "method", "metric"])
    parts.append(
        numbers["value"].median().unstack().T.to_html(float_format="{:.4g}".format)
    )
    (folder / "index.html").write_text("\n".join(parts), encoding="utf-8")


def describe_published(item: Mapping[str, Any]) -> list[str]:
    """Return paragraphs: what is published, and what to compare in ours."""
    texts = [f"Published: {item['shows']}", f"To compare: {item['see']}"]
    said = {
        name: item[name]
        for name in ("ruptures", "friction", "remaining")
        if name in item
    }
    if said:
        texts.append(_FILE["enhanced"])
        texts.append("Its text: " + "; ".join(f"{k}: {v}" for k, v in said.items()))
    return [f"<p>{escape(text)}</p>" for text in texts]
