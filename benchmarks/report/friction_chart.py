"""After the paper's Figure 10: friction of the gels, offline and online."""

from dataclasses import replace

import numpy as np

from benchmarks.report.gel_friction import PERCENTS, GelFriction
from benchmarks.verdict.published import TABLE_ONE_Ns_per_m
from figures import Chart, Curve, LineStyle, Panel, palette

COLORS = {"constant": palette.BLUE, "sinusoidal": palette.VERMILION}
"""As in the paper."""
SERIES = (
    ("offline", "default", "ft", "^", "offline"),
    ("online", "default", "ft", "*", "ours, F/T"),
    ("online", "default", "virtual", "D", "ours, virtual"),
    ("tuned", "paper", "ft", "x", "published"),
)
"""Kind, method, source, marker, words."""
PAPER_PLACE, FIRST_PLACE, STEP = -0.36, -0.2, 0.14


def friction_chart(title: str, gels: GelFriction) -> Chart:
    """One group of points per gel: from the left the paper's means, then ours."""
    curves = [*_paper_points()]
    for k, (kind, method, source, marker, words) in enumerate(SERIES):
        for speed, color in COLORS.items():
            style = LineStyle(color=color, marker=marker, size_pt=7.0 if marker == "*" else 5.5)
            values = [gels.middle(p, speed, kind, source=source, method=method) for p in PERCENTS]
            if np.isfinite(values).any():
                x = np.arange(3.0) + FIRST_PLACE + k * STEP
                label = f"{words}, {speed}"
                curves.append(Curve(style=style, x=x, y=np.array(values), label=label))
    curves += [_truth(gels, speed) for speed in COLORS]
    return Chart(
        title=title,
        x_label="isinglass in the gel",
        panels=(Panel(y_label="cumulative friction [Ns/m]", curves=tuple(curves)),),
        x_limits=(-0.6, 2.6),
        x_ticks=tuple((float(k), f"{percent} %") for k, percent in enumerate(PERCENTS)),
    )


def _paper_points() -> list[Curve]:
    x = np.arange(3.0) + PAPER_PLACE
    published = [TABLE_ONE_Ns_per_m[percent] for percent in PERCENTS]
    style = LineStyle(color=palette.GREY, marker="^", size_pt=6.0)
    return [
        Curve(
            style=style,
            x=x,
            y=np.array([item.offline for item in published]),
            label="paper, offline",
        ),
        Curve(
            style=replace(style, marker="*", size_pt=8.0),
            x=x,
            y=np.array([item.online for item in published]),
            label="paper, online",
        ),
    ]


def _truth(gels: GelFriction, speed: str) -> Curve:
    """Short lines across each group; dotted for the sinusoidal speed."""
    x, y = [], []
    for k, percent in enumerate(PERCENTS):
        value = gels.middle(percent, speed, "true")
        x += [k + FIRST_PLACE - 0.06, k + FIRST_PLACE + 3 * STEP + 0.06, np.nan]
        y += [value, value, np.nan]
    style = palette.TRUE if speed == "constant" else palette.TRUE_PART
    return Curve(style=style, x=np.array(x), y=np.array(y), label=f"truth, {speed}")
