"""A row of the page in words; behind ± stands the standard deviation, as elsewhere."""

import math
from collections.abc import Iterator, Mapping, Sequence

from needleforce.scene.nodes import PlanScene
from needleforce.scene.state_ring import ViewRow

M_TO_MM = 1e3
OUTSIDE = -1
"""Number of the place before the first planned layer."""

OFF_PLAN = -2
"""Number of the layer of a needle that is off the plan."""

BANNER = "OFF PLAN"
"""What the page shows while the needle is off the plan."""

PAST_TARGET = "PAST TARGET"
"""What the page shows while the tip is past the target."""

TOO_NEAR = "TOO NEAR"
"""What the page shows while the needle is too near to a structure at risk."""

CANNOT_TELL = "CANNOT TELL"
"""What the page shows while nobody can tell that the needle is on the plan."""

ON_PLAN = "ON PLAN"
"""What the page shows while none of these holds."""

MEANINGS = {
    BANNER: "no layer is named from the plan",
    PAST_TARGET: "the tip is deeper than planned",
    TOO_NEAR: "the needle, or its way ahead, is too near to a structure at risk",
    CANNOT_TELL: "the registration is not known well enough to say that the needle is "
    "on the plan",
}
"""What banners mean."""


def banner_of(row: ViewRow) -> str:
    """Return what the page must show large of a row; empty for nothing.

    Off the plan comes first: there the depth below the entry means little.
    """
    if row.is_off_plan:
        return BANNER
    if row.is_past_target:
        return PAST_TARGET
    if row.is_too_near:
        return TOO_NEAR
    return CANNOT_TELL if row.is_doubtful else ""


def layer_names(plan: PlanScene) -> dict[float, str]:
    """Return the names of planned layers by their numbers."""
    names: dict[float, str] = {OUTSIDE: "outside"}
    names |= {number: layer.name for number, layer in enumerate(plan.layers)}
    return names


def next_layer_name(row: ViewRow, names: Mapping[float, str]) -> str:
    """Return the name of the planned layer behind the present one; empty for none."""
    if row.is_off_plan:
        return ""
    return names.get(row.plan_layer + 1.0, "")


def rupture_text(row: ViewRow, names: Mapping[float, str]) -> str:
    """Return the rupture of a row, and the planned layer that it led into."""
    depth_mm = M_TO_MM * (row.rupture_depth_m - row.zero_m)
    text = f"rupture {row.rupture:.0f} at {depth_mm:.1f} mm {row.zero_name}"
    if math.isnan(row.plan_matched):
        return text
    if row.is_off_plan:
        return f"{text}: off plan"

    is_boundary = row.plan_matched >= 0.0
    next_name = names.get(row.plan_matched, "")
    meaning = f"into {next_name}" if is_boundary else "a false alarm"
    return f"{text}: {meaning} ({100.0 * row.plan_matched_probability:.0f} %)"


def rupture_label(row: ViewRow, names: Mapping[float, str]) -> str:
    """Return the rupture of a row in a word or two, for its label in the scene."""
    number = f"{row.rupture:.0f}"
    if math.isnan(row.plan_matched) or row.is_off_plan:
        return f"rupture {number}"
    if row.plan_matched < 0.0:
        return f"{number}: false alarm?"
    return f"{number}: {names.get(row.plan_matched, '').replace('_', ' ')}"


def headline(row: ViewRow) -> str:
    """Return time, depth and tip force of a row in a line."""
    return (
        f"{row.time_s:.1f} s, {_depth_text(row)}; tip force {row.tip_N:.2f} "
        f"± {row.tip_std_N:.2f} N"
    )


def target_parts(row: ViewRow) -> tuple[str, str]:
    """Return how far the tip is from the target, and its deviation and side."""
    side = "past the target" if row.aside_to_target_m < 0.0 else "to the target"
    return (
        f"{M_TO_MM * abs(row.aside_to_target_m):.1f}",
        f"± {M_TO_MM * row.aside_to_target_std_m:.1f} mm {side}",
    )


def _depth_text(row: ViewRow) -> str:
    """Return the depth of the tip with the name of its zero."""
    return f"{M_TO_MM * (row.depth_m - row.zero_m):.1f} mm {row.zero_name}"


def near_name(row: ViewRow, watched: Sequence[str]) -> str:
    """Return the name of the structure at risk that is nearest."""
    number = int(row.near_number)
    return watched[number] if number < len(watched) else f"structure {number}"


def near_text(row: ViewRow, watched: Sequence[str]) -> str:
    """Return the structure at risk that is nearest to the needle or its way ahead."""
    return (
        f"nearest: {near_name(row, watched)} at {M_TO_MM * row.near_distance_m:.1f} ± "
        f"{M_TO_MM * row.near_std_m:.1f} mm {near_part(row)}"
    )


def near_part(row: ViewRow) -> str:
    """Return from what part the distance to the nearest structure is."""
    return "from its way ahead" if row.near_is_ahead == 1.0 else "from the needle"


def state_lines(
    row: ViewRow, names: Mapping[float, str], watched: Sequence[str] = ()
) -> Iterator[str]:
    """Yield where the needle is, the forces, and what they say of the plan.

    Args:
        row: The tick.
        names: Of the planned layers, by number.
        watched: Names of the structures at risk, by number.
    """
    doubt = "" if row.is_good else " (not tared, or doubtful)"
    yield (f"{row.time_s:.1f} s at {_depth_text(row)}, layer {row.layer:.0f}")
    yield f"force {row.force_N:.2f} ± {row.force_std_N:.2f} N{doubt}"
    yield (
        f"tip force {row.tip_N:.2f} ± {row.tip_std_N:.2f} N, "
        f"shaft friction {row.friction_N:.2f} N"
    )
    if not math.isnan(row.aside_entry_m):
        yield aside_text(row)
    if not math.isnan(row.near_number):
        yield near_text(row, watched)
    if not math.isnan(row.plan_layer) and not row.is_off_plan:
        yield from _plan_lines(row, names)


def aside_text(row: ViewRow) -> str:
    """Return how far the needle is beside the planned path, and turned."""
    text = (
        f"needle {M_TO_MM * row.aside_entry_m:.1f} ± "
        f"{M_TO_MM * row.aside_entry_std_m:.1f} mm beside the planned entry, tip "
        f"{M_TO_MM * row.aside_tip_m:.1f} ± {M_TO_MM * row.aside_tip_std_m:.1f} "
        "mm beside the planned path"
    )
    if row.aside_angle_std_rad < math.pi:
        text += (
            f", turned by {math.degrees(row.aside_angle_rad):.1f} ± "
            f"{math.degrees(row.aside_angle_std_rad):.1f}°"
        )
    if not math.isnan(row.aside_to_target_m):
        text += f", {' '.join(target_parts(row))}"
    return text


def _plan_lines(row: ViewRow, names: Mapping[float, str]) -> Iterator[str]:
    """Yield in which planned layer the needle is, and how far the plan is off."""
    name = names.get(row.plan_layer, "")
    place = f"in {name} ({100.0 * row.plan_probability:.0f} %)"
    next_name = next_layer_name(row, names)
    if next_name:
        next_mm = M_TO_MM * (row.plan_next_m - row.zero_m)
        next_std_mm = M_TO_MM * row.plan_next_std_m
        place += f", {next_name} at {next_mm:.1f} ± {next_std_mm:.1f} mm"

    yield place
    offset_mm = M_TO_MM * row.plan_offset_m
    offset_std_mm = M_TO_MM * row.plan_offset_std_m
    yield f"all lies {offset_mm:+.1f} ± {offset_std_mm:.1f} mm deeper than planned"
