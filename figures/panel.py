"""One of the panels that share the x axis of a chart."""

from dataclasses import dataclass

from figures.curve import Curve


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One of the panels that share the x axis of a chart.

    Attributes:
        y_label: With the unit.
        curves: In the order of drawing, the last on top.
        limits: Of the y axis; None for what the curves need, without lonely spikes.
        height: In proportion to the other panels.
        has_zero_line: Whether a thin line marks zero.
    """

    y_label: str
    curves: tuple[Curve, ...]
    limits: tuple[float, float] | None = None
    height: float = 1.0
    has_zero_line: bool = True
