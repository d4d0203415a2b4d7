"""A plan against what was found in a log: the needle's path, and its ruptures."""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from foundation.arrays import Array
from identification import LayerEstimate
from needleforce import plots
from needleforce.anatomy import Layer, NeedleClearance, PlanError, PlanMatch, PlanState
from needleforce.anatomy.needle_surroundings import sort_clearances
from needleforce.cli.logs.outputs import Answer
from needleforce.depth_zero import PLANNED_ENTRY, DepthZero
from needleforce.needle_on_plan import (
    PlanDeviation,
    describe_deviation,
    describe_to_target,
    describe_too_near,
    state_values,
)
from needleforce.plan_file import LoadedPlan
from needleforce.sensor_replay import SensorReplay
from residual.tool_kinematics import ToolKinematics

NOTE = (
    "Depths below the planned entry. Probability: that the rupture led into that "
    "layer. Deeper: by how much it lies deeper than planned."
)

SHOWN_CLEARANCES = 3
"""Nearest structures that are named."""

M_TO_MM = 1e3


class NamedRupture(NamedTuple):
    """A rupture, and what the plan says of it.

    Attributes:
        depth_m: Below the planned entry.
        state: Plan and ruptures up to this one.
    """

    depth_m: float
    state: PlanState


class PlanFound(NamedTuple):
    """A plan against what was found.

    Attributes:
        layers: The planned layers.
        ruptures: The ruptures, in the order in which they came.
        last: Plan and all ruptures with the needle at its deepest; None where they
            cannot be matched.
        deepest: The needle against the planned path where it was deepest; None without
            a planned path, or above its entry.
        nearest: Of each structure at risk the nearest that the needle, below the
            planned entry, or its way ahead came to it; what is too near first, then
            the nearest.
        off_fraction: Fraction of the time below the planned entry for which the needle
            was off the plan.
        warnings: What is wrong with the plan, or could not be compared.
    """

    layers: tuple[Layer, ...]
    ruptures: tuple[NamedRupture, ...]
    last: PlanState | None
    deepest: PlanDeviation | None
    nearest: tuple[NeedleClearance, ...]
    off_fraction: float
    warnings: tuple[str, ...]

    def answer(self) -> Answer:
        """Return where the needle was against the plan, and the table of ruptures."""
        sentences: list[str] = []
        if self.last is not None and not self._is_off_plan:
            sentences.append(
                f"Plan against found: {len(self.ruptures)} ruptures matched; all lies "
                f"{M_TO_MM * self.last.offset_m:+.1f} ± "
                f"{M_TO_MM * self.last.offset_std_m:.1f} mm deeper than planned."
            )
        if self.deepest is not None:
            sentences.append(
                f"Needle at its deepest, {M_TO_MM * self.deepest.depth_m:.1f} mm below "
                f"the planned entry: {describe_deviation(self.deepest)}."
            )
        if self.nearest:
            nearest = ", ".join(map(str, self.nearest[:SHOWN_CLEARANCES]))
            sentences.append(f"Nearest on its way: {nearest}.")
        return Answer(tuple(sentences), self._describe_warnings(), self._tables())

    def state_json(self) -> bytes:
        """Return where the needle was at its deepest, and how near it came, as JSON."""
        values = (
            {} if self.deepest is None else state_values(self.deepest, self.nearest)
        )
        values["off_plan_fraction"] = self.off_fraction
        return msgspec.json.format(msgspec.json.encode(values)) + b"\n"

    def text(self) -> str:
        """Return the same as lines below the layers."""
        answer = self.answer()
        rows = [row for table in answer.tables for row in table.rows]
        lines = [
            *answer.sentences,
            *(f"warning: {text}" for text in answer.warnings),
            *(f"rupture {row[0]}: {row[1]} mm, into {row[2]}" for row in rows),
        ]
        return "\n" + "".join(f"{line}\n" for line in lines)

    @property
    def _is_off_plan(self) -> bool:
        return self.off_fraction > 0.0

    def _describe_warnings(self) -> tuple[str, ...]:
        """Return where the needle left the plan, then what else is doubtful."""
        off_plan: tuple[str, ...] = ()
        if self._is_off_plan:
            off_plan = (
                f"OFF PLAN for {100.0 * self.off_fraction:.0f} % of the rows below the "
                "planned entry: no layer is named from the plan",
            )
        past_target: tuple[str, ...] = ()
        if self.deepest is not None and self.deepest.is_past_target:
            past_target = (
                "PAST THE TARGET: at its deepest the tip was "
                f"{describe_to_target(self.deepest)}",
            )
        near = [describe_too_near(one) for one in self.nearest if one.is_too_near]
        return (*off_plan, *past_target, *near, *self.warnings)

    def _tables(self) -> tuple[plots.PageTable, ...]:
        """Return the table of ruptures; none where no layer can be named."""
        if self._is_off_plan or not self.ruptures:
            return ()
        cells = tuple(
            self._cells(number, one) for number, one in enumerate(self.ruptures, 1)
        )
        head = ("rupture", "at mm", "into", "probability", "planned mm", "deeper mm")
        table = plots.PageTable(
            caption="Plan against found",
            head=head,
            rows=cells,
            numeric=frozenset((0, 1, 3, 4, 5)),
            note=NOTE,
        )
        return (table,)

    def _cells(self, number: int, rupture: NamedRupture) -> tuple[str, ...]:
        """Return the line of a rupture."""
        state = rupture.state
        planned = deeper = ""
        if state.matched >= 0:
            planned_m = self.layers[state.matched].entry_m
            planned = f"{M_TO_MM * planned_m:.1f}"
            deeper = f"{M_TO_MM * (rupture.depth_m - planned_m):+.1f}"
        return (
            str(number),
            f"{M_TO_MM * rupture.depth_m:.1f}",
            state.matched_name,
            f"{100.0 * state.matched_probability:.0f} %",
            planned,
            deeper,
        )


