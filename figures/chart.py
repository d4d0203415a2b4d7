"""A chart as plain data."""

from dataclasses import dataclass

from figures.errors import ChartError
from figures.marks import Instants, Shading, Ticks
from figures.panel import Panel

WIDTH_IN = 4.4
"""At the width of a phone the letters are then still large enough to read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Panels below each other over one x axis, with one legend below them.

    Attributes:
        title: One line above.
        x_label: With the unit.
        panels: From above.
        shadings: Stretches marked in every panel.
        instants: Lines marked in every panel.
        ticks: Strokes marked in every panel.
        x_limits: None for what the curves need.
        x_ticks: Places and what stands there; empty for numbers.
        width_in: In inches.
        height_in: In inches, without the legend.
    """

    title: str
    x_label: str
    panels: tuple[Panel, ...]
    shadings: tuple[Shading, ...] = ()
    instants: tuple[Instants, ...] = ()
    ticks: tuple[Ticks, ...] = ()
    x_limits: tuple[float, float] | None = None
    x_ticks: tuple[tuple[float, str], ...] = ()
    width_in: float = WIDTH_IN
    height_in: float = 3.0

    def __post_init__(self) -> None:
        """Check that there is something to draw.

        Raises:
            ChartError: No panel.
        """
        if not self.panels:
            raise ChartError(f"chart {self.title!r} has no panel; give at least one")
