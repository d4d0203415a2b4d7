"""What happens in an insertion, as events with a sentence and named values."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from identification.estimate import HardContact, Rupture
from needleforce.depth_zero import find_depth_zero
from residual import SensorWarning

if TYPE_CHECKING:
    from needleforce.session import SessionEstimate

M_TO_MM = 1e3


class SessionEvent(NamedTuple):
    """An event of an insertion.

    Attributes:
        kind: ``rupture``, ``rupture_retracted``, ``layer``, ``hard_contact``,
            ``turn`` (of a joint's angle), ``past_target`` or ``too_near``.
        text: One sentence for people.
        values: What is known of it, by name with unit.
    """

    kind: str
    text: str
    values: dict[str, float]


def describe_hard_contact(contact: HardContact) -> str:
    """Return a hard contact in words."""
    return (
        f"hard contact at {M_TO_MM * contact.depth_m:.1f} mm: the force grows by "
        f"{contact.growth_N_per_m / M_TO_MM:.0f} N/mm, as on bone"
    )


def _describe_rupture(estimate: "SessionEstimate", rupture: Rupture) -> str:
    """Return where a rupture of this update is, and where it led to by the plan."""
    zero = find_depth_zero(estimate)
    text = (
        f"rupture of layer {rupture.layer} at {zero.shown_mm(rupture.depth_m):.1f} mm "
        f"{zero.name} ({100.0 * rupture.probability:.0f} %)"
    )
    plan = estimate.plan
    if plan is None:
        return text
    if estimate.deviation is not None and estimate.deviation.is_off_plan:
        return f"{text}, off plan"
    into = "into " if plan.matched >= 0 else ""
    probability = f"({100.0 * plan.matched_probability:.0f} %)"
    return f"{text}, by the plan {into}{plan.matched_name} {probability}"


def session_events(estimate: "SessionEstimate") -> Iterator[SessionEvent]:
    """Yield the events of one update."""
    yield from estimate.plan_events
    if SensorWarning.TURN in estimate.warnings:
        text = "an angle stepped by a whole turn: that counts as no motion"
        yield SessionEvent(kind="turn", text=text, values={})
    identification = estimate.identification
    rupture = identification.rupture
    if rupture is not None:
        yield SessionEvent(
            kind="rupture",
            text=_describe_rupture(estimate, rupture),
            values={
                "layer": rupture.layer,
                "depth_m": rupture.depth_m,
                "force_N": rupture.force_N,
                "speed_m_s": rupture.speed_m_s,
                "probability": rupture.probability,
                "alarm_delay_s": rupture.alarm_s - rupture.time_s,
            },
        )
    retracted = identification.retracted
    if retracted is not None:
        yield SessionEvent(
            kind="rupture_retracted",
            text=f"no rupture of layer {retracted.layer} after all: the force came "
            "back",
            values={"layer": retracted.layer, "depth_m": retracted.depth_m},
        )
    contact = identification.hard_contact
    if contact is not None:
        yield SessionEvent(
            kind="hard_contact",
            text=describe_hard_contact(contact),
            values={
                "depth_m": contact.depth_m,
                "force_N": contact.force_N,
                "growth_N_per_m": contact.growth_N_per_m,
            },
        )
    layer = identification.identified_layer
    if layer is not None:
        kind = "final" if layer.is_final else "provisional"
        yield SessionEvent(
            kind="layer",
            text=f"layer {layer.layer}: {M_TO_MM * layer.thickness_m:.1f} mm thick "
            f"({kind})",
            values={
                "layer": layer.layer,
                "is_final": float(layer.is_final),
                "start_depth_m": layer.start_depth_m,
                "thickness_m": layer.thickness_m,
                "force_drop_N": layer.force_drop_N,
                "stiffness_N_per_m": layer.stiffness_N_per_m,
                "friction_N": layer.friction_N,
            },
        )
