"""Estimates as named values, as diagnostics of ROS have them; needs no ROS."""

from collections.abc import Iterable
from typing import NamedTuple

from identification import LayerEstimate
from needleforce.needle_on_plan import (
    ON_PLAN,
    describe_deviation,
    describe_too_near,
    state_values,
)
from needleforce.session import SessionEstimate

OK = 0
WARNING = 1
ERROR = 2


class NamedReport(NamedTuple):
    """A name with a level, a sentence and values: a `diagnostic_msgs/DiagnosticStatus`.

    Attributes:
        name: What it is about.
        level: `OK`, `WARNING` or `ERROR`.
        message: One sentence.
        values: Text by name.
    """

    name: str
    level: int
    message: str
    values: dict[str, str]


def format_value(value: float | str) -> str:
    """Return a value as text that reads back; true and false for a switch."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def layer_reports(layers: Iterable[LayerEstimate]) -> list[NamedReport]:
    """Return a report of each layer traversed; values without an estimate are left out.

    Args:
        layers: As `InsertionSession.layers` has them.
    """
    # Fields of `LayerEstimate` that are published.
    layer_values = (
        "start_depth_m",
        "thickness_m",
        "force_drop_N",
        "force_drop_std_N",
        "stiffness_N_per_m",
        "stiffness_std_N_per_m",
        "friction_N",
        "friction_std_N",
        "is_final",
    )
    reports: list[NamedReport] = []
    for layer in layers:
        known = {
            name: format_value(getattr(layer, name))
            for name in layer_values
            if getattr(layer, name) is not None
        }
        reports.append(
            NamedReport(
                f"layer {layer.layer}",
                OK,
                f"{1e3 * layer.thickness_m:.1f} mm thick",
                known,
            )
        )
    return reports


def plan_reports(name: str, estimate: SessionEstimate | None) -> list[NamedReport]:
    """Return the report of the needle on its plan; none without a plan.

    Args:
        name: Of the node.
        estimate: The latest.
    """
    if estimate is None or estimate.deviation is None:
        return []
    values = state_values(estimate.deviation, estimate.clearances)
    values |= {
        f"clearance/{structure}/{key}": value
        for structure, clearance in values.pop("clearances").items()
        for key, value in clearance.items()
    }
    texts = {key: format_value(value) for key, value in values.items()}
    near = [describe_too_near(one) for one in estimate.clearances if one.is_too_near]
    return [
        NamedReport(
            f"{name}: plan",
            OK if values["verdict"] == ON_PLAN else WARNING,
            "; ".join([describe_deviation(estimate.deviation), *near]),
            texts,
        )
    ]
