"""A plan against what was found in a log: the needle's path, and its ruptures."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

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


def plan_result(
    log: str,
    *,
    deepest: PlanDeviation | None,
    nearest: Sequence[NeedleClearance],
    off_fraction: float,
    warnings: Sequence[str] = (),
) -> Result:
    """Return where the needle of a log was against a plan.

    Args:
        log: Name of the log.
        deepest: The needle against the planned path where it was deepest; None without
            a planned path, or above its entry.
        nearest: Of each structure at risk the nearest that the needle, below the
            planned entry, or its way ahead came to it; what is too near first.
        off_fraction: Fraction of the time below the planned entry for which the needle
            was off the plan.
        warnings: What is wrong with the plan, or could not be compared.
    """
    shown_clearances = 3
    doubts = [describe_too_near(one) for one in nearest if one.is_too_near]
    sentences: list[str] = []
    values: dict[str, Any] = {}
    if deepest is not None:
        values = state_values(deepest, tuple(nearest))
        sentences.append(
            f"Needle at its deepest, {1e3 * deepest.depth_m:.1f} mm below the planned "
            f"entry: {describe_deviation(deepest)}."
        )
        if deepest.is_past_target:
            where = describe_to_target(deepest)
            doubts.insert(0, f"PAST THE TARGET: at its deepest the tip was {where}")
    if off_fraction:
        doubts.insert(
            0,
            f"OFF PLAN for {100.0 * off_fraction:.0f} % of the rows below the planned "
            "entry: no layer is named from the plan",
        )
    if nearest:
        clearances = ", ".join(map(str, nearest[:shown_clearances]))
        sentences.append(f"Nearest on its way: {clearances}.")
    state = json_text({**values, "off_plan_fraction": off_fraction})
    return Result(
        log=log,
        title="Plan",
        sentences=tuple(sentences),
        warnings=(*doubts, *warnings),
        files={"needle_on_plan.json": state.encode()},
    )


def compare_with_plan(
    log: str,
    plan: LoadedPlan,
    tool: ToolKinematics,
    q_rad: Array,
    travel_m: Array,
    layers: Sequence[LayerEstimate],
) -> tuple[Result, DepthZero | None]:
    """Compare the needle of a log, and the ruptures found, with a plan.

    Args:
        log: Name of the log.
        plan: The plan.
        tool: Kinematics of the needle, which are updated.
        q_rad: Joint positions, shape (m, n).
        travel_m: Travel of the needle since the first finite row, shape (m,).
        layers: The layers found; their depths are travel.

    Returns:
        The result, and the planned entry, from which depths count; None without one.
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
    lines: list[dict[str, str]] = []
    matched = ""
    try:
        for depth_m, state in _match_ruptures(plan, layers, entry_m):
            lines.append(_rupture_cells(depth_m, state, plan))
            matched = (
                f"Plan against found: {len(lines)} ruptures matched; all lies "
                f"{1e3 * state.offset_m:+.1f} ± {1e3 * state.offset_std_m:.1f} mm "
                "deeper than planned."
            )
    except PlanError as error:
        lines = []
        warnings.append(f"ruptures not matched with the plan: {error}")
    result = plan_result(
        log,
        deepest=None if deepest is None else below[deepest],
        nearest=sort_clearances(nearest.values()),
        off_fraction=rows_off / max(len(below), 1),
        warnings=warnings,
    )
    if not lines or rows_off:
        return result, zero
    caption = "Plan against found"
    return replace(
        result,
        sentences=(matched, *result.sentences),
        tables={caption: pd.DataFrame(lines)},
        notes={caption: NOTE},
    ), zero


def _match_ruptures(
    plan: LoadedPlan, layers: Sequence[LayerEstimate], entry_m: float
) -> Iterator[tuple[float, PlanState]]:
    """Yield the depth of each rupture below the entry, and the plan after it."""
    ruptures_m = [layer.rupture.depth_m - entry_m for layer in layers]
    for number, depth_m in enumerate(ruptures_m, 1):
        contact_m = layers[0].start_depth_m - entry_m
        yield (
            depth_m,
            plan.match.state(depth_m, ruptures_m[:number], contact_m=contact_m),
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
    depth_m: float, state: PlanState, plan: LoadedPlan
) -> dict[str, str]:
    """Return the line of a rupture, by the heads of the columns."""
    planned_mm = ""
    deeper_mm = ""
    if state.matched >= 0:
        planned_m = plan.match.layers[state.matched].entry_m
        planned_mm = f"{1e3 * planned_m:.1f}"
        deeper_mm = f"{1e3 * (depth_m - planned_m):+.1f}"
    return {
        "at mm": f"{1e3 * depth_m:.1f}",
        "into": state.matched_name,
        "probability": f"{100.0 * state.matched_probability:.0f} %",
        "planned mm": planned_mm,
        "deeper mm": deeper_mm,
    }
