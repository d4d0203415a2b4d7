"""What the marks and colours of the scene stand for, in words."""

from collections.abc import Iterable
from html import escape
from typing import NamedTuple

from needleforce.scene import nodes
from needleforce.scene.force_arrow import ARROW_COLOR, BAND_COLOR
from needleforce.scene.structure_list import sorted_names

LINE = "line"
RING = "ring"
AREA = "area"
"""Shapes of the samples."""


class LegendLine(NamedTuple):
    """A line of the legend.

    Attributes:
        shape: Of its sample: `LINE`, `RING` or `AREA`.
        color: Of its sample.
        text: What it stands for.
    """

    shape: str
    color: nodes.Color
    text: str


OF_THE_NEEDLE = (
    LegendLine(LINE, nodes.NEEDLE_COLOR, "needle"),
    LegendLine(LINE, nodes.TRAIL_COLOR, "path of the tip so far"),
    LegendLine(AREA, ARROW_COLOR, "arrow: force of the tissue on the tip"),
    LegendLine(LINE, BAND_COLOR, "bar beside it: ± two standard deviations"),
    LegendLine(RING, nodes.DETECTED.color, "rupture detected"),
)

OF_THE_PLAN = (
    LegendLine(LINE, nodes.NEAREST_COLOR, "line to the nearest structure at risk"),
    LegendLine(LINE, nodes.OFF_PLAN_COLOR, "needle off the plan"),
    LegendLine(LINE, nodes.PATH_COLOR, "planned path"),
    LegendLine(AREA, nodes.TARGET_COLOR, "target"),
    LegendLine(RING, nodes.PLANNED.color, "planned boundary"),
    LegendLine(RING, nodes.OBSTACLE.color, "planned boundary of an obstacle"),
    LegendLine(RING, nodes.EXPECTED.color, "next boundary, as the ruptures moved it"),
)


def legend_lines(
    plan: nodes.PlanScene, *, has_needle: bool = True
) -> tuple[LegendLine, ...]:
    """Return the legend of a scene, structures last.

    Args:
        plan: Anatomy and plan.
        has_needle: Whether an insertion is shown.
    """
    lines = OF_THE_NEEDLE if has_needle else ()
    if plan.entry_m is not None:
        lines += OF_THE_PLAN if has_needle else OF_THE_PLAN[2:-1]
    colors = {surface.name: surface.colour for surface in plan.surfaces}
    return lines + tuple(
        LegendLine(AREA, nodes.color_of(colors[name]), name.replace("_", " "))
        for name in sorted_names(colors)
    )


SAMPLE_STYLES = {
    LINE: "height:.25em;background:",
    RING: "height:.9em;width:.9em;border-radius:50%;border:3px solid ",
    AREA: "height:.8em;background:",
}
"""CSS of a sample by its shape; the colour follows."""


def sample_style(line: LegendLine) -> str:
    """Return the CSS of the sample of a line."""
    return (
        "display:inline-block;width:1.3em;margin-right:.6em;vertical-align:middle;"
        f"{SAMPLE_STYLES[line.shape]}rgb{tuple(line.color)}"
    )


def legend_html(lines: Iterable[LegendLine]) -> str:
    """Return a legend as HTML for the panel beside the scene."""
    return "".join(_html_of(line) for line in lines)


def _html_of(line: LegendLine) -> str:
    """Return a line of the legend as HTML."""
    return (
        f'<div style="margin:.3em .8em"><span style="{sample_style(line)}"></span>'
        f"{escape(line.text)}</div>"
    )
