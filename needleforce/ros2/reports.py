"""Estimates as named values: layers, and the health of the node."""

from collections.abc import Iterable
from dataclasses import dataclass

from identification import LayerEstimate
from needleforce.needle_on_plan import (
    ON_PLAN,
    describe_deviation,
    describe_too_near,
    state_values,
)
from needleforce.ros2.joint_samples import JointReader
from needleforce.ros2.message_loss import LossCounter
from needleforce.ros2.named_report import (
    ERROR,
    OK,
    WARNING,
    NamedReport,
    format_value,
)
from needleforce.session import InsertionSession, SessionEstimate
from residual import SensorWarning, Status

EVENT_NUMBERS = {
    "rupture": (
        "layer",
        "depth_m",
        "force_N",
        "speed_m_s",
        "probability",
        "alarm_delay_s",
    ),
    "rupture_retracted": ("layer", "depth_m"),
    "hard_contact": ("depth_m", "force_N", "growth_N_per_m"),
    "layer": (
        "layer",
        "is_final",
        "start_depth_m",
        "thickness_m",
        "force_drop_N",
        "stiffness_N_per_m",
        "friction_N",
    ),
    "past_target": ("to_target_m", "to_target_std_m"),
    "too_near": ("distance_m", "needed_m", "std_m"),
}
"""Values of each kind of event, which have topics that exist before the event does."""


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
        values = {name: getattr(layer, name) for name in layer_values}
        known = {name: format_value(v) for name, v in values.items() if v is not None}
        text = f"{1e3 * layer.thickness_m:.1f} mm thick"
        reports.append(NamedReport(f"layer {layer.layer}", OK, text, known))
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
    for name_of_structure, clearance in values.pop("clearances").items():
        for key, value in clearance.items():
            values[f"clearance/{name_of_structure}/{key}"] = value
    texts = {
        key: value if isinstance(value, str) else format_value(value)
        for key, value in values.items()
    }
    near = [one for one in estimate.clearances if one.is_too_near]
    message = describe_deviation(estimate.deviation)
    sentences = [message, *map(describe_too_near, near)]
    level = OK if values["verdict"] == ON_PLAN else WARNING
    return [NamedReport(f"{name}: plan", level, "; ".join(sentences), texts)]


@dataclass(slots=True, kw_only=True)
class NodeHealth:
    """What the diagnostics are about.

    Attributes:
        session: The session.
        reader: Counts of joint states.
        loss: Counts of messages on their way.
        estimate: The latest; None before the first sample.
        silent_s: Time since the latest joint state.
        silence_limit_s: Longest silence that is no error.
        delay_max_s: Largest delay of a sample since the last report.
        lost_before: Messages lost at the last report.
        is_taring: Whether a tare is under way.
    """

    session: InsertionSession
    reader: JointReader
    loss: LossCounter
    estimate: SessionEstimate | None
    silent_s: float
    silence_limit_s: float
    delay_max_s: float
    lost_before: int
    is_taring: bool

    def report(self, name: str) -> NamedReport:
        """Return the report of the node."""
        errors = self._find_errors()
        warnings = self._find_warnings()
        level = ERROR if errors else WARNING if warnings else OK
        message = "; ".join([*errors, *warnings]) or "ok"
        return NamedReport(name, level, message, self._values())

    def _find_errors(self) -> list[str]:
        """Return what keeps the node from estimating."""
        if self.reader.problem:
            return [self.reader.problem]
        if self.silent_s > self.silence_limit_s:
            return [f"silent {self.silent_s:.1f} s"]
        return []

    def _find_warnings(self) -> list[str]:
        """Return what makes estimates worse, or may do so."""
        warnings: list[str] = []
        if self.is_taring:
            warnings.append("a tare is under way")
        elif not self.session.tared:
            warnings.append("not tared: move in free air, then call ~/tare")
        lost = self.loss.lost - self.lost_before
        if lost:
            warnings.append(f"{lost} joint states lost since the last report")
        estimate = self.estimate
        if estimate is None:
            return warnings
        if estimate.status is Status.REJECTED:
            warnings.append(f"sample rejected: {estimate.wrench.message}")
        elif estimate.warnings is not SensorWarning.NONE:
            warnings.append(f"{estimate.warnings}: {estimate.wrench.message}")
        return warnings

    def _values(self) -> dict[str, str]:
        """Return counts and the latest numbers by name."""
        counts = self.reader.counts
        values: dict[str, float] = {
            "received": self.loss.received,
            "lost": self.loss.lost,
            "used": counts.used,
            "other_joints": counts.other_joints,
            "malformed": counts.malformed,
            "without_effort": counts.without_effort,
            "stale": counts.stale,
            "unmatched": counts.unmatched,
            "rejected": self.session.rejected,
            "longest_gap_s": max(self.reader.longest_gap_s, self.silent_s),
            "delay_max_s": self.delay_max_s,
            "estimator_lag_s": self.session.lag_s,
            "tared": self.session.tared,
        }
        if self.estimate is not None:
            values["depth_m"] = self.estimate.depth_m
            values["layer"] = self.estimate.identification.layer
            values["axial_std_N"] = self.estimate.wrench.axial_std
        texts = {name: format_value(value) for name, value in values.items()}
        if not self.loss.is_counting:
            texts["lost"] = "unknown: the middleware numbers no messages"
        if self.estimate is not None:
            texts["status"] = str(self.estimate.status)
            texts["warnings"] = str(self.estimate.warnings or "none")
        return texts