class PlanWatch:
    """Watches the needle of a log against a plan.

    Args:
        plan: The plan.
        replay: The sensor, whose travel begins at the first finite row.
    """

    def __init__(self, plan: LoadedPlan, replay: SensorReplay) -> None:
        config = replay.config
        self._plan = plan
        self._tool = ToolKinematics(replay.robot, config.frame, config.insertion_axis)
        self._entry_travel_m: float | None = None  # travel at the planned entry
        self._deepest_m = -np.inf
        self._deepest: PlanDeviation | None = None
        self._nearest: dict[str, NeedleClearance] = {}
        self._rows_below = 0
        self._rows_off = 0

    @property
    def zero(self) -> DepthZero | None:
        """The planned entry, from which depths count; None without one."""
        if self._plan.entry_in_base_m is None:
            return None
        return DepthZero(self._entry_travel_m or 0.0, PLANNED_ENTRY)

    def add(self, q_rad: Array, travel_m: Array) -> None:
        """Take further rows: joint positions, (m, n), and travel of the tool, (m,)."""
        # Every so many rows the needle is compared with the planned path.
        compared_rows = 10
        finite = np.flatnonzero(np.isfinite(q_rad).all(axis=1))
        if len(finite) and self._entry_travel_m is None:
            self._begin(self._plan, q_rad[finite[0]])
        for row in finite[::compared_rows].tolist():
            self._compare_row(self._plan, q_rad[row], float(travel_m[row]))

    def _begin(self, plan: LoadedPlan, q_rad: Array) -> None:
        """Note where travel is zero."""
        self._tool.update(q_rad)
        entry_m = plan.entry_in_base_m
        self._entry_travel_m = 0.0
        if entry_m is not None:
            way_m = entry_m - self._tool.pose[:3, 3]
            self._entry_travel_m = float(way_m @ self._axis)

    @property
    def _axis(self) -> Array:
        """Direction of the needle in the robot's base, shape (3,)."""
        return self._tool.pose[:3, :3] @ self._tool.axis_in_tool

    def _compare_row(self, plan: LoadedPlan, q_rad: Array, travel_m: float) -> None:
        """Compare the needle of a row with the planned path."""
        is_deepest = travel_m > self._deepest_m
        self._deepest_m = max(self._deepest_m, travel_m)
        if plan.path is None:
            return
        self._tool.update(q_rad)
        deviation = plan.path.deviation(self._tool.pose[:3, 3], self._axis)
        if deviation.depth_m <= 0.0:
            return
        self._rows_below += 1
        self._rows_off += deviation.is_off_plan
        if plan.surroundings is not None:
            tip_m = self._tool.pose[:3, 3]
            for one in plan.surroundings.clearances(tip_m, self._axis):
                before = self._nearest.get(one.name, one)
                self._nearest[one.name] = min(
                    before, one, key=lambda clearance: clearance.distance_m
                )
        if is_deepest:
            self._deepest = deviation

    def compare(self, layers: Sequence[LayerEstimate]) -> PlanFound:
        """Match the ruptures of the layers found with the plan."""
        plan = self._plan
        entry_m = self._entry_travel_m or 0.0
        ruptures_m = [layer.rupture.depth_m - entry_m for layer in layers]
        contact_m = layers[0].start_depth_m - entry_m if layers else None
        warnings = list(plan.warnings)
        if plan.path is not None and not self._rows_below:
            warnings.append("the needle never came below the planned entry")
        ruptures: tuple[NamedRupture, ...] = ()
        last: PlanState | None = None
        try:
            ruptures = _match(plan.match, ruptures_m, contact_m)
            if np.isfinite(self._deepest_m):
                deepest_m = self._deepest_m - entry_m
                last = plan.match.state(deepest_m, ruptures_m, contact_m=contact_m)
        except PlanError as error:
            warnings.append(f"ruptures not matched with the plan: {error}")
        return PlanFound(
            layers=plan.match.layers,
            ruptures=ruptures,
            last=last,
            deepest=self._deepest,
            nearest=sort_clearances(self._nearest.values()),
            off_fraction=self._rows_off / max(self._rows_below, 1),
            warnings=tuple(warnings),
        )


def _match(
    match: PlanMatch, ruptures_m: list[float], contact_m: float | None
) -> tuple[NamedRupture, ...]:
    """Match ruptures with a plan, each with those before it."""
    return tuple(
        NamedRupture(
            depth_m, match.state(depth_m, ruptures_m[:count], contact_m=contact_m)
        )
        for count, depth_m in enumerate(ruptures_m, 1)
    )
