"""How one kind of curve is drawn."""

from dataclasses import dataclass

Dash = str | tuple[float, tuple[float, ...]]
"""As matplotlib takes it: ``-``, ``:``, or (offset, (on, off, …)) in points."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStyle:
    """How one kind of curve is drawn.

    Attributes:
        color: As ``#rrggbb``.
        dash: Tells the curves apart where colours do not: in print, and to eyes that mix them up.
        width_pt: Of the line.
        opacity: 0 to 1.
        marker: Of the points, as matplotlib names it; none for a line.
        size_pt: Of the marker.
    """

    color: str
    dash: Dash = "-"
    width_pt: float = 1.1
    opacity: float = 1.0
    marker: str = ""
    size_pt: float = 7.0
