"""A plan against what was found in a log: the needle's path, and its ruptures."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from foundation.arrays import Array
from needleforce.anatomy import NeedleClearance, PlanError
from needleforce.anatomy.clearance import sort_clearances
from needleforce.cli.logs.layers import LayerReplay
from needleforce.cli.logs.result import Result
from needleforce.cli.terminal import json_text, warn
from needleforce.depth_zero import PLANNED_ENTRY, DepthZero
from needleforce.needle_on_plan import (
    PlanDeviation,
    describe_deviation,
    describe_to_target,
    describe_too_near,
    state_values,
)
from needleforce.plan_file import LoadedPlan
from needleforce.session_replay import SensorReplay
from residual.tool_kinematics import ToolKinematics

CAPTION = "Plan against found"

NOTE = (
    "Depths below the planned entry. Probability: that the rupture led into that "
    "layer. Deeper: by how much it lies deeper than planned."
)


def compare_with_plan(
    result: Result, plan: LoadedPlan, replay: SensorReplay, found: LayerReplay
) -> LayerReplay:
    """Add to a result how the needle of a log, and the ruptures found, fit a plan.

    Args:
        result: The result.
        plan: The plan.
        replay: The forces of the log.
        found: The layers in them; their depths are travel.

    Returns:
        The layers with depths that count from the planned entry, if there is one.
    """
    warnings = list(plan.warnings)
    q_rad = replay.log["q_rad"]
    config = replay.config
    tool = ToolKinematics(replay.robot, config.frame, config.insertion_axis)
    travel_m = replay.rows["travel_m"].to_numpy()
    rows = np.flatnonzero(np.isfinite(travel_m))
    entry_m = 0.0
    if len(rows) and plan.path is not None:
        tool.update(q_rad[rows[0]])
        way_m = plan.path.entry_m - tool.pose[:3, 3]
        entry_m = float(tool.axis_in_base.dot(way_m))
        found = replace(found, zero=DepthZero(entry_m, PLANNED_ENTRY))
    below, nearest = _compare_with_path(plan, tool, q_rad[rows[::10]])
    if plan.path is not None and not below:
        warnings.append("the needle never came below the planned entry")
    off_fraction = sum(each.is_off_plan for each in below) / max(len(below), 1)
    try:
        if not off_fraction:
            _match_ruptures(result, plan, found, entry_m)
    except PlanError as error:
        warnings.append(f"ruptures not matched with the plan: {error}")
    # Beside the entry a line has a depth, too: the deepest is that along the needle.
    deepest = max(below, key=lambda each: each.depth_m, default=None)
    clearances = sort_clearances(nearest.values())
    doubts = add_place_on_plan(result, deepest, clearances, off_fraction)
    warn([*doubts, *warnings])
    result.warnings += [*doubts, *warnings]
    return found


def add_place_on_plan(
    result: Result,
    deepest: PlanDeviation | None,
    nearest: Sequence[NeedleClearance],
    off_fraction: float,
) -> list[str]:
    """Add to a result where the needle of a log was against a plan.

    Args:
        result: The result.
        deepest: The needle against the planned path where it was deepest; None without
            a planned path, or above its entry.
        nearest: Of each structure at risk the nearest that the needle, below the
            planned entry, or its way ahead came to it; what is too near first.
        off_fraction: Fraction of the time below the planned entry for which the needle
            was off the plan.

    Returns:
        What is wrong with it, the worst first.
    """
    shown_clearances = 3
    doubts: list[str] = []
    values = {"off_plan_fraction": off_fraction}
    if off_fraction:
        doubts.append(
            f"OFF PLAN for {100.0 * off_fraction:.0f} % of the rows below the planned "
            "entry: no layer is named from the plan"
        )
    if deepest is not None:
        values |= state_values(deepest, tuple(nearest))
        result.sentences.append(
            f"Needle at its deepest, {1e3 * deepest.depth_m:.1f} mm below the planned "
            f"entry: {describe_deviation(deepest)}."
        )
        if deepest.is_past_target:
            where = describe_to_target(deepest)
            doubts.append(f"PAST THE TARGET: at its deepest the tip was {where}")
    doubts += [describe_too_near(one) for one in nearest if one.is_too_near]
    if nearest:
        clearances = ", ".join(map(str, nearest[:shown_clearances]))
        result.sentences.append(f"Nearest on its way: {clearances}.")
    result.files["needle_on_plan.json"] = json_text(values).encode()
    return doubts


def _match_ruptures(
    result: Result, plan: LoadedPlan, found: LayerReplay, entry_m: float
) -> None:
    """Add to a result the layers of the plan into which ruptures led.

    Args:
        result: The result.
        plan: The plan.
        found: The ruptures; their depths are travel.
        entry_m: Travel to the planned entry.

    Raises:
        PlanError: They fit no layers of the plan.
    """
    ruptures_m = [layer.rupture.depth_m - entry_m for layer in found.layers]
    lines: list[dict[str, str]] = []
    offset = ""
    for number, depth_m in enumerate(ruptures_m, 1):
        contact_m = found.layers[0].start_depth_m - entry_m
        state = plan.match.state(depth_m, ruptures_m[:number], contact_m=contact_m)
        offset = f"{1e3 * state.offset_m:+.1f} ± {1e3 * state.offset_std_m:.1f} mm"
        line = {
            "at mm": f"{1e3 * depth_m:.1f}",
            "into": state.matched_name,
            "probability": f"{100.0 * state.matched_probability:.0f} %",
            "planned mm": "",
            "deeper mm": "",
        }
        if state.matched >= 0:
            planned_m = plan.match.layers[state.matched].entry_m
            line["planned mm"] = f"{1e3 * planned_m:.1f}"
            line["deeper mm"] = f"{1e3 * (depth_m - planned_m):+.1f}"
        lines.append(line)
    if lines:
        result.tables[CAPTION] = pd.DataFrame(lines)
        result.notes[CAPTION] = NOTE
        result.sentences.append(
            f"Plan against found: {len(lines)} ruptures matched; all lies {offset} "
            "deeper than planned."
        )


def _compare_with_path(
    plan: LoadedPlan, tool: ToolKinematics, q_rad: Iterable[Array]
) -> tuple[list[PlanDeviation], dict[str, NeedleClearance]]:
    """Return the deviations below the entry, and the nearest of each structure.

    Args:
        plan: The plan; without a path both are empty.
        tool: Kinematics of the needle, which are updated.
        q_rad: Joint positions that are compared, shape (m, n).
    """
    below: list[PlanDeviation] = []
    nearest: dict[str, NeedleClearance] = {}
    if plan.path is None:
        return below, nearest
    around = plan.surroundings
    for joints_rad in q_rad:
        tool.update(joints_rad)
        tip_m = tool.pose[:3, 3]
        axis = tool.axis_in_base
        deviation = plan.path.deviation(tip_m, axis)
        if deviation.depth_m <= 0.0:
            continue
        below.append(deviation)
        for one in () if around is None else around.clearances(tip_m, axis):
            before = nearest.get(one.name, one)
            nearest[one.name] = min(before, one, key=lambda each: each.distance_m)
    return below, nearest
