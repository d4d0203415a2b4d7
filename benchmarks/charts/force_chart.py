"""After the paper's Figure 5: the estimated force against the true one, and the error."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.force_reading import ForceReading
from benchmarks.signals.force_truth import ForceTruth
from figures import Chart, Curve, LineStyle, Panel, palette

Array = NDArray[np.float64]

OURS = ("virtual", "default")
STYLES: dict[tuple[str, str], tuple[str, LineStyle]] = {
    ("ft", "default"): ("F/T sensor", palette.OTHER_SENSOR),
    ("virtual", "paper"): ("virtual, published", palette.PAPER),
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
