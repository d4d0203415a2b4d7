"""A picture after the paper's Figure 5: force over time and over depth, error below."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from numpy.typing import NDArray

from benchmarks.force_reading import ForceReading
from benchmarks.force_truth import ForceTruth

matplotlib.use("Agg")

# After the backend is chosen: a report is written without a screen.
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

Array = NDArray[np.float64]
OURS = ("virtual", "default")


class Style(NamedTuple):
    """How a source and method is drawn."""

    label: str
    color: str
    width: float
    alpha: float = 1.0


STYLES = {
    ("ft", "default"): Style("F/T sensor", "tab:green", 0.6, 0.6),
    ("virtual", "paper"): Style("virtual, paper", "tab:orange", 0.9),
    OURS: Style("virtual, default", "tab:blue", 0.9),
}
"""In the order of drawing, ours on top."""
MARGIN_s = 2.0
"""Shown before contact and after withdrawal."""
POINTS = 6000
"""Drawn of a curve; more cannot be seen."""
MOST_OF = 99.0
"""Per cent of each error curve that its panel must hold; single spikes may leave it."""
CALM_SHARE = 3.0
"""How many times as wide as the calmest virtual curve a panel may become for the others."""
DPI = 110


def save_force_figure(
    path: Path, title: str, truth: ForceTruth, readings: Sequence[ForceReading]
) -> None:
    """Draw one run and write it as PNG.

    Args:
        path: File to write.
        title: Above the picture.
        truth: True force, depth and time.
        readings: What the sensors say; their order does not matter.
    """
    index = _shown(truth)
    ordered = sorted(readings, key=lambda item: list(STYLES).index((item.source, item.method)))
    places: list[tuple[str, Array]] = [("time / s", truth.t_s)]
    if np.ptp(truth.depth_m) > 0.0:
        places.append(("depth since first contact / mm", 1e3 * truth.depth_m))
    figure, axes = plt.subplots(
        2,
        len(places),
        figsize=(13, 7),
        sharex="col",
        sharey="row",
        height_ratios=(2, 1),
        layout="constrained",
        squeeze=False,
    )
    for (name, place), upper, lower in zip(places, axes[0], axes[1], strict=True):
        _draw_force(upper, place, index, truth, ordered)
        _draw_error(lower, place, index, truth, ordered)
        lower.set_xlabel(name)
    axes[0, 0].set_ylabel("axial force / N")
    axes[0, 0].legend(loc="best")
    axes[1, 0].set_ylabel("error / N")
    force_limits, error_limits = _limits(index, truth, ordered)
    axes[0, 0].set_ylim(*force_limits)
    axes[1, 0].set_ylim(*error_limits)
    axes[1, 0].legend(loc="upper left", fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=DPI)
    plt.close(figure)


def _shown(truth: ForceTruth) -> NDArray[np.intp]:
    """Samples that are drawn: around the judged part, not before the sensors were zeroed."""
    first = max(truth.start_s - MARGIN_s, truth.zeroed_s)
    shown = np.flatnonzero((truth.t_s > first) & (truth.t_s <= truth.end_s + MARGIN_s))
    return shown[:: max(1, len(shown) // POINTS)]


def _error(reading: ForceReading, truth: ForceTruth) -> Array:
    return reading.axial_N - truth.axial_N


def _draw_force(
    axes: Axes,
    place: Array,
    index: NDArray[np.intp],
    truth: ForceTruth,
    ordered: Sequence[ForceReading],
) -> None:
    for reading in ordered:
        rmse = np.sqrt(np.mean(_error(reading, truth)[truth.judged] ** 2))
        _draw(axes, place[index], reading.axial_N[index], reading, f"RMSE {rmse:.3f} N")
    axes.plot(place[index], truth.axial_N[index], color="black", linewidth=1.2, label="true")
    axes.grid(visible=True, alpha=0.3)


def _draw_error(
    axes: Axes,
    place: Array,
    index: NDArray[np.intp],
    truth: ForceTruth,
    ordered: Sequence[ForceReading],
) -> None:
    for reading in ordered:
        _draw(axes, place[index], _error(reading, truth)[index], reading)
        if (reading.source, reading.method) == OURS:
            band = 2.0 * reading.std_N[index]
            edge: dict[str, Any] = {
                "color": "navy",
                "linewidth": 0.7,
                "linestyle": "--",
                "alpha": 0.7,
            }
            axes.plot(place[index], band, label="± 2 standard deviations, as stated", **edge)
            axes.plot(place[index], -band, **edge)
    axes.axhline(0.0, color="black", linewidth=0.6)
    axes.grid(visible=True, alpha=0.3)


def _draw(axes: Axes, x: Array, y: Array, reading: ForceReading, more: str | None = None) -> None:
    style = STYLES[reading.source, reading.method]
    label = None if more is None else f"{style.label}: {more}"
    axes.plot(x, y, color=style.color, linewidth=style.width, alpha=style.alpha, label=label)


def _limits(
    index: NDArray[np.intp], truth: ForceTruth, ordered: Sequence[ForceReading]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of the force and of the error axis: no wild curve may flatten the others."""
    sizes = [
        float(np.percentile(np.abs(_error(item, truth)[index]), MOST_OF))
        for item in ordered
        if item.source == "virtual"
    ]
    error = 1.2 * min(max(sizes), CALM_SHARE * min(sizes)) if sizes else 0.0
    error = error or 1.0
    true = truth.axial_N[index]
    return (true.min() - error, true.max() + error), (-error, error)
