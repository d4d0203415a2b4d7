"""A plan against what was found in a log: the needle's path, and its ruptures."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from foundation.arrays import Array
from identification import LayerEstimate
from needleforce.anatomy import NeedleClearance, PlanError, PlanState
from needleforce.anatomy.needle_surroundings import sort_clearances
from needleforce.cli.logs.result import Result
from needleforce.cli.terminal import json_text
from needleforce.depth_zero import PLANNED_ENTRY, DepthZero
from needleforce.needle_on_plan import (
    PlanDeviation,
    describe_deviation,
    describe_to_target,
    describe_too_near,
    state_values,
)
from needleforce.plan_file import LoadedPlan
from residual.tool_kinematics import ToolKinematics

NOTE = (
    "Depths below the planned entry. Probability: that the rupture led into that "
    "layer. Deeper: by how much it lies deeper than planned."
)


class PlanFound(NamedTuple):
    """A plan against what was found.

    Attributes:
        ruptures: A line of text per rupture; empty where no layer can be named.
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
        zero: The planned entry, from which depths count; None without one.
    """

    ruptures: pd.DataFrame
    last: PlanState | None
    deepest: PlanDeviation | None
    nearest: tuple[NeedleClearance, ...]
    off_fraction: float
    warnings: tuple[str, ...]
    zero: DepthZero | None = None

    def sentences(self) -> list[str]:
        """Return where the needle was against the plan."""
        shown_clearances = 3
        sentences: list[str] = []
        if self.last is not None and not self.off_fraction:
            sentences.append(
                f"Plan against found: {len(self.ruptures)} ruptures matched; all lies "
                f"{1e3 * self.last.offset_m:+.1f} ± {1e3 * self.last.offset_std_m:.1f} "
                "mm deeper than planned."
            )
        if self.deepest is not None:
            sentences.append(
                f"Needle at its deepest, {1e3 * self.deepest.depth_m:.1f} mm below the "
                f"planned entry: {describe_deviation(self.deepest)}."
            )
        if self.nearest:
            nearest = ", ".join(map(str, self.nearest[:shown_clearances]))
            sentences.append(f"Nearest on its way: {nearest}.")
        return sentences

    def doubts(self) -> list[str]:
        """Return where the needle left the plan, then what else is doubtful."""
        doubts: list[str] = []
        if self.off_fraction:
            doubts.append(
                f"OFF PLAN for {100.0 * self.off_fraction:.0f} % of the rows below the "
                "planned entry: no layer is named from the plan"
            )
        if self.deepest is not None and self.deepest.is_past_target:
            doubts.append(
                "PAST THE TARGET: at its deepest the tip was "
                f"{describe_to_target(self.deepest)}"
            )
        doubts += [describe_too_near(one) for one in self.nearest if one.is_too_near]
        return [*doubts, *self.warnings]

    def state_json(self) -> bytes:
        """Return where the needle was at its deepest, and how near it came, as JSON."""
        values = (
            {} if self.deepest is None else state_values(self.deepest, self.nearest)
        )
        values["off_plan_fraction"] = self.off_fraction
        return json_text(values).encode()

    def result(self, log: str) -> Result:
        """Return it as part of the result of a log."""
        caption = "Plan against found"
        return Result(
            log=log,
            title="Plan",
            sentences=tuple(self.sentences()),
            warnings=tuple(self.doubts()),
            tables={caption: self.ruptures} if len(self.ruptures) else {},
            notes={caption: NOTE},
            files={"needle_on_plan.json": self.state_json()},
        )


def compare_with_plan(
    plan: LoadedPlan,
    tool: ToolKinematics,
    q_rad: Array,
    travel_m: Array,
    layers: Sequence[LayerEstimate],
) -> PlanFound:
    """Compare the needle of a log, and the ruptures found, with a plan.

    Args:
        plan: The plan.
        tool: Kinematics of the needle, which are updated.
        q_rad: Joint positions, shape (m, n).
        travel_m: Travel of the needle since the first finite row, shape (m,).
        layers: The layers found; their depths are travel.
    """
    warnings = list(plan.warnings)
    rows = np.flatnonzero(np.isfinite(travel_m))
    zero: DepthZero | None = None
    if len(rows) and plan.entry_in_base_m is not None:
        tool.update(q_rad[rows[0]])
        way_m = plan.entry_in_base_m - tool.pose[:3, 3]
        zero = DepthZero(float(tool.axis_in_base.dot(way_m)), PLANNED_ENTRY)
    compared = rows[::10]
    below, nearest = _compare_with_path(plan, tool, q_rad, compared.tolist())
    if plan.path is not None and not below:
        warnings.append("the needle never came below the planned entry")
    rows_off = sum(deviation.is_off_plan for deviation in below.values())
    deepest = max(below, key=lambda row: travel_m[row], default=None)

    entry_m = 0.0 if zero is None else zero.depth_m
    ruptures_m = [layer.rupture.depth_m - entry_m for layer in layers]
    contact_m = layers[0].start_depth_m - entry_m if layers else None
    lines: list[dict[str, str]] = []
    last: PlanState | None = None
    try:
        for number, depth_m in enumerate(ruptures_m, 1):
            state = plan.match.state(depth_m, ruptures_m[:number], contact_m=contact_m)
            lines.append(_rupture_cells(number, depth_m, state, plan))
        if len(compared):
            deepest_m = float(travel_m[compared].max()) - entry_m
            last = plan.match.state(deepest_m, ruptures_m, contact_m=contact_m)
    except PlanError as error:
        warnings.append(f"ruptures not matched with the plan: {error}")
    return PlanFound(
        ruptures=pd.DataFrame([] if rows_off or last is None else lines),
        last=last,
        deepest=None if deepest is None else below[deepest],
        nearest=sort_clearances(nearest.values()),
        off_fraction=rows_off / max(len(below), 1),
        warnings=tuple(warnings),
        zero=zero,
    )


def _compare_with_path(
    plan: LoadedPlan, tool: ToolKinematics, q_rad: Array, rows: Sequence[int]
) -> tuple[dict[int, PlanDeviation], dict[str, NeedleClearance]]:
    """Return the deviations of rows below the entry, and the nearest of each structure.

    Args:
        plan: The plan; without a path both are empty.
        tool: Kinematics of the needle, which are updated.
        q_rad: Joint positions, shape (m, n).
        rows: Which of them are compared.
    """
    below: dict[int, PlanDeviation] = {}
    nearest: dict[str, NeedleClearance] = {}
    if plan.path is None:
        return below, nearest
    around = plan.surroundings
    for row in rows:
        tool.update(q_rad[row])
        tip_m = tool.pose[:3, 3]
        axis = tool.axis_in_base
        deviation = plan.path.deviation(tip_m, axis)
        if deviation.depth_m <= 0.0:
            continue
        below[row] = deviation
        for one in () if around is None else around.clearances(tip_m, axis):
            before = nearest.get(one.name, one)
            nearest[one.name] = min(before, one, key=lambda each: each.distance_m)
    return below, nearest


def _rupture_cells(
    number: int, depth_m: float, state: PlanState, plan: LoadedPlan
) -> dict[str, str]:
    """Return the line of a rupture, by the heads of the columns."""
    planned_mm = ""
    deeper_mm = ""
    if state.matched >= 0:
        planned_m = plan.match.layers[state.matched].entry_m
        planned_mm = f"{1e3 * planned_m:.1f}"
        deeper_mm = f"{1e3 * (depth_m - planned_m):+.1f}"
    return {
        "rupture": str(number),
        "at mm": f"{1e3 * depth_m:.1f}",
        "into": state.matched_name,
        "probability": f"{100.0 * state.matched_probability:.0f} %",
        "planned mm": planned_mm,
        "deeper mm": deeper_mm,
    }
