"""After the upper halves of the paper's Figures 8, 9 and 11 to 14: forces without friction."""

from collections.abc import Sequence

import numpy as np

from benchmarks.charts.insertion_axis import InsertionAxis
from benchmarks.methods.force_reading import ForceReading
from benchmarks.methods.identified import Identified
from benchmarks.signals.insertion_truth import InsertionTruth
from figures import Chart, Curve, Panel, palette

READINGS = {"ft": "F/T reading", "virtual": "virtual sensor's force"}


def enhanced_chart(
    title: str,
    truth: InsertionTruth,
    item: Identified,
    other: Identified | None = None,
    ft: ForceReading | None = None,
    has_speed: bool = False,
) -> Chart:
    """Reading, prediction and enhanced force of one method.

    Args:
        title: Above.
        truth: Of the run.
        item: The method's result; ruptures and compensations are its own.
        other: Of the same method with the Kelvin-Voigt model, for comparison.
        ft: The F/T reading, where the method was given another force.
        has_speed: Whether the profile of the speed is drawn, as in Figure 9.
    """
    axis = InsertionAxis(truth)
    top_N = float(truth.axial_N[truth.is_insertion].max())
    curves = _curves(axis, item, other, ft)
    if has_speed:
        share = truth.speed_m_s / float(np.max(truth.speed_m_s[truth.is_insertion]))
        profile = 0.5 * top_N * share
        x = axis.place(truth.t_s)
        curves.insert(0, Curve(style=palette.OTHER_DASHED, x=x, y=profile, label="speed, no scale"))
    limits = (-0.25 * top_N, 1.15 * top_N)
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=(Panel(y_label=palette.FORCE, curves=tuple(curves), limits=limits),),
        shadings=(axis.true_ruptures(),),
        instants=tuple(axis.events(item)),
        x_limits=axis.limits,
        height_in=2.7,
    )


def _curves(
    axis: InsertionAxis, item: Identified, other: Identified | None, ft: ForceReading | None
) -> list[Curve]:
    truth, is_ours = axis.truth, item.method == "default"
    x = axis.place(truth.t_s)
    own = x[item.start :]
    return [
        Curve(style=palette.READING, x=own, y=item.force_N, label=READINGS[item.source]),
        Curve(style=palette.PREDICTED, x=own, y=_predicted(item), label="predicted"),
        *_others(axis, other, ft),
        Curve(
            style=palette.OURS if is_ours else palette.PAPER,
            x=own,
            y=item.enhanced_N,
            label="enhanced, ours" if is_ours else "enhanced, published",
        ),
        Curve(style=palette.TRUE_PART, x=x, y=truth.enhanced_N, label="enhanced, truth"),
    ]


def _others(
    axis: InsertionAxis, other: Identified | None, ft: ForceReading | None
) -> Sequence[Curve]:
    x, curves = axis.place(axis.truth.t_s), []
    if ft is not None:
        label = "F/T reading, to compare"
        curves.append(Curve(style=palette.OTHER_SENSOR, x=x, y=ft.axial_N, label=label))
    if other is not None:
        label = "enhanced, published, KV"
        curves.append(
            Curve(style=palette.PAPER_KV, x=x[other.start :], y=other.enhanced_N, label=label)
        )
    return curves


def _predicted(item: Identified) -> np.ndarray:
    return np.array([estimate.predicted_force_N for estimate in item.result.estimates])
