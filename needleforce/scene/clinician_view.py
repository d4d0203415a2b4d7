"""What a clinician looks at during an insertion, as one card of HTML.

The state in a word, how far it is to the target, where the needle passes the planned
path (a bullseye), and the structure at risk that is nearest. All of it is shown as the
session states it; only the direction in the bullseye comes from the scene's geometry.
"""

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.plots.needle_view import NeedleView, patient_side
from needleforce.scene.nodes import NeedlePose, PlanScene
from needleforce.scene.row_text import (
    CANNOT_TELL,
    M_TO_MM,
    MEANINGS,
    ON_PLAN,
    aside_text,
    banner_of,
    layer_names,
    near_name,
    near_part,
    target_parts,
)
from needleforce.scene.state_ring import ViewRow


class Bearing(NamedTuple):
    """Where the needle is beside the planned path, seen along that path.

    Attributes:
        entry_m: Where its line passes the entry, to the right and up, shape (2,).
        tip_m: Where its tip is, shape (2,).
        right: Side of the patient to the right: L, R, P, A, H or F.
        left: To the left.
        up: Upwards.
    """

    entry_m: Array
    tip_m: Array
    right: str
    left: str
    up: str


def find_bearing(row: ViewRow, needle: NeedlePose, plan: PlanScene) -> Bearing | None:
    """Return where the needle is beside the planned path; None where no path is known.

    Distances are those that the row states.
    """
    path = plan.path
    if path is None or math.isnan(row.aside_entry_m):
        return None
    view = NeedleView.along(plan.rotation.T @ path.axis)
    across = np.array([view.side, view.up]) @ plan.rotation.T
    from_entry_m = needle.tip_m - path.entry_m
    at_entry_m = from_entry_m - (from_entry_m @ needle.axis) * needle.axis
    return Bearing(
        _with_length(across @ at_entry_m, row.aside_entry_m),
        _with_length(across @ from_entry_m, row.aside_tip_m),
        right=patient_side(view.side),
        left=patient_side(-view.side),
        up=patient_side(view.up),
    )


def _with_length(vector: Array, length_m: float) -> Array:
    """Return a vector of a length in the direction of another one."""
    norm = float(np.linalg.norm(vector))
    return vector * (length_m / norm) if norm > 0.0 else np.zeros(2)


RED = "#b3261e"
GREEN = "#00695c"
AMBER = "#8a5a00"
GREY = "#555"


def card_html(
    row: ViewRow | None,
    plan: PlanScene,
    bearing: Bearing | None = None,
    event: tuple[str, float] | None = None,
) -> str:
    """Return the card of a row: of a plan without a path the tissue alone.

    Args:
        row: What is shown; None before the first sample.
        plan: Anatomy and plan.
        bearing: The needle beside the planned path.
        event: Kind of the latest event, empty for none, and its time [s], for a page
            that sounds: see `page_sound.js`.
    """
    path = plan.path
    if path is None:
        return _tissue_html(row, plan)
    sound = ""
    if event is not None:
        kind, time_s = event
        # `page_sound.js` marks the page once it may sound.
        sound = (
            f'<span hidden data-event="{kind}" data-time="{time_s:.3f}"></span>'
            "<style>[data-sound=on] .silent{display:none}</style>"
            '<p class="silent" style="font-size:.8rem;margin:.2rem 0;color:#555">'
            "Sound: press a key or a button here once.</p>"
        )
    return (
        '<div class="needle-card" style="margin:0 .75rem .5rem;color:#111">'
        f"{_verdict_html(row)}{_tissue_html(row, plan)}"
        '<div style="display:flex;align-items:center;gap:.5rem">'
        f'<div style="flex:1;min-width:0">{_target_html(row, path.length_m)}</div>'
        f"{_bullseye_svg(row, bearing)}</div>"
        f"{_nearest_html(row, plan)}{sound}</div>"
    )


def _box_html(color: str, head: str, text: str) -> str:
    """Return a box of a colour with words in it, the first ones bold."""
    return (
        f'<div style="background:{color};color:#fff;border-radius:.25rem;'
        "padding:.2rem .5rem;margin:.2rem 0;font-size:.875rem;overflow-wrap:anywhere"
        f'"><b>{escape(head)}</b> {escape(text)}</div>'
    )


def _verdict_html(row: ViewRow | None) -> str:
    """Return the state of the needle on its plan in a word and what it means."""
    if row is None:
        return _box_html(GREY, "PLANNED", "waiting for the first sample")
    banner = banner_of(row)
    if banner:
        color = AMBER if banner == CANNOT_TELL else RED
        return _box_html(color, f"⚠ {banner}", MEANINGS[banner])
    if math.isnan(row.aside_entry_m):
        return _box_html(AMBER, CANNOT_TELL, "no state of the needle on the plan yet")
    return _box_html(GREEN, ON_PLAN, "")


def _tissue_html(row: ViewRow | None, plan: PlanScene) -> str:
    """Return the planned tissue that the tip is in, with its probability."""
    if row is None or not plan.layers:
        return ""
    text = "tissue at the tip not known"
    name = layer_names(plan).get(row.plan_layer)
    if name is not None and not row.is_off_plan:
        text = f"in {name.replace('_', ' ')} ({100.0 * row.plan_probability:.0f} %)"
    return (
        '<div data-part="tissue" style="font-size:1.25rem;font-weight:700;'
        f'margin:.3rem 0;overflow-wrap:anywhere">{escape(text)}</div>'
    )


