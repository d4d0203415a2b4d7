"""What a clinician looks at during an insertion, as one card of HTML.

The verdict, the tissue at the tip, how far it is to the target, where the needle passes
the planned path (a bullseye), and the structure at risk that is nearest. All of it is
as the session states it; only directions in the bullseye come from the geometry.
"""

import math
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from foundation.arrays import Array
from needleforce.needle_on_plan import CANNOT_TELL, ON_PLAN, PlannedPath
from needleforce.plots.needle_view import NeedleView, patient_side
from needleforce.scene.nodes import NeedlePose, PlanScene
from needleforce.scene.words import (
    MEANINGS,
    describe_tissue,
    find_banner,
    shown_name,
)

if TYPE_CHECKING:
    from needleforce.needle_on_plan import PlanDeviation
    from needleforce.session import SessionEstimate

RED = "#b3261e"
GREEN = "#00695c"
AMBER = "#8a5a00"
GREY = "#555"


def card_html(
    estimate: "SessionEstimate | None", needle: NeedlePose | None, plan: PlanScene
) -> str:
    """Return the card of a tick: of a plan without a path the tissue alone.

    Args:
        estimate: What is shown; None before the first sample.
        needle: Where the needle is then.
        plan: Anatomy and plan.
    """
    tissue = ""
    if estimate is not None and plan.layers:
        tissue = (
            '<div data-part="tissue" style="font-size:1.25rem;font-weight:700;'
            'margin:.3rem 0;overflow-wrap:anywhere">'
            f"{escape(describe_tissue(estimate))}</div>"
        )
    path = plan.path
    if path is None:
        return tissue
    return (
        '<div class="needle-card" style="margin:0 .75rem .5rem;color:#111">'
        f"{_verdict_html(estimate)}{tissue}"
        '<div style="display:flex;align-items:center;gap:.5rem">'
        f'<div style="flex:1;min-width:0">{_target_html(estimate, path.length_m)}</div>'
        f"{_bullseye_html(estimate, needle, plan, path)}</div>"
        f"{_nearest_html(estimate, plan)}</div>"
    )


def _box_html(color: str, head: str, text: str) -> str:
    """Return a box of a colour with words in it, the first ones bold."""
    return (
        f'<div style="background:{color};color:#fff;border-radius:.25rem;'
        "padding:.2rem .5rem;margin:.2rem 0;font-size:.875rem;overflow-wrap:anywhere"
        f'"><b>{escape(head)}</b> {escape(text)}</div>'
    )


def _verdict_html(estimate: "SessionEstimate | None") -> str:
    """Return the state of the needle on its plan in a word and what it means."""
    if estimate is None:
        return _box_html(GREY, "PLANNED", "waiting for the first sample")
    if estimate.deviation is None:
        return _box_html(
            AMBER, CANNOT_TELL.upper(), "no state of the needle on the plan yet"
        )
    banner = find_banner(estimate)
    if not banner:
        return _box_html(GREEN, ON_PLAN.upper(), "")
    color = AMBER if banner == CANNOT_TELL else RED
    return _box_html(color, f"⚠ {banner.upper()}", MEANINGS[banner])


def _target_html(estimate: "SessionEstimate | None", length_m: float) -> str:
    """Return the distance to the target as a large number."""
    color = "#111"
    number = f"{1e3 * length_m:.1f}"
    below = "mm from the planned entry to the target"
    deviation = None if estimate is None else estimate.deviation
    if deviation is not None and not math.isnan(deviation.to_target_m):
        side = "past" if deviation.to_target_m < 0.0 else "to"
        number = f"{1e3 * abs(deviation.to_target_m):.1f}"
        below = f"± {1e3 * deviation.to_target_std_m:.1f} mm {side} the target"
        color = _target_color(deviation)
    elif estimate is not None:
        number = "–"
        below = "distance to the target not known"
    return (
        f'<div data-part="target" style="color:{color};font-variant-numeric:'
        'tabular-nums"><div style="font-size:3.25rem;font-weight:700;line-height:1">'
        f'{number}</div><div style="font-size:1rem;font-weight:600">{below}</div></div>'
    )


def _target_color(deviation: "PlanDeviation") -> str:
    """Return the colour of the distance to the target."""
    if deviation.is_past_target:
        return RED
    if deviation.is_off_plan:
        return GREY  # there the distance along the plan means little
    return AMBER if deviation.is_doubtful else "#111"


