"""A picture after the paper's Figure 8: forces; stiffness, friction, cumulative friction below."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from numpy.typing import NDArray

from benchmarks.identified import Identified
from benchmarks.insertion_truth import InsertionTruth

matplotlib.use("Agg")

# After the backend is chosen: a report is written without a screen.
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

Array = NDArray[np.float64]

COLORS = {"paper": "tab:orange", "default": "tab:blue"}
SOURCES = {"ft": "F/T sensor", "virtual": "virtual sensor"}
PANELS = (
    ("stiffness_N_per_m", "K  N/m"),
    ("friction_Ns_per_m2", "B  Ns/m²"),
    ("cumulative_friction_Ns_per_m", "Σ B d  Ns/m"),
)
MARGIN_s = 1.0
"""Shown before contact and after the deepest point."""
POINTS = 4000
"""Drawn of a curve; more cannot be seen."""
MOST_OF = 98.0
"""Per cent of our curve that a panel must hold; wild ones leave it."""
DPI = 100


def save_identification_figure(
    path: Path, title: str, truth: InsertionTruth, identified: Sequence[Identified]
) -> None:
    """Draw the insertion of one run and write it as PNG.

    Grey bands are true ruptures, from the onset to the end of the release. Continuous vertical
    lines are alarms, dashed ones compensations, each in the colour of its method.

    Args:
        path: File to write.
        title: Above the picture.
        truth: Of the run.
        identified: What the methods made of each source; one column per source.
    """
    sources = list(dict.fromkeys(item.source for item in identified))
    figure, axes = plt.subplots(
        1 + len(PANELS),
        len(sources),
        figsize=(7.5 * max(len(sources), 1), 10),
        sharex=True,
        sharey="row",
        height_ratios=(2.4, *(1.0 for _ in PANELS)),
        layout="constrained",
        squeeze=False,
    )
    for source, column in zip(sources, axes.T, strict=True):
        mine = [item for item in identified if item.source == source]
        ordered = sorted(mine, key=lambda item: list(COLORS).index(item.method))
        _draw_forces(column[0], truth, ordered)
        for axis, (name, label) in zip(column[1:], PANELS, strict=True):
            _draw_panel(axis, truth, ordered, name)
            axis.set_ylabel(label)
        for axis in column:
            _mark(axis, truth, ordered)
            axis.grid(visible=True, alpha=0.3)
        column[0].set_title(SOURCES[source])
        column[0].legend(loc="upper left", fontsize="small")
        column[-1].set_xlabel("time / s")
    axes[0, 0].set_ylabel("force / N")
    axes[0, 0].set_ylim(*_force_limits(truth))
    axes[0, 0].set_xlim(truth.contact_s - MARGIN_s, truth.insertion_end_s + MARGIN_s)
    figure.suptitle(title)
    figure.savefig(path, dpi=DPI)
    plt.close(figure)


class _Shown(NamedTuple):
    """Samples of an identification that are drawn, and their times."""

    rows: NDArray[np.intp]
    t_s: Array


def _shown(truth: InsertionTruth, item: Identified) -> _Shown:
    t_s = truth.t_s[item.start :]
    inside = (t_s > truth.contact_s - MARGIN_s) & (t_s < truth.insertion_end_s + MARGIN_s)
    rows = np.flatnonzero(inside)
    rows = rows[:: max(1, len(rows) // POINTS)]
    return _Shown(rows, t_s[rows])


def _draw_forces(axis: Axes, truth: InsertionTruth, ordered: Sequence[Identified]) -> None:
    for item in ordered:
        rows, t_s = _shown(truth, item)
        color = COLORS[item.method]
        if item.method == "default":
            axis.plot(t_s, item.force_N[rows], color="tab:green", linewidth=0.7, label="reading")
        axis.plot(
            t_s, item.enhanced_N[rows], color=color, linewidth=0.9, label=f"enhanced, {item.method}"
        )
        if item.method == "default":
            axis.plot(
                t_s, item.tip_N[rows], color="tab:purple", linewidth=0.7, label="tip, default"
            )
    axis.plot(truth.t_s, truth.axial_N, color="black", linewidth=1.0, label="true")
    axis.plot(
        truth.t_s,
        truth.enhanced_N,
        color="black",
        linewidth=1.0,
        linestyle=":",
        label="enhanced, true",
    )


def _draw_panel(
    axis: Axes, truth: InsertionTruth, ordered: Sequence[Identified], name: str
) -> None:
    for item in ordered:
        rows, t_s = _shown(truth, item)
        values = np.array([getattr(item.result.estimates[k], name) for k in rows])
        axis.plot(t_s, values, color=COLORS[item.method], linewidth=1.0, label=item.method)
        if item.method == "default" and len(values):
            top = 1.5 * float(np.percentile(values, MOST_OF))
            low = axis.get_ylim()[1] if axis.get_autoscaley_on() is False else 0.0
            axis.set_ylim(-0.05 * max(top, low), max(top, low) or 1.0)


def _mark(axis: Axes, truth: InsertionTruth, ordered: Sequence[Identified]) -> None:
    for rupture in truth.ruptures:
        axis.axvspan(rupture.onset_s, rupture.end_s, color="grey", alpha=0.4, linewidth=0)
    for item in ordered:
        color = COLORS[item.method]
        for alarm in item.alarms:
            axis.axvline(alarm.alarm_s, color=color, linewidth=0.8)
        for k, estimate in enumerate(item.result.estimates):
            if estimate.compensated is not None:
                when = truth.t_s[item.start + k]
                axis.axvline(when, color=color, linewidth=0.8, linestyle="--")


def _force_limits(truth: InsertionTruth) -> tuple[float, float]:
    true = truth.axial_N[truth.is_insertion]
    top = float(true.max()) if len(true) else 1.0
    return -0.35 * top, 1.2 * top
