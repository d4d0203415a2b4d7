"""After the lower halves of the paper's Figures 8, 9 and 11 to 14: what was identified online."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.charts.insertion_axis import InsertionAxis
from benchmarks.charts.true_friction import true_friction
from benchmarks.methods.identified import Identified
from benchmarks.signals.insertion_truth import InsertionTruth
from figures import Chart, Curve, LineStyle, Panel, palette

Array = NDArray[np.float64]

PANELS = (
    ("stiffness_N_per_m", palette.STIFFNESS),
    ("friction_Ns_per_m2", palette.FRICTION),
    ("cumulative_friction_Ns_per_m", palette.CUMULATIVE_FRICTION),
)


def parameter_chart(
    title: str,
    truth: InsertionTruth,
    ours: Identified,
    published: Identified,
    kelvin_voigt: Identified | None = None,
    on_ft: Identified | None = None,
) -> Chart:
    """Stiffness, friction per length and cumulative friction of every method.

    Args:
        title: Above.
        truth: Of the run.
        ours: With standard deviations; its ruptures and compensations are marked.
        published: With the multi-layer model.
        kelvin_voigt: Published, with the Kelvin-Voigt model. Its friction has another unit and is
            drawn only where the units agree.
        on_ft: Ours on the F/T reading, for comparison.
    """
    axis = InsertionAxis(truth)
    drawn: list[tuple[Identified, LineStyle, str]] = [
        (published, palette.PAPER, "published"),
        (ours, palette.OURS, "ours"),
    ]
    if on_ft is not None:
        drawn.insert(0, (on_ft, palette.OTHER_DASHED, "ours on the F/T reading"))
    if kelvin_voigt is not None:
        drawn.insert(0, (kelvin_voigt, palette.PAPER_KV, "published, Kelvin-Voigt"))
    true = true_friction(truth)
    panels = []
    for name, label in PANELS:
        curves = [
            _curve(axis, item, style, text, name)
            for item, style, text in drawn
            if item is not kelvin_voigt or name != "friction_Ns_per_m2"
        ]
        if name in true:
            t_s, values = true[name]
            curves.append(
                Curve(style=palette.TRUE_PART, x=axis.place(t_s), y=values, label="truth")
            )
        panels.append(Panel(y_label=label, curves=tuple(curves), limits=_limits(axis, curves)))
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=tuple(panels),
        shadings=(axis.true_ruptures(),),
        instants=tuple(axis.events(ours, ", ours")),
        x_limits=axis.limits,
        height_in=4.2,
    )


def _curve(axis: InsertionAxis, item: Identified, style: LineStyle, label: str, name: str) -> Curve:
    estimates = item.result.estimates
    stds = None
    if style is palette.OURS:
        spread = name.replace("_N_", "_std_N_").replace("_Ns_", "_std_Ns_")
        told = [getattr(estimate, spread) for estimate in estimates]
        stds = np.array([np.nan if std is None else std for std in told])
    return Curve(
        style=style,
        x=axis.place(axis.truth.t_s[item.start :]),
        y=np.array([getattr(estimate, name) for estimate in estimates]),
        label=label,
        std=stds,
        band_label=None if stds is None else "ours, ± 2 std",
    )


def _limits(axis: InsertionAxis, curves: Sequence[Curve]) -> tuple[float, float]:
    """Room for ours and the truth, and most of the others; transients may leave the panel."""
    sizes = [1e-9]
    for curve in curves:
        low, high = axis.limits
        inside = curve.y[(curve.x > low) & (curve.x < high) & np.isfinite(curve.y)]
        if curve.style is palette.TRUE_PART:
            sizes.append(1.4 * float(np.max(inside, initial=0.0)))
        elif len(inside):
            share, room = (90.0, 1.6) if curve.style is palette.OURS else (70.0, 1.2)
            sizes.append(room * float(np.percentile(inside, share)))
    return -0.2 * max(sizes), max(sizes)