def _bullseye_html(
    estimate: "SessionEstimate | None",
    needle: NeedlePose | None,
    plan: PlanScene,
    path: PlannedPath,
) -> str:
    """Return the needle beside the planned path, seen along it, in millimetres."""
    rings = "".join(
        f'<circle r="{radius}" fill="none" stroke="#999" stroke-width=".07"/>'
        f'<text x="{0.71 * radius}" y="{0.71 * radius + 0.8}" font-size="1" '
        f'fill="#555">{radius}</text>'
        for radius in (1, 2, 5)
    )
    view = NeedleView.along(plan.rotation.T @ path.axis)
    across = np.array([view.side, view.up]) @ plan.rotation.T
    sides = "".join(
        f'<text data-side="{name}" x="{x}" y="{y}" font-size="1" font-weight="bold" '
        f'fill="#111">{patient_side(direction)}</text>'
        for name, direction, x, y in (
            ("up", view.up, 0.2, -5.1),
            ("left", -view.side, -5.9, -0.2),
            ("right", view.side, 5.1, -0.2),
        )
    )
    drawn = ""
    caption = ""
    if estimate is not None and estimate.deviation is not None and needle is not None:
        deviation = estimate.deviation
        from_entry_m = needle.tip_m - path.entry_m
        at_entry_m = from_entry_m - (from_entry_m @ needle.axis) * needle.axis
        tip = _place_mm(across @ from_entry_m, deviation.tip_m)
        entry = _place_mm(across @ at_entry_m, deviation.entry_m)
        # A tip past the target may be doubtful for its depth alone.
        is_doubtful = deviation.is_doubtful and not deviation.is_past_target
        color = RED if deviation.is_off_plan else AMBER if is_doubtful else GREEN
        drawn = (
            f'<circle cx="{tip[0]:.2f}" cy="{tip[1]:.2f}" '
            f'r="{2e3 * deviation.tip_std_m:.2f}" fill="{color}" fill-opacity=".15" '
            f'stroke="{color}" stroke-width=".12" stroke-dasharray=".4 .2"/>'
            f'<path d="M{entry[0]:.2f} {entry[1]:.2f}L{tip[0]:.2f} {tip[1]:.2f}" '
            f'stroke="{color}" stroke-width=".2"/>'
            f'<circle cx="{tip[0]:.2f}" cy="{tip[1]:.2f}" r=".25" fill="{color}"/>'
        )
        caption = (
            f"{1e3 * deviation.tip_m:.1f} ± {1e3 * deviation.tip_std_m:.1f} mm aside"
            f"<br>{math.degrees(deviation.angle_rad):.1f} ± "
            f"{math.degrees(deviation.angle_std_rad):.1f}° turned"
        )
    return (
        '<div style="flex:none;font-size:.75rem;text-align:center">'
        '<svg data-part="bullseye" role="img" aria-label="needle beside the planned '
        'path" viewBox="-6 -6 12 12" '
        'style="display:block;width:7.5rem;height:7.5rem;background:#fff">'
        '<path d="M-6 0H6M0 -6V6" stroke="#bbb" stroke-width=".06"/>'
        f"{rings}{sides}{drawn}</svg>{caption}</div>"
    )


def _place_mm(aside_m: Array, distance_m: float) -> Array:
    """Return a place in the picture, whose y axis points down; outside is its edge.

    Args:
        aside_m: To the right and up, shape (2,); its direction counts.
        distance_m: How far aside, as the session states it.
    """
    edge_mm = 5.5
    norm_m = max(float(np.linalg.norm(aside_m)), np.finfo(float).tiny)
    right, up = min(1e3 * distance_m, edge_mm) * aside_m / norm_m
    return np.array([right, -up])


def _nearest_html(estimate: "SessionEstimate | None", plan: PlanScene) -> str:
    """Return the structure at risk that is nearest, in words and colour."""
    if not plan.watched:
        return _box_html(GREY, "Structures at risk:", "not known, nothing is watched")
    if estimate is None or not estimate.clearances:
        names = shown_name(", ".join(plan.watched))
        return _box_html(GREY, "Watched, no distance yet:", names)
    nearest = estimate.clearances[0]
    text = (
        f"{shown_name(nearest.name)} {1e3 * nearest.distance_m:.1f} ± "
        f"{1e3 * nearest.std_m:.1f} mm"
    )
    part = "from its way ahead" if nearest.is_ahead else "from the needle"
    if nearest.is_too_near:
        return _box_html(RED, f"⚠ TOO NEAR: {text}", part)
    return _box_html(GREEN, f"Nearest: {text}", part)
