"""What is marked in every panel of a chart."""

from dataclasses import dataclass

from figures.line_style import LineStyle


@dataclass(frozen=True, slots=True, kw_only=True)
class Shading:
    """Stretches of the x axis with a meaning.

    Attributes:
        label: In the legend.
        color: Of the shade.
        spans: First and last place of each stretch.
        least_pt: Width to which a short stretch is drawn at least, so that it is seen.
    """

    label: str
    color: str
    spans: tuple[tuple[float, float], ...]
    least_pt: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Instants:
    """Vertical lines.

    Attributes:
        label: In the legend.
        style: Of the lines.
        places: On the x axis.
    """

    label: str
    style: LineStyle
    places: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ticks:
    """Short strokes along the lower edge.

    Attributes:
        label: In the legend.
        color: Of the strokes.
        places: On the x axis.
    """

    label: str
    color: str
    places: tuple[float, ...]