def _target_html(row: ViewRow | None, length_m: float) -> str:
    """Return the distance to the target as a large number."""
    color = "#111"
    if row is None:
        text = f"{M_TO_MM * length_m:.1f}"
        below = "mm from the planned entry to the target"
    elif math.isnan(row.aside_to_target_m):
        text = "–"
        below = "distance to the target not known"
    else:
        text, below = target_parts(row)
        if row.is_past_target:
            color = RED
        elif row.is_off_plan:
            # Off the plan the distance along it means little.
            color = GREY
        elif row.is_doubtful:
            color = AMBER
    return (
        f'<div data-part="target" style="color:{color};font-variant-numeric:'
        'tabular-nums"><div style="font-size:3.25rem;font-weight:700;line-height:1">'
        f'{text}</div><div style="font-size:1rem;font-weight:600">{below}</div></div>'
    )


def _bullseye_svg(row: ViewRow | None, bearing: Bearing | None) -> str:
    """Return the needle beside the planned path, seen along it, in millimetres."""
    edge_mm = 6.0
    rings = "".join(
        f'<circle r="{radius}" fill="none" stroke="#999" stroke-width=".07"/>'
        f'<text x="{0.71 * radius}" y="{0.71 * radius + 0.8}" font-size="1" '
        f'fill="#555">{radius}</text>'
        for radius in (1, 2, 5)
    )
    cross = (
        f'<path d="M{-edge_mm} 0H{edge_mm}M0 {-edge_mm}V{edge_mm}" stroke="#bbb" '
        'stroke-width=".06"/>'
    )
    needle = ""
    words = "no needle yet"
    caption = ""
    if row is not None and bearing is not None:
        tip = _place_mm(bearing.tip_m, edge_mm)
        entry = _place_mm(bearing.entry_m, edge_mm)
        # A tip past the target may be doubtful for its depth alone.
        is_doubtful = row.is_doubtful and not row.is_past_target
        color = RED if row.is_off_plan else AMBER if is_doubtful else GREEN
        std_mm = 2.0 * M_TO_MM * row.aside_tip_std_m
        needle = (
            f'<circle cx="{tip[0]:.2f}" cy="{tip[1]:.2f}" r="{std_mm:.2f}" '
            f'fill="{color}" fill-opacity=".15" stroke="{color}" stroke-width=".12" '
            'stroke-dasharray=".4 .2"/>'
            f'<path d="M{entry[0]:.2f} {entry[1]:.2f}L{tip[0]:.2f} {tip[1]:.2f}" '
            f'stroke="{color}" stroke-width=".2"/>'
            f'<circle cx="{tip[0]:.2f}" cy="{tip[1]:.2f}" r=".25" fill="{color}"/>'
            '<g font-size="1" font-weight="bold" fill="#111">'
            f'<text data-side="up" x=".2" y="-5.1">{bearing.up}</text>'
            f'<text data-side="left" x="-5.9" y="-.2">{bearing.left}</text>'
            f'<text data-side="right" x="5.1" y="-.2">{bearing.right}</text></g>'
        )
        words = aside_text(row)
        caption = (
            f"{M_TO_MM * row.aside_tip_m:.1f} ± {M_TO_MM * row.aside_tip_std_m:.1f} mm "
            f"aside<br>{math.degrees(row.aside_angle_rad):.1f} ± "
            f"{math.degrees(row.aside_angle_std_rad):.1f}° turned"
        )
    return (
        '<div style="flex:none;font-size:.75rem;text-align:center">'
        f'<svg data-part="bullseye" role="img" aria-label="{escape(words)}" '
        f'viewBox="{-edge_mm} {-edge_mm} {2 * edge_mm} {2 * edge_mm}" '
        'style="display:block;width:7.5rem;height:7.5rem;background:#fff">'
        f"{cross}{rings}{needle}</svg>{caption}</div>"
    )


def _place_mm(aside_m: Array, edge_mm: float) -> Sequence[float]:
    """Return a place in the picture, whose y axis points down; outside is its edge."""
    x_mm, y_mm = (M_TO_MM * aside_m).tolist()
    shrink = max(math.hypot(x_mm, y_mm) / (edge_mm - 0.5), 1.0)
    return (x_mm / shrink, -y_mm / shrink)


def _nearest_html(row: ViewRow | None, plan: PlanScene) -> str:
    """Return the structure at risk that is nearest, in words and colour."""
    if not plan.watched:
        return _box_html(GREY, "Structures at risk:", "not known, nothing is watched")
    if row is None or math.isnan(row.near_number):
        names = ", ".join(plan.watched).replace("_", " ")
        return _box_html(GREY, "Watched, no distance yet:", names)
    name = near_name(row, plan.watched)
    text = (
        f"{name.replace('_', ' ')} {M_TO_MM * row.near_distance_m:.1f} ± "
        f"{M_TO_MM * row.near_std_m:.1f} mm"
    )
    if row.is_too_near:
        return _box_html(RED, f"⚠ TOO NEAR: {text}", near_part(row))
    return _box_html(GREEN, f"Nearest: {text}", near_part(row))
