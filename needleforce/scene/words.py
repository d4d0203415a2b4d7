"""A moment in words; behind ± stands the standard deviation, as elsewhere."""

from collections.abc import Iterator
from html import escape
from typing import TYPE_CHECKING

from needleforce.depth_zero import find_depth_zero
from needleforce.needle_on_plan import (
    CANNOT_TELL,
    OFF_PLAN,
    ON_PLAN,
    PAST_TARGET,
    TOO_NEAR,
    describe_clearances,
    describe_deviation,
    find_verdict,
)

if TYPE_CHECKING:
    from needleforce.session import SessionEstimate

NOTE = "Simulation and research only: not a medical device."

MEANINGS = {
    OFF_PLAN: "no layer is named from the plan",
    PAST_TARGET: "the tip is deeper than planned",
    TOO_NEAR: "the needle, or its way ahead, is too near to a structure at risk",
    CANNOT_TELL: "the registration is not known well enough to say that the needle is "
    "on the plan",
}
"""What verdicts mean that the page must show large."""


def shown_name(name: str) -> str:
    """Return the name of a structure as it is shown."""
    return name.replace("_", " ")


def text_html(*lines: str) -> str:
    """Return lines as paragraphs for viser's `add_html`.

    Names come from files. In viser's Markdown an `<iframe>` in a name would run and a
    picture would be fetched; here every character is itself.
    """
    style = "margin:0 .75rem .5rem;font-size:.875rem;overflow-wrap:anywhere"
    return "".join(f'<p style="{style}">{escape(line)}</p>' for line in lines)


def find_banner(estimate: "SessionEstimate") -> str:
    """Return the verdict that the page must show large; empty for none."""
    if estimate.deviation is None:
        return ""
    verdict = find_verdict(estimate.deviation, estimate.clearances)
    return "" if verdict == ON_PLAN else verdict


def describe_depth(estimate: "SessionEstimate") -> str:
    """Return the depth of the tip with the name of its zero."""
    zero = find_depth_zero(estimate)
    return f"{zero.shown_mm(estimate.depth_m):.1f} mm {zero.name}"


def describe_tissue(estimate: "SessionEstimate") -> str:
    """Return the planned tissue that the tip is in, with its probability."""
    plan = estimate.plan
    deviation = estimate.deviation
    if plan is None or (deviation is not None and deviation.is_off_plan):
        return "tissue at the tip not known"
    return f"in {shown_name(plan.name)} ({100.0 * plan.probability:.0f} %)"


def describe_state(estimate: "SessionEstimate") -> Iterator[str]:
    """Yield where the needle is, the forces, and what they say of the plan."""
    found = estimate.identification
    yield f"{estimate.time_s:.1f} s at {describe_depth(estimate)}, layer {found.layer}"
    status = estimate.status.value
    doubt = "" if status == "ok" else f" ({status})"
    wrench = estimate.wrench
    yield f"force {wrench.axial:.2f} ± {wrench.axial_std:.2f} N{doubt}"
    yield (
        f"tip force {found.tip_force_N:.2f} ± {found.tip_force_std_N or 0.0:.2f} N, "
        f"shaft friction {found.shaft_friction_N:.2f} N"
    )
    if estimate.deviation is not None:
        yield describe_deviation(estimate.deviation)
    if estimate.clearances:
        yield describe_clearances(estimate.clearances)
    plan = estimate.plan
    if plan is None or plan.name == OFF_PLAN:
        return
    place = describe_tissue(estimate)
    if plan.next_name:
        next_mm = find_depth_zero(estimate).shown_mm(plan.next_m)
        std_mm = 1e3 * plan.next_std_m
        place += f", {shown_name(plan.next_name)} at {next_mm:.1f} ± {std_mm:.1f} mm"
    yield place
    yield (
        f"all lies {1e3 * plan.offset_m:+.1f} ± {1e3 * plan.offset_std_m:.1f} mm "
        "deeper than planned"
    )
